"""How often each term is chosen when blocks of the record are drawn again with replacement."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sindy_surge.lag_fit import WhiteEquations
from sindy_surge.linear_problem import LinearProblem, Support, unit_norms, without_nuisances
from sindy_surge.sparse_paths import beam_search
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["inclusion_probabilities"]


# Weight of a block that a resample leaves out. It keeps the resampled Gram positive definite when
# a term acts in that block alone, and decides nothing: χ² changes by one part in 1e9.
_LEAST_WEIGHT = 1e-9
_WIDTH = 16
# The best structures about the record itself are tried in every resample, beside what its own
# narrow beam finds: with twenty hinges a beam of 16 misses a cubic in every resample.
_SEEDS = 30


def inclusion_probabilities(
    equations: WhiteEquations,
    blocks: Sequence[slice],
    max_terms: int,
    *,
    penalty_per_term: float,
    n_resamples: int,
    rng: np.random.Generator,
    required: Sequence[int] = (),
) -> FloatArray:
    """Bootstrap over blocks of rows: draw as many as there are, with replacement, choose again.

    In each resample the nuisances are projected out, the best structure of every size is
    searched by a beam, and the one of least χ²/s² + penalty · size is taken, s² being the
    variance that all terms leave (not below 1). A term well above the detection limit is in
    every structure; one at the limit, where the gain in χ² is the penalty, in about half of them.
    The absent terms come in more often than in new records: the noise of the record at hand is
    part of what a resample takes for true.

    Parameters
    ----------
    blocks : sequence of slice
        Rows of the record, from `segments.block_slices`. Their order does not matter; equations of
        rows in none of them are not used.

    Returns
    -------
    ndarray of shape (n_columns,)
        Share of the resamples whose structure holds each usable term; nan if no equation lies in
        the blocks.

    Notes
    -----
    A Gram matrix squares the condition number, which reaches 1e10 between the terms. So the
    equations are first factored as Q R over all rows, the blocks are summed up as Grams of Q, which
    is orthogonal, and a resample with Gram G = L L' of Q is the regression on L' R.
    """
    if n_resamples < 1:
        raise InputError("n_resamples", expected="at least 1", found=str(n_resamples))
    n_nuisances, n_terms = equations.nuisances.shape[1], equations.columns.shape[1]
    forced = tuple(sorted({int(i) for i in required}))
    largest = max(min(max_terms, n_terms), len(forced), 1)
    triangle, grams, sizes = _compressed_blocks(equations, blocks)
    if not len(grams):
        return np.full(n_terms, np.nan)
    linear = equations.compressed()
    ranked = sorted(
        (chi2 / linear.variance + penalty_per_term * size, support)
        for size, found in beam_search(linear, largest, required=forced).items()
        for chi2, support in found
    )
    seeds = sorted((support for _, support in ranked[:_SEEDS]), key=len)
    counts = rng.multinomial(len(grams), np.full(len(grams), 1 / len(grams)), size=n_resamples)
    held = np.zeros(n_terms)
    for drawn in counts:
        summed = np.tensordot(drawn + _LEAST_WEIGHT, grams, axes=1)
        rows = np.linalg.cholesky(summed).T @ triangle
        n_equations = int(drawn @ sizes)
        resample = without_nuisances(
            rows[:, :n_nuisances], rows[:, n_nuisances:-1], rows[:, -1], n_equations
        )
        held[list(_best(resample, seeds, largest, penalty_per_term, forced))] += 1
    return held / n_resamples


def _best(
    linear: LinearProblem, seeds: Sequence[Support], largest: int, penalty: float, required: Support
) -> Support:
    """Return the best of some structures and of those that a narrow beam finds."""
    floor = linear.outside / linear.variance
    best: tuple[float, Support] = (np.inf, ())
    for support in seeds:
        # Even with nothing left to explain a structure pays for its terms.
        if floor + penalty * len(support) < best[0]:
            score = linear.score(support, penalty)
            best = min(best, (score, support))
    if np.isfinite(best[0]):
        largest = min(largest, max(int((best[0] - floor) / penalty), len(required), 1))
    found = beam_search(linear, largest, _WIDTH, required)
    leading = [ranked[0] for ranked in found.values()]
    scored = [(chi2 / linear.variance + penalty * len(s), s) for chi2, s in leading]
    return min([best, *scored])[1]


def _compressed_blocks(
    equations: WhiteEquations, blocks: Sequence[slice]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return R, the Gram of Q in each block that has equations, and their number there."""
    ordered = sorted(blocks, key=lambda block: block.start)
    used = [
        slice(*np.searchsorted(equations.rows, (block.start, block.stop)).tolist())
        for block in ordered
    ]
    used = [rows for rows in used if rows.stop > rows.start]
    stacked = np.column_stack((equations.nuisances, equations.columns, equations.target))
    norms = unit_norms(stacked)
    orthogonal, triangle = np.linalg.qr(stacked / norms)
    # The target keeps its size: χ² is in units of the noise.
    triangle[:, -1] *= norms[-1]
    grams = np.array([orthogonal[rows].T @ orthogonal[rows] for rows in used])
    return triangle, grams, np.array([rows.stop - rows.start for rows in used], dtype=np.float64)
