"""Output-error fit of the lumped model to measured P31, P25 and W25."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from comparisons.total_system.facility import Facility
from comparisons.total_system.measured import Measured, first_reversal_s
from comparisons.total_system.model import STEP_S, TotalSystemModel
from surge_core.display import Displayed, Field, Sheet
from surge_core.rounding import round_to_error, significant
from surge_core.types import FloatArray

__all__ = ["TotalSystemFit", "TotalSystemState", "fit_total_system"]

# Channels that are fitted, and their units.
OUTPUTS = {"P31": "Pa", "P25": "Pa", "W25": "kg/s"}
# Where the search starts: β₁, β₂, β₃ and τ in s; and a unit step of each. That of τ is its
# logarithm.
_FIRST = np.array([1.0, 2.0, 40.0, 0.02])
_SCALES = np.array([1.0, 1.0, 10.0, 1.0])
# Small against what the scaled parameters are to be known to, large against rounding.
_DIFFERENCE = 1e-4
# The cost of a long run has many minima, that of its first 60 ms one: each search starts where the
# one over a shorter part of the surge ended. The last part comes twice, once with its own weights.
_HORIZONS_S: tuple[float, ...] = (0.06, 0.12, 0.25, 0.5, 0.5)
# A run is scored from a little before the collapse, which an early start would otherwise miss. The
# flow collapses some 17 ms before it reverses; the state that it starts from is the mean over what
# ends well ahead.
_BEFORE_REVERSAL_S = 0.03
_COLLAPSE_S = 0.017
_BEFORE_COLLAPSE_S = (0.045, 0.025)
# At first each channel weighs by this share of its spread, then by its own residual; but never by
# less than the last, or one channel would take all weight and the search would leave its minimum.
_FIRST_SIGMA = 0.1
_SMALLEST_SIGMA = 0.03
# Residual of P31 over its swing: good fits of the simulated rig stay near 0.01, with a volume that
# is wrong by 10 % near 0.04; a start that is wrong by 10 ms leaves 0.1 to 0.2.
_LOST = 0.06
# The score is summed over blocks of this length for the errors.
_BLOCK_S = 0.05


class TotalSystemState(Enum):
    """How a total-system fit ended; the value is the advice that goes with it."""

    CONVERGED = "The fit converged."
    NOT_CONVERGED = "The fit stopped before it converged."
    LOST_THE_CYCLES = (
        "The simulation does not follow the record: the fit sits in a wrong minimum, or a number "
        "of the facility or the surge start is wrong. Neither the characteristic nor the time "
        "constant counts; check volumes and throttle."
    )
    DIVERGED = "The simulation did not stay finite: check the facility's numbers."

    @property
    def code(self) -> str:
        """The name in lower case, as written to JSON."""
        return self.name.lower()


@dataclass(frozen=True)
class TotalSystemFit(Displayed):
    """What a total-system fit found.

    Parameters
    ----------
    beta, beta_stderr : tuple of float
        β₁, β₂, β₃ of ψ'_QS = β₁ + β₂ φ + β₃ φ², and their standard errors, valid for coloured
        residuals.
    tau_s, tau_stderr_s : float
        Time constant and its standard error, in seconds.
    start_s : float
        Surge start that the model ran with.
    state : TotalSystemState
        How the fit ended, with advice.
    rms : mapping of str to float
        Residual of P31 and P25 in Pa and of W25 in kg/s.
    relative_rms : mapping of str to float
        The same over the standard deviation of the measured channel.
    n_rows : int
        Rows that were scored.
    """

    beta: tuple[float, ...]
    beta_stderr: tuple[float, ...]
    tau_s: float
    tau_stderr_s: float
    start_s: float
    state: TotalSystemState
    rms: Mapping[str, float]
    relative_rms: Mapping[str, float]
    n_rows: int

    def quasi_steady(self, phi: ArrayLike) -> FloatArray:
        """Return ψ'_QS at φ, of the shape of φ."""
        return np.asarray(np.polynomial.polynomial.polyval(np.asarray(phi), self.beta))

    def _sheet(self) -> Sheet:
        beta = zip(("β₁", "β₂", "β₃"), self.beta, self.beta_stderr, strict=True)
        residuals = tuple(
            f"{name} {significant(rms, 3)} {OUTPUTS[name]}, "
            f"{100.0 * self.relative_rms[name]:.1f} % of its swing"
            for name, rms in self.rms.items()
        )
        good = self.state is TotalSystemState.CONVERGED
        return Sheet(
            "Total-system fit",
            (
                Field("τ", f"{round_to_error(1e3 * self.tau_s, 1e3 * self.tau_stderr_s)} ms"),
                *(Field(name, round_to_error(value, error)) for name, value, error in beta),
                Field("surge start", f"{self.start_s:.4f} s"),
                Field("rows", str(self.n_rows)),
                Field("residuals", residuals),
                Field(self.state.code, self.state.value, "good" if good else "advice"),
            ),
        )

    def to_json(self) -> dict[str, Any]:
        """Return the fit as plain JSON types."""
        return {
            "time_constant_s": {"value": self.tau_s, "stderr": self.tau_stderr_s},
            "terms": [
                {"name": name, "coefficient": value, "stderr": stderr}
                for name, value, stderr in zip(
                    ("1", "phi", "phi^2"), self.beta, self.beta_stderr, strict=True
                )
            ],
            "start_s": self.start_s,
            "state": {"code": self.state.code, "advice": self.state.value},
            "rms": dict(self.rms),
            "relative_rms": dict(self.relative_rms),
            "rows": self.n_rows,
        }


def fit_total_system(
    measured: Measured,
    facility: Facility,
    *,
    start_error_s: float = 0.0,
    near: TotalSystemFit | None = None,
    progress: Callable[[], object] = lambda: None,
) -> TotalSystemFit:
    """Fit β and τ of a model of the whole system to P31, P25 and W25 (output error).

    Minimises Σ ((P31, P25, W25 measured − simulated)/σ)² over the first half second of the surge,
    with σ the residual of each channel. The surge start is the one that makes the model's first
    reversal of the flow coincide with the measured one.

    Parameters
    ----------
    measured : Measured
        The record; see `measured_signals`.
    facility : Facility
        The facility's numbers.
    start_error_s : float
        Added to the surge start.
    near : TotalSystemFit, optional
        A fit that the search starts from.
    progress : callable
        Called after each step of the search.

    Returns
    -------
    TotalSystemFit
        β, τ, errors, residuals; a fit that went badly says so in its state.

    Raises
    ------
    InputError
        When a number of the facility cannot be used.
    """
    first, horizons_s = _FIRST, _HORIZONS_S
    if near is not None:
        first, horizons_s = np.array([*near.beta, near.tau_s]), _HORIZONS_S[-2:]
    run = _Run(measured, facility, start_error_s, first)
    sigma = _FIRST_SIGMA * np.std(run.measured_rows(horizons_s[0]), axis=0)
    z, found = np.zeros(_SCALES.size), None
    for horizon_s in horizons_s:
        measured_rows = run.measured_rows(horizon_s)
        try:
            found = least_squares(
                run.residuals,
                # Plus 1: the difference of each is then a share of its scale.
                z + 1.0,
                diff_step=np.full(z.size, _DIFFERENCE),
                ftol=1e-5,
                xtol=1e-10,
                gtol=1e-12,
                max_nfev=30,
                args=(horizon_s, sigma),
            )
        except ValueError:
            # The residuals are not finite where this search starts.
            found = None
            break
        z = found.x - 1.0
        spread = np.std(measured_rows, axis=0)
        residual = run.simulate(z, horizon_s)[0] - measured_rows
        rms = np.sqrt(np.mean(residual**2, axis=0))
        sigma = np.maximum(rms, _SMALLEST_SIGMA * spread)
        progress()
    model, start_s = run.model_at(z), run.simulate(z, horizons_s[-1])[1]
    if found is None:
        rms, spread = np.full((2, len(OUTPUTS)), np.nan)
        error, state = np.full(z.size, np.nan), TotalSystemState.DIVERGED
    else:
        error = _errors(found, (measured.time_s[-1] - measured.time_s[0]) / measured.time_s.size)
        error *= _SCALES * [1.0, 1.0, 1.0, model.tau_s]
        state = TotalSystemState.CONVERGED if found.status > 0 else TotalSystemState.NOT_CONVERGED
        if rms[0] > _LOST * spread[0]:
            state = TotalSystemState.LOST_THE_CYCLES
    return TotalSystemFit(
        beta=model.beta,
        beta_stderr=tuple(error[:3].tolist()),
        tau_s=model.tau_s,
        tau_stderr_s=float(error[3]),
        start_s=start_s,
        state=state,
        rms=dict(zip(OUTPUTS, rms.tolist(), strict=True)),
        relative_rms=dict(zip(OUTPUTS, (rms / spread).tolist(), strict=True)),
        n_rows=len(measured_rows),
    )


@dataclass(frozen=True)
class _Run:
    """The run that one evaluation of the cost makes."""

    measured: Measured
    facility: Facility
    start_error_s: float
    first: FloatArray

    def model_at(self, z: FloatArray) -> TotalSystemModel:
        """Return the model with scaled departures from where the search starts put in."""
        b1, b2, b3, _ = (self.first + z * _SCALES).tolist()
        # Beyond e^±20 a trial step would overflow.
        tau_s = float(self.first[3] * np.exp(np.clip(z[3], -20.0, 20.0)))
        flow, start_s = self.measured.near_stall_flow_kg_s, self.measured.reversal_s - _COLLAPSE_S
        return TotalSystemModel(
            self.measured.test, self.facility, flow, (b1, b2, b3), tau_s, start_s
        )

    def rows(self, horizon_s: float) -> slice:
        """Return the rows that are scored."""
        reversal_s = self.measured.reversal_s
        return self.measured.rows(reversal_s - _BEFORE_REVERSAL_S, reversal_s + horizon_s)

    def measured_rows(self, horizon_s: float) -> FloatArray:
        """Return the measured outputs that are scored, of shape (n, 3)."""
        return self.measured.outputs[self.rows(horizon_s)]

    def residuals(self, shifted: FloatArray, horizon_s: float, sigma: FloatArray) -> FloatArray:
        """Return simulated less measured outputs over their σ, at departures plus 1."""
        simulated, _ = self.simulate(shifted - 1.0, horizon_s)
        return np.asarray(((simulated - self.measured_rows(horizon_s)) / sigma).ravel())

    def simulate(self, z: FloatArray, horizon_s: float) -> tuple[FloatArray, float]:
        """Return the outputs of a run that reverses when the record does, and its surge start.

        The run is made from a nominal start and moved in time as a whole; before, the model rests.
        """
        measured, model = self.measured, self.model_at(z)
        before = measured.rows(*(measured.reversal_s - s for s in _BEFORE_COLLAPSE_S))
        p31, p25, flow = measured.outputs[before].mean(axis=0).tolist()
        run = model.simulate(
            n_rows=round((horizon_s + 2.0 * _BEFORE_REVERSAL_S) / STEP_S),
            state=model.resting_state(flow, p25, p31, float(measured.T25[before].mean())),
        )
        since_s: FloatArray = STEP_S * np.arange(run["W25"].size, dtype=np.float64)
        delay_s = first_reversal_s(since_s, run["W25"])
        # A trial characteristic without reversal has no delay of its own.
        start_s = measured.reversal_s - (_COLLAPSE_S if delay_s is None else delay_s)
        start_s += self.start_error_s
        times = measured.time_s[self.rows(horizon_s)]
        columns = [
            np.interp(times, start_s + since_s, run[name], left=value)
            for name, value in zip(OUTPUTS, (p31, p25, flow), strict=True)
        ]
        return np.column_stack(columns), start_s


def _errors(found: Any, period_s: float) -> FloatArray:
    """Return the roots of the diagonal of H⁻¹ (Σ g gᵀ) H⁻¹ over blocks of the rows.

    It holds for coloured residuals and for a model that is not quite right.
    """
    n_rows, n = found.fun.size // len(OUTPUTS), found.x.size
    n_blocks = max(1, round(n_rows * period_s / _BLOCK_S))
    if n_blocks <= n:
        return np.full(n, np.nan)
    blocks = np.array_split(np.arange(found.fun.size), n_blocks)
    g = np.array([found.jac[block].T @ found.fun[block] for block in blocks])
    inverse = np.linalg.pinv(found.jac.T @ found.jac, hermitian=True)
    # Small-sample factor n/(n − p) of cluster-robust covariances.
    middle = g.T @ g * n_blocks / (n_blocks - n)
    return np.asarray(np.sqrt(np.diag(inverse @ middle @ inverse)))
