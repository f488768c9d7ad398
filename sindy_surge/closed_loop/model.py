"""The autonomous surge model: its equations, its simulation and what its cycles measure."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from sindy_surge.closed_loop.cycles import Cycles
from sindy_surge.closed_loop.structure import StructureRow
from sindy_surge.closed_loop.terms import STATES, StateTerms
from sindy_surge.text import signed_sum, uncertain
from surge_core.errors import InputError
from surge_core.terms import pretty_term
from surge_core.types import FloatArray

__all__ = ["CycleRow", "LoopState", "SurgeModel"]


_RTOL = 1e-8
# A simulation that strays from the record by this many of its ranges has left for infinity.
_RANGES = 5.0
# Factors of a term before this one are functions of ψ' and Ψ, but for the first, which is φ.
_FLOW_FACTOR = 4


class LoopState(StrEnum):
    """Result of the discovery; each member carries its advice.

    Attributes
    ----------
    advice : str
        What the result means and what to do about it.
    """

    advice: str

    def __new__(cls, code: str, advice: str) -> LoopState:
        """Make a string member and hang its advice on it."""
        member = str.__new__(cls, code)
        member._value_ = code
        member.advice = advice
        return member

    OK = ("ok", "simulated from its own start, the model repeats the cycles within 5 %")
    LEAVES_RANGE = (
        "leaves_range",
        "simulated, the model runs away from the range of the record: use more cycles, fewer "
        "terms (max_terms), or look for clipped or shifted signals",
    )
    DOES_NOT_CYCLE = (
        "does_not_cycle",
        "simulated, the model settles instead of cycling: the record may be a transient, or the "
        "channels may be shifted in time against each other",
    )
    CYCLES_DIFFER = (
        "cycles_differ",
        "the model cycles, but its period or an amplitude is more than 5 % off the record's: "
        "look for a missing effect, a time shift between the channels, or cycles that drift",
    )
    MODEL_ERROR = (
        "model_error",
        "the cycles agree, but what the equations leave is well above the white noise: their terms "
        "stand in for an effect that the library lacks or for coloured noise; trust the cycles, "
        "not the terms",
    )
    NOT_A_LAG = (
        "not_a_lag",
        "the cycles agree, but ψ' follows more than φ, so that its equation is no lag behind a "
        "characteristic and its τ means nothing; a channel that is late by a sample does that: "
        "align the channels, and trust the cycles, not the terms",
    )
    NOT_CONVERGED = (
        "not_converged",
        "the cycles agree, but the last steps still changed the equations: use more cycles or "
        "fewer terms (max_terms)",
    )


@dataclass(frozen=True)
class CycleRow:
    """One line of the comparison of measured and simulated cycles.

    Parameters
    ----------
    quantity : str
        What is compared, with its unit.
    measured, simulated : float
        The two values; nan if the model does not cycle.
    """

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
        Standard deviation of what the fit leaves of each measured channel.
    measured_cycles : Cycles
        What the record's cycles measure.
    simulated_cycles : Cycles or None
        What ten cycles from the model's own start measure; None if it does not cycle.
    state : LoopState
        What became of the discovery.
    path : tuple of StructureRow
        The structures looked at.
    """

    terms: tuple[StateTerms, StateTerms, StateTerms]
    coefficients: tuple[FloatArray, FloatArray, FloatArray]
    covariance: FloatArray
    start: FloatArray
    sample_period_s: float
    lower: FloatArray
    upper: FloatArray
    noise: FloatArray
    measured_cycles: Cycles
    simulated_cycles: Cycles | None
    state: LoopState
    path: tuple[StructureRow, ...]

    @property
    def plenum_measured(self) -> bool:
        """Whether Ψ was measured; else it is a hidden state in the unit of ψ'."""
        return self.noise.size == len(STATES)

    @property
    def period_s(self) -> float:
        """Period of the simulated cycles in seconds; nan if the model does not cycle."""
        return np.nan if self.simulated_cycles is None else self.simulated_cycles.period_s

    @property
    def amplitude(self) -> FloatArray:
        """Half the peak-to-peak value of the simulated φ, ψ' and Ψ; nan without cycles."""
        if self.simulated_cycles is None:
            return np.full(len(STATES), np.nan)
        return np.array(self.simulated_cycles.amplitude)

    @property
    def standard_errors(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Standard errors of the coefficients of each equation, per second."""
        errors = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        first, second = len(self.terms[0]), len(self.terms[0]) + len(self.terms[1])
        return errors[:first], errors[first:second], errors[second:]

    def rate(self, states: ArrayLike) -> FloatArray:
        """Return the time derivative of the states.

        Parameters
        ----------
        states : array-like of shape (..., 3)
            φ, ψ' and Ψ.

        Returns
        -------
        ndarray of shape (..., 3)
            Their derivatives per second.
        """
        terms, matrix = self._compact
        return terms.values(np.asarray(states, dtype=np.float64)) @ matrix.T

    @cached_property
    def _compact(self) -> tuple[StateTerms, FloatArray]:
        """The terms of all three equations, each once, and the matrix of their coefficients."""
        rows = sorted({tuple(row) for terms in self.terms for row in terms.exponents.tolist()})
        matrix = np.zeros((len(STATES), len(rows)))
        for k, (terms, values) in enumerate(zip(self.terms, self.coefficients, strict=True)):
            for row, value in zip(terms.exponents.tolist(), values.tolist(), strict=True):
                matrix[k, rows.index(tuple(row))] = value
        return StateTerms(np.array(rows, dtype=np.intp)), matrix

    def simulate(
        self,
        start: ArrayLike | None = None,
        n_samples: int | None = None,
        sample_period_s: float | None = None,
    ) -> FloatArray:
        """Let the model run by itself.

        Parameters
        ----------
        start : array-like of shape (3,) or None
            First state; None takes the model's own, at the first sample of the record.
        n_samples : int or None
            Number of samples; None takes ten periods of the record.
        sample_period_s : float or None
            Sample period in seconds; None takes that of the record.

        Returns
        -------
        ndarray of shape (n_samples, 3)
            φ, ψ' and Ψ; nan from where the model has left the range of the record for good.

        Raises
        ------
        InputError
            If the start is not three finite numbers, or a number is not positive.
        """
        from scipy.integrate import solve_ivp

        first = self.start if start is None else _checked_start(start)
        step = self.sample_period_s if sample_period_s is None else float(sample_period_s)
        if n_samples is None:
            n_samples = int(np.ceil(10 * self.measured_cycles.period_s / step)) + 1
        for name, value in (("n_samples", n_samples), ("sample_period_s", step)):
            if not value > 0:
                raise InputError(name, expected="a positive number", found=f"{value}")
        reach = (_RANGES + 0.5) * (self.upper - self.lower)
        middle = (self.upper + self.lower) / 2

        def inside(_: float, x: FloatArray) -> float:
            return float(np.min(reach - np.abs(x - middle)))

        inside.terminal = True  # type: ignore[attr-defined]
        times = np.arange(n_samples) * step
        states = np.full((n_samples, len(STATES)), np.nan)
        states[0] = first
        if n_samples > 1:
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
        measured, simulated = self.measured_cycles, self.amplitude
        rows = [CycleRow("period, s", measured.period_s, self.period_s)]
        for name, before, after in zip(STATES, measured.amplitude, simulated, strict=False):
            rows.append(CycleRow(f"amplitude of {pretty_term(name)}", before, float(after)))
        return tuple(rows)

    @property
    def time_constant_s(self) -> float:
        """τ of the compressor's lag in seconds; nan if dψ'/dt has no term -ψ'/τ."""
        decay = self._decay()
        return np.nan if decay is None else -1 / float(self.coefficients[1][decay])

    @property
    def time_constant_stderr_s(self) -> float:
        """Standard error of τ in seconds."""
        decay = self._decay()
        return (
            np.nan
            if decay is None
            else float(self.standard_errors[1][decay]) * self.time_constant_s**2
        )

    def characteristic(self, phi: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the quasi-steady characteristic ψ'_QS(φ) and its standard error.

        Parameters
        ----------
        phi : array-like of shape (n_points,)
            Flow coefficient.

        Returns
        -------
        value, stderr : ndarray of shape (n_points,)
            ψ'_QS and its standard error.

        Raises
        ------
        InputError
            If dψ'/dt is no lag behind a function of φ alone.
        """
        decay = self._decay()
        terms = self.terms[1]
        others = [i for i in range(len(terms)) if i != decay]
        if decay is None or not self.is_lag:
            raise InputError(
                "characteristic",
                expected="an equation τ dψ'/dt + ψ' = ψ'_QS(φ)",
                found=self.equations()[1],
                remedy="see equations(), and state for what may be missing",
            )
        flow = np.atleast_1d(np.asarray(phi, dtype=np.float64))
        values = terms.subset(tuple(others)).values(flow[:, None] * np.array([1.0, 0.0, 0.0]))
        beta, covariance = self._lag_coefficients(decay)
        variance = np.einsum("ni,ij,nj->n", values, covariance, values)
        return values @ beta, np.sqrt(np.maximum(variance, 0.0))

    @property
    def is_lag(self) -> bool:
        """Whether ψ' lags behind a function of φ alone."""
        decay = self._decay()
        others = [i for i in range(len(self.terms[1])) if i != decay]
        coupled = self.terms[1].exponents[others, 1:_FLOW_FACTOR].any()
        return decay is not None and not bool(coupled)

    def _decay(self) -> int | None:
        names = self.terms[1].names
        place = names.index("psi_p") if "psi_p" in names else None
        return place if place is not None and self.coefficients[1][place] < 0 else None

    def equations(self) -> tuple[str, str, str]:
        """Return the three equations as text, each coefficient rounded to its error.

        The second is written as the lag τ dψ'/dt + ψ' = ψ'_QS where it has the term -ψ'/τ.
        """
        texts = [
            f"d{pretty_term(STATES[k])}/dt = {self._sum(k)}   [1/s; φ, ψ', Ψ dimensionless]"
            for k in range(3)
        ]
        decay = self._decay()
        if decay is not None and len(self.terms[1]) > 1:
            tau = uncertain(self.time_constant_s, self.time_constant_stderr_s)
            beta, covariance = self._lag_coefficients(decay)
            names = [name for i, name in enumerate(self.terms[1].names) if i != decay]
            errors = np.sqrt(np.maximum(np.diag(covariance), 0.0)).tolist()
            right = signed_sum(list(zip(names, beta.tolist(), errors, strict=True)))
            texts[1] = f"{tau} s · dψ'/dt + ψ' = {right}   [φ, ψ', Ψ dimensionless, t in s]"
        return texts[0], texts[1], texts[2]

    def _sum(self, equation: int) -> str:
        columns = (self.coefficients[equation].tolist(), self.standard_errors[equation].tolist())
        return signed_sum(list(zip(self.terms[equation].names, *columns, strict=True)))

    def _lag_coefficients(self, decay: int) -> tuple[FloatArray, FloatArray]:
        """Return β_i = -c_i / c_ψ' of the terms beside -ψ'/τ, and their covariance."""
        coefficients, first = self.coefficients[1], len(self.terms[0])
        rows = slice(first, first + coefficients.size)
        tau = self.time_constant_s
        slopes = tau * np.eye(coefficients.size)
        slopes[:, decay] += coefficients * tau**2
        slopes = np.delete(slopes, decay, axis=0)
        beta = tau * np.delete(coefficients, decay)
        return beta, slopes @ self.covariance[rows, rows] @ slopes.T


def _checked_start(start: ArrayLike) -> FloatArray:
    first = np.asarray(start, dtype=np.float64)
    if first.shape != (len(STATES),) or not np.all(np.isfinite(first)):
        raise InputError(
            "start", expected="three finite numbers φ, ψ', Ψ", found=np.array2string(first)
        )
    return first
