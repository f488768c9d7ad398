"""Switches of the total-system fit, and what came out of one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from comparisons.total_system.facility import Facility
from surge_core.errors import InputError

__all__ = ["STARTS", "TotalSystemFit", "TotalSystemSettings", "TotalSystemState"]

STARTS = ("fitted", "aligned", "multiple-shooting")
ALSO = ("reverse_loss", "throttle", "volume")
_NODES = ("fitted", "measured")


@dataclass(frozen=True)
class TotalSystemSettings:
    """How the lumped model is fitted.

    Parameters
    ----------
    facility : Facility
        The facility's numbers.
    start : {"multiple-shooting", "aligned", "fitted"}
        Restart the model in every segment; or run it once from a surge start that makes its
        first reversal of the flow coincide with the measured one; or from one that is fitted.
    start_error_s : float
        Added to the surge start (with ``"fitted"`` to where its search begins).
    volume_factor : float
        Multiplies the discharge volume that the model is told.
    fit_also : tuple of {"reverse_loss", "throttle", "volume"}
        What is fitted besides β and τ, from the facility's value on.
    initial_beta : tuple of float, optional
        Where β starts. Without it a single run starts, β and τ, from multiple shooting,
        and that from a parabola through ψ' + τ dψ'/dt over φ in stall, both as measured.
    initial_tau_s : float
        Where τ starts.
    segment_s : float
        Length of a segment of multiple shooting.
    nodes : {"fitted", "measured"}
        Flow, ψ', P31 and inlet pressure at the begin of a segment: fitted as nuisance states,
        or taken as measured.
    switches : {"measured", "model"}
        When the machine goes into stall and out of it within a segment: when the measured φ says
        so, or when the model's does. With the latter the cost jumps where a trial run recovers
        late or not at all, and the search sticks. A single run has its own switches always.
    window_s : tuple of float, optional
        What multiple shooting fits; the quasi-steady cycles without it.
    horizon_s : float
        What a single run fits, from the first reversal on.
    measured_t25 : bool
        Let the measured T25 drive the model. It swings with the record's own cycles and pulls a
        long single run towards them; the minima stay many.
    smoothing_s : float or None
        Width of the average behind states and switches read off the record; None: one cell
        period. On records without noise that costs 0.3 to 1 ms of τ, and 0 is right.
    max_iterations : int
        Gauss-Newton steps at most.

    Raises
    ------
    InputError
        Naming the setting at fault.
    """

    facility: Facility
    start: str = "multiple-shooting"
    start_error_s: float = 0.0
    volume_factor: float = 1.0
    fit_also: tuple[str, ...] = ()
    initial_beta: tuple[float, float, float] | None = None
    initial_tau_s: float = 0.02
    segment_s: float = 0.08
    nodes: str = "fitted"
    switches: str = "measured"
    window_s: tuple[float, float] | None = None
    horizon_s: float = 0.5
    measured_t25: bool = False
    smoothing_s: float | None = None
    max_iterations: int = 30

    def __post_init__(self) -> None:
        _among("start", self.start, STARTS)
        _among("nodes", self.nodes, _NODES)
        _among("switches", self.switches, ("measured", "model"))
        for name in self.fit_also:
            _among("fit_also", name, ALSO)
        # A surge cycle lasts some 150 ms: beyond that an error of the start has no meaning.
        _between("start_error_s", self.start_error_s, -0.2, 0.2)
        _between("volume_factor", self.volume_factor, 0.1, 10.0)
        _between("initial_tau_s", self.initial_tau_s, 1e-3, 1.0)
        _between("segment_s", self.segment_s, 0.02, 10.0)
        _between("horizon_s", self.horizon_s, 0.05, 60.0)
        _between("max_iterations", self.max_iterations, 1, 1000)
        if self.initial_beta is not None and not (
            len(self.initial_beta) == 3 and np.all(np.isfinite(self.initial_beta))
        ):
            raise _refused("initial_beta", "three finite numbers", self.initial_beta)
        if self.window_s is not None and not self.window_s[0] < self.window_s[1]:
            raise _refused("window_s", "two times, the earlier first", self.window_s)


def _refused(name: str, expected: str, found: object) -> InputError:
    return InputError(f"TotalSystemSettings.{name}", expected=expected, found=repr(found))


def _among(name: str, value: str, choices: tuple[str, ...]) -> None:
    if value not in choices:
        raise _refused(name, " or ".join(repr(c) for c in choices), value)


def _between(name: str, value: float, low: float, high: float) -> None:
    if isinstance(value, bool) or not (np.isfinite(value) and low <= value <= high):
        raise _refused(name, f"a number from {low:g} to {high:g}", value)


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
        "The parameters cannot be told apart on these rows: fit fewer, or take a longer window."
    )

    @property
    def advice(self) -> str:
        """What it means and what to do about it."""
        return self.value

    @property
    def code(self) -> str:
        """The name in lower case, as written to JSON."""
        return self.name.lower()


@dataclass(frozen=True)
class TotalSystemFit:
    """What a total-system fit found.

    Parameters
    ----------
    beta, beta_stderr : tuple of float
        β₁, β₂, β₃ of ψ'_QS = β₁ + β₂ φ + β₃ φ², and their standard errors.
    tau_s, tau_stderr_s : float
        Time constant and its standard error, in seconds.
    covariance : ndarray of shape (4, 4)
        Covariance of (β₁, β₂, β₃, τ in seconds), valid for coloured residuals.
    others : mapping of str to (float, float)
        What else was fitted and its standard error: ``"reverse_loss"``, ``"throttle"`` and
        ``"volume"`` (as factors of the facility's), ``"start"`` in seconds.
    start_s : float
        Surge start that the model ran with.
    state : TotalSystemState
        How the fit ended, with advice.
    rms : mapping of str to float
        Residual of P31 and P25 in Pa and of W25 in kg/s.
    relative_rms : mapping of str to float
        The same over the standard deviation of the measured channel.
    cost_trace : tuple of float
        Half the weighted sum of squares after each step.
    n_segments, n_rows : int
        Runs of the model, and rows that were scored.
    settings : TotalSystemSettings
        The switches.
    """

    beta: tuple[float, float, float]
    beta_stderr: tuple[float, float, float]
    tau_s: float
    tau_stderr_s: float
    covariance: NDArray[np.float64]
    others: Mapping[str, tuple[float, float]]
    start_s: float
    state: TotalSystemState
    rms: Mapping[str, float]
    relative_rms: Mapping[str, float]
    cost_trace: tuple[float, ...]
    n_segments: int
    n_rows: int
    settings: TotalSystemSettings

    def characteristic(self, phi: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return ψ'_QS at φ and its standard error, each of shape (n,)."""
        points = np.asarray(phi, dtype=np.float64)
        terms = np.stack([np.ones_like(points), points, points**2], axis=-1)
        variance = np.einsum("...i,ij,...j->...", terms, self.covariance[:3, :3], terms)
        return terms @ np.asarray(self.beta), np.sqrt(variance)

    def to_json(self) -> dict[str, Any]:
        """Return the fit as plain JSON types."""
        settings = asdict(self.settings)
        return {
            "time_constant_s": {"value": self.tau_s, "stderr": self.tau_stderr_s},
            "terms": [
                {"name": name, "coefficient": value, "stderr": stderr}
                for name, value, stderr in zip(
                    ("1", "phi", "phi^2"), self.beta, self.beta_stderr, strict=True
                )
            ],
            "others": {k: {"value": v, "stderr": e} for k, (v, e) in self.others.items()},
            "start_s": self.start_s,
            "state": {"code": self.state.code, "advice": self.state.advice},
            "rms": dict(self.rms),
            "relative_rms": dict(self.relative_rms),
            "cost_trace": list(self.cost_trace),
            "segments": self.n_segments,
            "rows": self.n_rows,
            "settings": settings,
        }
