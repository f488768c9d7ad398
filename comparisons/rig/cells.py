"""What the four probes of a plane see that the mean flow does not: stall cells, hub/tip shift."""

from __future__ import annotations

from math import pi, radians

import numpy as np

from comparisons.rig.cases import RigCase
from comparisons.rig.gas import P_REF_PA, T_REF_K
from comparisons.rig.hidden import SECOND_CELL_ROTOR_FRAC, Alteration
from comparisons.rig.plant import PLANT_RATE_HZ, PlantRun
from comparisons.rig.sensors import SensorSettings
from surge_core.types import FloatArray

__all__ = ["IMMERSIONS", "RAKES", "corrected_plane_flow_kg_s", "local_flow"]


RAKES = ("A", "B")
IMMERSIONS = ("tip", "hub")

# Lock-in of the independent record at 82.5 and 165 Hz: the cell reaches rake B 110° after rake A,
# the tip swings 1.3 and the hub 0.7 times the mean, pressure leads flow by 30°.
_RAKE_ANGLE = {"A": 0.0, "B": radians(-110.0)}
_REACH = {"tip": 1.3, "hub": 0.7}
_PRESSURE_LEAD = radians(30.0)
_SIDE = {"tip": -1.0, "hub": 1.0}


def corrected_plane_flow_kg_s(run: PlantRun, plane: int) -> FloatArray:
    """Return the mean corrected flow W √(T/T_o) / (P/P_o) of a plane (Eq N1), in kg/s."""
    theta = run[f"T{plane}"] / T_REF_K
    return np.asarray(run[f"W{plane}"] * np.sqrt(theta) / (run[f"P{plane}"] / P_REF_PA))


def local_flow(
    case: RigCase,
    run: PlantRun,
    settings: SensorSettings,
    altered: Alteration,
    *,
    plane: int,
    rake: str,
    immersion: str,
) -> tuple[FloatArray, FloatArray]:
    """Return corrected flow in kg/s and total pressure in Pa at one probe pair.

    Equation: W_c + J A w (sin θ + h₂ sin 2θ) ± q ΔW_c, θ = 2π f t + angle of the rake; the total
    pressure moves in proportion. Over the plane hub and tip shift cancel; the cells do not, because
    two rakes do not resolve them.

    Parameters
    ----------
    case, run, settings : RigCase, PlantRun, SensorSettings
        The plant, what it did, and the factors on cells and shift.
    altered : Alteration
        What is hidden; a second cell pattern, slower than the first, shows here.
    plane : int
        25 or 31.
    rake, immersion : str
        ``"A"`` or ``"B"``; ``"tip"`` or ``"hub"``.

    Returns
    -------
    tuple of ndarray of shape (n,)
        At `PLANT_RATE_HZ`; the flow that the whole plane would pass if all were like this spot.
    """
    share = 1.0 if plane == 25 else case.exit_cell_frac
    mean = corrected_plane_flow_kg_s(run, plane)
    time_s = np.arange(mean.size) / PLANT_RATE_HZ
    angle = 2.0 * pi * case.cell_frequency_hz * time_s + _RAKE_ANGLE[rake]
    reach = share * settings.cells * run["cells"] * _REACH[immersion]
    shift = share * settings.hub_tip * case.hub_tip_flow_kg_s * run["blend"] * _SIDE[immersion]
    flow = mean + reach * case.cell_flow_kg_s * _wave(case, angle) + shift
    ripple = reach * case.cell_pressure_frac * _wave(case, angle + _PRESSURE_LEAD)
    if altered.rotating_stall_ripple:
        turn = SECOND_CELL_ROTOR_FRAC * 2.0 * pi * case.rotor_speed_rpm / 60.0
        angle = turn * time_s + _RAKE_ANGLE[rake]
        reach = share * altered.rotating_stall_ripple * run["cells"] * _REACH[immersion]
        flow = flow + reach * case.cell_flow_kg_s * np.sin(angle)
        ripple = ripple + reach * case.cell_pressure_frac * np.sin(angle + _PRESSURE_LEAD)
    return flow, run[f"P{plane}"] * (1.0 + ripple)


def _wave(case: RigCase, angle: FloatArray) -> FloatArray:
    return np.asarray(np.sin(angle) + case.cell_second_harmonic * np.sin(2.0 * angle))
