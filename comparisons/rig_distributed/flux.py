"""Compiled fluxes of the Euler equations: between cells, at the mouth, at the throttle.

Each is of mass, momentum and energy a second and square metre. Imported only when a simulation
runs, because it pulls in numba.
"""

from __future__ import annotations

from math import sqrt
from typing import Any, TypeAlias

import numpy as np
from numba import njit

from comparisons.rig_distributed.gas import CP, GAMMA, R
from surge_core.types import FloatArray

G1 = GAMMA - 1.0
POWER = GAMMA / G1
_Three: TypeAlias = tuple[float, float, float]


@njit(cache=True)
def total_state(rho: float, u: float, p: float) -> tuple[float, float]:
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
    _, t_up = total_state(rho, u, p)
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
def fill_fluxes(
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
