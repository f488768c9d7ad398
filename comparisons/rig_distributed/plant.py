"""The machine in its ducts: the grid, the steady flow that it starts from, the run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from comparisons.rig_distributed.euler import OUTPUTS, Constants, integrate
from comparisons.rig_distributed.gas import CP, GAMMA, R
from comparisons.rig_distributed.machine import Machine
from surge_core.errors import InputError
from surge_core.types import FloatArray

PLANT_HZ = 10_000.0
CELL_M = 0.1
SUBSTEPS = 2
# Before the record: acoustic waves of the first guess of the steady flow have died out by then.
SETTLING_S = 0.4
# Length of the area of plane 31 behind the compressor, with the plane in its middle.
_EXIT_M = 0.2
# Atmosphere behind the throttle.
_BACK_PA = 101_325.0

# What the plant did, at `PLANT_HZ`, before any sensor, named as in
# `comparisons.rig_distributed.euler.OUTPUTS`.
PlantRun: TypeAlias = Mapping[str, FloatArray]


@dataclass(frozen=True)
class GasPath:
    """The gas path in cells."""

    cell_m: float  # Length of a cell
    n_inlet: int  # Cells in front of the compressor, the last of which is plane 25
    n_compressor: int
    areas_m2: FloatArray  # At the n + 1 faces
    # Share of ρ u² that walls and the screens of the inlet take off each cell, a metre.
    friction_per_m: FloatArray

    @property
    def volumes_m3(self) -> FloatArray:
        """Volume of each cell."""
        return np.asarray(0.5 * self.cell_m * (self.areas_m2[1:] + self.areas_m2[:-1]))

    @property
    def planes(self) -> tuple[int, int]:
        """Cells of planes 25 and 31."""
        behind = round(0.5 * _EXIT_M / self.cell_m)
        return self.n_inlet - 1, self.n_inlet + self.n_compressor + behind

    @property
    def between_planes(self) -> tuple[float, float]:
        """∫dx/A in 1/m and the volume in m³ between the middles of planes 25 and 31."""
        front, back = self.planes
        weight = np.ones(back - front + 1)
        weight[[0, -1]] = 0.5
        volumes = self.volumes_m3[front : back + 1]
        return float(np.sum(weight * self.cell_m**2 / volumes)), float(np.sum(weight * volumes))

    @property
    def table(self) -> FloatArray:
        """What the compiled loop takes: areas of the faces, volumes and friction of the cells."""
        # Of the faces there is one more than of the cells.
        cells = (np.append(values, 0.0) for values in (self.volumes_m3, self.friction_per_m))
        return np.stack([self.areas_m2, *cells])


def lay_out(machine: Machine, cell_m: float = CELL_M) -> GasPath:
    """Divide the gas path into cells of one length in m, to which all lengths are rounded."""
    inlet, compressor, cone, plenum = (
        max(2, round(length / cell_m))
        for length in (machine.inlet_m, machine.compressor_m, machine.cone_m, machine.plenum_m)
    )
    small, large = np.sqrt([machine.exit_area_m2, machine.plenum_area_m2])
    parts = (
        np.full(inlet, machine.inlet_area_m2),
        np.linspace(machine.inlet_area_m2, machine.exit_area_m2, compressor + 1),
        np.full(round(_EXIT_M / cell_m), machine.exit_area_m2),
        np.linspace(small, large, cone + 1)[1:] ** 2,
        np.full(plenum, machine.plenum_area_m2),
    )
    areas = np.concatenate(parts)
    diameters_m = np.sqrt(2.0 / np.pi * (areas[1:] + areas[:-1]))
    friction = 0.5 * machine.friction / diameters_m
    friction[:inlet] += 0.5 * machine.inlet_loss / (inlet * cell_m)
    return GasPath(cell_m, inlet, compressor, areas, friction)


def _static(flow: FloatArray, total_pa: FloatArray, total_k: FloatArray) -> FloatArray:
    """Return (ρ, ρu, ρE) of a subsonic flow per area, from its total state."""
    share = flow * np.sqrt(R * total_k / GAMMA) / total_pa
    mach = share.copy()
    for _ in range(100):
        mach = share * (1.0 + 0.2 * mach**2) ** 3
    k = total_k / (1.0 + 0.2 * mach**2)
    pa = total_pa * (k / total_k) ** 3.5
    rho = pa / (R * k)
    return np.stack([rho, flow, pa / (GAMMA - 1.0) + 0.5 * flow**2 / rho])


def steady_flow(machine: Machine, path: GasPath) -> tuple[FloatArray, FloatArray, float, float]:
    """Return the first steady flow, but for the friction behind the compressor.

    ρ, ρu, ρE of the cells (3, n); ψ', ψ, amplitude of the stall cell and opening of the throttle;
    the area of the throttle that passes the flow; total temperature behind the compressor.
    """
    phi = machine.start_phi * machine.peak_phi
    psi_p = float(machine.steady_psi_p(np.array(phi)))
    psi = machine.work_zero - machine.work_slope * phi
    static_k = machine.supply_k - (phi * machine.rotor_velocity_m_s) ** 2 / (2.0 * CP)
    velocity = phi * machine.rotor_velocity_m_s
    loss = path.cell_m * float(np.sum(path.friction_per_m[: path.n_inlet])) * velocity**2
    per_pa = (static_k / machine.supply_k) ** 2.5 / (R * machine.supply_k)
    front_pa = machine.supply_pa / (1.0 + per_pa * loss)
    flow = per_pa * front_pa * velocity * machine.inlet_area_m2
    middle = 0.5 * (path.areas_m2[1:] + path.areas_m2[:-1])
    place = np.arange(middle.size) + 0.5
    s = np.clip((place - path.n_inlet) / path.n_compressor, 0.0, 1.0)
    ratio = (1.0 + machine.temperature_rise_k(psi_p) / machine.supply_k) ** 3.5
    total_k = np.asarray(machine.supply_k + s * machine.temperature_rise_k(psi), np.float64)
    lost_pa = np.clip(place / path.n_inlet, 0.0, 1.0) * (machine.supply_pa - front_pa)
    cells = _static(flow / middle, (machine.supply_pa - lost_pa) * ratio**s, total_k)
    u = cells[1, -1] / cells[0, -1]
    pa = 0.4 * (cells[2, -1] - 0.5 * cells[0, -1] * u**2)
    low = max(_BACK_PA / pa, 1.2**-3.5)
    if not np.all(np.isfinite(cells)) or low >= 1.0:
        raise InputError(
            "machine",
            expected="a subsonic flow and more than the pressure of the atmosphere behind it",
            found=f"φ = {phi:.3f}, ψ' = {psi_p:.2f}",
        )
    head = low ** (2.0 / GAMMA) * (1.0 - low ** (1.0 / 3.5))
    area = flow / (pa * np.sqrt(7.0 / (R * total_k[-1]) * head))
    own = np.array([psi_p, psi, machine.distortion * machine.span, 1.0])
    return cells, own, float(area), float(total_k[-1])


def constants(machine: Machine, path: GasPath, throttle_m2: float, exit_k: float) -> Any:
    """Gather the numbers of the compiled loop, the last two as of :func:`steady_flow`."""
    same = {n: float(getattr(machine, n)) for n in Constants._fields if hasattr(machine, n)}
    return Constants(
        **same,
        n_inlet=path.n_inlet,
        n_compressor=path.n_compressor,
        back_cell=path.planes[1],
        cell_m=path.cell_m,
        growth=machine.growth_per_s,
        exit_k=exit_k,
        back_pa=_BACK_PA,
        throttle_m2=throttle_m2,
        closed=0.0,
    )


def run_plant(machine: Machine, *, n_rows: int, cell_m: float = CELL_M) -> PlantRun:
    """Let the flow settle, then run the machine through its surge, for rows at `PLANT_HZ`.

    The time step shrinks with the cells. A machine without a steady flow to start from, or whose
    flow does not stay finite, is refused.
    """
    path = lay_out(machine, cell_m)
    cells, own, throttle_m2, exit_k = steady_flow(machine, path)
    numbers = constants(machine, path, throttle_m2, exit_k)
    substeps = max(1, round(SUBSTEPS * CELL_M / cell_m))
    waiting = numbers._replace(close_start_s=2.0 * SETTLING_S)
    step_s = 1.0 / PLANT_HZ
    integrate(waiting, path.table, cells, own, round(SETTLING_S * PLANT_HZ), step_s, substeps)
    rows = integrate(numbers, path.table, cells, own, n_rows, step_s, substeps)
    if not np.all(np.isfinite(rows)):
        raise InputError(
            "machine",
            expected="a flow that stays finite",
            found=f"one that does not after {np.argmax(~np.isfinite(rows[:, 0])) * step_s:.3f} s",
        )
    return dict(zip(OUTPUTS, np.ascontiguousarray(rows.T), strict=True))
