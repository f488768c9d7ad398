"""The rig's own gas relations: mass flow function, probe pressures, isentropic pressure ratio.

They are written here a second time on purpose. The reduction has its own; if both shared one
routine, a wrong equation would cancel out between the rig and the reduction.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from surge_core.types import FloatArray

GAMMA = 1.4
GAS_CONSTANT_J_KG_K = 287.05
# c_p = gamma R / (gamma - 1); the paper's 0.240 BTU/lbm/°R is the same number.
CP_J_KG_K = GAMMA * GAS_CONSTANT_J_KG_K / (GAMMA - 1.0)
# Standard day, paper Eq N1.
P_REF_PA = 101_325.0
T_REF_K = 288.15
# International avoirdupois pound and pound per square inch, for constants that the paper and its
# companion notes state in US units.
LBM_KG = 0.453_592_37
PSI_PA = 6_894.757_293

# Eq 3: W_c / A at sonic conditions without the bracket, 416.86 kg/s/m² (85.38 lbm/s/ft²).
FLOW_CONSTANT_KG_S_M2 = P_REF_PA / np.sqrt(T_REF_K) * np.sqrt(GAMMA / GAS_CONSTANT_J_KG_K)

# W_c at which the annulus chokes (M = 1), as a fraction of the constant above: 1 / 1.2³.
_CHOKED = 1.2**-3
_NEWTON_STEPS = 60


def corrected_flow_kg_s(mach: ArrayLike, area_m2: float) -> FloatArray:
    """Return the corrected mass flow of a Mach number, with its sign.

    Equation: W_c = A (P_o/√T_o) √(γ/R) M / (1 + (γ−1)/2 M²)³ (paper Eq 3, γ = 1.4).
    """
    m = np.asarray(mach, dtype=np.float64)
    return np.asarray(area_m2 * FLOW_CONSTANT_KG_S_M2 * m / (1.0 + 0.2 * m * m) ** 3)


def mach_from_corrected_flow(corrected_kg_s: ArrayLike, area_m2: float) -> FloatArray:
    """Return the signed Mach number of a corrected flow (inverse of Eq 3), ±1 if choked."""
    w = np.asarray(corrected_kg_s, dtype=np.float64) / (area_m2 * FLOW_CONSTANT_KG_S_M2)
    size = np.minimum(np.abs(w), _CHOKED)
    # Newton from M = w stays below the root because the flow function is concave on 0 < M < 1, so
    # the iteration rises monotonically; at the choke itself the root is double and needs the cap.
    m = size.copy()
    for _ in range(_NEWTON_STEPS):
        b = 1.0 + 0.2 * m * m
        slope = np.maximum((1.0 - m * m) / b**4, 1e-8)
        step = (size - m / b**3) / slope
        m = np.minimum(m + step, 1.0)
        if not np.any(np.abs(step) > 1e-14):
            break
    return np.asarray(np.sign(w) * m)


def probe_pressures_pa(
    corrected_kg_s: ArrayLike,
    total_pressure_pa: ArrayLike,
    *,
    area_m2: float,
    slope: float,
    offset: float,
    ramp: float = 0.0,
) -> tuple[FloatArray, FloatArray]:
    """Return what the forward and aft holes of one probe pair feel.

    Inverse of Eq 1, 2 and 3: M from W_c, M_calc = (|M| − b)/a, upstream hole at the total pressure
    and downstream hole at P / (1 + 0.2 M_calc²)^3.5. In reverse flow the two holes change places
    with the same constants of the pair. Below |M| = b the pair has nothing to show: a dead band.

    `slope` and `offset` are a and b of Eq 2; below a calculated Mach number of `ramp` b falls to
    nothing in proportion.
    """
    total = np.asarray(total_pressure_pa, dtype=np.float64)
    mach = mach_from_corrected_flow(corrected_kg_s, area_m2)
    apparent = np.maximum(np.abs(mach) - offset, 0.0) / slope
    if ramp:
        apparent = np.maximum(apparent, np.minimum(np.abs(mach) / (slope + offset / ramp), ramp))
    wake = total / (1.0 + 0.2 * apparent**2) ** 3.5
    forward = np.where(mach >= 0.0, total, wake)
    aft = np.where(mach >= 0.0, wake, total)
    return forward, aft
