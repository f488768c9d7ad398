"""Where a simulated run of a user's model and its measurement part."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from comparisons.missing_effect.results import MissingEffect
from comparisons.missing_effect.runs import CheckRun
from comparisons.missing_effect.systems.roles import measured_as
from comparisons.missing_effect.where import where_of as where_of_residuals
from comparisons.missing_effect.where_rows import Residuals, Where
from surge_core.errors import InputError
from surge_core.types import FloatArray

if TYPE_CHECKING:
    from comparisons.missing_effect.systems.model import Model

SIGNAL_KEYS = ("signal", "input", "sensor", "state")


def where_of(
    check: CheckRun,
    effects: Sequence[MissingEffect] = (),
    *,
    output: str | None = None,
    model: Model | None = None,
) -> Where:
    """Return where the residuals of a run stand out.

    Parameters
    ----------
    check : CheckRun
        A run, simulated without and with what was added.
    effects : sequence of MissingEffect
        What was added: the signal of the first one whose signal is measured is looked at.
    output : str, optional
        Name of the output; without it the one that the model before misses most, against its own
        swing.
    model : Model, optional
        Tells units, and which states are measured under another name.

    Raises
    ------
    InputError
        When the run has no such output, or too few rows.
    """
    chosen = worst_output(check) if output is None else output
    if chosen not in check.outputs:
        raise InputError(
            f"{check.name}: output",
            expected=f"one of {', '.join(check.outputs)}",
            found=repr(chosen),
        )
    column = list(check.outputs).index(chosen)
    scored = slice(check.settle, None)
    measured = check.measured[scored, column]
    signal, values = _signal(check, effects, chosen, model)
    own = signal == chosen
    units = {**({} if model is None else model.inputs), **check.outputs}
    return where_of_residuals(
        Residuals(
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
    )


def worst_output(check: CheckRun) -> str:
    """Return the output that the model before misses most, against its own swing.

    Parameters
    ----------
    check : CheckRun
        A run.
    """
    share = check.before_rms / check.swing
    return list(check.outputs)[int(np.argmax(np.where(np.isfinite(share), share, np.inf)))]


def _signal(
    check: CheckRun, effects: Sequence[MissingEffect], output: str, model: Model | None
) -> tuple[str, FloatArray]:
    """Return the signal of an effect as far as it is measured; the output where none is."""
    channels = check.signals
    also = {}
    if model is not None:
        also = {model.state_names[i]: name for i, name in measured_as(model).items()}
    for effect in effects:
        for key in SIGNAL_KEYS:
            if key not in effect.place:
                continue
            name = effect.place[key]
            # A state may share its name with an output that is something else.
            channel = also.get(name, "" if _is_state(name, model) else name)
            if channel in channels:
                return channel, channels[channel]
            break
    return output, channels[output]


def _is_state(name: str, model: Model | None) -> bool:
    return model is not None and name in model.states


def _simulated(check: CheckRun, column: int) -> FloatArray:
    for run in (check.after, check.before):
        if np.all(np.isfinite(run[:, column])):
            return np.asarray(run[:, column])
    return np.asarray(check.measured[:, column])
