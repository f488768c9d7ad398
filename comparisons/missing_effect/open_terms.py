"""Terms without a name that compete with the effects: what the catalogue cannot say."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from comparisons.missing_effect.catalogue.workings import rising
from comparisons.missing_effect.effect import Effect, Parameter
from comparisons.missing_effect.fit import Fit
from comparisons.missing_effect.kernels import lag_pass
from comparisons.missing_effect.lag_data import LagData
from comparisons.missing_effect.ports import Ports
from surge_core.types import FloatArray

Function = Callable[[LagData, FloatArray, FloatArray, FloatArray], FloatArray]


def _above(state: FloatArray, level: float) -> FloatArray:
    return np.maximum(state - level, 0.0)


def _slow(state: FloatArray, data: LagData, tau_s: float) -> FloatArray:
    return np.asarray(lag_pass(state[:, None], tau_s, data.step_s, data.fine_runs)[:, 0])


# Factors are taken from their means: one with a mean would bring the term itself once more, in
# another φ than the base's. Each is f(data, φ, ψ' as simulated, e = τ dψ'/dt as simulated). No
# linearisation of an effect of the catalogue is among them: dφ/dt is the delay, d²ψ'/dt² the
# second-order lag, sign(dφ/dt)·e the asymmetric lag, and each would take its name away.
_DRIVEN: dict[str, Function] = {
    "phi*dphi": lambda d, p, s, e: p * d["dphi_s"],
    "phi^2*dphi": lambda d, p, s, e: p * p * d["dphi_s"],
    "dphi^2": lambda d, p, s, e: d["dphi_s"] ** 2,
    "|dphi|": lambda d, p, s, e: np.abs(d["dphi_s"]),
    "sgn(dphi)": lambda d, p, s, e: rising(d),
    "sgn(dphi)*phi": lambda d, p, s, e: rising(d) * p,
    "e^2": lambda d, p, s, e: e * e,
    "e|e|": lambda d, p, s, e: e * np.abs(e),
    "e^3": lambda d, p, s, e: e**3,
    "phi*e": lambda d, p, s, e: p * e,
    "phi^2*e": lambda d, p, s, e: p * p * e,
    "psi*e": lambda d, p, s, e: s * e,
    "psi^2": lambda d, p, s, e: s * s,
    "psi^3": lambda d, p, s, e: s**3,
    "phi*psi": lambda d, p, s, e: p * s,
    "phi*psi^2": lambda d, p, s, e: p * s * s,
    "phi^2*psi": lambda d, p, s, e: p * p * s,
    "A*phi": lambda d, p, s, e: (d["amplitude"] - d.references.mean_amplitude) * p,
    "A": lambda d, p, s, e: d["amplitude"],
    "t*phi": lambda d, p, s, e: (d["time_s"] - d.middle_s) * p,
    "t*e": lambda d, p, s, e: (d["time_s"] - d.middle_s) * e,
    "n*phi": lambda d, p, s, e: (d["Nc_frac"] - d.references.mean_speed) * p,
    "n*e": lambda d, p, s, e: (d["Nc_frac"] - d.references.mean_speed) * e,
}
_ADDED: dict[str, Function] = {
    "high psi at the output": lambda d, p, s, e: _above(s, d.psi_levels[1]),
    "highest psi at the output": lambda d, p, s, e: _above(s, d.psi_levels[2]),
    "low psi at the output": lambda d, p, s, e: _above(-s, -d.psi_levels[0]),
    "slow psi": lambda d, p, s, e: _slow(s, d, d.surge_s),
    "slowest psi": lambda d, p, s, e: _slow(s, d, 4.0 * d.surge_s),
    "psi^2 at the output": lambda d, p, s, e: s * s,
    "psi^3 at the output": lambda d, p, s, e: s**3,
    "sgn(dpsi) at the output": lambda d, p, s, e: np.sign(e),
}
_TERMS = {**_DRIVEN, **_ADDED}


def with_state(data: LagData, fit: Fit) -> LagData:
    """Return the data with ψ' and e = τ dψ'/dt as a fit simulates them, for the open terms.

    Simulated, not measured: a regressor that holds the noise of the measurement would correlate
    with the errors it is tested on.
    """
    ports = fit.structure.ports(data, fit.nonlinear)
    q = ports.driven.shape[1]
    target = ports.driven @ fit.coefficients[:q] * ports.gain
    state = _slow(target, data, fit.tau_s)
    return data.with_signal("state", state).with_signal("relaxation", target - state)


def with_own_state(data: LagData, fit: Fit) -> LagData:
    """Return the data with the state of a fit where one of its terms needs it."""
    return with_state(data, fit) if any(e.unnamed for e in fit.structure.effects) else data


def _acts(name: str, ports: Ports, data: LagData, values: FloatArray) -> Ports:
    column = _TERMS[name](data, data["phi_smooth"], data["state"], data["relaxation"])
    if name in _DRIVEN:
        return ports.with_driven(column[:, None], (name,))
    return ports.with_added(data.sampled(column)[:, None], (name,))


def open_terms(data: LagData) -> tuple[Effect, ...]:
    """Return the terms that these records can carry."""
    steady = "Nc_frac" not in data or float(np.ptp(data["Nc_frac"])) < 1e-6
    return tuple(_open_term(name) for name in _TERMS if not (steady and name.startswith("n*")))


def _open_term(name: str) -> Effect:
    return Effect(
        name,
        "characteristic" if name in _DRIVEN else "output",
        f"+ c {name}",
        "a term that no effect of the catalogue stands behind",
        (Parameter("c", "1", -np.inf, np.inf),),
        partial(_acts, name),
        on_tau="unknown",
        confirm="unknown",
        unnamed=True,
    )
