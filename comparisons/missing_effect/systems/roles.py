"""What the states of a model are to each other: displacements, rates, angles, free equations."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from comparisons.missing_effect.systems.model import Model
from surge_core.types import FloatArray

# Points at which an exact equation is compared with another state.
TRIES = 5
SAME = 1e-9
# Share of the largest slope of an equation below which it does not depend on a state.
DEPENDS = 1e-7
ANGLE_UNITS = ("rad", "deg", "°")


def free_equations(model: Model) -> tuple[int, ...]:
    """Return the states in whose equation something may be missing: not the cells of vectors."""
    names = enumerate(model.state_names)
    return tuple(i for i, name in names if name not in model.exact and i not in model.cells)


def rate_of(model: Model) -> dict[int, int]:
    """Return, for each exact state, the state that is its rate, as far as one is.

    dq/dt = v makes v the rate of q, and so does dq/dt = S v for any S.
    """
    return {i: j for i, (j, _) in _rates(model).items()}


def rate_factors(model: Model) -> dict[int, float]:
    """Return S of dq/dt = S v for each exact state with a rate; NaN where parameters make it."""
    return {i: factor for i, (_, factor) in _rates(model).items()}


@lru_cache(maxsize=64)
def _rates(model: Model) -> dict[int, tuple[int, float]]:
    """Return rate and factor of each exact state; the factor is the same at all states."""
    if model.simulate is not None:
        return {}
    factors = []
    for seed in range(2):
        x, dx, _ = map(np.array, zip(*_tries(model, seed), strict=True))
        ratio = dx[:, :, None] / x[:, None, :]
        with np.errstate(invalid="ignore"):
            same = np.ptp(ratio, axis=0) <= SAME * np.abs(ratio[0])
        factors.append(np.where(same & (ratio[0] != 0.0), ratio[0], np.nan))
    one, other = factors
    known = np.where(np.abs(one - other) <= SAME * np.abs(one), one, np.nan)
    pairs = np.argwhere(np.isfinite(one) & np.isfinite(other)).tolist()
    exact = [i for i, name in enumerate(model.state_names) if name in model.exact]
    return {i: (j, float(known[i, j])) for i, j in pairs if i in exact and i != j}


@lru_cache(maxsize=64)
def stored_from(model: Model) -> dict[tuple[int, int], int]:
    """Return which states are integrals of which others, and with which sign: {(x, v): ±1}.

    A state is an integral where its own value does not matter to its slope: a deflection of
    speeds, a charge of a current. What resists it acts on those against the sign.
    """
    if model.simulate is not None:
        return {}
    n = len(model.states)
    signs: dict[tuple[int, int], set[int]] = {}
    rng = np.random.default_rng(1)
    for p in (_middle(model, 0), _middle(model, 1)):
        x, u = rng.uniform(0.1, 1.0, n), tuple(rng.uniform(0.1, 1.0, len(model.inputs)).tolist())
        slopes = np.array(
            [
                (_slope(model, x + step, u, p) - _slope(model, x - step, u, p)) / 2e-6
                for step in 1e-6 * np.eye(n)
            ]
        ).T
        sizes = np.max(np.abs(slopes), axis=1)
        for i in range(n):
            for j in (j for j in range(n) if j != i):
                free = abs(slopes[i, i]) <= DEPENDS * sizes[i]
                acts = abs(slopes[i, j]) > DEPENDS * sizes[i]
                signs.setdefault((i, j), set()).add(int(np.sign(slopes[i, j])) * (free and acts))
    return {pair: found.pop() for pair, found in signs.items() if found in ({1}, {-1})}


def _slope(model: Model, x: FloatArray, u: tuple[float, ...], p: tuple[float, ...]) -> FloatArray:
    return np.array(model.evaluate(0.3, tuple(x.tolist()), u, p)[0])


def measured_as(model: Model) -> dict[int, str]:
    """Return, for each state that is measured as it is, the output that measures it."""
    if model.simulate is not None:
        return {}
    x, _, y = map(np.array, zip(*_tries(model), strict=True))
    agree = np.all(np.abs(y[:, None, :] - x[:, :, None]) < SAME, axis=0)
    return {i: model.output_names[k] for i, k in np.argwhere(agree).tolist()}


def _middle(model: Model, seed: int) -> tuple[float, ...]:
    """Return parameters well within their bounds: an offset that starts at zero would hide."""
    shares = np.random.default_rng(seed).uniform(0.3, 0.7, len(model.params))
    return tuple(
        float(q.low + share * (q.high - q.low))
        for q, share in zip(model.params.values(), shares, strict=True)
    )


def _tries(
    model: Model, seed: int = 0
) -> list[tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]]:
    """Return the model at a few points: states, their slopes, outputs."""
    rng, p = np.random.default_rng(seed + 10), _middle(model, seed)
    out = []
    for _ in range(TRIES):
        x = tuple(rng.uniform(0.1, 1.0, len(model.states)).tolist())
        u = tuple(rng.uniform(0.1, 1.0, len(model.inputs)).tolist())
        out.append((x, *model.evaluate(0.3, x, u, p)))
    return out


def physical(model: Model) -> tuple[int, ...]:
    """Return the states on which something may act.

    An exact state that is no displacement is a definition of the user's, such as the filter of a
    controller: nothing in the plant feels it.
    """
    free, known = free_equations(model), _deflections(model) - model.cells
    return tuple(i for i in range(len(model.states)) if i in free or i in known)


def _deflections(model: Model) -> set[int]:
    """Return the exact states that sum up others: of one rate, or of several and of no input."""
    summed = {i for i, _ in stored_from(model)} - set(free_equations(model))
    if not summed:
        return set(rate_of(model))
    p, rest = _middle(model, 0), (0.0,) * len(model.inputs)
    inner = {
        i
        for i in summed
        if all(model.evaluate(0.3, x, rest, p)[0][i] == dx[i] for x, dx, _ in _tries(model))
    }
    return inner | set(rate_of(model))


def displacements(model: Model) -> tuple[int, ...]:
    """Return the states that may be deflections: all but those that are rates of others."""
    rates_ = set(rate_of(model).values())
    return tuple(i for i in physical(model) if i not in rates_)


def rates(model: Model) -> tuple[int, ...]:
    """Return the states that may be speeds or flows: all but those whose rate is a state."""
    known = _deflections(model)
    return tuple(i for i in physical(model) if i not in known)


def angles(model: Model) -> tuple[int, ...]:
    """Return the states that are angles in radians."""
    return tuple(i for i, unit in enumerate(model.states.values()) if unit in ANGLE_UNITS[:1])
