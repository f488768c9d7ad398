"""How each effect of the catalogue acts on the ports of a lag model, and where searches start."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

import numpy as np

from comparisons.missing_effect.effect import Effect, Parameter
from comparisons.missing_effect.kernels import lag_pass, shifted
from comparisons.missing_effect.lag_data import LagData
from comparisons.missing_effect.ports import Ports
from surge_core.segments import scored_pieces
from surge_core.types import FloatArray

THRESHOLD_QUANTILES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
# τ is never let fall below this share of itself, nor below zero.
LEAST_TAU_SHARE = 0.15
HEATING_TIMES = (0.03, 0.1, 0.3, 0.7, 2.0)
BRANCH_QUANTILES = (0.06, 0.15, 0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85, 0.94)
# Intervals between the knots of the free characteristic over the range of φ; how many is set by
# the data. One means no knots but two more powers of φ, which go on beyond the range.
INTERVALS = (1, 4, 7, 12, 20, 34)
MORE_POWERS = 2
GATE_QUANTILES = (0.3, 0.4, 0.5, 0.6, 0.7, 1.0)
# The ripple is searched up to this share of the sample rate.
HIGHEST_SHARE = 0.4
# An episode shorter than this many samples has no phase to speak of.
SHORTEST_EPISODE = 8


def _delayed(ports: Ports, data: LagData, values: FloatArray) -> Ports:
    if "exit_Pa" in data:
        # From raw counts: the pressures behind the blading are late, and ψ' is made of them. They
        # are taken back, and not the model put off: what it has in reversed flow would move into
        # the rows that are scored.
        early = shifted(data["exit_Pa"], -values[0] / data.step_s, data.fine_runs)
        return replace(ports, known=ports.known + data.of_exit(data["exit_Pa"] - early))
    # Only what is smooth is shifted: noise on φ says nothing about a delay, but its own shift
    # would correlate with what it leaves in the errors.
    smooth = np.ascontiguousarray(data["phi_smooth"])
    late = shifted(smooth, values[0] / data.step_s, data.fine_runs)
    return replace(ports, phi=ports.phi + (late - smooth))


def _second_order(ports: Ports, data: LagData, values: FloatArray) -> Ports:
    return replace(ports, a2_s2=max(float(values[0]), 0.0))


def _filtered(share: float, ports: Ports, data: LagData, values: FloatArray) -> Ports:
    """Pass a share of the characteristic through one more lag; the rest goes by it.

    Twice the lagged one less itself has gain 1 at all frequencies: all but a delay.
    """
    if not values[0] > 0.0:
        return ports
    target = ports.driven * np.reshape(ports.gain, (-1, 1))
    slow = lag_pass(np.ascontiguousarray(target), float(values[0]), data.step_s, data.fine_runs)
    return replace(ports, driven=share * slow + (1.0 - share) * target, gain=1.0)


def _bent(ports: Ports, data: LagData, values: FloatArray) -> Ports:
    return ports.with_driven(np.minimum(ports.phi - values[0], 0.0)[:, None] ** 2, ("bend",))


def _bend_grid(data: LagData) -> FloatArray:
    return np.quantile(data["phi"], BRANCH_QUANTILES)[:, None]


def _with_tau(ports: Ports, factor: FloatArray) -> Ports:
    factor = np.maximum(factor, LEAST_TAU_SHARE)
    return replace(ports, tau_factor=ports.tau_factor * factor)


def _amplitude_lag(ports: Ports, data: LagData, values: FloatArray) -> Ports:
    name = "amplitude" if values[1] > 0.5 else "amplitude_as_is"
    swing = data[name] / getattr(data.references, f"mean_{name}") - 1.0
    return _with_tau(ports, 1.0 + values[0] * swing)


def _both_ways(data: LagData) -> FloatArray:
    # With the ends of the record prolonged, and as they stand; lagged, and not.
    return np.array([[1.0], [0.0]])


def _asymmetric(ports: Ports, data: LagData, values: FloatArray) -> Ports:
    return _with_tau(ports, 1.0 + values[0] * rising(data))


def _flow_lag(ports: Ports, data: LagData, values: FloatArray) -> Ports:
    # Of the measured φ averaged as ψ' was: without cells the same as φ itself.
    phi = data.signals.get("phi_averaged", ports.phi)
    below = _share_below(phi, values[1], data)
    return _with_tau(ports, 1.0 + values[0] * below)


def rising(data: LagData) -> FloatArray:
    """Return the mean sign of dφ/dt over the step that ends at each row."""
    slope = data["dphi_s"]
    return np.asarray(1.0 - 2.0 * _share_below(slope, 0.0, data))


def _share_below(signal: FloatArray, threshold: float, data: LagData) -> FloatArray:
    """Return which share of the step that ends at each row a signal spent below a threshold."""
    before = np.concatenate([signal[:1], signal[:-1]])
    before[data.fine_runs[:, 0]] = signal[data.fine_runs[:, 0]]
    low, high = np.minimum(before, signal), np.maximum(before, signal)
    width = np.maximum(high - low, 1e-300)
    return np.asarray(np.clip((threshold - low) / width, 0.0, 1.0))


def _flow_thresholds(data: LagData) -> FloatArray:
    phi = data.signals.get("phi_averaged", data["phi"])
    return np.quantile(phi, THRESHOLD_QUANTILES)[:, None]


def _heated(ports: Ports, data: LagData, values: FloatArray) -> Ports:
    a, time_s = values
    return replace(ports, gain=ports.gain * (1.0 - a * (1.0 - np.exp(-clock_s(data) / time_s))))


def _heating_times(data: LagData) -> FloatArray:
    span = float(np.max(clock_s(data)))
    return span * np.array(HEATING_TIMES)[:, None]


def clock_s(data: LagData) -> FloatArray:
    """Return the facility clock from its zero on."""
    return np.asarray(data["time_s"] - data.references.clock_zero_s)


def _drooped(ports: Ports, data: LagData, values: FloatArray) -> Ports:
    speed = data["Nc_frac"]
    return replace(ports, gain=ports.gain * (speed / data.references.mean_speed) ** values[0])


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
    splines, held = _splines(intervals, n_base)
    return np.asarray(splines(at) - np.vander(at, len(held), increasing=True) @ held)


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
def _splines(intervals: int, n_base: int) -> tuple[Any, FloatArray]:
    """Return splines, orthonormal over the range once the powers of the base are taken off them.

    Beside them: how much of each power, a row each, to take off each column.
    """
    from scipy.interpolate import BSpline

    knots = np.concatenate([np.zeros(3), np.arange(intervals + 1) / intervals, np.ones(3)])
    at = np.linspace(0.0, 1.0, 40 * intervals + 1)
    raw = BSpline.design_matrix(np.minimum(at, 1.0 - 1e-12), knots, 3).toarray()
    n_powers = min(n_base, 4)
    powers = np.vander(at, n_powers, increasing=True)
    onto = np.linalg.lstsq(powers, raw, rcond=None)[0]
    _, size, right = np.linalg.svd(raw - powers @ onto, full_matrices=False)
    n_own = intervals + 3 - n_powers
    mix = right[:n_own].T / size[:n_own] * np.sqrt(at.size)
    return BSpline(knots, mix, 3), onto @ mix


def _interval_grid(data: LagData) -> FloatArray:
    return np.array([(count, *data.references.phi_range) for count in INTERVALS])


def _over_the_range(data: LagData, values: FloatArray) -> FloatArray:
    """Lay the knots over the φ of what is fitted now: more rows may reach further."""
    return np.array([values[0], *data.references.phi_range])


def _inertia(ports: Ports, data: LagData, values: FloatArray) -> Ports:
    return ports.with_added(-data.sampled(data["dphi_s"])[:, None], ("-dphi/dt",))


def _thermocouple(ports: Ports, data: LagData, values: FloatArray) -> Ports:
    temperature = data.sampled(data["T25_K"])
    rate = data.sampled(data["dT25_K_s"])
    read = temperature / np.maximum(temperature + values[0] * rate, 0.2 * temperature)
    return replace(ports, out_gain=ports.out_gain * read)


def _sensitivity(ports: Ports, data: LagData, values: FloatArray) -> Ports:
    if "exit_Pa" in data:
        drifted = data.of_exit(values[0] * clock_s(data) * data["exit_Pa"])
        return replace(ports, known=ports.known + drifted)
    drifted = 1.0 + values[0] * data.sampled(clock_s(data))
    return replace(ports, out_gain=ports.out_gain * drifted)


def _bias(ports: Ports, data: LagData, values: FloatArray) -> Ports:
    clock = data.sampled(clock_s(data))
    return ports.with_added(clock[:, None], ("t",))


def _ripple(ports: Ports, data: LagData, values: FloatArray) -> Ports:
    frequency_hz, gate = values
    episodes = stall_episodes(data, gate)
    time_s = data.sampled(data["time_s"])
    columns = np.zeros((data.n_samples, 2 * len(episodes)))
    for i, rows in enumerate(episodes):
        own = time_s[rows]
        phase = 2.0 * np.pi * frequency_hz * (own - 0.5 * (own[0] + own[-1]))
        columns[rows, 2 * i] = np.sin(phase)
        columns[rows, 2 * i + 1] = np.cos(phase)
    names = [
        f"ripple {i // 2 + 1} {'sin' if i % 2 == 0 else 'cos'}" for i in range(columns.shape[1])
    ]
    return ports.with_added(columns, names)


def stall_episodes(data: LagData, gate: float) -> list[slice]:
    """Return the stretches of samples in stall: by ``in_stall``, else by φ below ``gate``."""
    if "in_stall" in data:
        state = data.sampled(data["in_stall"]) > 0.5
    elif "stalled" in data:
        state = data.sampled(data["stalled"]) > 0.5
    else:
        state = data.sampled(data["phi"]) < gate
    pieces = [piece for run in data.slices for piece in scored_pieces(state.astype(float), run)]
    return [piece for piece in pieces if piece.stop - piece.start >= SHORTEST_EPISODE]


def ripple_waves(
    data: LagData, gate: float, amplitude: float, rng: np.random.Generator
) -> FloatArray:
    """Return the coefficients of a ripple whose phase is another in each episode."""
    phase = rng.uniform(0.0, 2.0 * np.pi, len(stall_episodes(data, gate)))
    return np.asarray(amplitude * np.column_stack([np.cos(phase), np.sin(phase)]).ravel())


def _ripple_grid(data: LagData) -> FloatArray:
    """Return the gates; the frequency is found from the spectrum of the residual."""
    if "in_stall" in data or "stalled" in data:
        return np.array([[0.0, 0.0]])
    phi = data["phi"]
    return np.column_stack([np.zeros(len(GATE_QUANTILES)), np.quantile(phi, GATE_QUANTILES)])


def _unchanged(ports: Ports, data: LagData, values: FloatArray) -> Ports:
    return ports


# What a second lag, a delay and a shape are taken for on records that do not part them.
_TIME = Parameter("a", "s", 0.0, 0.2, "free", 1e-4)
_ONE_MORE_LAG = Effect("one more lag", "lag", "", "", (_TIME,), partial(_filtered, 1.0))
_DEAD_TIME = Effect("a dead time", "lag", "", "", (_TIME,), partial(_filtered, 2.0))
_LEVEL = Parameter("level", "1", -2.0, 2.0, "free", 1e-4)
_DEPTH = Parameter("c", "1", -np.inf, np.inf)
_BEND = Effect("a bend", "characteristic", "", "", (_DEPTH, _LEVEL), _bent, _bend_grid)

# By the names of effects.toml; an effect without a grid has nothing but an amplitude.
WORKINGS: dict[str, dict[str, Any]] = {
    "transport_delay": {"acts": _delayed, "kin": _ONE_MORE_LAG},
    "facility_heating": {"acts": _heated, "grid": _heating_times},
    "speed_droop": {"acts": _drooped},
    "hysteresis": {"acts": _branched, "grid": _branch_grid},
    "reverse_flow_branch": {"acts": _reversed, "grid": _both_ways},
    "characteristic_shape": {
        "acts": _shaped,
        "grid": _interval_grid,
        "adapted": _over_the_range,
        "kin": _BEND,
    },
    "second_order_lag": {"acts": _second_order, "kin": _DEAD_TIME},
    "amplitude_dependent_lag": {"acts": _amplitude_lag, "grid": _both_ways},
    "asymmetric_lag": {"acts": _asymmetric},
    "flow_dependent_lag": {"acts": _flow_lag, "grid": _flow_thresholds},
    "flow_inertia": {"acts": _inertia},
    "thermocouple_lag": {"acts": _thermocouple},
    "sensitivity_drift": {"acts": _sensitivity},
    "bias_drift": {"acts": _bias},
    "rotating_stall_ripple": {"acts": _ripple, "grid": _ripple_grid},
    "flow_noise": {"acts": _unchanged},
}
