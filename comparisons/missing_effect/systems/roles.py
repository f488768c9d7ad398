"""What the states of a model are to each other: displacements, rates, angles, free equations."""

from __future__ import annotations

import numpy as np

from comparisons.missing_effect.systems.model import Model

__all__ = [
    "angles",
    "displacements",
    "free_equations",
    "measured_as",
    "physical",
    "rate_of",
    "rates",
]

# Points at which an exact equation is compared with another state.
TRIES = 5
SAME = 1e-9
ANGLE_UNITS = ("rad", "deg", "°")


def free_equations(model: Model) -> tuple[int, ...]:
    """Return the states in whose equation something may be missing."""
    return tuple(i for i, name in enumerate(model.state_names) if name not in model.exact)


def rate_of(model: Model) -> dict[int, int]:
    """Return, for each exact state, the state that is its rate, as far as one is.

    Parameters
    ----------
    model : Model
        The model; dq/dt = v makes v the rate of q.
    """
    agree = {
        (i, j)
        for i, name in enumerate(model.state_names)
        for j in range(len(model.states))
        if name in model.exact and i != j
    }
    for x, dx, _ in _tries(model):
        agree = {(i, j) for i, j in agree if abs(dx[i] - x[j]) < SAME}
    return dict(sorted(agree))


def measured_as(model: Model) -> dict[int, str]:
    """Return, for each state that is measured as it is, the output that measures it.

    Parameters
    ----------
    model : Model
        The model; an output that returns x.q makes q measured.
    """
    agree = {(i, k) for i in range(len(model.states)) for k in range(len(model.outputs))}
    for x, _, y in _tries(model):
        agree = {(i, k) for i, k in agree if abs(y[k] - x[i]) < SAME}
    return {i: model.output_names[k] for i, k in sorted(agree)}


def _tries(
    model: Model,
) -> list[tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]]:
    """Return the model at a few points: states, their slopes, outputs."""
    rng = np.random.default_rng(0)
    # Not at the starts: an offset that starts at zero would hide.
    p = tuple(
        float(q.low + share * (q.high - q.low))
        for q, share in zip(
            model.params.values(), rng.uniform(0.3, 0.7, len(model.params)), strict=True
        )
    )
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
    known = rate_of(model)
    free = set(free_equations(model))
    return tuple(i for i in range(len(model.states)) if i in free or i in known)


def displacements(model: Model) -> tuple[int, ...]:
    """Return the states that may be deflections: all but those that are rates of others."""
    rates_ = set(rate_of(model).values())
    return tuple(i for i in physical(model) if i not in rates_)


def rates(model: Model) -> tuple[int, ...]:
    """Return the states that may be speeds or flows: all but those whose rate is a state."""
    known = rate_of(model)
    return tuple(i for i in physical(model) if i not in known)


def angles(model: Model) -> tuple[int, ...]:
    """Return the states that are angles in radians."""
    return tuple(i for i, unit in enumerate(model.states.values()) if unit in ANGLE_UNITS[:1])
