"""Truths of small systems with an effect that a model of them lacks, made by an own RK4."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

Signal = Callable[[float], float]
Slopes = Callable[[float, list[float]], Sequence[float]]


def tones(
    rng: np.random.Generator, size: float, top_hz: float, mean: float = 0.0, n: int = 12
) -> Signal:
    """An input as a sum of sines from a fortieth of the top to the top, swelling and fading."""
    hz = np.geomspace(top_hz / 40.0, top_hz, n) * rng.uniform(0.93, 1.07, n)
    phase = rng.uniform(0.0, 2.0 * math.pi, n)
    pairs = list(zip((2.0 * math.pi * hz).tolist(), phase.tolist(), strict=True))
    each = size * math.sqrt(2.0 / n)

    def value(t: float) -> float:
        return mean + each * sum(math.sin(w * t + a) for w, a in pairs)

    return value


def integrated(
    slopes: Slopes, start: Sequence[float], n: int, period_s: float, substeps: int = 8
) -> np.ndarray:
    """States at n samples by the classical Runge–Kutta method, so many steps a sample."""
    x = [float(v) for v in start]
    m = len(x)
    out = np.empty((n, m))
    h = period_s / substeps
    for k in range(n):
        out[k] = x
        for s in range(substeps):
            t = (k * substeps + s) * h
            a = slopes(t, x)
            b = slopes(t + h / 2, [x[i] + h / 2 * a[i] for i in range(m)])
            c = slopes(t + h / 2, [x[i] + h / 2 * b[i] for i in range(m)])
            d = slopes(t + h, [x[i] + h * c[i] for i in range(m)])
            x = [x[i] + h / 6 * (a[i] + 2 * b[i] + 2 * c[i] + d[i]) for i in range(m)]
    return out


def sampled(signal: Signal, n: int, period_s: float) -> np.ndarray:
    """A signal at n samples."""
    return np.array([signal(k * period_s) for k in range(n)])


def noisy(values: np.ndarray, share: float, rng: np.random.Generator) -> np.ndarray:
    """A channel with white noise, a share of its spread."""
    return values + share * float(np.std(values)) * rng.standard_normal(values.size)


def limited(value: float, limit: float) -> float:
    """A value within ± limit."""
    return min(max(value, -limit), limit)


def beyond(value: float, gap: float) -> float:
    """How far a value is beyond ± gap."""
    return max(value - gap, 0.0) + min(value + gap, 0.0)


# Heater and body: C_h dT_h/dt = P − G (T_h − T_b), C_b dT_b/dt = G (T_h − T_b) − G_a (T_b − T_a);
# temperatures above ambient, so T_a = 0.
THERMAL = {"C_h": 40.0, "C_b": 160.0, "G": 4.0, "G_a": 2.5}
THERMAL_PERIOD_S = 1.0


def thermal(
    seed: int,
    n: int = 2000,
    *,
    delay_s: float = 0.0,
    sensor_lag_s: float = 0.0,
    valve_lag_s: float = 0.0,
    drift: float = 0.0,
    noise: float = 0.01,
) -> dict[str, np.ndarray]:
    """Power P in W, temperatures T_h and T_b in K; ``drift`` is of G_a in 1000 s.

    The sensor lag is of the body's sensor.
    """
    rng = np.random.default_rng(seed)
    power = tones(rng, 30.0, 0.03, mean=100.0)
    p = THERMAL

    def slopes(t: float, x: list[float]) -> list[float]:
        given = power(t - delay_s)
        inner = (given - x[2]) / valve_lag_s if valve_lag_s else 0.0
        heat = x[2] if valve_lag_s else given
        through = p["G"] * (x[0] - x[1])
        loss = p["G_a"] * (1.0 + drift * (t / 1000.0 - 1.0)) * x[1]
        seen = (x[1] - x[3]) / sensor_lag_s if sensor_lag_s else 0.0
        return [(heat - through) / p["C_h"], (through - loss) / p["C_b"], inner, seen]

    states = integrated(slopes, [60.0, 38.0, power(0.0), 38.0], n, THERMAL_PERIOD_S)
    shown = states[:, 3] if sensor_lag_s else states[:, 1]
    return {
        "P": sampled(power, n, THERMAL_PERIOD_S),
        "T_h": noisy(states[:, 0], noise, rng),
        "T_b": noisy(shown, noise, rng),
    }


# Two tanks: A_1 dh_1/dt = q − k (h_1 − h_2), A_2 dh_2/dt = k (h_1 − h_2) − k_o h_2; a pipe between
# a pump and a vessel: I dQ/dt = p − R Q − p_v, C dp_v/dt = Q − p_v / R_o.
TANKS = {"A_1": 2.0, "A_2": 3.0, "k": 0.15, "k_o": 0.1}
TANKS_PERIOD_S = 1.0
PIPE = {"I": 2.0, "R": 1.0, "C": 0.5, "R_o": 4.0}
PIPE_PERIOD_S = 0.05


def tanks(
    seed: int,
    n: int = 2000,
    *,
    rim: float = math.inf,
    into_second: bool = False,
    noise: float = 0.01,
) -> dict[str, np.ndarray]:
    """Inflow q in dm³/s, levels h_1 and h_2 in dm; what exceeds the rim of the first spills."""
    rng = np.random.default_rng(seed)
    flow = tones(rng, 0.25, 0.01, mean=0.6)
    p = TANKS

    def slopes(t: float, x: list[float]) -> list[float]:
        q = max(flow(t), 0.0)
        over, lower = p["k"] * (x[0] - x[1]), p["k_o"] * x[1]
        first, second = (q - over) / p["A_1"], (over - lower) / p["A_2"]
        # A vessel that is full stays full while it is filled: fast, as the flow over an edge is.
        spilt = max(x[0] - rim, 0.0) / (0.5 * TANKS_PERIOD_S)
        gained = spilt * p["A_1"] / p["A_2"] if into_second else 0.0
        return [first - spilt, second + gained]

    states = integrated(slopes, [9.0, 5.5], n, TANKS_PERIOD_S)
    given = np.maximum(sampled(flow, n, TANKS_PERIOD_S), 0.0)
    return {
        "q": given,
        "h_1": noisy(states[:, 0], noise, rng),
        "h_2": noisy(states[:, 1], noise, rng),
    }


def pipe(
    seed: int, n: int = 2000, *, drag: float = 0.0, asymmetric: float = 0.0, noise: float = 0.01
) -> dict[str, np.ndarray]:
    """Pressure p in kPa, flow Q in dm³/s; ``drag`` in kPa/(dm³/s)² against Q|Q|."""
    rng = np.random.default_rng(seed)
    pump = tones(rng, 6.0, 1.0)
    p = PIPE

    def slopes(t: float, x: list[float]) -> list[float]:
        loss = p["R"] * x[0] + drag * x[0] * abs(x[0]) + asymmetric * abs(x[0])
        return [(pump(t) - loss - x[1]) / p["I"], (x[0] - x[1] / p["R_o"]) / p["C"]]

    states = integrated(slopes, [0.0, 0.0], n, PIPE_PERIOD_S)
    return {"p": sampled(pump, n, PIPE_PERIOD_S), "Q": noisy(states[:, 0], noise, rng)}


# Series circuit: L di/dt = v − R i − v_C, C dv_C/dt = i.
CIRCUIT = {"L": 0.05, "R": 3.0, "C": 2e-3}
CIRCUIT_PERIOD_S = 5e-3


def circuit(
    seed: int,
    n: int = 2000,
    *,
    drive_limit: float = math.inf,
    drive_gap: float = 0.0,
    cubic: float = 0.0,
    noise: float = 0.01,
) -> dict[str, np.ndarray]:
    """Voltage v in V, current i in A; ``cubic`` in V/C³ over the charge C v_C."""
    rng = np.random.default_rng(seed)
    source = tones(rng, 8.0, 12.0)
    p = CIRCUIT

    def slopes(t: float, x: list[float]) -> list[float]:
        v = beyond(limited(source(t), drive_limit), drive_gap)
        back = x[1] + cubic * (p["C"] * x[1]) ** 3
        return [(v - p["R"] * x[0] - back) / p["L"], x[0] / p["C"]]

    states = integrated(slopes, [0.0, 0.0], n, CIRCUIT_PERIOD_S)
    return {"v": sampled(source, n, CIRCUIT_PERIOD_S), "i": noisy(states[:, 0], noise, rng)}


# Body on a spring: M dv/dt = F − c v − k q.
BODY = {"M": 2.0, "c": 1.5, "k": 80.0}
BODY_PERIOD_S = 0.02


def body(
    seed: int,
    n: int = 2000,
    *,
    force: Callable[[float, float, float], float] = lambda t, q, v: 0.0,
    sensor: Callable[[np.ndarray], np.ndarray] = lambda q: q,
    play: float = 0.0,
    hysteresis: tuple[float, float] = (0.0, 1.0),
    noise: float = 0.01,
    with_speed: bool = False,
) -> dict[str, np.ndarray]:
    """Force F in N, position q in m; ``force`` is what the model lacks, in N.

    ``hysteresis`` is (N, m): a Dahl force and the way on which it builds up.
    """
    rng = np.random.default_rng(seed)
    drawn = tones(rng, 20.0, 2.0)
    p = BODY
    held, reach = hysteresis

    def slopes(t: float, x: list[float]) -> list[float]:
        q, v, z, w = x
        given = drawn(t)
        followed = beyond(given - w, play) / (0.1 * BODY_PERIOD_S) if play else 0.0
        acts = w if play else given
        dz = (v - 0.5 * abs(v) * z - 0.5 * v * abs(z)) / reach
        dv = (acts - p["c"] * v - p["k"] * q + force(t, q, v) - held * z) / p["M"]
        return [v, dv, dz, followed]

    states = integrated(slopes, [0.05, 0.0, 0.0, drawn(0.0)], n, BODY_PERIOD_S, substeps=16)
    made = {"F": sampled(drawn, n, BODY_PERIOD_S), "q": noisy(sensor(states[:, 0]), noise, rng)}
    if with_speed:
        made["v"] = noisy(states[:, 1], noise, rng)
    return made
