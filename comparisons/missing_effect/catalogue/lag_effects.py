"""Effects at the input and in the lag itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from comparisons.missing_effect.effect import Effect, Parameter
from comparisons.missing_effect.kernels import shifted
from comparisons.missing_effect.lag_data import LagData
from comparisons.missing_effect.ports import Ports
from surge_core.types import FloatArray

THRESHOLD_QUANTILES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
# τ is never let fall below this share of itself, nor below zero.
LEAST_TAU_SHARE = 0.15


def _delayed(ports: Ports, data: LagData, values: FloatArray) -> Ports:
    if "exit_Pa" in data:
        # From raw counts: the pressures behind the blading are late, and ψ' is made of them. They
        # are taken back, and not the model put off: what it has in reversed flow would move into
        # the rows that are scored.
        early = shifted(data["exit_Pa"], -values[0] / data.step_s, data.fine_runs)
        return ports.with_known(data.of_exit(data["exit_Pa"] - early))
    # Only what is smooth is shifted: noise on φ says nothing about a delay, but its own shift
    # would correlate with what it leaves in the errors.
    smooth = np.ascontiguousarray(data["phi_smooth"])
    late = shifted(smooth, values[0] / data.step_s, data.fine_runs)
    return replace(ports, phi=ports.phi + (late - smooth))


def _second_order(ports: Ports, data: LagData, values: FloatArray) -> Ports:
    return replace(ports, a2_s2=max(float(values[0]), 0.0))


def _amplitude_lag(ports: Ports, data: LagData, values: FloatArray) -> Ports:
    name = "amplitude" if values[1] > 0.5 else "amplitude_as_is"
    mean = data.mean_amplitude if values[1] > 0.5 else data.mean_amplitude_as_is
    swing = data[name] / mean - 1.0
    return ports.with_tau_factor(np.maximum(1.0 + values[0] * swing, LEAST_TAU_SHARE))


def _amplitude_ends(data: LagData) -> FloatArray:
    # With the ends of the record prolonged, and as they stand.
    return np.array([[1.0], [0.0]])


def _asymmetric(ports: Ports, data: LagData, values: FloatArray) -> Ports:
    return ports.with_tau_factor(np.maximum(1.0 + values[0] * rising(data), LEAST_TAU_SHARE))


def _flow_lag(ports: Ports, data: LagData, values: FloatArray) -> Ports:
    # Of the measured φ averaged as ψ' was: without cells the same as φ itself.
    phi = data.get("phi_averaged", ports.phi)
    below = _share_below(phi, values[1], data)
    return ports.with_tau_factor(np.maximum(1.0 + values[0] * below, LEAST_TAU_SHARE))


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
    phi = data.get("phi_averaged", data["phi"])
    return np.quantile(phi, THRESHOLD_QUANTILES)[:, None]


INPUT_EFFECTS = (
    Effect(
        "transport_delay",
        "input",
        "φ(t − d)",
        "ψ' answers to a φ of some time before: the rakes lie apart, or the channels are skewed "
        "on the tape",
        (Parameter("d", "s", -0.2, 0.2, "free", 1e-4),),
        _delayed,
        on_tau="τ reads high by more than the delay, typically by 1.6 times as much",
        confirm="a pressure step applied to both rakes at once; the skew of the recorder from a "
        "common test signal",
    ),
)

LAG_EFFECTS = (
    Effect(
        "second_order_lag",
        "lag",
        "a₂ d²ψ'/dt² + τ dψ'/dt + ψ' = ψ'_QS",
        "a second store: another plenum behind the blading, or a lag of the ψ' sensor or its tube",
        (Parameter("a2", "s^2", 0.0, 0.1, "free", 1e-6),),
        _second_order,
        on_tau="τ reads high, typically by half of the second time constant",
        confirm="a second tap without a tube, or a step calibration of the pressure line",
    ),
    Effect(
        "amplitude_dependent_lag",
        "lag",
        "τ (1 + k (A − Ā)/Ā)",
        "the lag depends on how far the flow swings: the recirculating volume grows with it",
        (
            Parameter("k", "1", -3.0, 3.0, "free", 1e-3),
            Parameter("prolonged", "1", 0.0, 1.0, "held"),
        ),
        _amplitude_lag,
        _amplitude_ends,
        2.0,
        "τ is that of a mixture of amplitudes",
        "records at several throttle settings, each of one amplitude",
        needs="amplitude",
    ),
    Effect(
        "asymmetric_lag",
        "lag",
        "τ (1 + k sign dφ/dt)",
        "the flow field builds up and breaks down at different rates",
        (Parameter("k", "1", -0.9, 0.9, "free", 1e-3),),
        _asymmetric,
        on_tau="τ is a mean of two",
        confirm="throttle ramps up and down at the same rate",
    ),
    Effect(
        "flow_dependent_lag",
        "lag",
        "τ (1 + k [φ < φ_t])",
        "the lag is another one below a flow, as between stalled and reversed flow",
        (
            Parameter("k", "1", -0.85, 8.0, "free", 1e-3),
            Parameter("phi_t", "1", -2.0, 2.0, "free", 1e-4),
        ),
        _flow_lag,
        _flow_thresholds,
        6.0,
        "τ is a mixture of two",
        "small throttle steps at flows above and below the threshold",
    ),
)
