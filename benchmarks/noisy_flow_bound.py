"""The least error of τ on a record with noise on both channels, for who knows the structure.

τ dψ'/dt + ψ' = Σ β s(φ) with φ joined by straight lines between samples gives
ψ'[k+1] = p ψ'[k] + (1 - R) f[k+1] + (R - p) f[k], p = exp(-h/τ), R = (1 - p) τ/h, f = Σ β s(φ).
With white noise on ψ' and on φ, and every true φ[k] unknown, the information on (τ, β) is
J' S⁻¹ J: J is the slope of this equation's error, S its covariance when both noises are put in.
That this is the information with all φ[k] as nuisance parameters is Woodbury's identity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solveh_banded
from surge_truths import PERIOD_S, TAU_S, FloatArray, Simulated, characteristic

_STEP = 1e-6


@dataclass(frozen=True)
class TauBound:
    """What can be had of τ from one record.

    Parameters
    ----------
    stderr_s : float
        Cramer-Rao bound of its standard error.
    one_step_s : float
        Error of the one-step estimate from the truth, whose variance is the bound.
    """

    stderr_s: float
    one_step_s: float


def tau_bound(terms: dict[str, float], made: Simulated, noise: float) -> TauBound:
    """Return the bound of τ, and the error of an estimate that attains it on this record.

    Parameters
    ----------
    terms : dict
        The truth, without terms in ψ'.
    made : Simulated
        The record, in one piece, with what it was before it was measured.
    noise : float
        Standard deviation of the noise as a share of each signal's own.
    """
    p = np.exp(-PERIOD_S / TAU_S)
    ratio = (1.0 - p) * TAU_S / PERIOD_S
    jacobian = _jacobian(terms, made, p, ratio)
    bands = _covariance(terms, made, noise, p, ratio)
    covariance = np.linalg.inv(jacobian.T @ solveh_banded(bands, jacobian))
    psi_off, phi_off = made.measured.psi_p - made.psi_p, made.measured.phi - made.phi
    now, before = _weights(terms, made.phi, p, ratio)
    errors = psi_off[1:] - p * psi_off[:-1] - now[1:] * phi_off[1:] - before[:-1] * phi_off[:-1]
    one_step = -covariance @ (jacobian.T @ solveh_banded(bands, errors))
    return TauBound(float(np.sqrt(covariance[0, 0])), float(one_step[0]))


def _jacobian(terms: dict[str, float], made: Simulated, p: float, ratio: float) -> FloatArray:
    """Return ∂(error of the equation)/∂(τ, β) at the truth."""
    p_slope = p * PERIOD_S / TAU_S**2
    ratio_slope = (1.0 - p) / PERIOD_S - p / TAU_S
    curve = characteristic(terms, made.phi)
    by_tau = -p_slope * (made.psi_p[:-1] - curve[:-1]) + ratio_slope * np.diff(curve)
    columns = [characteristic({name: 1.0}, made.phi) for name in terms]
    by_beta = [-(1.0 - ratio) * s[1:] - (ratio - p) * s[:-1] for s in columns]
    return np.column_stack([by_tau, *by_beta])


def _covariance(
    terms: dict[str, float], made: Simulated, noise: float, p: float, ratio: float
) -> FloatArray:
    """Return the upper bands of S, tridiagonal since two neighbours share one sample."""
    psi_variance, phi_variance = (noise * made.psi_p.std()) ** 2, (noise * made.phi.std()) ** 2
    now, before = _weights(terms, made.phi, p, ratio)
    bands = np.zeros((2, made.phi.size - 1))
    bands[1] = psi_variance * (1.0 + p**2)
    bands[1] += phi_variance * (now[1:] ** 2 + before[:-1] ** 2)
    bands[0, 1:] = -p * psi_variance + phi_variance * now[1:-1] * before[1:-1]
    return bands


def _weights(
    terms: dict[str, float], phi: FloatArray, p: float, ratio: float
) -> tuple[FloatArray, FloatArray]:
    """Return what the noise of φ[k] enters the equation with that ends, and that starts, at k."""
    slope = (characteristic(terms, phi + _STEP) - characteristic(terms, phi - _STEP)) / (2 * _STEP)
    return (1.0 - ratio) * slope, (ratio - p) * slope
