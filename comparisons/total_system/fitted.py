"""Switches of the total-system fit, and what came out of one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from comparisons.total_system.facility import Facility
from surge_core.display import Displayed, Field, Sheet
from surge_core.rounding import round_to_error, significant
from surge_core.terms import terms_json
from surge_core.types import FloatArray

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
        Restart the model in every segment of the quasi-steady cycles; or run it once from a surge
        start that makes its first reversal of the flow coincide with the measured one.
    start_error_s : float
        Added to the surge start.
    volume_factor : float
        Multiplies the discharge volume that the model takes.
    initial_beta : tuple of float, optional
        Where β starts. Without it a single run starts, β and τ, from multiple shooting.
    initial_tau_s : float
        Where τ starts.
    window_s : tuple of float, optional
        What multiple shooting fits; the quasi-steady cycles without it.
    max_iterations : int
        Evaluations of the Jacobian in each pass at most.
    """

    facility: Facility
    start: str = MULTIPLE
    start_error_s: float = 0.0
    volume_factor: float = 1.0
    initial_beta: tuple[float, float, float] | None = None
    initial_tau_s: float = 0.02
    window_s: tuple[float, float] | None = None
    max_iterations: int = 30


class TotalSystemState(Enum):
    """How a total-system fit ended; the value is the advice that goes with it."""

    CONVERGED = "The fit converged."
    NOT_CONVERGED = (
        "The fit stopped before it converged, and states no number. A number of the facility, or "
        "the timing of a plane, may be wrong: check volumes, throttle and clocks."
    )
    LOST_THE_CYCLES = (
        "The simulation does not follow the record: the fit sits in a wrong minimum, or a number "
        "of the facility or the surge start is wrong. Neither the characteristic nor the time "
        "constant counts: check volumes and throttle."
    )
    DIVERGED = (
        "The simulation did not stay finite from the starting values: check the facility's "
        "numbers or start nearer."
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
    cost_trace : tuple of float
        Half the weighted sum of squares after each pass, each with its own weights.
    n_segments, n_rows : int
        Runs of the model, and rows that were scored.
    settings : TotalSystemSettings
        The switches.
    """

    beta: tuple[float, float, float]
    beta_stderr: tuple[float, ...]
    tau_s: float
    tau_stderr_s: float
    start_s: float
    state: TotalSystemState
    rms: Mapping[str, float]
    relative_rms: Mapping[str, float]
    cost_trace: tuple[float, ...]
    n_segments: int
    n_rows: int
    settings: TotalSystemSettings

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
        tau = f"{round_to_error(1e3 * self.tau_s, 1e3 * self.tau_stderr_s)} ms"
        numbers = Field("τ", tau), *(Field(name, round_to_error(*pair)) for name, *pair in beta)
        return Sheet(
            "Total-system fit",
            (
                *(numbers if good else ()),
                Field("surge start", f"{self.start_s:.4f} s"),
                Field("rows", f"{self.n_segments} runs over {self.n_rows} rows"),
                Field("residuals", residuals),
                Field(self.state.code, self.state.value, "good" if good else "advice"),
            ),
        )

    def to_json(self) -> dict[str, Any]:
        """Return the fit as plain JSON types; one that did not converge states no number."""
        counts = 1.0 if self.state is TotalSystemState.CONVERGED else math.nan
        beta, beta_stderr = counts * np.array(self.beta), counts * np.array(self.beta_stderr)
        settings = vars(self.settings) | {"facility": self.settings.facility.model_dump()}
        return {
            "time_constant_s": {"value": counts * self.tau_s, "stderr": counts * self.tau_stderr_s},
            "terms": terms_json(("1", "phi", "phi^2"), beta, beta_stderr),
            "start_s": self.start_s,
            "state": {"code": self.state.code, "advice": self.state.value},
            "rms": dict(self.rms),
            "relative_rms": dict(self.relative_rms),
            "cost_trace": list(self.cost_trace),
            "segments": self.n_segments,
            "rows": self.n_rows,
            "settings": settings,
        }
