"""What entries of the general catalogue share: where an effect may sit, where its search starts."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from comparisons.missing_effect.systems.model import Model
from comparisons.missing_effect.systems.places import Place
from comparisons.missing_effect.systems.roles import (
    angles,
    displacements,
    free_equations,
    physical,
    rates,
    stored_from,
)
from surge_core.types import FloatArray

Places = Callable[[Model], tuple[Place, ...]]
Starts = Callable[[FloatArray], tuple[tuple[float, ...], ...]]

# A sign means something only where the signal spends time on both sides of it: this share of the
# samples beyond a twentieth of its rms, either way.
LEAST_SIDE_SHARE = 0.02
SIDE = 0.05


def on(signals: Callable[[Model], Sequence[int]]) -> Places:
    """Return places in every equation that is not exact, on some signals."""

    def places(model: Model) -> tuple[Place, ...]:
        return tuple(Place(i, s) for i in free_equations(model) for s in signals(model))

    return places


def on_own(model: Model) -> tuple[Place, ...]:
    """Return every rate in its own equation: what resists a motion acts on that motion."""
    return tuple(Place(i, i) for i in free_equations(model) if i in rates(model))


def against_storing(model: Model) -> tuple[Place, ...]:
    """Return where a deflection pushes back: its own equation, and those of what it sums up."""
    free, stored = free_equations(model), stored_from(model)
    return tuple(
        Place(i, s, sign=1 if i == s else stored[s, i])
        for s in displacements(model)
        for i in free
        if i == s or (s, i) in stored
    )


def alone(model: Model) -> tuple[Place, ...]:
    """Return every equation that is not exact, on no signal."""
    return tuple(Place(i) for i in free_equations(model))


def at_inputs(model: Model) -> tuple[Place, ...]:
    """Return every input."""
    n = len(model.states)
    return tuple(Place(j, n + j) for j in range(len(model.inputs)))


def at_outputs(model: Model) -> tuple[Place, ...]:
    """Return every output."""
    return tuple(Place(j) for j in range(len(model.outputs)))


def at_parameters(model: Model) -> tuple[Place, ...]:
    """Return every parameter."""
    return tuple(Place(j) for j in range(len(model.params)))


def everywhere(_: Model) -> tuple[Place, ...]:
    """Return the one place of what is the same for all channels."""
    return (Place(-1),)


def at_states(model: Model) -> tuple[Place, ...]:
    """Return every state on which something may act."""
    return tuple(Place(i, i) for i in physical(model))


def at_spills(model: Model) -> tuple[Place, ...]:
    """Return every state that may spill: lost, or into each other state of the same unit."""
    out = []
    free = free_equations(model)
    units = list(model.states.values())
    for i in (i for i in displacements(model) if i in free):
        out.append(Place(i, i, -1))
        out += [Place(i, i, j) for j in free if j != i and units[j] == units[i]]
    return tuple(out)


def input_signals(model: Model) -> tuple[int, ...]:
    """Return the inputs, as signals are numbered."""
    n = len(model.states)
    return tuple(range(n, n + len(model.inputs)))


def every_signal(model: Model) -> tuple[int, ...]:
    """Return the signals that a term may act on: states, then inputs."""
    return (*physical(model), *input_signals(model))


def on_products(model: Model) -> tuple[Place, ...]:
    """Return places in every equation that is not exact, on each two signals."""
    return tuple(place for place in on_square_products(model) if place.signal < place.other)


def on_square_products(model: Model) -> tuple[Place, ...]:
    """Return places in every equation that is not exact, on each two signals in either order."""
    pairs = [(a, b) for a in every_signal(model) for b in every_signal(model) if a != b]
    return tuple(Place(i, a, b) for i in free_equations(model) for a, b in pairs)


on_displacements, on_rates, on_angles = on(displacements), on(rates), on(angles)


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
    """Return why a signal does not change sign, or an empty text.

    Parameters
    ----------
    signal : ndarray
        Over its rms.
    """
    share = min(float(np.mean(signal > SIDE)), float(np.mean(signal < -SIDE)))
    return "" if share >= LEAST_SIDE_SHARE else "needs a signal that changes sign"


def blind_to_sign(simulated: FloatArray, reading: FloatArray) -> str:
    """Return why a sensor cannot be blind to a sign, or an empty text.

    What is read must change its sign, as the model has it, and the reading must not.

    Parameters
    ----------
    simulated, reading : ndarray
        Output of the model, and what was measured, over their rms. Noise may take a few readings
        below zero.
    """
    if float(np.mean(reading < -SIDE)) > LEAST_SIDE_SHARE:
        return "needs a reading that stays on one side of zero"
    return both_signs(simulated, reading) and "needs an output that changes sign in the model"
