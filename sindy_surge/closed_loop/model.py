"""The autonomous surge model: its equations, its simulation and what its cycles measure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sindy_surge.closed_loop.record import Cycles
from sindy_surge.closed_loop.terms import STATES, StateTerms
from sindy_surge.text import signed_sum
from surge_core.fit_state import AdvisedState
from surge_core.terms import pretty_term
from surge_core.types import FloatArray

__all__ = ["CycleRow", "LoopState", "SurgeModel"]


_RTOL = 1e-8
# A simulation that strays from the record by this many of its ranges has left for infinity.
_RANGES = 5.0


class LoopState(AdvisedState):
    """How the discovery ended; each member carries its advice."""

    OK = ("ok", "simulated from its own start, the model repeats the cycles within 5 %")
    DOES_NOT_CYCLE = (
        "does_not_cycle",
        "simulated, the model settles or runs away instead of cycling: use more cycles, and look "
        "for clipped signals, a transient, or channels shifted in time against each other",
    )
    CYCLES_DIFFER = (
        "cycles_differ",
        "the model cycles, but its period or an amplitude is more than 5 % off the record's: "
        "look for a missing effect, a time shift between the channels, or cycles that drift",
    )
    MODEL_ERROR = (
        "model_error",
        "the cycles agree, but what the equations leave is well above the white noise, or ψ' "
        "follows more than φ: an effect that the library lacks, coloured noise, or a channel late "
        "by a sample; trust the cycles, not the terms",
    )
    NOT_CONVERGED = (
        "not_converged",
        "the cycles agree, but the last steps still changed the equations: use more cycles",
    )


class CycleRow(NamedTuple):
    """A quantity of the cycles, with its unit, as measured and simulated (nan without cycles)."""

    quantity: str
    measured: float
    simulated: float

    @property
    def difference(self) -> float:
        """Simulated over measured, less one."""
        return self.simulated / self.measured - 1


@dataclass(frozen=True)
class SurgeModel:
    """An autonomous surge model d(φ, ψ', Ψ)/dt = f(φ, ψ', Ψ), with its own start.

    Parameters
    ----------
    terms : tuple of three StateTerms
        The terms of dφ/dt, dψ'/dt and dΨ/dt.
    coefficients : tuple of three ndarray
        Their coefficients, per second.
    covariance : ndarray of shape (n_coefficients, n_coefficients)
        Covariance of all coefficients, those of dφ/dt first.
    start : ndarray of shape (3,)
        Estimated state at the first sample of the record.
    sample_period_s : float
        Sample period of the record in seconds.
    lower, upper : ndarray of shape (3,)
        Range of the record.
    noise : ndarray of shape (2,) or (3,)
        Standard deviation of what the fit leaves of each measured channel; two where Ψ is a
        hidden state, in the unit of ψ'.
    measured_cycles : Cycles
        What the record's cycles measure.
    simulated_cycles : Cycles
        What ten cycles from the model's own start measure.
    state : LoopState
        How the discovery ended.
    """

    terms: tuple[StateTerms, ...]
    coefficients: tuple[FloatArray, ...]
    covariance: FloatArray
    start: FloatArray
    sample_period_s: float
    lower: FloatArray
    upper: FloatArray
    noise: FloatArray
    measured_cycles: Cycles
    simulated_cycles: Cycles
    state: LoopState

    @property
    def period_s(self) -> float:
        """Period of the simulated cycles in seconds; nan if the model does not cycle."""
        return self.simulated_cycles.period_s

    @property
    def standard_errors(self) -> tuple[FloatArray, ...]:
        """Standard errors of the coefficients of each equation, per second."""
        errors = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return tuple(np.split(errors, np.cumsum([len(t) for t in self.terms])[:-1]))

    def rate(self, states: ArrayLike) -> FloatArray:
        """Return the time derivative of states (..., 3) per second, of the same shape."""
        x = np.asarray(states, dtype=np.float64)
        pairs = zip(self.terms, self.coefficients, strict=True)
        return np.stack([terms.values(x) @ beta for terms, beta in pairs], axis=-1)

    def simulate(self, start: ArrayLike | None = None, n_samples: int | None = None) -> FloatArray:
        """Let the model run by itself.

        Parameters
        ----------
        start : array-like of shape (3,) or None
            First state; None takes the model's own, at the first sample of the record.
        n_samples : int or None
            Number of samples; None takes ten periods of the record.

        Returns
        -------
        ndarray of shape (n_samples, 3)
            φ, ψ' and Ψ; nan from where the model has left the range of the record for good.

        """
        from scipy.integrate import solve_ivp

        first = np.asarray(self.start if start is None else start, dtype=np.float64)
        step = self.sample_period_s
        if n_samples is None:
            n_samples = int(np.ceil(10 * self.measured_cycles.period_s / step)) + 1
        reach = (_RANGES + 0.5) * (self.upper - self.lower)
        middle = (self.upper + self.lower) / 2

        def inside(_: float, x: FloatArray) -> float:
            return float(np.min(reach - np.abs(x - middle)))

        inside.terminal = True  # type: ignore[attr-defined]
        times = np.arange(n_samples) * step
        states = np.full((n_samples, len(STATES)), np.nan)
        found = solve_ivp(
            lambda _, x: self.rate(x),
            (0.0, float(times[-1])),
            first,
            method="LSODA",
            t_eval=times,
            events=inside,
            rtol=_RTOL,
            atol=_RTOL * (self.upper - self.lower),
        )
        states[: found.y.shape[1]] = found.y.T
        return states

    def cycle_rows(self) -> tuple[CycleRow, ...]:
        """Return the comparison of measured and simulated cycles, row by row."""
        measured, simulated = self.measured_cycles, self.simulated_cycles
        rows = [CycleRow("period, s", measured.period_s, simulated.period_s)]
        for name, *pair in zip(STATES, measured.amplitude, simulated.amplitude, strict=False):
            rows.append(CycleRow(f"amplitude of {pretty_term(name)}", *pair))
        return tuple(rows)

    @property
    def time_constant_s(self) -> float:
        """τ of the compressor's lag in seconds, from -ψ'/τ in dψ'/dt; nan without such a term."""
        return -1.0 / self._decay()[0]

    @property
    def time_constant_stderr_s(self) -> float:
        """Standard error of τ in seconds."""
        rate, error = self._decay()
        return error / rate**2

    @property
    def is_lag(self) -> bool:
        """Whether ψ' lags behind a function of φ alone."""
        others = [name for name in self.terms[1].names if name != "psi_p"]
        coupled = any("psi_p" in name or "plenum" in name for name in others)
        return self.time_constant_s > 0 and not coupled

    def equations(self) -> tuple[str, ...]:
        """Return the three equations as text, each coefficient rounded to its error."""
        return tuple(
            f"d{pretty_term(name)}/dt = "
            + signed_sum(list(zip(terms.names, values.tolist(), errors.tolist(), strict=True)))
            + "   [1/s; φ, ψ', Ψ dimensionless]"
            for name, terms, values, errors in zip(
                STATES, self.terms, self.coefficients, self.standard_errors, strict=True
            )
        )

    def _decay(self) -> tuple[float, float]:
        """Return the coefficient of ψ' in dψ'/dt and its error, per second; nan without one."""
        names = self.terms[1].names
        if "psi_p" not in names:
            return math.nan, math.nan
        at = names.index("psi_p")
        return float(self.coefficients[1][at]), float(self.standard_errors[1][at])
