"""Effects in the quasi-steady characteristic."""

from __future__ import annotations

from functools import lru_cache
from math import comb

import numpy as np

from comparisons.missing_effect.effect import Effect, Parameter
from comparisons.missing_effect.kernels import piecewise_cubics
from comparisons.missing_effect.lag_data import LagData
from comparisons.missing_effect.ports import Ports
from surge_core.types import FloatArray

HEATING_TIMES = (0.03, 0.1, 0.3, 0.7, 2.0)
BRANCH_QUANTILES = (0.06, 0.15, 0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85, 0.94)
# Intervals between the knots of the free characteristic over the range of φ; how many is set by
# the data. One means no knots but two more powers of φ, which go on beyond the range.
INTERVALS = (1, 4, 7, 12, 20, 34)
MORE_POWERS = 2


def _heated(ports: Ports, data: LagData, values: FloatArray) -> Ports:
    a, time_s = values
    return ports.with_gain(1.0 - a * (1.0 - np.exp(-clock_s(data) / time_s)))


def _heating_times(data: LagData) -> FloatArray:
    span = float(np.max(clock_s(data)))
    return span * np.array(HEATING_TIMES)[:, None]


def clock_s(data: LagData) -> FloatArray:
    """Return the facility clock from its zero on."""
    return np.asarray(data["time_s"] - data.origin_s)


def _drooped(ports: Ports, data: LagData, values: FloatArray) -> Ports:
    speed = data["Nc_frac"]
    return ports.with_gain((speed / data.mean_speed) ** values[0])


def _branched(ports: Ports, data: LagData, values: FloatArray) -> Ports:
    low, high = values
    return ports.with_driven(-on_branch(ports.phi, low, high, data)[:, None], ("hysteresis",))


def on_branch(phi: FloatArray, low: float, high: float, data: LagData) -> FloatArray:
    """Return S on the fine grid: 1 from φ < low until φ > high, in each run by itself.

    The step in which a threshold is crossed counts by its share, so that the thresholds can be
    known to less than a step. Before its first crossing a run stands where its φ tells, or on the
    side that it crosses away from.
    """
    state = np.full(phi.size, -1.0)
    state[phi < low] = 1.0
    state[phi > high] = 0.0
    starts = data.fine_runs[:, 0]
    for start, stop in data.fine_runs:
        if state[start] < 0.0:
            known = np.flatnonzero(state[start:stop] >= 0.0)
            state[start] = 1.0 - state[start + known[0]] if known.size else 0.0
    last = np.maximum.accumulate(np.where(state >= 0.0, np.arange(phi.size), 0))
    state = state[last]
    change = np.flatnonzero(np.diff(state) != 0.0) + 1
    change = change[~np.isin(change, starts)]
    threshold = np.where(state[change] > 0.5, low, high)
    width = phi[change] - phi[change - 1]
    share = np.clip((phi[change] - threshold) / np.where(width == 0.0, 1.0, width), 0.0, 1.0)
    # A straight line over the step before has the area of a switch within it.
    out = state.copy()
    before = state[change - 1]
    out[change] = before + (state[change] - before) * np.clip(share + 0.5, 0.0, 1.0)
    out[change - 1] = before + (state[change] - before) * np.clip(share - 0.5, 0.0, 1.0)
    return out


def _branch_grid(data: LagData) -> FloatArray:
    edges = np.quantile(data["phi"], BRANCH_QUANTILES)
    return np.array([(a, b) for i, a in enumerate(edges) for b in edges[i + 1 :]])


def _reversed(ports: Ports, data: LagData, values: FloatArray) -> Ports:
    loss = np.where(ports.phi < 0.0, ports.phi**2, 0.0)[:, None]
    if values[0] > 0.5:
        return ports.with_driven(loss, ("phi^2[phi<0]",))
    return ports.with_added(data.averaged(loss)[data.rows], ("phi^2[phi<0], unlagged",))


def _reversed_grid(data: LagData) -> FloatArray:
    return np.array([[1.0], [0.0]])


def _shaped(ports: Ports, data: LagData, values: FloatArray) -> Ports:
    phi_range = (float(values[1]), float(values[2]))
    columns = shape_columns(ports.phi, phi_range, int(values[0]), ports.n_powers)
    names = [f"spline {i + 1}" for i in range(columns.shape[1])]
    return ports.with_driven(columns, names)


def shape_columns(
    phi: FloatArray, phi_range: tuple[float, float], intervals: int, n_base: int
) -> FloatArray:
    """Return cubic splines of φ that no cubic in φ holds; constant beyond the range of the knots.

    A base of fewer terms than a cubic's (``n_base``) leaves its missing powers to the splines.
    """
    low, high = phi_range
    at = (phi - low) / (high - low)
    if intervals == 1:
        powers = [at**k for k in range(n_base, n_base + MORE_POWERS)]
        return np.column_stack(powers) @ _more_powers(n_base)
    at = np.clip(at, 0.0, 1.0)
    return np.asarray(piecewise_cubics(np.ascontiguousarray(at), _cubics(intervals, n_base)))


@lru_cache(maxsize=8)
def _more_powers(n_base: int) -> FloatArray:
    """Return the mixture of the next powers that is orthonormal over the range and to the base.

    Whole powers of the base are left in: the base holds them anyway, beyond the range too.
    """
    at = np.linspace(0.0, 1.0, 401)
    base = np.linalg.qr(np.vander(at, n_base, increasing=True))[0]
    more = np.column_stack([at**k for k in range(n_base, n_base + MORE_POWERS)])
    own = more - base @ (base.T @ more)
    return np.asarray(np.linalg.inv(np.linalg.qr(own)[1]) * np.sqrt(at.size))


@lru_cache(maxsize=32)
def _cubics(intervals: int, n_base: int) -> FloatArray:
    """Return the cubics of each column in each interval, of shape (intervals, 4, columns).

    The columns are orthonormal over the range and free of the powers that the base has.
    """
    from scipy.interpolate import BSpline, PPoly

    knots = np.concatenate([np.zeros(3), np.arange(intervals + 1) / intervals, np.ones(3)])
    at = np.linspace(0.0, 1.0, 40 * intervals + 1)
    raw = BSpline.design_matrix(np.minimum(at, 1.0 - 1e-12), knots, 3).toarray()
    n_powers = min(n_base, 4)
    powers = np.vander(at, n_powers, increasing=True)
    onto = np.linalg.lstsq(powers, raw, rcond=None)[0]
    _, size, right = np.linalg.svd(raw - powers @ onto, full_matrices=False)
    n_own = intervals + 3 - n_powers
    mix = right[:n_own].T / size[:n_own] * np.sqrt(at.size)
    pieces = np.zeros((intervals, 4, n_own))
    for column in range(n_own):
        spline = PPoly.from_spline((knots, np.ascontiguousarray(mix[:, column]), 3))
        # Rows of PPoly run from the cube down; the clamped knots at both ends have no width.
        pieces[:, :, column] = spline.c[::-1, 3 : 3 + intervals].T
    less = onto @ mix
    for i in range(intervals):
        for power in range(n_powers):
            # The power of the base, written about the left end of the interval.
            for k in range(power + 1):
                pieces[i, k] -= comb(power, k) * (i / intervals) ** (power - k) * less[power]
    return np.ascontiguousarray(pieces)


def _interval_grid(data: LagData) -> FloatArray:
    return np.array([(count, *data.phi_range) for count in INTERVALS])


def _over_the_range(data: LagData, values: FloatArray) -> FloatArray:
    """Lay the knots over the φ of what is fitted now: more rows may reach further."""
    return np.array([values[0], *data.phi_range])


CHARACTERISTIC_EFFECTS = (
    Effect(
        "facility_heating",
        "characteristic",
        "ψ'_QS · (1 − a (1 − e^(−t/T_h)))",
        "the facility heats up while it surges, and with the inlet temperature the corrected speed "
        "and the pressure rise settle to another level",
        (
            Parameter("a", "1", -0.8, 0.8, "free", 1e-4),
            Parameter("T_h", "s", 0.02, 1e5, "free", 0.01),
        ),
        _heated,
        _heating_times,
        3.0,
        "slow drift looks like a second, slow pole to one-step estimators; a free run hardly minds",
        "a steady point after the test",
    ),
    Effect(
        "speed_droop",
        "characteristic",
        "ψ'_QS · (N_c/N_c,ref)^c",
        "the characteristic moves with the corrected speed, which droops in surge",
        (Parameter("c", "1", -20.0, 20.0, "free", 1e-2),),
        _drooped,
        on_tau="small, unless the speed swings with surge",
        confirm="records at two speeds",
        needs="Nc_frac",
    ),
    Effect(
        "hysteresis",
        "characteristic",
        "− Δ·S, S = 1 from φ < φ_lo until φ > φ_hi",
        "the characteristic has two branches, and which one holds depends on where φ came from",
        (
            Parameter("Delta", "1", -np.inf, np.inf),
            Parameter("phi_lo", "1", -2.0, 2.0, "free", 2e-4),
            Parameter("phi_hi", "1", -2.0, 2.0, "free", 2e-4),
        ),
        _branched,
        _branch_grid,
        20.0,
        "a branch that answers late reads as lag",
        "a slow throttle sweep through stall and back",
        switches=True,
    ),
    Effect(
        "reverse_flow_branch",
        "characteristic",
        "+ c φ² where φ < 0, lagged or not",
        "reversed flow meets a loss that forward flow does not",
        (
            Parameter("c", "1", -np.inf, np.inf),
            Parameter("lagged", "1", 0.0, 1.0, "held"),
        ),
        _reversed,
        _reversed_grid,
        2.0,
        "small for the lagged loss; the unlagged one pulls τ down",
        "deeper reversal, or a steady reversed-flow test",
    ),
    Effect(
        "characteristic_shape",
        "characteristic",
        "+ f(φ), smooth",
        "the characteristic bends where its base terms cannot",
        (
            Parameter("f", "1", -np.inf, np.inf),
            Parameter("intervals", "1", 1.0, 64.0, "held"),
            Parameter("phi_from", "1", -3.0, 3.0, "held"),
            Parameter("phi_to", "1", -3.0, 3.0, "held"),
        ),
        _shaped,
        _interval_grid,
        4.0,
        "small where φ sweeps its range in every cycle",
        "steady points between those of the map, or a slow throttle sweep",
        adapted=_over_the_range,
    ),
)
