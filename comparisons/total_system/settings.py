"""Switches of the total-system fit, and what came out of one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from comparisons.total_system.facility import Facility
from surge_core.display import Displayed, Field, Sheet
from surge_core.errors import InputError
from surge_core.rounding import round_to_error, significant
from surge_core.types import FloatArray
from surge_core.validation import one_of

__all__ = ["TotalSystemFit", "TotalSystemSettings", "TotalSystemState"]

# Channels that are fitted, and their units.
OUTPUTS = {"P31": "Pa", "P25": "Pa", "W25": "kg/s"}
MULTIPLE, ALIGNED = "multiple-shooting", "aligned"


@dataclass(frozen=True)
class TotalSystemSettings:
    """How the lumped model is fitted.

    Parameters
    ----------
    facility : Facility
        The facility's numbers.
    start : {"multiple-shooting", "aligned"}
        Restart the model in every segment; or run it once from a surge start that makes its
        first reversal of the flow coincide with the measured one.
    start_error_s : float
        Added to the surge start.
    volume_factor : float
        Multiplies the discharge volume that the model takes.
    initial_beta : tuple of float, optional
        Where β starts. Without it a single run starts, β and τ, from multiple shooting,
        and that from a parabola through ψ' + τ dψ'/dt over φ in stall, both as measured.
    initial_tau_s : float
        Where τ starts.
    segment_s : float
        Length of a segment of multiple shooting.
    window_s : tuple of float, optional
        What multiple shooting fits; the quasi-steady cycles without it.
    horizon_s : float
        What a single run fits, from the first reversal on.
    max_iterations : int
        Evaluations of the Jacobian in each pass at most.

    Raises
    ------
    InputError
        Naming the setting at fault.
    """

    facility: Facility
    start: str = MULTIPLE
    start_error_s: float = 0.0
    volume_factor: float = 1.0
    initial_beta: tuple[float, float, float] | None = None
    initial_tau_s: float = 0.02
    segment_s: float = 0.08
    window_s: tuple[float, float] | None = None
    horizon_s: float = 0.5
    max_iterations: int = 30

    def __post_init__(self) -> None:
        one_of("TotalSystemSettings.start", self.start, (MULTIPLE, ALIGNED))
        for name, low, high in (
            # A surge cycle lasts some 150 ms: beyond that an error of the start has no meaning.
            ("start_error_s", -0.2, 0.2),
            ("volume_factor", 0.1, 10.0),
            ("initial_tau_s", 1e-3, 1.0),
            ("segment_s", 0.02, 10.0),
            ("horizon_s", 0.05, 60.0),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise InputError(
                    f"TotalSystemSettings.{name}",
                    expected=f"a number from {low:g} to {high:g}",
                    found=f"{value!r}",
                )


class TotalSystemState(Enum):
    """How a total-system fit ended; the value is the advice that goes with it."""

    CONVERGED = "The fit converged."
    NOT_CONVERGED = (
        "The fit stopped before it converged: allow more iterations, start nearer, or take "
        "multiple shooting."
    )
    LOST_THE_CYCLES = (
        "The simulation does not follow the record: the fit sits in a wrong minimum, or a number "
        "of the facility or the surge start is wrong. Neither the characteristic nor the time "
        "constant counts; take multiple shooting, a shorter horizon, or check volumes and throttle."
    )
    DIVERGED = (
        "The simulation did not stay finite from the starting values: check the facility's "
        "numbers or start nearer."
    )
    AT_BOUND = (
        "The time constant ran out of 1 ms to 1 s: it makes up for something that the model of "
        "the facility lacks; do not use it."
    )
    RANK_DEFICIENT = (
        "These rows do not determine all parameters: take a longer window, or more cycles."
    )

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
        β₁, β₂, β₃ of ψ'_QS = β₁ + β₂ φ + β₃ φ², and their standard errors.
    tau_s, tau_stderr_s : float
        Time constant and its standard error, in seconds.
    covariance : ndarray of shape (4, 4)
        Covariance of (β₁, β₂, β₃, τ in seconds), valid for coloured residuals.
    start_s : float
        Surge start that the model ran with.
    state : TotalSystemState
        How the fit ended, with advice.
    rms : mapping of str to float
        Residual of P31 and P25 in Pa and of W25 in kg/s.
    relative_rms : mapping of str to float
        The same over the standard deviation of the measured channel.
    cost_trace : tuple of float
        Half the weighted sum of squares after each pass, each with its own weights.
    n_segments, n_rows : int
        Runs of the model, and rows that were scored.
    settings : TotalSystemSettings
        The switches.
    """

    beta: tuple[float, float, float]
    beta_stderr: tuple[float, float, float]
    tau_s: float
    tau_stderr_s: float
    covariance: FloatArray
    start_s: float
    state: TotalSystemState
    rms: Mapping[str, float]
    relative_rms: Mapping[str, float]
    cost_trace: tuple[float, ...]
    n_segments: int
    n_rows: int
    settings: TotalSystemSettings

    def characteristic(self, phi: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return ψ'_QS at φ and its standard error, each of shape (n,)."""
        terms = np.vander(np.atleast_1d(np.asarray(phi, dtype=np.float64)), 3, increasing=True)
        variance = np.einsum("...i,ij,...j->...", terms, self.covariance[:3, :3], terms)
        return terms @ np.asarray(self.beta), np.sqrt(variance)

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
                Field("rows", f"{self.n_segments} runs over {self.n_rows} rows"),
                Field("residuals", residuals),
                Field(self.state.code, self.state.value, "good" if good else "advice"),
            ),
        )

    def to_json(self) -> dict[str, Any]:
        """Return the fit as plain JSON types."""
        settings = vars(self.settings) | {"facility": self.settings.facility.model_dump()}
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
            "cost_trace": list(self.cost_trace),
            "segments": self.n_segments,
            "rows": self.n_rows,
            "settings": settings,
        }
