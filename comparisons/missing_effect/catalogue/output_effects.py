"""Effects in the measurement of the coefficient, behind the lag."""

from __future__ import annotations

import numpy as np

from comparisons.missing_effect.catalogue.characteristic_effects import clock_s
from comparisons.missing_effect.effect import Effect, Parameter
from comparisons.missing_effect.lag_data import LagData
from comparisons.missing_effect.ports import Ports
from surge_core.types import FloatArray

GATE_QUANTILES = (0.3, 0.4, 0.5, 0.6, 0.7, 1.0)
# The ripple is searched up to this share of the sample rate.
HIGHEST_SHARE = 0.4
# An episode shorter than this many samples has no phase to speak of.
SHORTEST_EPISODE = 8


def _inertia(ports: Ports, data: LagData, values: FloatArray) -> Ports:
    return ports.with_added(-data.sampled(data["dphi_s"])[:, None], ("-dphi/dt",))


def _thermocouple(ports: Ports, data: LagData, values: FloatArray) -> Ports:
    temperature = data.sampled(data["T25_K"])
    rate = data.sampled(data["dT25_K_s"])
    return ports.with_out_gain(
        temperature / np.maximum(temperature + values[0] * rate, 0.2 * temperature)
    )


def _sensitivity(ports: Ports, data: LagData, values: FloatArray) -> Ports:
    if "exit_Pa" in data:
        return ports.with_known(data.of_exit(values[0] * clock_s(data) * data["exit_Pa"]))
    return ports.with_out_gain(1.0 + values[0] * data.sampled(clock_s(data)))


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
    out = []
    for run in data.slices:
        edges = np.flatnonzero(np.diff(np.concatenate([[0], state[run], [0]])))
        for first, stop in edges.reshape(-1, 2) + run.start:
            if stop - first >= SHORTEST_EPISODE:
                out.append(slice(int(first), int(stop)))
    return out


def _ripple_grid(data: LagData) -> FloatArray:
    """Return the gates; the frequency is found from the spectrum of the residual."""
    if "in_stall" in data or "stalled" in data:
        return np.array([[0.0, 0.0]])
    phi = data["phi"]
    return np.column_stack([np.zeros(len(GATE_QUANTILES)), np.quantile(phi, GATE_QUANTILES)])


OUTPUT_EFFECTS = (
    Effect(
        "flow_inertia",
        "output",
        "− ℓ dφ/dt",
        "the pressure that accelerates the gas was taken off with a wrong ∫dx/A",
        (Parameter("l", "s", -np.inf, np.inf),),
        _inertia,
        on_tau="τ moves by about ℓ over the slope of the characteristic",
        confirm="the duct's areas, or the ring of P31 after a fast throttle closure",
    ),
    Effect(
        "thermocouple_lag",
        "output",
        "ψ'·T/(T + τ_tc dT/dt)",
        "the temperature that normalises ψ' comes late",
        (Parameter("tau_tc", "s", -5.0, 20.0, "free", 1e-3),),
        _thermocouple,
        on_tau="τ moves by a few percent where T25 swings with surge",
        confirm="a faster probe beside it, or the thermocouple's own step response",
        needs="T25_K",
    ),
    Effect(
        "sensitivity_drift",
        "output",
        "ψ' (1 + s t)",
        "the sensitivity of a pressure transducer moves through the record",
        (Parameter("s", "1/s", -0.5, 5.0, "free", 1e-5),),
        _sensitivity,
        on_tau="a free run hardly minds; one-step estimators read a slow pole",
        confirm="zero and span readings after the test",
    ),
    Effect(
        "bias_drift",
        "output",
        "ψ' + c t",
        "the zero of a pressure transducer moves through the record",
        (Parameter("c", "1/s", -np.inf, np.inf),),
        _bias,
        on_tau="a free run hardly minds; one-step estimators read a slow pole",
        confirm="a zero reading after the test",
    ),
    Effect(
        "rotating_stall_ripple",
        "output",
        "+ r sin(2πft + θ) in stall",
        "rotating-stall cells pass the taps and are not averaged out",
        (
            Parameter("r", "1", -np.inf, np.inf),
            Parameter("f", "Hz", 0.0, np.inf, "free", 1e-3),
            Parameter("phi_gate", "1", -2.0, 2.0, "held"),
        ),
        _ripple,
        _ripple_grid,
        500.0,
        "none, but the stated errors are wrong",
        "taps around the circumference: the cells turn",
        episodes=True,
    ),
)


def _unchanged(ports: Ports, data: LagData, values: FloatArray) -> Ports:
    return ports


# Not searched among the others: it is found from the errors, as noise (noise.py).
FLOW_NOISE = Effect(
    "flow_noise",
    "noise",
    "φ measured = φ + n",
    "φ itself is noisy, and the lag passes its noise on into the errors",
    (Parameter("sigma_phi", "1", 0.0, 1.0, "free", 1e-4),),
    _unchanged,
    on_tau="none to speak of in a free run; one-step estimators read it too fast",
    confirm="the scatter of φ at a steady point",
)
