"""Physical effects that a test at the level of coefficients can hide, each at its port.

The fifteen of `EFFECTS` have the equations of the catalogue in `comparisons.missing_effect`; those
of `OUTSIDE` are as sensible and stand in no catalogue, so that no name is the right answer to them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import pi
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from comparisons.rig.coefficient_plant import Plant, Points
from surge_core.types import FloatArray

Parameters: TypeAlias = Mapping[str, float]
Change: TypeAlias = "Callable[[Parameters, Points, FloatArray], FloatArray]"

PAIRS = (
    ("amplitude_dependent_lag", "transport_delay"),
    ("transport_delay", "facility_heating"),
    ("hysteresis", "rotating_stall_ripple"),
    ("flow_inertia", "bias_drift"),
    ("thermocouple_lag", "reverse_flow_branch"),
)

# Share of the sample rate up to which a ripple is looked for; below so many
# times the surge frequency it would be no rotating stall.
_HIGHEST_RIPPLE = 0.4
_LOWEST_RIPPLE = 5.0
# Largest share by which τ may vary, and by which a thermocouple's reading may be corrected.
_LIMIT_OF_TAU = 0.9
_DEEPEST_CORRECTION = 0.6


@dataclass(frozen=True)
class Form:
    """How an effect is drawn and how large it may be made.

    One that has neither curve, lag nor output acts in the integration itself.
    """

    size: str  # Name of the parameter that its strength is set by
    # Plant to the size of a visible effect, and to the largest that still makes sense.
    sizes: Callable[[Plant], tuple[float, float]]
    # Plant and generator to its other parameters.
    draw: Callable[[Plant, np.random.Generator], dict[str, float]] = lambda plant, rng: {}
    signed: bool = False  # Whether the size may be negative as well
    curve: Change | None = None  # What it makes of ψ'_QS
    lag: Callable[[Parameters, Points], FloatArray] | None = None  # Factor on τ
    output: Change | None = None  # What it makes of ψ' as sensors and reduction show it
    # Parameters to the values of the acting φ at which it begins or ends.
    levels: Callable[[Parameters], tuple[float, ...]] = lambda p: ()


def _draw_hysteresis(plant: Plant, rng: np.random.Generator) -> dict[str, float]:
    low, high = rng.uniform(0.20, 0.40), rng.uniform(0.60, 0.80)
    return {"phi_lo": plant.phi_at(low), "phi_hi": plant.phi_at(high)}


def _draw_bump(plant: Plant, rng: np.random.Generator) -> dict[str, float]:
    reach = plant.phi_at(0.98) - plant.phi_at(0.02)
    return {
        "centre": plant.phi_at(0.02) + rng.uniform(0.15, 0.85) * reach,
        "width": rng.uniform(0.06, 0.16) * reach,
    }


def _draw_ripple(plant: Plant, rng: np.random.Generator) -> dict[str, float]:
    rate_hz = 1.0 / plant.sample_period_s
    lowest = _LOWEST_RIPPLE * max(flow.surge_hz for flow in plant.flows)
    return {
        "frequency_hz": rng.uniform(
            min(lowest, 0.5 * _HIGHEST_RIPPLE * rate_hz), rate_hz * 0.95 * _HIGHEST_RIPPLE
        ),
        "phi_threshold": plant.stall_phi,
        "phase_seed": float(rng.integers(2**31)),
    }


def _reference_speed(plant: Plant, _: np.random.Generator) -> dict[str, float]:
    return {"reference_frac": plant.mean_speed}


def _thermocouple_sizes(plant: Plant) -> tuple[float, float]:
    swings = [c.cyclic[0] * 2.0 * pi * c.flow.surge_hz for c in plant.temperatures]
    return 0.2, _DEEPEST_CORRECTION / max(swings)


def _stall_state(phi: FloatArray, p: Parameters) -> NDArray[np.bool_]:
    """Return the state of a Schmitt trigger: set below `phi_lo`, until above `phi_hi`."""
    decided = np.where(phi < p["phi_lo"], 1, np.where(phi > p["phi_hi"], 0, -1))
    decided[0] = max(decided[0], 0)
    last = np.maximum.accumulate(np.where(decided >= 0, np.arange(phi.size), 0))
    return np.asarray(decided[last] == 1)


def _heating(p: Parameters, at: Points, curve: FloatArray) -> FloatArray:
    # The facility is cold until the clock starts.
    clock = np.maximum(at.time_s, 0.0)
    return np.asarray(curve * (1.0 - p["loss_frac"] * -np.expm1(-clock / p["heating_time_s"])))


def _speed_ratio(p: Parameters, at: Points) -> FloatArray:
    speed, _ = at.plant.speeds[at.record].at(at.time_s)
    return np.asarray(speed / p["reference_frac"])


def _reverse(p: Parameters, at: Points) -> FloatArray:
    return np.asarray(p["coefficient"] * at.phi**2 * (at.branch_phi < 0.0))


def _bump(p: Parameters, at: Points, curve: FloatArray) -> FloatArray:
    distance = (at.phi - p["centre"]) / p["width"]
    return np.asarray(curve + p["height"] * np.exp(-0.5 * distance**2))


def _memory(p: Parameters, at: Points, curve: FloatArray) -> FloatArray:
    """Gain that depends on how deep the flow fell in the cycle before."""
    falling = at.branch_phi < p["phi_mean"]
    # A cycle begins where φ falls through its mean.
    cycle = np.cumsum(np.diff(falling.astype(np.int64), prepend=falling[0]) > 0)
    deepest = np.full(cycle[-1] + 1, np.inf)
    np.minimum.at(deepest, cycle, at.branch_phi)
    depth = p["phi_mean"] - np.concatenate((deepest[:1], deepest[:-1]))
    gain = 1.0 + p["slope"] * (depth / p["mean_depth"] - 1.0)
    return np.asarray(curve * gain[cycle])


def _amplitude_lag(p: Parameters, at: Points) -> FloatArray:
    amplitude = at.plant.amplitudes[at.record](at.time_s)
    return np.asarray(1.0 + p["slope"] * (amplitude / p["mean_amplitude"] - 1.0))


def _thermocouple(p: Parameters, at: Points, psi: FloatArray) -> FloatArray:
    shown, rate = at.plant.temperatures[at.record].at(at.time_s)
    return np.asarray(psi * shown / (shown + p["lag_s"] * rate))


def _ripple(p: Parameters, at: Points, psi: FloatArray) -> FloatArray:
    stalled = at.phi < p["phi_threshold"]
    episode = np.cumsum(np.diff(stalled.astype(np.int64), prepend=0) > 0)
    rng = np.random.default_rng([int(p["phase_seed"]), at.record])
    phases = rng.uniform(-pi, pi, int(episode[-1]) + 1)
    wave = np.sin(2.0 * pi * p["frequency_hz"] * at.time_s + phases[episode])
    return np.asarray(psi + p["amplitude"] * stalled * wave)


def _saturating_sensor(p: Parameters, _at: Points, psi: FloatArray) -> FloatArray:
    beyond = p["softness"] * np.logaddexp(0.0, (psi - p["knee"]) / p["softness"])
    return np.asarray(psi - p["share"] * beyond)


_CATALOGUE: Mapping[str, Form] = {
    "transport_delay": Form("delay_s", lambda p: (0.03 * p.tau_s, p.tau_s)),
    "facility_heating": Form(
        "loss_frac",
        lambda p: (0.01, 0.9),
        lambda p, rng: {"heating_time_s": rng.uniform(0.5, 3.0) * p.duration_s},
        curve=_heating,
    ),
    "speed_droop": Form(
        "exponent",
        lambda p: (0.5, 60.0),
        _reference_speed,
        curve=lambda p, at, curve: curve * _speed_ratio(p, at) ** p["exponent"],
    ),
    "hysteresis": Form(
        "step",
        lambda p: (0.05 * p.psi_std, 5.0 * p.psi_std),
        _draw_hysteresis,
        curve=lambda p, at, curve: curve - p["step"] * _stall_state(at.branch_phi, p),
        levels=lambda p: (p["phi_lo"], p["phi_hi"]),
    ),
    "reverse_flow_branch": Form(
        "coefficient",
        lambda p: tuple(k * p.psi_std / max(p.all_phi[0] ** 2, 1e-4) for k in (0.02, 10.0)),
        lambda p, rng: {"lagged": float(rng.random() < 0.5)},
        curve=lambda p, at, curve: curve + _reverse(p, at) if p["lagged"] else curve,
        output=lambda p, at, psi: psi if p["lagged"] else psi + _reverse(p, at),
        levels=lambda p: (0.0,),
    ),
    "characteristic_shape": Form(
        "height",
        lambda p: (0.05 * p.psi_std, 20.0 * p.psi_std),
        _draw_bump,
        signed=True,
        curve=_bump,
    ),
    "second_order_lag": Form("a2_s2", lambda p: (0.02 * p.tau_s**2, p.tau_s**2)),
    "amplitude_dependent_lag": Form(
        "slope",
        lambda p: (0.1, 3.0),
        lambda p, rng: {"mean_amplitude": p.mean_amplitude},
        signed=True,
        lag=_amplitude_lag,
    ),
    "asymmetric_lag": Form(
        "slope",
        lambda p: (0.03, _LIMIT_OF_TAU),
        signed=True,
        lag=lambda p, at: 1.0 + p["slope"] * np.sign(at.phi_rate),
    ),
    "flow_dependent_lag": Form(
        "slope",
        lambda p: (0.05, _LIMIT_OF_TAU),
        lambda p, rng: {"phi_threshold": p.phi_at(rng.uniform(0.3, 0.6))},
        signed=True,
        lag=lambda p, at: np.where(at.branch_phi < p["phi_threshold"], 1.0 + p["slope"], 1.0),
        levels=lambda p: (p["phi_threshold"],),
    ),
    "flow_inertia": Form(
        "length_s",
        lambda p: (0.01 * p.psi_std, 0.5),
        signed=True,
        output=lambda p, at, psi: psi - p["length_s"] * at.phi_rate,
    ),
    "thermocouple_lag": Form("lag_s", _thermocouple_sizes, output=_thermocouple),
    "sensitivity_drift": Form(
        "rate_per_s",
        lambda p: (0.01 / p.duration_s, 1.0 / p.duration_s),
        signed=True,
        output=lambda p, at, psi: psi * (1.0 + p["rate_per_s"] * at.time_s),
    ),
    "bias_drift": Form(
        "rate_per_s",
        lambda p: (0.02 * p.psi_std / p.duration_s, 5.0 * p.psi_std / p.duration_s),
        signed=True,
        output=lambda p, at, psi: psi + p["rate_per_s"] * at.time_s,
    ),
    "rotating_stall_ripple": Form(
        "amplitude",
        lambda p: (0.02 * p.psi_std, 5.0 * p.psi_std),
        _draw_ripple,
        output=_ripple,
    ),
}
_OTHERS: Mapping[str, Form] = {
    "nonlinear_relaxation": Form("kappa", lambda p: (0.2 / p.psi_std, 50.0 / p.psi_std)),
    "second_slow_mode": Form(
        "share",
        lambda p: (0.05, 0.6),
        lambda p, rng: {"slow_tau_s": p.tau_s * rng.uniform(8.0, 15.0)},
    ),
    "speed_dependent_lag": Form(
        "exponent",
        lambda p: (3.0, 60.0),
        _reference_speed,
        signed=True,
        lag=lambda p, at: _speed_ratio(p, at) ** p["exponent"],
    ),
    "amplitude_memory": Form(
        "slope",
        lambda p: (0.1, 5.0),
        lambda p, rng: {"mean_depth": p.phi_at(0.5) - p.phi_at(0.02), "phi_mean": p.phi_at(0.5)},
        signed=True,
        curve=_memory,
        levels=lambda p: (p["phi_mean"],),
    ),
    "sensor_quadratic": Form(
        "curvature",
        lambda p: (0.1 / p.psi_std, 2.0 / p.psi_std),
        lambda p, rng: {"centre": p.psi_mean},
        signed=True,
        output=lambda p, at, psi: psi + p["curvature"] * (psi - p["centre"]) ** 2,
    ),
    "sensor_saturation": Form(
        "share",
        lambda p: (0.2, 0.9),
        lambda p, rng: {
            "knee": p.psi_mean + rng.uniform(0.3, 0.8) * p.psi_std,
            "softness": 0.1 * p.psi_std,
        },
        output=_saturating_sensor,
    ),
    "sensor_backlash": Form("half_width", lambda p: (0.01 * p.psi_std, 0.5 * p.psi_std)),
}
FORMS = {**_CATALOGUE, **_OTHERS}
EFFECTS, OUTSIDE = tuple(_CATALOGUE), tuple(_OTHERS)
