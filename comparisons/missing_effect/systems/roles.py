"""What the states of a model are to each other, and so where effects may sit and searches start."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import permutations

import numpy as np

from comparisons.missing_effect.systems.compiled import compiled
from comparisons.missing_effect.systems.model import Model
from comparisons.missing_effect.systems.places import Place
from surge_core.types import FloatArray

# Points at which an exact equation is compared with another state.
TRIES = 5
SAME = 1e-9
# Share of the largest slope of an equation below which it does not depend on a state.
DEPENDS = 1e-7
# A sign means something only where the signal spends time on both sides of it: this share of the
# samples beyond a twentieth of its rms, either way.
LEAST_SIDE_SHARE = 0.02
SIDE = 0.05

Places = Callable[[Model], tuple[Place, ...]]
Starts = Callable[[FloatArray], tuple[tuple[float, ...], ...]]


def free_equations(model: Model) -> tuple[int, ...]:
    """Return the states in whose equation something may be missing: not the cells of vectors."""
    names = enumerate(model.state_names)
    return tuple(i for i, name in names if name not in model.exact and i not in model.cells)


@lru_cache(maxsize=64)
def rates_of(model: Model) -> dict[int, tuple[int, float]]:
    """Return, for each exact state, the state that is its rate, as far as one is, and its factor.

    dq/dt = v makes v the rate of q, and so does dq/dt = S v for any S, which is the same at all
    states; it is not a number where parameters make it.
    """
    if model.simulate is not None:
        return {}
    factors = []
    for seed in range(2):
        x, dx, _ = _tries(model, seed)
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
    n, rng, found = len(model.states), np.random.default_rng(1), []
    for p in (_middle(model, 0), _middle(model, 1)):
        x, u = _drawn(model, rng)
        step, rhs = 1e-6 * x.max(), compiled(model)[0]
        above, below = (
            np.array([rhs(0.3, row, u, p) for row in x + by * np.eye(n)]) for by in (step, -step)
        )
        slopes = ((above - below) / (2.0 * step)).T
        acts = np.abs(slopes) > DEPENDS * np.max(np.abs(slopes), axis=1, keepdims=True)
        # A state that matters to its own slope is no integral of any.
        found.append(np.sign(slopes) * (acts & ~np.diag(acts)[:, None]))
    one, other = found
    pairs = np.argwhere((one == other) & (one != 0.0)).tolist()
    return {(i, j): int(one[i, j]) for i, j in pairs if i != j}


def measured_as(model: Model) -> dict[int, str]:
    """Return, for each state that is measured as it is, the output that measures it."""
    if model.simulate is not None:
        return {}
    x, _, y = _tries(model)
    agree = np.all(np.abs(y[:, None, :] - x[:, :, None]) < SAME, axis=0)
    return {i: model.output_names[k] for i, k in np.argwhere(agree).tolist()}


def _middle(model: Model, seed: int) -> tuple[float, ...]:
    """Return parameters well within their bounds: an offset that starts at zero would hide."""
    shares = np.random.default_rng(seed).uniform(0.3, 0.7, len(model.params))
    given = zip(model.params.values(), shares, strict=True)
    return tuple(float(q.low + share * (q.high - q.low)) for q, share in given)


def _tries(
    model: Model, seed: int = 0, *, driven: bool = True
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the model at a few points: states, their slopes, outputs."""
    rng, p, out = np.random.default_rng(seed + 10), _middle(model, seed), []
    rhs, output = compiled(model)
    for _ in range(TRIES):
        x, u = _drawn(model, rng)
        out.append((x, *(function(0.3, x, u * driven, p) for function in (rhs, output))))
    states, slopes, outputs = map(np.array, zip(*out, strict=True))
    return states, slopes, outputs


def _drawn(model: Model, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Draw states and inputs of the size at which the model gives numbers."""
    size = max((*model.trial[0], *model.trial[1]))
    x, u = (size * rng.uniform(0.1, 1.0, len(each)) for each in (model.states, model.inputs))
    return x, u


@lru_cache(maxsize=64)
def feeds_through(model: Model) -> bool:
    """Tell whether an input enters an output at once, as that of a black box may."""
    if model.simulate is not None:
        return True
    return bool(np.any(_tries(model)[2] != _tries(model, driven=False)[2]))


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
        return set(rates_of(model))
    still = np.all(_tries(model)[1] == _tries(model, driven=False)[1], axis=0)
    return {i for i in summed if still[i]} | set(rates_of(model))


def displacements(model: Model) -> tuple[int, ...]:
    """Return the states that may be deflections: all but those that are rates of others."""
    speeds = {j for j, _ in rates_of(model).values()}
    return tuple(i for i in physical(model) if i not in speeds)


def rates(model: Model) -> tuple[int, ...]:
    """Return the states that may be speeds or flows: all but those whose rate is a state."""
    known = _deflections(model)
    return tuple(i for i in physical(model) if i not in known)


def every_signal(model: Model) -> tuple[int, ...]:
    """Return the signals that a term may act on: states, then inputs."""
    n = len(model.states)
    return (*physical(model), *range(n, n + len(model.inputs)))


def on(signals: Callable[[Model], Sequence[int]]) -> Places:
    """Return places in every equation that is not exact, on some signals."""
    return lambda model: tuple(Place(i, s) for i in free_equations(model) for s in signals(model))


def against_storing(model: Model) -> tuple[Place, ...]:
    """Return where a deflection pushes back: its own equation, and those of what it sums up."""
    free, stored = free_equations(model), stored_from(model)
    return tuple(
        Place(i, s, sign=1 if i == s else stored[s, i])
        for s in displacements(model)
        for i in free
        if i == s or (s, i) in stored
    )


def _at_spills(model: Model) -> tuple[Place, ...]:
    out = []
    free, units = free_equations(model), list(model.states.values())
    for i in (i for i in displacements(model) if i in free):
        out.append(Place(i, i, -1))
        out += [Place(i, i, j) for j in free if j != i and units[j] == units[i]]
    return tuple(out)


def _on_square_products(model: Model) -> tuple[Place, ...]:
    pairs = list(permutations(every_signal(model), 2))
    return tuple(Place(i, a, b) for i in free_equations(model) for a, b in pairs)


# Where effects may sit, by the names that the catalogue has for it. Equations are those that are
# not exact; what resists a motion acts on that motion; a level spills, lost or into another of its
# unit; and what is the same for all channels has one place.
PLACES: dict[str, Places] = {
    "alone": lambda model: tuple(map(Place, free_equations(model))),
    "on_own": lambda model: tuple(Place(i, i) for i in free_equations(model) if i in rates(model)),
    "on_displacements": on(displacements),
    "on_rates": on(rates),
    "on_angles": on(lambda model: [i for i, u in enumerate(model.states.values()) if u == "rad"]),
    "on_signals": on(every_signal),
    "on_products": lambda model: tuple(
        place for place in _on_square_products(model) if place.signal < place.other
    ),
    "on_square_products": _on_square_products,
    "against_storing": against_storing,
    "at_inputs": lambda model: tuple(
        Place(j, len(model.states) + j) for j in range(len(model.inputs))
    ),
    "at_states": lambda model: tuple(Place(i, i) for i in physical(model)),
    "at_spills": _at_spills,
    "at_outputs": lambda model: tuple(map(Place, range(len(model.outputs)))),
    "at_parameters": lambda model: tuple(map(Place, range(len(model.params)))),
    "everywhere": lambda _: (Place(-1),),
}


def fixed(*starts: Sequence[float]) -> Starts:
    """Start from numbers that are the same for every signal."""
    return lambda _: tuple(map(tuple, starts))


def quantiles(
    of: str, shares: Sequence[float], before: Sequence[float] = (), after: Sequence[float] = ()
) -> Starts:
    """Start a threshold from quantiles of a signal, or of its size, among other numbers."""

    def starts(signal: FloatArray) -> tuple[tuple[float, ...], ...]:
        values = np.quantile(np.abs(signal) if of == "size" else signal, shares)
        return tuple((*before, float(value), *after) for value in values)

    return starts


def always(_: FloatArray, __: FloatArray) -> str:
    """Refuse no signal."""
    return ""


def both_signs(signal: FloatArray, _: FloatArray) -> str:
    """Return why a signal, over its rms, does not change sign, or an empty text."""
    share = min(float(np.mean(signal > SIDE)), float(np.mean(signal < -SIDE)))
    return "" if share >= LEAST_SIDE_SHARE else "needs a signal that changes sign"


def blind_to_sign(simulated: FloatArray, reading: FloatArray) -> str:
    """Return why a sensor cannot be blind to a sign, or an empty text.

    What is read must change its sign, as the model has it, and the reading must not, but for a few
    that noise takes below zero. Both are over their rms.
    """
    if float(np.mean(reading < -SIDE)) > LEAST_SIDE_SHARE:
        return "needs a reading that stays on one side of zero"
    one_sided = both_signs(simulated, reading)
    return one_sided and "needs an output that changes sign, and that of the fitted model does not"
