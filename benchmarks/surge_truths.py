"""Surge records with a known truth for the benchmarks, made by numpy and scipy alone.

φ is a relaxation oscillation that wanders between 5 and 7 Hz; ψ' obeys τ dψ'/dt + ψ' = F(φ, ψ') and
is simulated at eight times the sample rate. Noise is given as a share of each signal's standard
deviation and is on both channels. No two records share a random number.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded
from scipy.signal import lfilter

FloatArray = NDArray[np.float64]

TAU_S = 0.018
PERIOD_S = 1e-3
FINER = 8
# Damping of the Van der Pol oscillation, and its period in its own time.
_MU, _PERIOD = 3.0, 8.859
_LEAD_S = 0.5
# In stall below this flow; shorter pieces are left out.
_STALL_PHI = 0.27
_SHORTEST_PIECE = 30
# Of φ, for the slope of a characteristic.
_STEP = 1e-6

# Coefficients of ψ'_QS and of what depends on ψ' itself, by the names of the terms.
TRUTHS: dict[str, dict[str, float]] = {
    "quadratic": {"1": 0.35, "phi": 1.2, "phi^2": -1.9},
    "cubic": {"1": 0.30, "phi": 0.5, "phi^2": 3.0, "phi^3": -7.0},
    "hinge": {"1": 0.35, "phi": 0.8, "relu(phi-0.3)": -1.6},
    "reverse": {"1": 0.35, "phi": 1.2, "phi^2": -1.9, "phi^2[phi<0]": 20.0},
    # Moore & Greitzer (1986): H (1 + 1.5 (φ/W - 1) - 0.5 (φ/W - 1)³) with W = 0.25, H = 0.09.
    "Moore-Greitzer": {"1": 0.30, "phi^2": 4.32, "phi^3": -5.76},
    "hinge at 0.27": {"1": 0.35, "phi": 0.8, "relu(phi-0.27)": -1.6},
    "with psi'^2": {"1": 0.35, "phi": 1.2, "phi^2": -1.9, "psi_p^2": -1.5},
    "with psi' phi": {"1": 0.35, "phi": 1.2, "phi^2": -1.9, "psi_p phi": 0.8},
}


@dataclass(frozen=True)
class Record:
    """One record: measured φ and ψ', and the number of the in-stall piece of each row.

    One in one piece has no numbers.
    """

    phi: FloatArray
    psi_p: FloatArray
    labels: NDArray[np.int64] | None = None


@dataclass(frozen=True)
class Simulated:
    """A record with what it was before it was measured, whole and without noise."""

    measured: Record
    phi: FloatArray
    psi_p: FloatArray


def simulate_record(
    truth: str,
    noise: float,
    seed: int,
    n_samples: int = 5000,
    *,
    colour: float = 0.0,
    late: int = 0,
    pieces: bool = False,
) -> Simulated:
    """Simulate and measure one record at 1 kHz, and keep its truth.

    Its random numbers depend on the seed and on every other argument: the noise as a share of each
    signal's standard deviation; its colour, the coefficient of a first-order autoregression; the
    samples by which ψ' is measured too late; and whether the in-stall pieces alone are kept, cut to
    unequal lengths.
    """
    key = f"{truth}|{noise}|{n_samples}|{colour}|{late}|{pieces}"
    rng = np.random.default_rng([seed, zlib.crc32(key.encode())])
    n_fine = FINER * (n_samples + late)
    fine = relaxation_wave(n_fine, PERIOD_S / FINER, rng)
    pressure = response(TRUTHS[truth], fine, PERIOD_S / FINER)[-n_fine:]
    clean_phi = fine[-n_fine:][FINER * late :: FINER]
    clean_psi_p = pressure[: FINER * n_samples : FINER]
    phi = clean_phi + noise * clean_phi.std() * _noise(n_samples, colour, rng)
    psi_p = clean_psi_p + noise * clean_psi_p.std() * _noise(n_samples, colour, rng)
    measured = Record(phi, psi_p)
    if pieces:
        labels = _in_stall(clean_phi, rng)
        inside = labels > 0
        measured = Record(phi[inside], psi_p[inside], labels[inside])
    return Simulated(measured, clean_phi, clean_psi_p)


def relaxation_wave(n: int, step_s: float, rng: np.random.Generator) -> FloatArray:
    """Return φ of a surging machine, -0.04 to 0.51, with a lead of half a second before n steps."""
    lead = int((_LEAD_S + rng.uniform(0, 1 / 6)) / step_s)
    total = n + lead
    corners = np.arange(int(total * step_s * 2) + 3) * 0.5
    hertz = np.interp(np.arange(total) * step_s, corners, rng.uniform(5, 7, corners.size))
    x, v, wave = 2.0, 0.0, np.empty(total)
    for i, s in enumerate((hertz * _PERIOD * step_s).tolist()):
        # Midpoint rule.
        xm, vm = x + s / 2 * v, v + s / 2 * (_MU * (1 - x * x) * v - x)
        x, v = x + s * vm, v + s * (_MU * (1 - xm * xm) * vm - xm)
        wave[i] = x
    return 0.235 + 0.1365 * wave


def response(terms: dict[str, float], phi: FloatArray, step_s: float) -> FloatArray:
    """Return ψ' from τ dψ'/dt + ψ' = Σ β s(φ, ψ') for φ joined by straight lines."""
    curve = {name: value for name, value in terms.items() if "psi_p" not in name}
    rest = {name: value for name, value in terms.items() if "psi_p" in name}
    if rest:
        return _runge_kutta(curve, rest, phi, step_s)
    # Exact for straight lines between the steps of the forcing, of which there are 144 in a lag.
    forcing = characteristic(curve, phi)
    pole = np.exp(-step_s / TAU_S)
    ratio = (1 - pole) * TAU_S / step_s
    drive = (1 - ratio) * forcing[1:] + (ratio - pole) * forcing[:-1]
    later, _ = lfilter([1.0], [1.0, -pole], drive, zi=[pole * forcing[0]])
    return np.concatenate((forcing[:1], later))


def characteristic(terms: dict[str, float], phi: FloatArray) -> FloatArray:
    """Return Σ β s(φ) of terms that do not depend on ψ'."""
    total = np.zeros_like(phi)
    for name, value in terms.items():
        if name == "phi^2[phi<0]":
            total += value * np.where(phi < 0, phi**2, 0.0)
        elif name.startswith("relu(phi-"):
            total += value * np.maximum(phi - float(name[9:-1]), 0.0)
        else:
            power = 0 if name == "1" else int(name.partition("^")[2] or 1)
            total += value * phi**power
    return total


def _runge_kutta(
    curve: dict[str, float], rest: dict[str, float], phi: FloatArray, step_s: float
) -> FloatArray:
    """Integrate by the classical rule of fourth order, one step between two values of φ."""
    square, product = rest.get("psi_p^2", 0.0), rest.get("psi_p phi", 0.0)
    h = step_s / TAU_S
    middle = (phi[1:] + phi[:-1]) / 2
    ends, between = characteristic(curve, phi).tolist(), characteristic(curve, middle).tolist()
    flow, flow_between = phi.tolist(), middle.tolist()
    y = ends[0]
    states = [y]
    for i, (f, p) in enumerate(zip(between, flow_between, strict=True)):
        k1 = ends[i] + (square * y + product * flow[i] - 1) * y
        z = y + h / 2 * k1
        k2 = f + (square * z + product * p - 1) * z
        z = y + h / 2 * k2
        k3 = f + (square * z + product * p - 1) * z
        z = y + h * k3
        k4 = ends[i + 1] + (square * z + product * flow[i + 1] - 1) * z
        y += h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        states.append(y)
    return np.array(states)


def _noise(n: int, colour: float, rng: np.random.Generator) -> FloatArray:
    """Return noise of unit variance, white or of first order."""
    white = rng.standard_normal(n + 200)
    coloured: FloatArray = lfilter([np.sqrt(1 - colour**2)], [1.0, -colour], white)[200:]
    return coloured


def _in_stall(phi: FloatArray, rng: np.random.Generator) -> NDArray[np.int64]:
    """Label the pieces below the stalling flow 1, 2, ..., each cut short by up to a third."""
    inside = np.concatenate(([0], (phi < _STALL_PHI).astype(int), [0]))
    edges = np.flatnonzero(np.diff(inside))
    labels = np.zeros(phi.size, dtype=np.int64)
    number = 0
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        first = start + int(rng.integers(0, (stop - start) // 3 + 1))
        if stop - first >= _SHORTEST_PIECE:
            number += 1
            labels[first:stop] = number
    return labels


def canonical(names: Iterable[str]) -> frozenset[str]:
    """Return a structure as a set of names in which equal models are equal.

    φ|φ| = φ² - 2 φ²[φ<0], so that any two of these three span the same model; and a product is the
    same in either order.
    """
    terms = {" ".join(sorted(_plain(name).split(), reverse=True)) for name in names}
    aliases = {"phi^2", "phi^2[phi<0]", "phi|phi|"}
    if len(terms & aliases) >= 2:
        terms = (terms - aliases) | {"phi^2", "phi^2[phi<0]"}
    return frozenset(terms)


def _plain(name: str) -> str:
    for other in ("|phi|phi", "|phi| phi", "phi |phi|"):
        name = name.replace(other, "phi|phi|")
    return name.replace("psi'", "psi_p").replace("*", " ")


class TauBound(NamedTuple):
    """What can be had of τ from one record.

    ``stderr_s`` is the Cramer-Rao bound of its standard error, ``one_step_s`` the error of the
    one-step estimate from the truth, whose variance is the bound.
    """

    stderr_s: float
    one_step_s: float


def tau_bound(terms: dict[str, float], made: Simulated, noise: float) -> TauBound:
    """Return the least error of τ with noise on both channels, for who knows the structure.

    τ dψ'/dt + ψ' = Σ β s(φ) with φ joined by straight lines between samples gives
    ψ'[k+1] = p ψ'[k] + (1 - R) f[k+1] + (R - p) f[k], p = exp(-h/τ), R = (1 - p) τ/h, f = Σ β s(φ).
    With white noise on ψ' and on φ, and every true φ[k] unknown, the information on (τ, β) is
    J' S⁻¹ J: J is the slope of this equation's error, S its covariance when both noises are put in.
    That this is the information with all φ[k] as nuisance parameters is Woodbury's identity. The
    terms are those of the truth, without any in ψ', and the record is in one piece.
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
