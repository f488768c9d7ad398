"""The equations of the lag with noise on both channels, about any point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sindy_surge.free_run import (
    Hold,
    HoldCoefficients,
    Segments,
    hold_coefficients,
    hold_sensitivities,
    simulate,
)
from sindy_surge.library import CandidateTerms
from sindy_surge.whitening import NoiseLevels, Whitener

__all__ = ["Equations", "Features", "LagProblem", "equations_about", "features", "noise_in_inputs"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

# τ below a thousandth of the sample period is no lag at all: e^-1000 = 0.
_SHORTEST_LAG_SAMPLES = 1e-3
# Second difference by a parabola through seven points (Savitzky & Golay 1964, table of 2nd
# derivatives): a plain one would be mostly noise.
_SECOND_DIFFERENCE = np.array([5.0, 0.0, -3.0, -4.0, -3.0, 0.0, 5.0]) / 42


@dataclass(frozen=True)
class LagProblem:
    """The data and everything that stays the same from structure to structure.

    Parameters
    ----------
    inputs : ndarray of shape (n_rows, n_inputs)
        Measured inputs (φ).
    output : ndarray of shape (n_rows,)
        Measured ψ'.
    segments : Segments
        The runs of rows.
    sample_period_s : float
        Sample period in seconds.
    hold : {"first", "zero"}
        How the terms run between two samples.
    terms : CandidateTerms
        The library.
    columns : ndarray of int of shape (n_columns,)
        The terms of the library that this data can tell apart.
    noise : NoiseLevels
        The measurement noise.
    """

    inputs: FloatArray
    output: FloatArray
    segments: Segments
    sample_period_s: float
    hold: Hold
    terms: CandidateTerms
    columns: IntArray
    noise: NoiseLevels

    @property
    def longest_lag_s(self) -> float:
        """A lag three times the longest segment cannot be told from an integrator."""
        return 3.0 * float(self.segments.lengths.max()) * self.sample_period_s

    @property
    def shortest_lag_s(self) -> float:
        """The shortest τ tried, in seconds."""
        return _SHORTEST_LAG_SAMPLES * self.sample_period_s

    def hold_at(self, time_constant_s: float) -> HoldCoefficients:
        """Return the discrete lag for one τ."""
        return hold_coefficients(time_constant_s, self.sample_period_s, self.hold)


@dataclass(frozen=True)
class Features:
    """Terms at given inputs: values of shape (n, q) and slopes of shape (n_inputs, n, q)."""

    values: FloatArray
    slopes: FloatArray


def features(problem: LagProblem, inputs: FloatArray, blur: FloatArray) -> Features:
    """Evaluate the usable terms and undo the bend that remaining noise gives them.

    Noise of standard deviation s left in φ turns g into G g, its Gaussian average. The value
    returned is 3g - 3Gg + GGg, exact for powers up to five with the three-point
    Gauss-Hermite rule used here (nodes 0 and ±√3 s). The slope is the central difference over
    the same nodes.

    Parameters
    ----------
    problem : LagProblem
        Supplies the terms.
    inputs : ndarray of shape (n_rows, n_inputs)
        Where to evaluate.
    blur : ndarray of shape (n_inputs,)
        Standard deviation s of the noise left in each input.

    Returns
    -------
    Features
        Values and slopes of the usable terms.
    """
    n_rows, n_inputs = inputs.shape
    least = 1e-5 * np.ptp(problem.inputs, axis=0)
    least[least == 0] = 1e-5
    reach = np.sqrt(3.0) * blur
    blurred = reach > least
    steps = np.where(blurred, reach, least)
    shifts = [np.zeros(n_inputs)]
    for j in range(n_inputs):
        unit = np.eye(n_inputs)[j] * steps[j]
        shifts += [unit, -unit, 2 * unit, -2 * unit] if blurred[j] else [unit, -unit]
    # All shifts in one call: pysindy's array type costs more for each call than for each row.
    stacked = problem.terms(np.concatenate([inputs + shift for shift in shifts]))
    at = iter(stacked[:, problem.columns].reshape(len(shifts), n_rows, problem.columns.size))
    base = next(at)
    values, slopes = base.copy(), []
    for j in range(n_inputs):
        above, below = next(at), next(at)
        slopes.append((above - below) / (2 * steps[j]))
        if blurred[j]:
            once = 2 / 3 * base + (above + below) / 6
            twice = base / 2 + 2 / 9 * (above + below) + (next(at) + next(at)) / 36
            values += 2 * base - 3 * once + twice
    return Features(values, np.stack(slopes))


@dataclass(frozen=True)
class Equations:
    """The equations of the lag about one point (τ, β, estimated input noise).

    Parameters
    ----------
    whitener : Whitener
        Whitens vectors over the equations.
    residual : ndarray of shape (n_equations,)
        A e, not yet whitened.
    tau_column, bend_column : ndarray of shape (n_equations,)
        Derivatives with respect to τ and to the bend.
    raw_columns : ndarray of shape (n_equations, n_columns)
        Derivatives with respect to the coefficient of every usable term.
    slopes : ndarray of shape (n_inputs, n_rows)
        dψ'_QS/dφ along the record.
    initial : ndarray of shape (n_segments,)
        ψ' at the start of each segment.
    weighted : ndarray of shape (n_equations,)
        T⁻¹ A e.
    """

    whitener: Whitener
    residual: FloatArray
    tau_column: FloatArray
    bend_column: FloatArray
    raw_columns: FloatArray
    slopes: FloatArray
    initial: FloatArray
    weighted: FloatArray


def _discrete(values: FloatArray, later: IntArray, coefficients: HoldCoefficients) -> FloatArray:
    """Apply the input side B of the lag: c0 f[k] + c1 f[k-1]."""
    result: FloatArray = coefficients.now * values[later]
    result += coefficients.before * values[later - 1]
    return result


def equations_about(
    problem: LagProblem,
    found: Features,
    support: IntArray,
    tau: float,
    beta: FloatArray,
    input_noise: FloatArray,
    bend: float = 0.0,
) -> Equations:
    """Set up residual, derivatives and whitening about one point.

    Parameters
    ----------
    problem : LagProblem
        The data.
    found : Features
        Terms at the inputs without their estimated noise.
    support : ndarray of int
        Positions of the terms in the model.
    tau : float
        τ in seconds.
    beta : ndarray
        Coefficients of those terms.
    input_noise : ndarray of shape (n_rows, n_inputs)
        Estimated noise of the inputs.
    bend : float
        Share of the smooth-signal correction.

    Returns
    -------
    Equations
        Not yet whitened.
    """
    segments, later = problem.segments, problem.segments.later
    lag = problem.hold_at(tau)
    forcing = found.values[:, support] @ beta
    slopes = found.slopes[:, :, support] @ beta
    bent = _bend(forcing, segments)
    forcing = forcing + bend * bent
    # The residual at the measured φ, to first order about φ without its estimated noise.
    measured = forcing + (slopes * input_noise.T).sum(axis=0)
    residual = problem.output[later] - lag.pole * problem.output[later - 1]
    residual = residual - _discrete(measured, later, lag)
    whitener = Whitener(lag, slopes, problem.noise, segments)
    weighted = whitener.precision(residual)
    initial = problem.output[segments.starts].copy()
    run = whitener.equation_segments
    long = segments.lengths > 1
    # Generalised least squares for the free initial state: y[0] - E[e[0] | A e].
    initial[long] += lag.pole * problem.noise.output**2 * weighted[run.starts]
    states = simulate(forcing, segments, lag, initial)
    change = hold_sensitivities(tau, problem.sample_period_s, problem.hold)
    # The simulated ψ', not the measured one: noise in the sensitivity would bias τ.
    tau_column = change.pole * states[later - 1] + _discrete(forcing, later, change)
    columns = _discrete(found.values, later, lag)
    bend_column = _discrete(bent, later, lag)
    return Equations(
        whitener, residual, tau_column, bend_column, columns, slopes, initial, weighted
    )


def _bend(forcing: FloatArray, segments: Segments) -> FloatArray:
    """Return minus a twelfth of the second difference; 0 within three rows of a segment's ends."""
    if forcing.size < _SECOND_DIFFERENCE.size:
        return np.zeros_like(forcing)
    bent = np.convolve(forcing, -_SECOND_DIFFERENCE / 12, mode="same")
    offsets = segments.offsets()
    to_end = np.repeat(segments.lengths, segments.lengths) - 1 - offsets
    return np.where((offsets >= 3) & (to_end >= 3), bent, 0.0)


def noise_in_inputs(problem: LagProblem, eq: Equations, tau: float) -> FloatArray:
    """Return the expected noise of the inputs given the residual, -σ_φ² D Bᵀ T⁻¹ A e.

    Five standard deviations at most: a structure that is far off blames more on its inputs than
    any noise can do, and the terms would be evaluated outside their range.
    """
    lag, later = problem.hold_at(tau), problem.segments.later
    back = np.zeros(problem.output.size)
    back[later] += lag.now * eq.weighted
    back[later - 1] += lag.before * eq.weighted
    levels = problem.noise.inputs
    return np.clip((-(levels[:, None] ** 2) * eq.slopes * back).T, -5 * levels, 5 * levels)
