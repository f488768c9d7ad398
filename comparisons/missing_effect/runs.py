"""A record simulated without and with what was added."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from surge_core.types import BoolArray, FloatArray

# A check whose error grew beyond this factor is worse.
WORSE = 1.02


@dataclass(frozen=True, eq=False)
class CheckRun:
    """Rows simulated without and with what was added, by fits to the fitted rows.

    Parameters
    ----------
    name, kind : str
        Of the record; "fitted", "held out" of the fits, "left out" in turn, cycle by cycle, or
        "check", a record that is only simulated.
    period_s, time_s : float, ndarray of shape (n,)
        Sample period, and clock of the record.
    outputs : mapping of str to str
        Names and units.
    measured, before, after : ndarray of shape (n, n_y)
        Outputs; what is not a number is not scored.
    settle : int
        Rows at the start that are not scored.
    signals : mapping of str to ndarray of shape (n,)
        Measured inputs and outputs.
    refitted : ndarray of shape (n, n_y), optional
        The model with what was added, its parameters fitted to this very record.
    loose : float or ndarray of shape (n_y,)
        What the rms error would be from the errors of the start alone.
    """

    name: str
    kind: str
    period_s: float
    time_s: FloatArray
    outputs: Mapping[str, str]
    measured: FloatArray
    before: FloatArray
    after: FloatArray
    settle: int = 0
    signals: Mapping[str, FloatArray] = field(default_factory=dict)
    refitted: FloatArray | None = None
    loose: float | FloatArray = 0.0

    @property
    def held_out(self) -> bool:
        """Whether nothing was fitted to it."""
        return self.kind != "fitted"

    @property
    def title(self) -> str:
        """Name and kind."""
        return f"{self.name} ({self.kind})"

    @property
    def scored(self) -> int:
        """How many rows count."""
        return int(np.count_nonzero(np.isfinite(self.measured[self.settle :]).any(axis=1)))

    def errors(self, *, before: bool) -> FloatArray:
        """Return the errors of the scored rows, of shape (n, n_y), of the model before or after."""
        return np.asarray((self.measured - (self.before if before else self.after))[self.settle :])

    @property
    def before_rms(self) -> FloatArray:
        """The rms error of each output of the model as it was."""
        return rms(self.errors(before=True))

    @property
    def after_rms(self) -> FloatArray:
        """The rms error of each output of the model with what was added."""
        return rms(self.errors(before=False))

    @property
    def swing(self) -> FloatArray:
        """The standard deviation of each output; 1 where it does not move."""
        swing = np.nanstd(self.measured[self.settle :], axis=0)
        return np.asarray(np.where(swing > 0.0, swing, 1.0))

    @property
    def worse(self) -> BoolArray:
        """Whether what was added made the error of each output larger, beyond rounding."""
        return np.asarray(self.after_rms > WORSE * self.before_rms)

    @property
    def spoilt(self) -> bool:
        """Whether what was added made the errors of all outputs together larger."""
        ratios = self.after_rms / np.fmax(self.before_rms, np.finfo(float).tiny)
        return bool(np.exp(np.mean(np.log(ratios))) > WORSE)

    @property
    def refitted_rms(self) -> FloatArray:
        """The same by a fit to this very record; what is above it no other record knows."""
        if self.refitted is None:
            return np.full(len(self.outputs), np.nan)
        return rms((self.measured - self.refitted)[self.settle :])


def rms(errors: FloatArray) -> FloatArray:
    """Return the rms of each column over the rows that were read; NaN where none was simulated."""
    there = np.isfinite(errors)
    total = np.sum(np.where(there, errors, 0.0) ** 2, axis=0)
    return np.asarray(np.sqrt(total / np.where(there.any(axis=0), there.sum(axis=0), np.nan)))
