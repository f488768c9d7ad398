"""The identification problem of the benchmarks: truth, records and Cramer-Rao bound.

τ dψ'/dt + ψ' = β0 + β1 φ + β2 φ² sampled with a hold of order zero (paper, Eq 9-11), with a moving
average of white noise in the equation, ψ'[k+1] = a ψ'[k] + (1 - a) Σ β_i s_i[k] + e[k+1] + c e[k].
Needs numpy and scipy alone, and nothing that recovers the parameters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

FloatArray = NDArray[np.float64]

TAU_S = 0.018
BETA = (0.30, 1.20, -1.50)
SIGMA = 0.002
PERIOD_S = 1e-3
# c of the records that fits are timed and judged on.
MOVING_AVERAGE = -0.6
SWEEP_HZ = 1.2
WANDER_HZ = 6.0
# φ from 0.2 to 0.6, over the top of the characteristic: dψ'_QS/dφ changes its sign at 0.4.
MEAN_FLOW, SWEEP, WANDER_STD = 0.4, 0.15, 0.05
# Samples simulated ahead of a record so that its error starts in its steady state.
SETTLING = 1000


# Pole of the lag, exp(-h/τ) (paper, Eq 10), and its slope over τ.
POLE = float(np.exp(-PERIOD_S / TAU_S))
POLE_SLOPE = POLE * PERIOD_S / TAU_S**2


@dataclass(frozen=True)
class Record:
    """One simulated record: c of C(q) = 1 + c q⁻¹, φ, ψ', and the white error e."""

    c: float
    phi: FloatArray
    y: FloatArray
    e: FloatArray

    def bound(self) -> tuple[FloatArray, FloatArray]:
        """Return the Cramer-Rao bound given φ, and the one-step estimate from the truth.

        The first is the least standard error of an unbiased estimate of (τ, β0, β1, β2); C is a
        nuisance parameter that counts. The second is F⁻¹ times the score at the truth: an error
        whose variance is the bound, and which that of maximum likelihood approaches as records
        grow.

        F = E[J'J]/σ² with J = ∂e/∂θ. What the input adds to J is fixed; what the error adds is
        taken by its expectation: E(∂e/∂a)² = σ²/(1 - a²), E(∂e/∂c)² = σ²/(1 - c²) and their
        product σ²/(1 + a c) (Box and Jenkins 1976, information matrix of an ARMA(1, 1)).
        """
        certain, uncertain = self._jacobian()
        fisher = certain.T @ certain / SIGMA**2 + len(certain) * self._error_information()
        covariance = np.linalg.inv(fisher)
        one_step = -covariance @ ((certain + uncertain).T @ self.e[1:]) / SIGMA**2
        return np.sqrt(np.diag(covariance))[:-1], one_step[:-1]

    def _jacobian(self) -> tuple[FloatArray, FloatArray]:
        """Return ∂e/∂(τ, β, c) from the input, and from e."""
        terms = np.vander(self.phi, len(BETA), increasing=True)
        clean = lagged(self.phi)
        by_tau = (clean - terms @ np.array(BETA)) * POLE_SLOPE
        by_input = np.column_stack([by_tau, (1.0 - POLE) * terms])[:-1]
        by_error = np.column_stack([(self.y - clean) * POLE_SLOPE, self.e])[:-1]
        # Of one equation, then through 1/C.
        certain, uncertain = np.zeros((2, len(by_input), len(BETA) + 2))
        certain[:, :-1] = -lfilter([1.0], [1.0, self.c], by_input, axis=0)
        uncertain[:, [0, -1]] = -lfilter([1.0], [1.0, self.c], by_error, axis=0)
        return certain, uncertain

    def _error_information(self) -> FloatArray:
        """Return what the error adds to the information, per sample."""
        information = np.zeros((len(BETA) + 2, len(BETA) + 2))
        information[0, 0] = POLE_SLOPE**2 / (1.0 - POLE**2)
        information[0, -1] = information[-1, 0] = POLE_SLOPE / (1.0 + POLE * self.c)
        information[-1, -1] = 1.0 / (1.0 - self.c**2)
        return information


def simulate(n_samples: int, seed: int, c: float) -> Record:
    """Simulate one record; the seed is that of flow and error."""
    rng = np.random.default_rng(seed)
    phi = flow(n_samples, rng)
    e = SIGMA * rng.standard_normal(n_samples + SETTLING)
    error = lfilter([1.0, c], [1.0, -POLE], e)[SETTLING:]
    return Record(c, phi, lagged(phi) + error, e[SETTLING:])


def flow(n_samples: int, rng: np.random.Generator) -> FloatArray:
    """Return a flow coefficient that sweeps at 1.2 Hz and wanders with a bandwidth of 6 Hz."""
    t = PERIOD_S * np.arange(n_samples)
    pole = np.exp(-2.0 * np.pi * WANDER_HZ * PERIOD_S)
    white = rng.standard_normal(n_samples + SETTLING) * np.sqrt(1.0 - pole**2)
    wander = lfilter([1.0], [1.0, -pole], white)[SETTLING:]
    sweep = np.sin(2.0 * np.pi * SWEEP_HZ * t + rng.uniform(0.0, 2.0 * np.pi))
    return np.asarray(MEAN_FLOW + SWEEP * sweep + WANDER_STD * wander)


def lagged(phi: FloatArray) -> FloatArray:
    """Return the error-free ψ', from rest on the characteristic at the first sample."""
    quasi_steady = np.vander(phi, len(BETA), increasing=True) @ np.array(BETA)
    drive = [0.0, 1.0 - POLE]
    out, _ = lfilter(drive, [1.0, -POLE], quasi_steady, zi=np.array([quasi_steady[0]]))
    return np.asarray(out)
