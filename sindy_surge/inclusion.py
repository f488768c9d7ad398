"""How often each term is chosen when blocks of the record are drawn again with replacement."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sindy_surge.lag_fit import WhiteEquations
from sindy_surge.linear_problem import unit_norms, without_nuisances
from sindy_surge.search import beam_search
from surge_core.types import FloatArray

# Weight of a block that a resample leaves out. It keeps the resampled Gram positive definite when
# a term acts in that block alone, and decides nothing: χ² changes by one part in 1e9.
_LEAST_WEIGHT = 1e-9
# The best structures about the record itself are tried in every resample.
_TRIED = 100


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
    """Return the share of resamples whose structure holds each usable term.

    Bootstrap over blocks of rows: as many as there are, from `segments.block_slices`, are drawn
    with replacement, and the choice is made again; nan if no equation lies in the blocks.

    In each resample the nuisances are projected out, and of the best structures about the whole
    record the one of least χ²/s² + penalty · size is taken, s² being the variance that all terms
    leave (not below 1). A term well above the detection limit is in every structure; one at the
    limit, where the gain in χ² is the penalty, in about half of them. The absent terms come in more
    often than in new records: the noise of the record at hand is part of what a resample takes for
    true.

    A Gram matrix squares the condition number, which reaches 1e10 between the terms. So the
    equations are first factored as Q R over all rows, the blocks are summed up as Grams of Q, which
    is orthogonal, and a resample with Gram G = L L' of Q is the regression on L' R.
    """
    n_nuisances, n_terms = equations.nuisances.shape[1], equations.columns.shape[1]
    forced = tuple(required)
    triangle, grams, sizes = _compressed_blocks(equations, blocks)
    if not len(grams):
        return np.full(n_terms, np.nan)
    linear = equations.compressed()
    ranked = sorted(
        (chi2 / linear.variance + penalty_per_term * size, support)
        for size, found in beam_search(linear, max_terms, required=forced).items()
        for chi2, support in found
    )
    tried = [support for _, support in ranked[:_TRIED]]
    counts = rng.multinomial(len(grams), np.full(len(grams), 1 / len(grams)), size=n_resamples)
    held = np.zeros(n_terms)
    for drawn in counts:
        summed = np.tensordot(drawn + _LEAST_WEIGHT, grams, axes=1)
        rows = np.linalg.cholesky(summed).T @ triangle
        n_equations = int(drawn @ sizes)
        resample = without_nuisances(
            rows[:, :n_nuisances], rows[:, n_nuisances:-1], rows[:, -1], n_equations
        )
        best = min(tried, key=lambda support: resample.score(support, penalty_per_term))
        held[list(best)] += 1
    return held / n_resamples


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
