"""What is looked at and what is found of a residual: rows of numbers, a panel each."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

from surge_core.types import BoolArray, FloatArray, IntArray

__all__ = [
    "PANELS",
    "FlowRow",
    "FrequencyRow",
    "Line",
    "PhaseRow",
    "RegimeRow",
    "ResidualRuns",
    "TimeRow",
    "Where",
]

PANELS = ("time", "frequency", "flow", "phase", "regime")


@dataclass(frozen=True)
class ResidualRuns:
    """The residual of a free run with what it is looked at over.

    Parameters
    ----------
    residual : ndarray of shape (n,)
        Measured minus simulated.
    phi : ndarray of shape (n,)
        Flow coefficient.
    time_s : ndarray of shape (n,)
        Facility clock, in seconds.
    runs : tuple of slice
        Contiguous, uniformly sampled pieces in order; nothing is carried from one to the next.
    record : ndarray of int, shape (n,)
        Number of the record of each row.
    scored : ndarray of bool, shape (n,)
        Rows whose residual counts; that of the others may be NaN.
    sample_rate_hz : float
        Samples a second.
    record_names : tuple of str
        Names of the records.
    """

    residual: FloatArray
    phi: FloatArray
    time_s: FloatArray
    runs: tuple[slice, ...]
    record: IntArray
    scored: BoolArray
    sample_rate_hz: float
    record_names: tuple[str, ...]


@dataclass(frozen=True)
class TimeRow:
    """The residual in one block of time.

    Parameters
    ----------
    record : str
        Name of the record.
    from_s, to_s : float
        Edges of the block on the facility clock, in seconds.
    n : int
        Scored rows.
    mean, rms : float
        Of the residual, in its own unit.
    excess : float
        rms of what exceeds the floor, √(rms² − floor²), 0 below it.
    z_mean, z_variance : float
        Of the mean against zero and of the variance against the floor.
    """

    record: str
    from_s: float
    to_s: float
    n: int
    mean: float
    rms: float
    excess: float
    z_mean: float
    z_variance: float

    @property
    def z(self) -> float:
        """The larger of the two; a variance below the floor is no structure."""
        return _larger(abs(self.z_mean), self.z_variance)


@dataclass(frozen=True)
class FrequencyRow:
    """The residual's power in one band against the floor's.

    Parameters
    ----------
    low_hz, high_hz : float
        Edges, in hertz.
    ratio : float
        Power over that of the floor.
    ratio_bound : float
        Ratio that chance reaches, all looks counted.
    share : float
        Share of all power beyond the floor that lies in the band.
    z : float
        Of the ratio against 1.
    lines : tuple of str
        Lines in the band: "surge" (with harmonics), "stall cells".
    """

    low_hz: float
    high_hz: float
    ratio: float
    ratio_bound: float
    share: float
    z: float
    lines: tuple[str, ...]


@dataclass(frozen=True)
class Line:
    """A frequency worth a mark.

    Parameters
    ----------
    name : str
        "surge" or "stall cells".
    frequency_hz : float
        In hertz.
    source : str
        "flow" (found in φ), "given", or "residual" (found there).
    harmonic : int
        1 is the fundamental.
    z : float
        How far the line stands out of the residual, where that was looked at; else NaN.
    width_hz : float
        Width over which it does; else NaN.
    """

    name: str
    frequency_hz: float
    source: str
    harmonic: int = 1
    z: float = math.nan
    width_hz: float = math.nan


@dataclass(frozen=True)
class FlowRow:
    """The residual in one octile of φ and one direction of travel.

    Parameters
    ----------
    phi_from, phi_to : float
        Edges of the octile.
    direction : str
        "falling" or "rising".
    mean, stderr : float
        Mean residual without its slow part, and its standard error.
    z : float
        Of the mean against zero, outliers held back.
    n : int
        Scored rows.
    """

    phi_from: float
    phi_to: float
    direction: str
    mean: float
    stderr: float
    z: float
    n: int


@dataclass(frozen=True)
class PhaseRow:
    """The residual in one part of the surge cycle.

    Parameters
    ----------
    from_cycle, to_cycle : float
        Edges, in cycles from where φ rises through its mean.
    mean, stderr, z, n
        As in :class:`FlowRow`.
    """

    from_cycle: float
    to_cycle: float
    mean: float
    stderr: float
    z: float
    n: int


@dataclass(frozen=True)
class RegimeRow:
    """The residual of one record beside the regime that it was taken in.

    Parameters
    ----------
    record : str
        Name of the record.
    phi_mean, phi_amplitude : float
        Mean of φ, and the amplitude √2 · rms of its departure from it.
    surge_hz : float
        Surge frequency, in hertz; NaN where φ has no regular cycle.
    mean, rms : float
        Of the residual.
    ratio : float
        rms over the floor.
    z_mean, z_variance : float
        Of the mean against zero and of the variance against the floor.
    """

    record: str
    phi_mean: float
    phi_amplitude: float
    surge_hz: float
    mean: float
    rms: float
    ratio: float
    z_mean: float
    z_variance: float

    @property
    def z(self) -> float:
        """The larger of the two."""
        return _larger(abs(self.z_mean), self.z_variance)


@dataclass(frozen=True)
class Where:
    """Where a residual stands out, and where it does not.

    Parameters
    ----------
    time, frequency, flow, phase, regime : tuple
        Rows of each panel; `phase` is empty where φ has no regular cycle.
    lines : tuple of Line
        Surge and stall cells.
    spectrum_hz, spectrum_ratio : ndarray of shape (m,)
        The spectrum over the floor's.
    direction_means : tuple of float
        Mean residual while φ falls and while it rises, without the slow part.
    direction_z : float
        Of the difference of the two.
    floor_rms : float
        Measurement noise as stated.
    background : float
        rms of the quietest quarter of the spectrum over the floor.
    effective_share : float
        Independent rows in a mean over one row of the floor's noise, 1 for white noise.
    looks : int
        Numbers looked at.
    bound_z : float
        What chance reaches in that many looks.
    words : tuple of str
        A sentence for each panel, and one on how they were judged.
    """

    time: tuple[TimeRow, ...]
    frequency: tuple[FrequencyRow, ...]
    flow: tuple[FlowRow, ...]
    phase: tuple[PhaseRow, ...]
    regime: tuple[RegimeRow, ...]
    lines: tuple[Line, ...]
    spectrum_hz: FloatArray
    spectrum_ratio: FloatArray
    direction_means: tuple[float, float]
    direction_z: float
    floor_rms: float
    background: float
    effective_share: float
    looks: int
    bound_z: float
    words: tuple[str, ...] = ()

    @property
    def strongest_z(self) -> dict[str, float]:
        """Largest |z| of each panel; 0 where a panel has nothing that was looked at."""
        found = {
            "time": [row.z for row in self.time],
            "frequency": [row.z for row in self.frequency] + [line.z for line in self.lines],
            "flow": [abs(row.z) for row in self.flow] + [abs(self.direction_z)],
            "phase": [abs(row.z) for row in self.phase],
            "regime": [row.z for row in self.regime] if len(self.regime) > 1 else [],
        }
        return {
            name: max((z for z in values if math.isfinite(z)), default=0.0)
            for name, values in found.items()
        }

    @property
    def standing_out(self) -> tuple[str, ...]:
        """The panels in which something lies beyond what chance reaches, the strongest first."""
        beyond = {name: z for name, z in self.strongest_z.items() if z > self.bound_z}
        return tuple(sorted(beyond, key=lambda name: -beyond[name]))

    @property
    def max_band_ratio(self) -> float:
        """Largest ratio of a band to the floor; calibrated by the row's own `ratio_bound`."""
        return max(row.ratio for row in self.frequency)

    @property
    def max_flow_z(self) -> float:
        """Largest |z| of the flow map or of its falling-rising contrast; compare `bound_z`."""
        return self.strongest_z["flow"]

    def to_json(self) -> dict[str, Any]:
        """Return the rows of each panel and the words as plain lists and dictionaries."""
        document: dict[str, Any] = {
            name: [asdict(row) for row in getattr(self, name)] for name in PANELS
        }
        for row in document["frequency"]:
            row["lines"] = list(row["lines"])
        document["words"] = list(self.words)
        return document


def _larger(*values: float) -> float:
    return max((value for value in values if math.isfinite(value)), default=0.0)
