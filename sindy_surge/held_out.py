"""Terms judged by what is left out, where the error of the model is what the fit leaves.

They are fitted in the weak form: sliding test functions instead of a derivative of noisy data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from sindy_surge.constraints import Constraints
from sindy_surge.lag_problem import LagProblem
from sindy_surge.linear_problem import (
    LinearProblem,
    Support,
    least_squares,
    unit_norms,
    without_nuisances,
)
from sindy_surge.preparation import Prepared
from sindy_surge.search import proposals
from sindy_surge.segments import Segments, block_slices
from sindy_surge.selection import PathRow
from surge_core.leave_out import leave_out, scatter
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
    segments: Segments, time_constant_s: float, sample_period_s: float
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


# A characteristic in stall falls, turns and rises: a cubic (Moore & Greitzer 1986) is the
# most that is asked of a polynomial when the data cannot tell a term from an error.
_HIGHEST_DEGREE = 3
_MOST_SPECIAL = 24
# With fewer, a scatter over blocks says nothing.
_FEWEST_BLOCKS = 3
# Variance of what all terms leave over that of the noise which fourth differences show. An
# autoregression of first order has 3.5/(1 - a²): 16 for a = 0.9, 88 for a = 0.98, which is a noise
# that lasts 50 samples. What exceeds this is smoother than a sensor's noise: on reduced records
# of the simulated rig it was 2e4 to 1e5, for noise alone behind their 48 Hz filter 200 to 400.
_MOST_EXCESS = 100.0
# About an error that comes again in every cycle, one cycle is all the data there is. A surge
# cycle of 130 ms holds four test functions of 2 τ = 32 ms (equivalent width 1.1 half widths).
_EQUATIONS_IN_CYCLE = 4.0
# With so few the extended BIC takes a term picked out of p = 20 when the mean square error
# falls to exp(-(ln 4 + 3 ln p)/4) = 0.07: about a tenth.
_SHARE_LEFT = 0.1
# A straight line alone is no ladder: such a library means to be piecewise linear.
_FEWEST_RUNGS = 2


class Equations(Protocol):
    """What structures are tried on."""

    def fit(self, support: Support) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return parameters with τ last, derivatives of the fitted values, and the residual."""


@dataclass
class Trials:
    """Held-out errors of the structures tried."""

    equations: Equations  # What is fitted
    # What is left out in turn: the equations that any row of a block enters, and those on which the
    # fit without them is scored
    blocks: list[tuple[IndexArray, IndexArray]]
    # A block that holds more than this share of the information on some parameter is not scored:
    # without it the parameter would be a guess. From 0 to 1; 1 scores all
    most_leverage: float = 1.0
    # Mean square error of each block's equations, NaN where not scored, by structure
    errors: dict[Support, FloatArray] = field(default_factory=dict)
    lags: dict[Support, float] = field(default_factory=dict)  # τ in seconds, by structure

    def error(self, support: Support) -> FloatArray:
        """Return the mean square error of each block's equations, fitted without that block."""
        if support not in self.errors:
            parameters, design, residual = self.equations.fit(support)
            moves, _ = leave_out(-design, residual, [touched for touched, _ in self.blocks])
            own_errors = np.empty(len(self.blocks))
            for number, (touched, own) in enumerate(self.blocks):
                error = residual[own] - design[own] @ moves[number]
                own_errors[number] = np.mean(error**2)
                if self.most_leverage < 1.0 and _leverage(design, touched) > self.most_leverage:
                    own_errors[number] = np.nan
            self.lags[support], self.errors[support] = float(parameters[-1]), own_errors
        return self.errors[support]

    def pair(self, one: Support, other: Support) -> tuple[FloatArray, FloatArray]:
        """Return the errors of two structures on the blocks that are scored for both."""
        first, second = self.error(one), self.error(other)
        both = np.isfinite(first) & np.isfinite(second)
        return first[both], second[both]

    def mean(self, support: Support) -> float:
        """Return the mean over the blocks that are scored."""
        known = self.error(support)
        known = known[np.isfinite(known)]
        return float(np.mean(known)) if known.size else float("nan")


def _leverage(design: FloatArray, rows: IndexArray) -> float:
    """Return the largest share of the information on any parameter that some rows hold."""
    basis, values, _ = np.linalg.svd(design / unit_norms(design), full_matrices=False)
    within = basis[np.ix_(rows, values > 1e-10 * values[0])]
    return float(np.linalg.norm(within, 2) ** 2)


def polynomial_ladder(degrees: Sequence[int | None], max_terms: int) -> list[Support]:
    """Return the complete polynomials from degree 1 up to a cubic, smallest first.

    By the total degree of each usable term, None for one that is no polynomial.
    """
    known = [degree for degree in degrees if degree is not None]
    if not {0, 1} <= set(known):
        return []
    rungs = [
        tuple(i for i, degree in enumerate(degrees) if degree is not None and degree <= top)
        for top in range(1, min(max(known), _HIGHEST_DEGREE) + 1)
    ]
    return [rung for rung in dict.fromkeys(rungs) if len(rung) <= max_terms]


def best_of_each_size(linear: LinearProblem, proposed: list[Support]) -> list[Support]:
    """Return the structure of least χ² of every size, smallest first."""
    best: dict[int, Support] = {}
    for support in sorted(proposed, key=linear.chi2):
        best.setdefault(len(support), support)
    return [best[size] for size in sorted(best)]


def climb(trials: Trials, ladder: list[Support]) -> Support:
    """Go up a ladder of structures as long as that pays on what is left out."""
    chosen = ladder[0]
    for rung in ladder[1:]:
        if pays(trials, chosen, rung):
            chosen = rung
    trials.error(chosen)
    return chosen


def pays(trials: Trials, one: Support, other: Support) -> bool:
    """Return whether the other leaves less by more than a standard error of the differences."""
    before, after = trials.pair(one, other)
    gain = before - after
    if gain.size < _FEWEST_BLOCKS:
        return False
    return bool(gain.mean() > gain.std(ddof=1) / np.sqrt(gain.size))


def special_structures(
    trials: Trials,
    linear: LinearProblem,
    proposed: list[Support],
    chosen: Support,
    ladder: list[Support],
    share_left: float,
) -> dict[Support, float]:
    """Return the structures off the ladder, and no larger, that leave little of the error.

    With the share each leaves of the held-out error of the chosen one, below `share_left`.
    """
    largest = max(len(rung) for rung in ladder)
    others = [s for s in proposed if s not in ladder and len(s) <= largest]
    found = {}
    for support in sorted(others, key=linear.chi2)[:_MOST_SPECIAL]:
        own, reference = trials.pair(support, chosen)
        if own.size >= _FEWEST_BLOCKS and own.mean() / reference.mean() < share_left:
            found[support] = float(own.mean() / reference.mean())
    return found


def with_held_out(
    path: Sequence[PathRow], trials: Trials, chosen: Support, names: Sequence[str]
) -> tuple[PathRow, ...]:
    """Add the structures tried on rows left out, with their rms there, to a table."""
    rows = {row.terms: replace(row, chosen=False, consistent=False) for row in path}
    for support, tau in trials.lags.items():
        terms = tuple(names[i] for i in support)
        none = PathRow(len(support), terms, np.nan, np.nan, np.nan, False, False)
        rows[terms] = replace(
            rows.get(terms, none),
            time_constant_s=tau,
            chosen=support == chosen,
            held_out_rms=trials.mean(support) ** 0.5,
        )

    def order(row: PathRow) -> tuple[int, float]:
        return row.size, row.held_out_rms if np.isfinite(row.held_out_rms) else np.inf

    return tuple(sorted(rows.values(), key=order))


def model_error_dominates(prepared: Prepared, consistent: bool) -> bool:
    """Return whether what the terms leave is an error of the model rather than noise.

    True if even all terms leave more than 100 times the variance of the noise, or if no
    structure stands against all others (`consistent`) and all terms leave a coloured rest. With a
    white rest it is the number of terms allowed that no structure fits in.
    """
    coloured = prepared.problem.noise.colour.size > 0
    return prepared.excess > _MOST_EXCESS or (not consistent and coloured)


def select_by_held_out(
    problem: LagProblem, optimizer: Any, max_terms: int, constraints: Constraints
) -> tuple[Support, FloatArray, FloatArray, Trials] | None:
    """Choose the degree of a polynomial by cycles left out and fit it in the weak form.

    Where the model is wrong, its error comes again in every cycle. Cycles left out then do not
    tell a term from that error: by any one-standard-error rule over the whole library, four to
    six terms were chosen on records of the simulated rig, and the curve was off by 0.5 to 2.
    So polynomials are taken complete, all powers up to a degree (a complete polynomial
    stays one when φ is shifted by an offset of its probes). The degree is raised as long as
    that lowers the error on cycles left out by more than one standard error of the paired
    differences, and another structure, no larger than a cubic, is taken only if it leaves a tenth
    of the error.

    The weak form with a half width of two time constants passes over the ends of the
    segments and the fast part of the error, both of which a free run or a one-step fit
    takes for dynamics.

    Returned are the terms, β in physical units with τ in seconds last, their covariance, and each
    structure tried. None if the segments are too short for the weak form, or no lag comes out.
    """
    weak = WeakEquations.of(problem)
    if weak is None:
        return None
    trials = Trials(weak, _blocks(problem, weak))
    if len(trials.blocks) < _FEWEST_BLOCKS or weak.signal.size < 2 * max_terms + 2:
        return None
    linear = weak.linear()
    # Terms with ψ' have no part in the weak form.
    required = tuple(i for i in constraints.required if i < linear.columns.shape[1])

    def admitted(support: Support) -> bool:
        held = set(required) <= set(support)
        return held and constraints.allow(support, weak.fit(support)[0][:-1])

    proposed = [s for s in proposals(linear, optimizer, max_terms, required) if admitted(s)]
    ladder = [s for s in polynomial_ladder(problem.degrees, max_terms) if admitted(s)]
    if len(ladder) < _FEWEST_RUNGS:
        ladder = best_of_each_size(linear, proposed)
    if not ladder:
        return None
    chosen = climb(trials, ladder)
    special = special_structures(trials, linear, proposed, chosen, ladder, _SHARE_LEFT)
    # The smallest: an error that every cycle repeats rewards each further term.
    chosen = min(special, key=lambda s: (len(s), special[s]), default=chosen)
    if not problem.shortest_lag_s < trials.lags[chosen] < problem.longest_lag_s:
        return None
    parameters, design, residual = weak.fit(chosen)
    moves, _ = leave_out(-design, residual, [own for _, own in trials.blocks])
    covariance = scatter(moves)
    covariance += _beyond_cycles(problem, weak, chosen, design, residual)
    return chosen, parameters, covariance, trials


def _blocks(problem: LagProblem, weak: WeakEquations) -> list[tuple[IndexArray, IndexArray]]:
    """Return the blocks to leave out, each scored on the equations centred in it."""
    centres, reach = weak.centres, weak.half_width
    blocks = []
    for rows in block_slices(problem.segments, 2 * reach + 1):
        own = np.flatnonzero((centres >= rows.start) & (centres < rows.stop))
        touched = (centres > rows.start - reach) & (centres < rows.stop - 1 + reach)
        if own.size:
            blocks.append((np.flatnonzero(touched), own))
    return blocks


def _beyond_cycles(
    problem: LagProblem, weak: WeakEquations, support: Support, design: FloatArray, rest: FloatArray
) -> FloatArray:
    """Return the covariance of what no cycle left out shows.

    Cycles that repeat an error agree about it, and their scatter says nothing of its size: its
    information is that of one cycle, however many there are. And a true model gives one answer for
    every test function and either direction of the regression; the mean square of the two shifts,
    to the other direction and to a narrower function, is what a wrong one adds.
    """
    norms = unit_norms(design)
    scaled = design / norms
    inverse = np.linalg.pinv(scaled.T @ scaled, hermitian=True) / np.outer(norms, norms)
    others = [weak.fit_forward(support)]
    narrow = round(weak.half_width / np.sqrt(2.0))
    narrower = WeakEquations.of(problem, narrow) if narrow >= MIN_HALF_WIDTH else None
    if narrower is not None:
        others.append(narrower.fit(support)[0])
    parameters = weak.fit(support)[0]
    shifts = np.array([other - parameters for other in others if other is not None])
    shifts = shifts.reshape(-1, parameters.size)
    repeated = float(rest @ rest) / _EQUATIONS_IN_CYCLE * inverse
    return np.asarray(repeated + shifts.T @ shifts / max(len(shifts), 1))
