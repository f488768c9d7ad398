"""The truth behind a simulated record, which only the one who simulated it knows."""

from __future__ import annotations

from dataclasses import dataclass

from surge_core.types import FloatArray

__all__ = ["Truth"]


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
