"""The four ports of the lag model, and its answer once effects have acted on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from comparisons.missing_effect.kernels import lag_pass, second_order_pass, varying_lag_pass
from comparisons.missing_effect.lag_data import LagData
from comparisons.results import evaluate_terms
from surge_core.types import FloatArray


@dataclass(frozen=True)
class Ports:
    """What stands at each port: φ, the inputs of the lag, the lag itself, its output.

    Parameters
    ----------
    phi : ndarray of shape (N,)
        φ as it acts.
    driven : ndarray of shape (N, q)
        Inputs of the lag, one a linear coefficient; the terms of the characteristic first.
    names : tuple of str
        Their names.
    added : ndarray of shape (n, p)
        What is added behind the lag, one a linear coefficient.
    added_names : tuple of str
        Their names.
    gain : ndarray of shape (N,), or 1
        Factor of the whole characteristic.
    tau_factor : ndarray of shape (N,), or 1
        Factor of τ over the step that ends at each row.
    a2_s2 : float
        a₂ of the second-order lag, in s²; 0 for the first-order one.
    out_gain : ndarray of shape (n,), or 1
        Factor of the lag's output at the samples.
    known : ndarray of shape (n,), or 0
        What is added at the samples without a coefficient.
    n_powers : int
        Powers of φ, from the constant on without a gap, among the base terms.
    """

    phi: FloatArray
    driven: FloatArray
    names: tuple[str, ...]
    added: FloatArray
    added_names: tuple[str, ...] = ()
    gain: FloatArray | float = 1.0
    tau_factor: FloatArray | float = 1.0
    a2_s2: float = 0.0
    out_gain: FloatArray | float = 1.0
    known: FloatArray | float = 0.0
    n_powers: int = 0

    @classmethod
    def of(cls, data: LagData, phi: FloatArray, terms: Sequence[str]) -> Ports:
        """Return the ports of the base model at a φ."""
        names = tuple(terms)
        nothing = np.zeros((data.n_samples, 0))
        driven = evaluate_terms(list(names), phi)
        return cls(phi, driven, names, nothing, n_powers=n_powers(names))

    def with_driven(self, columns: FloatArray, names: Sequence[str]) -> Ports:
        """Return the ports with more inputs of the lag."""
        return replace(
            self, driven=np.column_stack([self.driven, columns]), names=(*self.names, *names)
        )

    def with_added(self, columns: FloatArray, names: Sequence[str]) -> Ports:
        """Return the ports with more columns behind the lag."""
        both = np.column_stack([self.added, columns])
        return replace(self, added=both, added_names=(*self.added_names, *names))

    def contracted(self, coefficients: FloatArray) -> Ports:
        """Return the ports with all columns of one side joined by their coefficients."""
        q = self.driven.shape[1]
        behind = coefficients[coefficients.size - self.added.shape[1] :, None]
        driven, added = self.driven @ coefficients[:q, None], self.added @ behind
        return replace(self, driven=driven, names=("",), added=added, added_names=("",))


def n_powers(terms: Sequence[str]) -> int:
    """Return how many powers of φ, from the constant on without a gap, are among terms."""
    powers = powers_of_phi(len(terms))
    return next((k for k, name in enumerate(powers) if name not in terms), len(terms))


def powers_of_phi(degree: int) -> tuple[str, ...]:
    """Return the names of the powers of φ up to a degree, one or more."""
    return ("1", "phi", *(f"phi^{k}" for k in range(2, degree + 1)))


def respond(
    ports: Ports, data: LagData, tau_s: float, nuisance: FloatArray | None = None
) -> FloatArray:
    """Return the answer to every linear coefficient at the samples, a column each.

    Columns are inputs of the lag, nuisances (others in place of the data's), and what is added
    behind the lag.
    """
    driven = ports.driven
    if "stalled" in data:
        driven = driven * data["stalled"][:, None]
    driven = data.averaged(driven * np.reshape(ports.gain, (-1, 1)))
    extra = data.nuisance if nuisance is None else nuisance
    if extra.shape[1]:
        driven = np.column_stack([driven, extra])
    columns = _lagged(np.ascontiguousarray(driven), ports, data, tau_s)
    return np.column_stack([columns * np.reshape(ports.out_gain, (-1, 1)), ports.added])


def decay_of(ports: Ports, data: LagData, tau_s: float) -> FloatArray:
    """Return what is left, at each sample, of a start of its run that is off by one."""
    return np.asarray(np.exp(-ages(ports, data, tau_s)))


def ages(ports: Ports, data: LagData, tau_s: float) -> FloatArray:
    """Return the time since the start of its run, at each sample, in (slower) time constants."""
    slow_s, _, turn = lag_times(tau_s, ports.a2_s2)
    if isinstance(ports.tau_factor, float) or turn > 0.0:
        return np.asarray(data.steps_of_run[data.rows] * (data.step_s / slow_s))
    ratio = data.step_s / (slow_s * ports.tau_factor)
    passed = [np.cumsum(np.append(0.0, ratio[start + 1 : stop])) for start, stop in data.fine_runs]
    return np.asarray(np.concatenate(passed)[data.rows])


def lag_times(tau_s: float, a2_s2: float) -> tuple[float, float, float]:
    """Return slow and fast time constant, in seconds, and angular frequency where a lag swings."""
    if a2_s2 == 0.0:
        return tau_s, 0.0, 0.0
    inside = tau_s**2 - 4.0 * a2_s2
    if inside < 0.0:
        return 2.0 * a2_s2 / tau_s, 0.0, float(np.sqrt(-inside)) / (2.0 * a2_s2)
    slow_s = 0.5 * (tau_s + float(np.sqrt(inside)))
    return slow_s, a2_s2 / slow_s, 0.0


def _lagged(driven: FloatArray, ports: Ports, data: LagData, tau_s: float) -> FloatArray:
    runs, step_s = data.fine_runs, data.step_s
    slow_s, fast_s, turn = lag_times(tau_s, ports.a2_s2)
    if turn > 0.0:
        return second_order_pass(driven, tau_s, ports.a2_s2, step_s, runs, data.every)
    # Overdamped: two lags in a row, the fast one first; the slow one may vary. The bound is only
    # against a division by zero: at the first small step of a₂ the fast lag is short.
    if fast_s > 1e-9 * step_s:
        # A start is put where a long ramp would have left it.
        behind = fast_s / step_s * (driven[runs[:, 0] + 1] - driven[runs[:, 0]])
        start = np.repeat(behind, np.diff(runs, axis=1)[:, 0], axis=0)
        driven = lag_pass(driven, fast_s, step_s, runs)
        driven = driven - start * np.exp(-data.steps_of_run * (step_s / fast_s))[:, None]
    if isinstance(ports.tau_factor, float):
        return lag_pass(driven, slow_s, step_s, runs, data.every)
    ratio = step_s / (slow_s * ports.tau_factor)
    a, mean = np.exp(-ratio), -np.expm1(-ratio) / ratio
    out: FloatArray = varying_lag_pass(driven, a, 1.0 - mean, mean - a, runs, data.every)
    return out
