"""Compiled loop: quasi-one-dimensional Euler equations of the whole gas path, lag and cell.

With A(x) the area of the path,

    ∂(A ρ)/∂t  + ∂(A ρ u)/∂x        = 0
    ∂(A ρ u)/∂t + ∂(A (ρ u² + p))/∂x = p dA/dx + A (f − λ ρ u |u| / 2D)
    ∂(A ρ E)/∂t + ∂(A u (ρ E + p))/∂x = A q

solved by finite volumes: MUSCL with the minmod limiter in ρ, u, p, the HLLC flux, Heun's method.
Blade force f and power q act in the cells of the compressor alone:

    f = (p/P) P25 Π^s ln Π / L + p (γ M²/2)(ΔT/L)/T,  Π = (1 + ψ' U²/(2 c_p T25))^(γ/(γ−1))
    q = |ρ u| (U²/2) ψ / L + N c_p max(−ρ u, 0) (T_w − T)/L,  ΔT = ψ U²/(2 c_p)

with ψ' behind its lag, s from 0 to 1 through the compressor, P and T total. In steady flow the
total pressure is multiplied by Π at any Mach number; in unsteady flow the gas between the planes
adds its inertia. Reversed flow meets the blading as a screen besides, k ρ u²/2L without a lag, and
the second part of q is its metal, which cools what runs backwards.
`comparisons.rig_distributed.machine` has the equations of ψ' and of the cell.
"""

from __future__ import annotations

from collections import namedtuple
from math import exp, log, sqrt
from typing import Any, TypeAlias

import numpy as np
from numba import njit

from comparisons.rig_distributed.gas import CP, GAMMA, R
from surge_core.types import FloatArray

G1 = GAMMA - 1.0
POWER = GAMMA / G1
_Three: TypeAlias = tuple[float, float, float]
_named_tuple: Any = namedtuple
Constants = _named_tuple(
    "Constants",
    "n_inlet n_compressor back_cell cell_m rotor_velocity_m_s tau_s valley span rise level "
    "cell_share growth distortion reverse_loss work_zero work_slope transfer_units supply_pa "
    "supply_k exit_k back_pa throttle_m2 close_start_s close_per_s after_stall after_lag_s closed",
)
OUTPUTS = (
    "phi", "psi_p", "psi_p_lagged", "psi_p_qs", "psi", "psi_qs", "amplitude", "in_stall",
    "throttle", "W25", "P25", "T25", "W31", "P31", "T31", "W_in", "W_out", "mass", "energy",
    "power", "phi31",
)  # fmt: skip
# The machine's own states, and what it remembers.
PSI_P, PSI, CELL, THROTTLE = range(4)
STALLED, EVER = range(2)

_LEAST_RATIO = 0.2
# At flows far from the inflexion the amplitude changes as quickly as it does at this y².
_FARTHEST_Y2 = 6.0
# The machine counts as in stall from the larger share of the largest amplitude, 2W, to the smaller.
_STALLED_SHARE, _RECOVERED_SHARE = 0.25, 0.15


@njit(cache=True)
def _total_state(rho: float, u: float, p: float) -> tuple[float, float]:
    """Return total pressure and total temperature."""
    static = p / (rho * R)
    total = static + 0.5 * u * u / CP
    return p * (total / static) ** POWER, total


@njit(cache=True)
def _limited(a: float, b: float) -> float:
    """Return the smaller of two slopes, zero where they differ in sign (minmod)."""
    if a * b <= 0.0:
        return 0.0
    return a if abs(a) < abs(b) else b


@njit(cache=True)
def _between(rl: float, ul: float, pl: float, rr: float, ur: float, pr: float) -> _Three:
    """Return the HLLC flux between two states (Toro, Spruce and Speares 1994)."""
    al, ar = sqrt(GAMMA * pl / rl), sqrt(GAMMA * pr / rr)
    wl, wr = sqrt(rl), sqrt(rr)
    share = wl / (wl + wr)
    mean = share * ul + (1.0 - share) * ur
    jump = 0.5 * share * (1.0 - share) * (ur - ul) ** 2
    speed = sqrt(share * al * al + (1.0 - share) * ar * ar + jump)
    sl, sr = min(ul - al, mean - speed), max(ur + ar, mean + speed)
    ml, mr = rl * (sl - ul), rr * (sr - ur)
    middle = (pr - pl + ml * ul - mr * ur) / (ml - mr)
    if middle >= 0.0:
        rho, u, p, m, own = rl, ul, pl, ml, sl
        wave = min(sl, 0.0)
    else:
        rho, u, p, m, own = rr, ur, pr, mr, sr
        wave = max(sr, 0.0)
    energy = p / G1 + 0.5 * rho * u * u
    star = m / (own - middle)
    star_energy = star * (energy / rho + (middle - u) * (middle + p / m))
    return (
        rho * u + wave * (star - rho),
        rho * u * u + p + wave * (star * middle - rho * u),
        u * (energy + p) + wave * (star_energy - energy),
    )


@njit(cache=True)
def _mouth(c: Any, rho: float, u: float, p: float) -> _Three:
    """Return the flux at the mouth: supply at rest where gas enters, its pressure where it leaves.

    The wave that arrives from within keeps u − 2a/(γ−1); of the entering gas a² + (γ−1)/2 u² is
    that of the supply.
    """
    if c.closed > 0.0:
        return _between(rho, -u, p, rho, u, p)
    wave = u - 2.0 * sqrt(GAMMA * p / rho) / G1
    first = 1.0 + 2.0 / G1
    last = 0.5 * G1 * wave * wave - GAMMA * R * c.supply_k
    a = (-wave + sqrt(max(wave * wave - first * last, 0.0))) / first
    p_mouth, t_mouth = c.supply_pa, a * a / (GAMMA * R)
    if wave + 2.0 * a / G1 >= 0.0:
        p_mouth *= (t_mouth / c.supply_k) ** POWER
    else:
        t_mouth = p / (rho * R) * (p_mouth / p) ** (1.0 / POWER)
        a = sqrt(GAMMA * R * t_mouth)
    u_mouth = wave + 2.0 * a / G1
    w = p_mouth / (R * t_mouth) * u_mouth
    return w, w * u_mouth + p_mouth, w * (CP * t_mouth + 0.5 * u_mouth * u_mouth)


@njit(cache=True)
def _throttle(c: Any, area_m2: float, end_m2: float, rho: float, u: float, p: float) -> _Three:
    """Return the flux at the throttle, a compressible orifice to the back pressure, either way."""
    if c.closed > 0.0:
        return _between(rho, u, p, rho, -u, p)
    _, t_up = _total_state(rho, u, p)
    high, low, sign = p, c.back_pa, 1.0
    if high < low:
        t_up, high, low, sign = c.supply_k, low, high, -1.0
    ratio = max(low / high, (2.0 / (GAMMA + 1.0)) ** POWER)
    head = ratio ** (2.0 / GAMMA) * (1.0 - ratio ** (1.0 / POWER))
    w = sign * area_m2 / end_m2 * high * sqrt(2.0 * POWER / (R * t_up) * head)
    # The wave that leaves carries the difference of velocity, Δp = −ρ a Δu.
    u_end = w / rho
    return w, w * u_end + p - sqrt(GAMMA * p * rho) * (u_end - u), w * CP * t_up


@njit(cache=True)
def _fill_fluxes(
    c: Any, throttle_m2: float, areas_m2: FloatArray, prim: FloatArray, rise: FloatArray,
    flux: FloatArray,
) -> None:  # fmt: skip
    """Fill in the fluxes (3, n + 1) at all faces from ρ, u, p, W, p + ρu²/2 (5, n) of the cells.

    ``rise`` is what the force of the blading adds to p within each cell. The state at a face is
    found by straight lines in ρ, W and p + ρu²/2 less that rise, which hardly change where area or
    force do: u and p, which follow from them, do not jump there.
    """
    n = prim.shape[1]
    flux[0, 0], flux[1, 0], flux[2, 0] = _mouth(c, prim[0, 0], prim[1, 0], prim[2, 0])
    rho, u, p = prim[0, n - 1], prim[1, n - 1], prim[2, n - 1]
    end_m2 = float(areas_m2[n])
    flux[0, n], flux[1, n], flux[2, n] = _throttle(c, throttle_m2, end_m2, rho, u, p)
    s = np.empty((2, 3))
    for f in range(1, n):
        for k, row in enumerate((0, 3, 4)):
            q, share = prim[row], 0.5 if row == 4 else 0.0
            step = q[f] - q[f - 1] - share * (rise[f] + rise[f - 1])
            low, high = 0.0, 0.0
            if f > 1:
                low = _limited(q[f - 1] - q[f - 2] - share * (rise[f - 1] + rise[f - 2]), step)
            if f < n - 1:
                high = _limited(step, q[f + 1] - q[f] - share * (rise[f + 1] + rise[f]))
            s[0, k] = q[f - 1] + 0.5 * low + share * rise[f - 1]
            s[1, k] = q[f] - 0.5 * high - share * rise[f]
        for side in range(2):
            s[side, 1] /= s[side, 0] * areas_m2[f]
            s[side, 2] -= 0.5 * s[side, 0] * s[side, 1] ** 2
        mass, momentum, energy = _between(s[0, 0], s[0, 1], s[0, 2], s[1, 0], s[1, 1], s[1, 2])
        flux[0, f], flux[1, f], flux[2, f] = mass, momentum, energy


@njit(cache=True)
def _machine(
    c: Any,
    time: float,
    phi: float,
    own: FloatArray,
    ever: float,
    d_own: FloatArray,
    out: FloatArray,
) -> None:
    """Fill in the rates of the machine's own states, and the quasi-steady values of the output."""
    y = (phi - c.valley) / c.span - 1.0
    j = (own[CELL] / c.span) ** 2
    part = 1.0 + 1.5 * y * (1.0 - 0.5 * c.cell_share * j) - 0.5 * y * y * y
    out[3] = c.level + c.rise * part
    out[5] = c.work_zero - c.work_slope * max(phi, 0.0)
    d_own[PSI_P] = (out[3] - own[PSI_P]) / c.tau_s
    d_own[PSI] = (out[5] - own[PSI]) / c.tau_s
    gain = 1.0 - min(y * y, _FARTHEST_Y2) - 0.25 * j
    d_own[CELL] = 0.5 * c.growth * (own[CELL] * gain + c.distortion * c.span)
    if ever > 0.0:
        d_own[THROTTLE] = (c.after_stall - own[THROTTLE]) / c.after_lag_s
    else:
        d_own[THROTTLE] = -c.close_per_s if time >= c.close_start_s else 0.0


@njit(cache=True)
def _blading(
    c: Any, prim: FloatArray, own: FloatArray, p25: float, t25: float, rise: FloatArray,
    power: FloatArray,
) -> float:  # fmt: skip
    """Fill in what each cell of the blading adds to p, and its power in W; return the whole ψ'."""
    head = c.rotor_velocity_m_s**2 / (2.0 * CP)
    log_ratio = POWER * log(max(1.0 + own[PSI_P] * head / t25, _LEAST_RATIO ** (1.0 / POWER)))
    lift = own[PSI] * head
    screen_pa = 0.0
    for i in range(c.n_inlet, c.n_inlet + c.n_compressor):
        rho, u, p, flow = prim[0, i], prim[1, i], prim[2, i], prim[3, i]
        s = (i - c.n_inlet + 0.5) / c.n_compressor
        p_total, t_total = _total_state(rho, u, p)
        rise[i] = p / p_total * p25 * exp(s * log_ratio) * log_ratio / c.n_compressor
        power[i] = abs(flow) * CP * lift / c.n_compressor
        if u > 0.0:
            # p γM²/2 = ρ u²/2.
            rise[i] += 0.5 * rho * u * u * lift / t_total / c.n_compressor
        else:
            drag_pa = 0.5 * c.reverse_loss * rho * u * u / c.n_compressor
            rise[i] += drag_pa
            screen_pa += drag_pa
            wall = c.supply_k + s * (c.exit_k - c.supply_k)
            power[i] -= c.transfer_units * CP * flow * (wall - t_total) / c.n_compressor
    psi_p: float = ((exp(log_ratio) + screen_pa / p25) ** (1.0 / POWER) - 1.0) * t25 / head
    return psi_p


@njit(cache=True)
def _rates(
    c: Any, time: float, path: FloatArray, cells: FloatArray, own: FloatArray, memory: FloatArray,
    work: FloatArray, d_cells: FloatArray, d_own: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    """Fill in the rates of the gas in each cell and of the machine's own states, and the output."""
    n = cells.shape[1]
    prim, rise, power, flux = work[:5, :n], work[5, :n], work[6, :n], work[7:]
    prim[0] = cells[0]
    prim[1] = cells[1] / cells[0]
    prim[2] = G1 * (cells[2] - 0.5 * cells[1] * prim[1])
    prim[3] = cells[1] * path[1, :n] / c.cell_m
    prim[4] = prim[2] + 0.5 * cells[1] * prim[1]
    front, back = c.n_inlet - 1, c.back_cell
    p25, t25 = _total_state(prim[0, front], prim[1, front], prim[2, front])
    p31, t31 = _total_state(prim[0, back], prim[1, back], prim[2, back])
    phi = prim[1, front] / c.rotor_velocity_m_s
    _machine(c, time, phi, own, memory[EVER], d_own, out)
    psi_p = _blading(c, prim, own, p25, t25, rise, power)
    _fill_fluxes(c, own[THROTTLE] * c.throttle_m2, path[0], prim, rise, flux)
    for i in range(n):
        area_in, area_out, volume = path[0, i], path[0, i + 1], path[1, i]
        for k in range(3):
            d_cells[k, i] = (area_in * flux[k, i] - area_out * flux[k, i + 1]) / volume
        # ∫ p dA of a flow that obeys Bernoulli's equation within the cell.
        push = prim[4, i] * (area_out - area_in)
        push -= 0.5 * prim[3, i] ** 2 / prim[0, i] * (1.0 / area_in - 1.0 / area_out)
        d_cells[1, i] += push / volume + rise[i] / c.cell_m
        d_cells[1, i] -= path[2, i] * cells[1, i] * abs(prim[1, i])
        d_cells[2, i] += power[i] / volume
    heat = np.sum(power) + path[0, 0] * flux[2, 0] - path[0, n] * flux[2, n]
    row = (phi, psi_p, own[PSI_P], out[3], own[PSI], out[5], own[CELL], memory[STALLED],
           own[THROTTLE], prim[3, front], p25, t25, prim[3, back], p31, t31,
           path[0, 0] * flux[0, 0], path[0, n] * flux[0, n], np.sum(cells[0] * path[1, :n]),
           np.sum(cells[2] * path[1, :n]), heat, prim[1, back] / c.rotor_velocity_m_s)  # fmt: skip
    for i in range(len(row)):
        out[i] = row[i]


@njit(cache=True)
def integrate(
    c: Any, path: FloatArray, cells: FloatArray, own: FloatArray, n_rows: int, row_s: float,
    substeps: int,
) -> FloatArray:  # fmt: skip
    """Integrate from the given gas (3, n) and machine (4,), which end as they are left.

    ``path`` has the areas of the n + 1 faces, the volumes of the n cells and their friction.
    """
    n_out = 21
    rows, scratch = np.empty((n_rows, n_out)), np.empty(n_out)
    work = np.zeros((10, cells.shape[1] + 1))
    k1, k2, m1, m2 = np.empty_like(cells), np.empty_like(cells), np.empty(4), np.empty(4)
    memory = np.zeros(2)
    h = row_s / substeps
    for i in range(n_rows):
        for j in range(substeps):
            time = i * row_s + j * h
            out = rows[i] if j == 0 else scratch
            _rates(c, time, path, cells, own, memory, work, k1, m1, out)
            share = 0.5 * own[CELL] / c.span
            if share > _STALLED_SHARE:
                memory[:] = 1.0
            elif share < _RECOVERED_SHARE and out[0] > c.valley + c.span:
                memory[STALLED] = 0.0
            ahead, own_ahead = cells + h * k1, own + h * m1
            _rates(c, time + h, path, ahead, own_ahead, memory, work, k2, m2, scratch)
            cells += 0.5 * h * (k1 + k2)
            own += 0.5 * h * (m1 + m2)
        if not np.isfinite(rows[i, 0]):
            rows[i:] = np.nan
            break
    return rows
