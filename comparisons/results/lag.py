"""A fitted lag model as a value: it can be saved, read back and run on another record."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import norm, t

from classic_ml.series import CoefficientSeries
from comparisons.results.names import SYMBOLS
from comparisons.results.rows import FitRows
from comparisons.results.terms import evaluate_terms, is_known_term
from sindy_surge.text import interval95
from surge_core.lag import FirstOrderLag, Hold
from surge_core.rounding import bracketed
from surge_core.segments import runs_of
from surge_core.terms import signed_sum, terms_json
from surge_core.types import FloatArray, IntArray


class LagModel(Protocol):
    """A fitted model that can be run over another record, whatever it holds beside the lag."""

    @property
    def estimator(self) -> str:
        """Name of what found it."""

    @property
    def target(self) -> str:
        """The coefficient it gives, "psi_p" or "psi"."""

    @property
    def time_constant_s(self) -> float:
        """τ, in seconds."""

    @property
    def valid_phi(self) -> tuple[float, float]:
        """Range of φ in which the curve can be trusted."""

    def equation(self) -> str:
        """Return the model in one line."""

    def free_run_over(
        self,
        rows: FitRows,
        records: Sequence[CoefficientSeries],
        labels: IntArray | None = None,
    ) -> FloatArray:
        """Return the free run over rows of records, each segment from its measured start."""

    def to_json(self) -> dict[str, Any]:
        """Return the model as plain JSON types."""


@dataclass(frozen=True)
class FittedLag:
    """τ dy/dt + y = Σ β_i s_i(φ) with numbers in it.

    Parameters
    ----------
    estimator : str
        Name of the estimator that found it.
    target : {"psi_p", "psi"}
        The coefficient it gives.
    time_constant_s, time_constant_stderr_s : float
        τ and its standard error, in seconds.
    terms : tuple of str
        Names of the s_i.
    coefficients, stderr : tuple of float
        β_i and their standard errors.
    hold : {"zero", "first"}
        How φ acts between samples.
    valid_phi : tuple of float
        Range of φ in which the curve can be trusted.
    table : tuple of tuple of float
        The characteristic as (φ, value, standard error), for plots and for terms whose function
        is not known by name.
    n_blocks : int
        Blocks behind the standard errors; 0 where the estimator does not say.
    dead_time_s : float
        How much later than φ the coefficient was measured, in seconds; negative if φ was late.
    interval_s : tuple of float, optional
        95 % interval of τ, where the estimator states its own.
    covariance : tuple of float
        Of τ in seconds and the β_i, in that order, row by row; empty where it is not known.
    rows : {"filtered", "unfiltered"}
        Which signals it was fitted to.
    free_run_rms : float
        Error of its free run over the rows that it was fitted to.
    """

    estimator: str
    target: str
    time_constant_s: float
    time_constant_stderr_s: float
    terms: tuple[str, ...]
    coefficients: tuple[float, ...]
    stderr: tuple[float, ...]
    hold: Hold
    valid_phi: tuple[float, float]
    table: tuple[tuple[float, float, float], ...]
    n_blocks: int = 0
    dead_time_s: float = 0.0
    interval_s: tuple[float, float] | None = None
    covariance: tuple[float, ...] = ()
    rows: Literal["filtered", "unfiltered"] = "filtered"
    free_run_rms: float = math.nan

    @property
    def measured(self) -> bool:
        """Whether τ was measured: fitted, and two standard errors or more above zero."""
        return 0.0 < 2.0 * self.time_constant_stderr_s < self.time_constant_s < math.inf

    @property
    def quantile(self) -> float:
        """Standard errors to either side of a 95 % interval."""
        # A variance from few blocks is itself uncertain.
        n = self.n_blocks
        return float(t.isf(0.025, n - 1) if n > 1 else norm.isf(0.025))

    @property
    def ci95_s(self) -> tuple[float, float]:
        """95 % interval of τ, in seconds; on log τ where τ is well separated from zero."""
        if self.interval_s is not None:
            return self.interval_s
        return interval95(self.time_constant_s, self.time_constant_stderr_s, self.quantile)

    def quasi_steady(self, phi: ArrayLike) -> FloatArray:
        """Return the characteristic at φ, of shape (n,)."""
        if self._knows_terms:
            terms = evaluate_terms(list(self.terms), phi)
            return np.asarray(terms @ np.asarray(self.coefficients))
        grid, value, _ = np.asarray(self.table).T
        return np.asarray(np.interp(np.asarray(phi, dtype=np.float64), grid, value))

    def free_run_over(
        self,
        rows: FitRows,
        records: Sequence[CoefficientSeries],
        labels: IntArray | None = None,
    ) -> FloatArray:
        """Return the free run over rows, each segment from its measured start.

        Parameters
        ----------
        rows : FitRows
            The rows.
        records : sequence of CoefficientSeries
            The records they come from; a plain lag needs φ alone.
        labels : ndarray of int, shape (n,), optional
            In place of the rows' own segments.
        """
        marks = rows.labels if labels is None else labels
        out = self._late(self._over(rows), rows.sample_period_s, marks)
        if math.isfinite(self.time_constant_s):
            lag = FirstOrderLag(self.time_constant_s, rows.sample_period_s, self.hold)
            for run in runs_of(marks, out.size):
                out[run] = lag.respond(out[run], rows.measured[run.start])
        return out

    def free_run_stderr(self, rows: FitRows) -> FloatArray:
        """Return the standard error of the free run over rows, of shape (n,).

        That of the covariance of τ and the coefficients, carried through the free run by its
        derivatives; the start of a segment is measured and adds nothing. NaN where the model knows
        no covariance, or no function of its terms.

        Parameters
        ----------
        rows : FitRows
            The rows.
        """
        n = len(self.terms) + 1
        known = self._knows_terms and math.isfinite(self.time_constant_s)
        if not known or len(self.covariance) != n * n:
            return np.full(rows.phi.size, math.nan)
        covariance = np.reshape(self.covariance, (n, n))
        inputs = rows.terms(lambda phi: evaluate_terms(list(self.terms), phi))
        lag = FirstOrderLag(self.time_constant_s, rows.sample_period_s, self.hold)
        variance = np.empty(rows.phi.size)
        late = [self._late(column, rows.sample_period_s, rows.labels) for column in inputs.T]
        acting = np.column_stack(late)
        quasi_steady = acting @ np.asarray(self.coefficients)
        for run in rows.runs:
            state = lag.respond(quasi_steady[run], rows.measured[run.start])
            by_tau = lag.d_respond(quasi_steady[run], state) / self.time_constant_s
            moves = np.column_stack([by_tau, lag.respond(acting[run], 0.0)])
            variance[run] = np.einsum("ij,jk,ik->i", moves, covariance, moves)
        return np.sqrt(np.maximum(variance, 0.0))

    def one_step_over(self, rows: FitRows) -> FloatArray:
        """Predict each row from the measured row before it; first rows predict themselves."""
        out = self._late(self._over(rows), rows.sample_period_s, rows.labels)
        if not math.isfinite(self.time_constant_s):
            return out
        lag = FirstOrderLag(self.time_constant_s, rows.sample_period_s, self.hold)
        for run in rows.runs:
            out[run][1:] = lag.a * rows.measured[run][:-1] + lag.drive(out[run])
            out[run.start] = rows.measured[run.start]
        return out

    @property
    def _knows_terms(self) -> bool:
        return bool(self.terms) and all(map(is_known_term, self.terms))

    def _over(self, rows: FitRows) -> FloatArray:
        return rows.terms(lambda phi: self.quasi_steady(phi)[:, None])[:, 0]

    def _late(
        self, values: FloatArray, sample_period_s: float, labels: ArrayLike | None
    ) -> FloatArray:
        """Return values dead_time_s later, the ends of each segment prolonged."""
        out = values.copy()
        late = self.dead_time_s / sample_period_s
        for run in runs_of(labels, out.size) if late else ():
            rows = np.arange(run.stop - run.start, dtype=np.float64)
            out[run] = np.interp(rows - late, rows, out[run])
        return out

    def equation(self) -> str:
        """Return the model in one line, each number rounded to its standard error."""
        symbol = SYMBOLS.get(self.target, self.target)
        right = signed_sum(list(zip(self.terms, self.coefficients, self.stderr, strict=True)))
        if not math.isfinite(self.time_constant_s):
            return f"{symbol} = {right}"
        tau_ms = bracketed(1e3 * self.time_constant_s, 1e3 * self.time_constant_stderr_s)
        late = f", φ at t - {1e3 * self.dead_time_s:.3g} ms" if self.dead_time_s else ""
        return f"{tau_ms} ms · d{symbol}/dt + {symbol} = {right}{late}"

    def to_json(self) -> dict[str, Any]:
        """Return the value as plain JSON types, NaN for what is not known."""
        return {
            "estimator": self.estimator,
            "target": self.target,
            "time_constant_s": self.time_constant_s,
            "time_constant_stderr_s": self.time_constant_stderr_s,
            "terms": terms_json(self.terms, self.coefficients, self.stderr),
            "hold": self.hold,
            "valid_phi": list(self.valid_phi),
            "n_blocks": self.n_blocks,
            "dead_time_s": self.dead_time_s,
            "characteristic": [list(row) for row in self.table],
            "covariance": list(self.covariance),
            "rows": self.rows,
            "free_run_rms": self.free_run_rms,
        }
