"""The residuals of a simulated run of a user's model, and the signal to look at them over."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from comparisons.missing_effect.results import MissingEffect
from comparisons.missing_effect.runs import CheckRun
from comparisons.missing_effect.systems.roles import measured_as
from comparisons.missing_effect.where_rows import Residuals
from surge_core.types import FloatArray

if TYPE_CHECKING:
    from comparisons.missing_effect.systems.model import Model

SIGNAL_KEYS = ("signal", "input", "sensor", "state")


def residuals_of(
    check: CheckRun,
    effects: Sequence[MissingEffect] = (),
    *,
    output: str | None = None,
    model: Model | None = None,
) -> Residuals:
    """Return the residuals of one output of a run, to be looked at over a signal.

    Parameters
    ----------
    check : CheckRun
        A run, simulated without and with what was added.
    effects : sequence of MissingEffect
        What was added: the signal of the first one whose signal is measured is looked at.
    output : str, optional
        Name of the output; the first without it.
    model : Model, optional
        Knows units, and which states are measured under another name.
    """
    chosen = output or next(iter(check.outputs))
    column, scored = list(check.outputs).index(chosen), slice(check.settle, None)
    measured = check.measured[scored, column]
    signal, values = _signal(check, effects, chosen, model)
    own = signal == chosen
    units = {**({} if model is None else model.inputs), **check.outputs}
    return Residuals(
        chosen,
        units.get(chosen, "1"),
        check.time_s[scored],
        measured,
        check.before[scored, column],
        check.after[scored, column],
        (_simulated(check, column) if own else values)[scored],
        signal,
        units.get(signal, "1"),
        (slice(0, measured.size),),
        np.zeros(measured.size, dtype=np.int64),
        (check.name,),
        check.period_s,
        own,
    )


def _signal(
    check: CheckRun, effects: Sequence[MissingEffect], output: str, model: Model | None
) -> tuple[str, FloatArray]:
    """Return the signal of an effect as far as it is measured; the output where none is."""
    channels = check.signals
    also = {} if model is None else {model.state_names[i]: n for i, n in measured_as(model).items()}
    # A state may share its name with an output that is something else.
    states = () if model is None else model.states
    for effect in effects:
        name = next((effect.place[key] for key in SIGNAL_KEYS if key in effect.place), "")
        channel = also.get(name, "" if name in states else name)
        if channel in channels:
            return channel, channels[channel]
    return output, channels[output]


def _simulated(check: CheckRun, column: int) -> FloatArray:
    for run in (check.after, check.before):
        if np.all(np.isfinite(run[:, column])):
            return np.asarray(run[:, column])
    return np.asarray(check.measured[:, column])
