"""Weak form of the lag: sliding test functions instead of a derivative of noisy data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sindy_surge.lag_problem import LagProblem
from sindy_surge.linear_problem import LinearProblem, Support, least_squares, without_nuisances
from sindy_surge.segments import Segments
from surge_core.types import FloatArray, IndexArray

# Below 4 samples the trapezoid sums of (1 - z²)⁴ and of its slope are no longer accurate.
MIN_HALF_WIDTH = 4
# Exponent of the test function: three derivatives vanish at its ends.
_EXPONENT = 4
# 2 τ lies between the 1.5 and 3 τ within which the study found no bias (30-50 ms at 18 ms).
_HALF_WIDTH_IN_TAU = 2.0
# τ in samples with which the search for a width begins.
_FIRST_GUESS = 20


def half_width_samples(
    segments: Segments,
    time_constant_s: float,
    sample_period_s: float,
) -> int | None:
    """Return the half width in samples: 2 τ, never more than the segments allow.

    Half of the rows must lie in segments that hold at least one whole test function; with segments
    too short for a half width of 4 samples the answer is None.
    """
    lengths = np.sort(segments.lengths)[::-1]
    # The longest width that still leaves half of all rows in segments long enough.
    longest = int(lengths[np.searchsorted(np.cumsum(lengths), lengths.sum() / 2)])
    # Twice as many rows as one test function spans, so that it can slide.
    room = (longest - 1) // 4 if longest > 8 * MIN_HALF_WIDTH else (longest - 1) // 2
    wanted = _HALF_WIDTH_IN_TAU * time_constant_s / sample_period_s
    width = int(min(max(round(min(wanted, 1e9)), MIN_HALF_WIDTH), room))
    return width if width >= MIN_HALF_WIDTH else None


def _test_function(half_width: int, sample_period_s: float) -> tuple[FloatArray, FloatArray]:
    """Return w, of sum one, and dw/dt in 1/s over its 2 m + 1 samples."""
    z = np.arange(-half_width, half_width + 1) / half_width
    weight = (1 - z**2) ** _EXPONENT
    slope = -2 * _EXPONENT * z * (1 - z**2) ** (_EXPONENT - 1) / (half_width * sample_period_s)
    return weight / weight.sum(), slope / weight.sum()


@dataclass(frozen=True)
class WeakEquations:
    """Weak equations ψ' = -τ dψ'/dt + Σ β_i s_i: sums against sliding w(z) = (1 - z²)⁴.

    By parts, ∫ w (dψ'/dt) dt = -∫ (dw/dt) ψ' dt, so nothing is differentiated. The terms are
    built from the raw φ and integrated with the very same w; smoothing φ first would not
    commute with its powers. A test function starts every quarter of a half width; segments
    shorter than one give no equation.
    """

    derivative: FloatArray  # (n_weak,): Weak dψ'/dt (1/s) and ψ'
    signal: FloatArray
    columns: FloatArray  # (n_weak, n_columns): Weak terms
    centres: IndexArray  # (n_weak,): Row at the middle of each test function
    half_width: int  # Half width m in samples

    @classmethod
    def integrate(
        cls,
        y: FloatArray,
        terms: FloatArray,
        segments: Segments,
        half_width: int,
        sample_period_s: float,
    ) -> WeakEquations:
        """Integrate ψ' (n_rows,) and terms (n_rows, n_terms) against the test functions."""
        weight, slope = _test_function(half_width, sample_period_s)
        stride, width = max(1, half_width // 4), 2 * half_width + 1
        stacked = np.column_stack((y, terms))
        parts, centres = [np.empty((0, stacked.shape[1] + 1))], [np.empty(0, dtype=np.intp)]
        for rows in segments.slices():
            if rows.stop - rows.start >= width:
                seen = np.lib.stride_tricks.sliding_window_view(stacked[rows], width, axis=0)
                seen = seen[::stride]
                parts.append(np.column_stack((-(seen[:, 0] @ slope), seen @ weight)))
                centres.append(rows.start + half_width + stride * np.arange(len(seen)))
        every = np.concatenate(parts)
        places = np.concatenate(centres)
        return cls(every[:, 0], every[:, 1], every[:, 2:], places, half_width)

    @classmethod
    def of(cls, problem: LagProblem, half_width: int | None = None) -> WeakEquations | None:
        """Set up the equations of a record; None takes a half width of two time constants.

        None also if the segments are too short for a test function, or no lag shows.
        """
        # Terms with ψ' need a simulated ψ', of which the weak form has none.
        without = problem.columns[: problem.n_without_state].tolist()
        values = problem.late(problem.terms(problem.inputs, wanted=without))
        segments, period = problem.segments, problem.sample_period_s
        if half_width is None:
            # The first terms of a library are its simplest; with all of them τ drifts up.
            half_width = _half_width(problem.output, values[:, :3], segments, period)
            if half_width is None:
                return None
        return cls.integrate(problem.output, values, segments, half_width, period)

    def fit(self, support: Support) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Regress ψ' on dψ'/dt and some terms: β with τ in seconds last, the design, what is left.

        dψ'/dt stands on the right, so that what is left is an error of ψ'. Put the other way round,
        τ came out 5 to 20 ms too high on records of the simulated rig.
        """
        design = np.column_stack((self.columns[:, list(support)], -self.derivative))
        parameters = least_squares(design, self.signal)
        return parameters, design, self.signal - design @ parameters

    def fit_forward(self, support: Support) -> FloatArray | None:
        """Return (β, τ) from regressing dψ'/dt; None if τ is not positive."""
        design = np.column_stack((self.columns[:, list(support)], -self.signal))
        solution = least_squares(design, self.derivative)
        if not solution[-1] > 0:
            return None
        parameters: FloatArray = np.append(solution[:-1], 1.0) / solution[-1]
        return parameters

    def linear(self) -> LinearProblem:
        """Return the regression on all terms, τ projected out, for the optimizers."""
        return without_nuisances(self.derivative[:, None], self.columns, self.signal)


def _half_width(
    y: FloatArray, terms: FloatArray, segments: Segments, sample_period_s: float
) -> int | None:
    """Return a half width of about 2 τ in samples, τ by weak regression on a few terms.

    None if the segments are too short or no lag shows.
    """
    guess = _FIRST_GUESS * sample_period_s
    result: int | None = None
    for _ in range(2):
        width = half_width_samples(segments, guess, sample_period_s)
        if width is None:
            return None
        weak = WeakEquations.integrate(y, terms, segments, width, sample_period_s)
        every = tuple(range(terms.shape[1]))
        if weak.signal.size < len(every) + 3:
            return result
        guess = float(weak.fit(every)[0][-1])
        if weak.fit_forward(every) is None or not guess > 0:
            return result
        result = width
    return result
