"""Time constants: as estimators found them, as a trial scores them, as a simulation had them."""

from __future__ import annotations

from dataclasses import dataclass

from comparisons.results.comparison import EstimatorResult
from surge_core.types import FloatArray


@dataclass(frozen=True)
class TauTrial:
    """Reconstruction error over τ.

    Parameters
    ----------
    tau_s : ndarray of shape (n,)
        Values at which τ was held, in seconds.
    refitted_rms : ndarray of shape (n,)
        Error of the free run with the curve refitted to each τ.
    best_tau_s : float
        τ of least error with a curve of its own, between the values by a parabola.
    interval_s : tuple of float
        Values of τ whose error exceeds the least by no more than two paired standard errors; an
        end that the values do not reach is that of the values.
    least_rms : float
        The least error.
    target : {"psi_p", "psi"}
        Which coefficient it is.
    estimates : tuple of (EstimatorResult, float)
        What was estimated on the same rows, each with the error of its own reconstruction.
    """

    tau_s: FloatArray
    refitted_rms: FloatArray
    best_tau_s: float
    interval_s: tuple[float, float]
    least_rms: float
    target: str
    estimates: tuple[tuple[EstimatorResult, float], ...] = ()


@dataclass(frozen=True)
class Truth:
    """Time constant and characteristic that a simulated record was made with.

    Parameters
    ----------
    time_constant_s : float
        τ, in seconds.
    phi, quasi_steady : ndarray of shape (n,)
        The quasi-steady characteristic at increasing φ.
    label : str
        What pictures call it.
    """

    time_constant_s: float
    phi: FloatArray
    quasi_steady: FloatArray
    label: str
