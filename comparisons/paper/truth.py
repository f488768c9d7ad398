"""The rig's own characteristics, written out for the claims and pictures that show the truth."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from classic_ml.flow import LBM_KG
from comparisons.paper.instabilities import InstabilityRun
from surge_core.types import FloatArray

__all__ = [
    "LBM_KG",
    "PSI_PA",
    "RANKINE_PER_K",
    "THRESHOLD_LBM_S",
    "in_stall_psi",
    "in_stall_psi_p",
]

PSI_PA = 6_894.757_293
RANKINE_PER_K = 1.8
# Paper, "Model Identification for 98.5% Corrected Speed": between in-stall and unstalled flow.
THRESHOLD_LBM_S = 50.0


def in_stall_psi_p(run: InstabilityRun, phi: ArrayLike) -> FloatArray:
    """Return the rig's quasi-steady ψ' in stall, without the loss of reversed flow (Eq 12)."""
    return np.asarray(
        np.polynomial.polynomial.polyval(np.asarray(phi), run.rig.truth_parameters["beta"])
    )


def in_stall_psi(run: InstabilityRun, phi: ArrayLike) -> FloatArray:
    """Return the rig's quasi-steady ψ in stall: three straight pieces (Eq 14)."""
    known = run.rig.truth_parameters
    first, second = known["psi_breaks"]
    flow = np.asarray(phi, dtype=np.float64)
    pieces = (
        np.minimum(flow, first),
        np.clip(flow - first, 0.0, second - first),
        np.maximum(flow - second, 0.0),
    )
    slopes = known["psi_slopes"]
    steps = [slope * piece for slope, piece in zip(slopes, pieces, strict=True)]
    return np.asarray(known["psi_intercept"] + np.sum(steps, axis=0))
