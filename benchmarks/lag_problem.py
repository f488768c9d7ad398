"""The identification problem of the benchmarks: truth, records and Cramer-Rao bound.

τ dψ'/dt + ψ' = β0 + β1 φ + β2 φ² sampled with a hold of order zero (paper, Eq 9-11), with one of
three errors: white on the output, white in the equation, or a moving average in the equation,
ψ'[k+1] = a ψ'[k] + (1 - a) Σ β_i s_i[k] + e[k+1] + c e[k].
Needs numpy and scipy alone, and nothing that recovers the parameters.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

FloatArray = NDArray[np.float64]
Error = Literal["arx", "armax", "output-error"]

TAU_S = 0.018
BETA = (0.30, 1.20, -1.50)
SIGMA = 0.002
PERIOD_S = 1e-3
NAMES = ("tau", "beta0", "beta1", "beta2")
SWEEP_HZ = 1.2
WANDER_HZ = 6.0
# φ from 0.2 to 0.6, over the top of the characteristic: dψ'_QS/dφ changes its sign at 0.4.
MEAN_FLOW, SWEEP, WANDER_STD = 0.4, 0.15, 0.05
# Samples simulated ahead of a record so that its error starts in its steady state.
SETTLING = 1000


@dataclass(frozen=True)
class Problem:
    """Where the white noise enters, and c of C(q) = 1 + c q⁻¹, 0 unless that is "armax"."""

    error: Error = "armax"
    c: float = 0.0

    @property
    def a(self) -> float:
        """Pole of the lag, exp(-h/τ) (paper, Eq 10)."""
        return float(np.exp(-PERIOD_S / TAU_S))

    @property
    def truth(self) -> FloatArray:
        """(τ in seconds, β0, β1, β2)."""
        return np.array([TAU_S, *BETA])

    def record(self, n_samples: int, seed: int) -> Record:
        """Simulate one record; the seed is that of flow and error."""
        rng = np.random.default_rng(seed)
        phi = flow(n_samples, rng)
        e = SIGMA * rng.standard_normal(n_samples + SETTLING)
        error = e if self.error == "output-error" else lfilter([1.0, self.c], [1.0, -self.a], e)
        clean = lagged(phi, self.a)
        return Record(self, phi, clean + error[SETTLING:], e[SETTLING:])


@dataclass(frozen=True)
class Record:
    """One simulated record: its truth, φ, ψ', and the white error e."""

    problem: Problem
    phi: FloatArray
    y: FloatArray
    e: FloatArray

    def bound(self) -> tuple[FloatArray, FloatArray]:
        """Return the Cramer-Rao bound given φ, and the one-step estimate from the truth.

        The first is the least standard error of an unbiased estimate of (τ, β0, β1, β2); C, and for
        output error the start, are nuisance parameters that count. The second is F⁻¹ times the
        score at the truth: an error whose variance is the bound, and which that of maximum
        likelihood approaches as records grow.

        F = E[J'J]/σ² with J = ∂e/∂θ. What the input adds to J is fixed; what the error adds is
        taken by its expectation: E(∂e/∂a)² = σ²/(1 - a²), E(∂e/∂c)² = σ²/(1 - c²) and their
        product σ²/(1 + a c) (Box and Jenkins 1976, information matrix of an ARMA(1, 1)).
        """
        certain, uncertain = self._jacobian()
        n = certain.shape[0]
        fisher = certain.T @ certain / SIGMA**2
        if uncertain is not None:
            fisher += n * self._error_information()
        score = -(certain if uncertain is None else certain + uncertain).T @ self._scored()
        covariance = np.linalg.inv(fisher)
        one_step = covariance @ score / SIGMA**2
        keep = len(NAMES)
        return np.sqrt(np.diag(covariance))[:keep], one_step[:keep]

    def _scored(self) -> FloatArray:
        return self.e if self.problem.error == "output-error" else self.e[1:]

    def _jacobian(self) -> tuple[FloatArray, FloatArray | None]:
        """Return ∂e/∂(τ, β, nuisance) from the input and, for equation errors, from e."""
        a = self.problem.a
        da_dtau = a * PERIOD_S / TAU_S**2
        terms = np.vander(self.phi, len(BETA), increasing=True)
        quasi_steady = terms @ np.array(BETA)
        clean = lagged(self.phi, a)
        # ∂(prediction)/∂a, ∂(prediction)/∂β of one equation, then through 1/C or through 1/A.
        slopes = np.column_stack([(clean - quasi_steady) * da_dtau, (1.0 - a) * terms])[:-1]
        if self.problem.error == "output-error":
            held = np.zeros((1, slopes.shape[1]))
            moved = np.concatenate([held, lfilter([1.0], [1.0, -a], slopes, axis=0)])
            # The start is free: it adds a^k to the output.
            return -np.column_stack([moved, a ** np.arange(self.phi.size)]), None
        whitened = lfilter([1.0], [1.0, self.problem.c], slopes, axis=0)
        before = np.zeros_like(whitened)
        noise = self.y - clean
        before[:, 0] = lfilter([1.0], [1.0, self.problem.c], noise[:-1]) * da_dtau
        if self.problem.error == "arx":
            return -whitened, -before
        c_column = lfilter([1.0], [1.0, self.problem.c], self.e[:-1])
        nothing = np.zeros(c_column.size)
        return -np.column_stack([whitened, nothing]), -np.column_stack([before, c_column])

    def _error_information(self) -> FloatArray:
        """Return what the error adds to the information, per sample."""
        a, c = self.problem.a, self.problem.c
        da_dtau = a * PERIOD_S / TAU_S**2
        n_parameters = len(NAMES) + (1 if self.problem.error == "armax" else 0)
        information = np.zeros((n_parameters, n_parameters))
        information[0, 0] = da_dtau**2 / (1.0 - a**2)
        if self.problem.error == "armax":
            information[0, -1] = information[-1, 0] = da_dtau / (1.0 + a * c)
            information[-1, -1] = 1.0 / (1.0 - c**2)
        return information


def flow(n_samples: int, rng: np.random.Generator) -> FloatArray:
    """Return a flow coefficient that sweeps at 1.2 Hz and wanders with a bandwidth of 6 Hz."""
    t = PERIOD_S * np.arange(n_samples)
    pole = np.exp(-2.0 * np.pi * WANDER_HZ * PERIOD_S)
    white = rng.standard_normal(n_samples + SETTLING) * np.sqrt(1.0 - pole**2)
    wander = lfilter([1.0], [1.0, -pole], white)[SETTLING:]
    sweep = np.sin(2.0 * np.pi * SWEEP_HZ * t + rng.uniform(0.0, 2.0 * np.pi))
    return np.asarray(MEAN_FLOW + SWEEP * sweep + WANDER_STD * wander)


def lagged(phi: FloatArray, a: float) -> FloatArray:
    """Return the error-free ψ', from rest on the characteristic at the first sample."""
    quasi_steady = np.vander(phi, len(BETA), increasing=True) @ np.array(BETA)
    out, _ = lfilter([0.0, 1.0 - a], [1.0, -a], quasi_steady, zi=np.array([quasi_steady[0]]))
    return np.asarray(out)
