"""What a claim of the paper is, and the small sums that several of them share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from classic_ml.flow import LBM_KG
from comparisons.paper.instabilities import Instabilities, InstabilityRun
from comparisons.results import FittedLag
from comparisons.rig import SensorSettings
from surge_core.types import FloatArray

__all__ = [
    "CURVE_PHI",
    "LBM_KG",
    "PSI_PA",
    "Claim",
    "ClaimCheck",
    "curve_change",
    "near_stall_mean",
    "sensors_of",
    "window_mask",
]

PSI_PA = 6_894.757_293
# Flows at which curves are compared: the forward part of the range that the paper calls reliable.
CURVE_PHI = np.linspace(0.0, 0.15, 31)


@dataclass(frozen=True)
class Claim:
    """One claim of the paper beside what was found.

    Parameters
    ----------
    id : int
        Its number in the list of claims.
    section : str
        Where in the paper.
    claim : str
        The claim in one sentence.
    stated : float or str
        The number the paper states, or its words where it states none.
    found : float or str
        What came out here.
    holds : bool
        Whether it holds.
    how : str
        How it was tested, and what else was seen.
    unit : str
        Unit of the numbers.
    """

    id: int
    section: str
    claim: str
    stated: float | str
    found: float | str
    holds: bool
    how: str
    unit: str = ""

    def __post_init__(self) -> None:
        # Rows go to JSON, which knows no numpy.
        object.__setattr__(self, "holds", bool(self.holds))
        for name in ("stated", "found"):
            value = getattr(self, name)
            object.__setattr__(self, name, value if isinstance(value, str) else float(value))


ClaimCheck: TypeAlias = Callable[[Instabilities], Claim]


def sensors_of(run: InstabilityRun) -> SensorSettings:
    """Return the settings of the sensors that a run was made with."""
    return SensorSettings(**run.rig.truth_parameters["sensor_settings"])


def window_mask(run: InstabilityRun) -> NDArray[np.bool_]:
    """Return the rows of the quasi-steady cycles in the paper's reduction."""
    return np.asarray(run.paper.record["window"] > 0.5)


def near_stall_mean(run: InstabilityRun, channel: str) -> float:
    """Return the mean of a channel of the paper's reduction over the facility's reading."""
    reading = run.paper.test.near_stall
    time_s = run.paper.record.time_s
    rows = (time_s >= reading.from_s) & (time_s <= reading.to_s)
    return float(np.mean(run.paper.record[channel][rows]))


def curve_change(
    fit: FittedLag, other: FittedLag | FloatArray, phi: FloatArray = CURVE_PHI
) -> float:
    """Return the largest relative difference of two characteristics over φ from 0 to 0.15.

    Parameters
    ----------
    fit : FittedLag
        One curve.
    other : FittedLag or ndarray of shape (n,)
        The other, which is the measure.
    phi : ndarray of shape (n,)
        Where to compare.
    """
    reference = other.quasi_steady(phi) if isinstance(other, FittedLag) else other
    return float(np.max(np.abs(fit.quasi_steady(phi) / reference - 1.0)))
