"""How often each term, and each structure, is chosen when the surge cycles are drawn anew."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sindy_surge.lag_fit import WhiteEquations
from sindy_surge.sparse_paths import Support, beam_search
from surge_core.errors import InputError
from surge_core.types import BoolArray, FloatArray, IntArray

__all__ = ["Inclusion", "inclusion_probabilities"]


# Weight of a block that a resample leaves out. It keeps the resampled Gram positive definite when
# a term acts in that block alone, and decides nothing: χ² changes by one part in 1e9.
_LEAST_WEIGHT = 1e-9
# As in `sparse_paths.beam_search`: what is left of a unit column is rounding.
_DEPENDENT = 1e-16
_WIDTH = 16
# The best structures about the record itself are tried in every resample, beside what its own
# narrow beam finds: with twenty hinges a beam of 16 misses a cubic in every resample.
_SEEDS = 30
# Numbers held at once for all resamples of a batch: 16 MB stay near the cache.
_BATCH_NUMBERS = 2e6


@dataclass(frozen=True)
class Inclusion:
    """What resampled cycles choose.

    Parameters
    ----------
    terms : ndarray of shape (n_columns,)
        Share of the resamples whose structure holds each usable term.
    structures : tuple of (tuple of int, float)
        Every structure chosen and its share, the most frequent first.
    n_resamples : int
        Number of resamples.
    """

    terms: FloatArray
    structures: tuple[tuple[Support, float], ...]
    n_resamples: int


def inclusion_probabilities(
    equations: WhiteEquations,
    blocks: Sequence[slice],
    max_terms: int,
    *,
    penalty_per_term: float,
    n_resamples: int,
    rng: np.random.Generator,
    required: Sequence[int] = (),
) -> Inclusion:
    """Bootstrap over blocks of rows: draw as many as there are, with replacement, choose again.

    In each resample the nuisances are projected out, the best structure of every size is
    searched by a beam, and the one of least χ²/s² + penalty · size is taken, s² being the
    variance that all terms leave (not below 1). A term well above the detection limit is in
    every structure; one at the limit, where the gain in χ² is the penalty, in about half of them.
    The absent terms come in more often than in new records: the noise of the record at hand is
    part of what a resample takes for true.

    Parameters
    ----------
    equations : WhiteEquations
        The whitened equations about one fit.
    blocks : sequence of slice
        Rows of the record, from `cycles.cycle_blocks`. Their order does not matter; equations of
        rows in none of them are not used.
    max_terms : int
        Largest structure.
    penalty_per_term : float
        From `selection.information_penalty`.
    n_resamples : int
        Number of resamples.
    rng : numpy.random.Generator
        Source of the draws.
    required : sequence of int
        Terms that every structure holds.

    Returns
    -------
    Inclusion
        The shares; all nan, without structures, if no equation lies in the blocks.

    Raises
    ------
    InputError
        If no resample is asked for.

    Notes
    -----
    A Gram matrix squares the condition number, which reaches 1e10 between the terms. So the
    equations are first factored as Q R over all rows, the blocks are summed up as Grams of Q, which
    is orthogonal, and a resample with Gram G = L L' of Q is the regression on L' R.
    """
    if n_resamples < 1:
        raise InputError("n_resamples", expected="at least 1", found=str(n_resamples))
    n_terms = equations.columns.shape[1]
    forced = tuple(sorted({int(i) for i in required}))
    largest = max(min(max_terms, n_terms), len(forced), 1)
    triangle, grams, sizes = _compressed_blocks(equations, blocks)
    if not len(grams):
        return Inclusion(np.full(n_terms, np.nan), (), n_resamples)
    counts = rng.multinomial(len(grams), np.full(len(grams), 1 / len(grams)), size=n_resamples)
    batch = max(int(_BATCH_NUMBERS / (_WIDTH * max(triangle.shape[0], 1) * (n_terms + 1))), 1)
    seeds = _seeds(equations, largest, penalty_per_term, set(forced))
    chosen: list[BoolArray] = []
    for first in range(0, n_resamples, batch):
        drawn = counts[first : first + batch]
        problems = _resampled(triangle, grams, drawn, equations.nuisances.shape[1])
        freedom = np.maximum(drawn @ sizes - n_terms - 1, 1)
        beam = _Beam(problems, freedom, penalty_per_term, forced)
        for support in seeds:
            beam.consider(support)
        chosen.append(beam.run(largest))
    return _counted(np.concatenate(chosen), n_resamples)


def _seeds(
    equations: WhiteEquations, largest: int, penalty: float, required: set[int]
) -> list[Support]:
    """Return the best structures of the record as it is."""
    linear = equations.compressed()
    ranked = [
        (chi2 / linear.variance + penalty * size, support)
        for size, found in beam_search(linear, largest).items()
        for chi2, support in found
        if required <= set(support)
    ]
    return [support for _, support in sorted(ranked)[:_SEEDS]]


def _counted(members: BoolArray, n_resamples: int) -> Inclusion:
    supports = [tuple(np.flatnonzero(row).tolist()) for row in members]
    ranked = sorted(Counter(supports).items(), key=lambda item: (-item[1], len(item[0]), item[0]))
    structures = tuple((support, number / n_resamples) for support, number in ranked)
    return Inclusion(members.mean(axis=0), structures, n_resamples)


def _compressed_blocks(
    equations: WhiteEquations, blocks: Sequence[slice]
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return R, the Gram of Q in each block that has equations, and their number there."""
    ordered = sorted(blocks, key=lambda block: block.start)
    used = [
        slice(*np.searchsorted(equations.rows, (block.start, block.stop)).tolist())
        for block in ordered
    ]
    used = [rows for rows in used if rows.stop > rows.start]
    stacked = np.column_stack((equations.nuisances, equations.columns, equations.target))
    norms = np.linalg.norm(stacked, axis=0)
    norms[norms == 0] = 1.0
    orthogonal, triangle = np.linalg.qr(stacked / norms)
    # The target keeps its size: χ² is in units of the noise.
    triangle[:, -1] *= norms[-1]
    grams = np.array([orthogonal[rows].T @ orthogonal[rows] for rows in used])
    return triangle, grams, np.array([rows.stop - rows.start for rows in used], dtype=np.int64)


@dataclass(frozen=True)
class _Problems:
    """The compressed regressions of a batch: columns (b, m, q), target (b, m), outside (b,)."""

    columns: FloatArray
    target: FloatArray
    outside: FloatArray


def _resampled(
    triangle: FloatArray, grams: FloatArray, counts: IntArray, n_nuisances: int
) -> _Problems:
    weights = counts + _LEAST_WEIGHT
    size = triangle.shape[0]
    summed = (weights @ grams.reshape(len(grams), -1)).reshape(-1, size, size)
    roots = np.swapaxes(np.linalg.cholesky(summed), 1, 2)
    reduced = np.asarray(np.linalg.qr(roots @ triangle, mode="r"))[:, n_nuisances:, n_nuisances:]
    columns, target = reduced[:, :, :-1], reduced[:, :, -1]
    rank = min(columns.shape[1:])
    norms = np.linalg.norm(columns, axis=1)
    # Projecting the nuisances out shortens a column that they can stand in for.
    norms[norms < 1e-12] = 1.0
    return _Problems(
        columns[:, :rank] / norms[:, None],
        target[:, :rank],
        np.sum(target[:, rank:] ** 2, axis=1),
    )


class _Beam:
    """A beam search for all resamples of a batch at once.

    `rest` holds, for every resample and every support in its beam, the columns and the target with
    the terms of that support projected out.
    """

    def __init__(
        self, problems: _Problems, freedom: IntArray, penalty: float, required: Support
    ) -> None:
        n, _, n_terms = problems.columns.shape
        self.problems = problems
        self.outside = problems.outside
        self.variance = np.maximum(problems.outside / freedom, 1.0)
        self.penalty = penalty
        stacked = np.concatenate((problems.columns, problems.target[:, :, None]), axis=2)
        self.rest = stacked[:, None]
        self.members = np.zeros((n, 1, n_terms), dtype=bool)
        # Supports are told apart by sums of random numbers, one for each term.
        self.marks = np.random.default_rng(0).integers(1, 2**56, n_terms)
        self.active = np.arange(n)
        self.best = np.zeros((n, n_terms), dtype=bool)
        self.best_score = np.full(n, np.inf)
        for term in required:
            self._project(np.zeros((n, 1), dtype=np.intp), np.full((n, 1), term))
        self.size = len(required)
        if required:
            self._note()

    def consider(self, support: Support) -> None:
        """Keep one given structure where it beats what is known so far; before `run`."""
        target = self.problems.target
        basis, _ = np.linalg.qr(self.problems.columns[:, :, list(support)])
        explained = np.sum(np.matmul(target[:, None, :], basis) ** 2, axis=(1, 2))
        chi2 = np.sum(target**2, axis=1) - explained + self.outside
        score = chi2 / self.variance + self.penalty * len(support)
        better = score < self.best_score
        self.best_score[better] = score[better]
        self.best[better] = np.isin(np.arange(self.best.shape[1]), support)

    def run(self, largest: int) -> BoolArray:
        """Return the members (b, q) of the best structure of each resample."""
        while self.size < largest and self.active.size:
            parents, terms = self._additions()
            if not parents.size:
                break
            self._project(parents, terms)
            self.size += 1
            self._note()
            self._retire()
        return self.best

    def _additions(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return the parents and the terms (b, width) of the best supports one term larger."""
        columns, target = self.rest[..., :-1], self.rest[..., -1]
        lengths = np.einsum("bwpq,bwpq->bwq", columns, columns)
        products = np.matmul(target[:, :, None, :], columns)[:, :, 0, :]
        usable = (lengths > _DEPENDENT) & ~self.members
        gains = np.where(usable, products**2 / np.where(usable, lengths, 1.0), -np.inf)
        chi2 = np.einsum("bwp,bwp->bw", target, target)
        scores = (chi2[:, :, None] - gains).reshape(len(gains), -1)
        marks = (self.members @ self.marks)[:, :, None] + self.marks
        scores = _without_doubles(scores, marks.reshape(scores.shape))
        # One width for all resamples: what is beyond the supports of one has infinite scores.
        width = min(_WIDTH, int(np.isfinite(scores).sum(axis=1).min()))
        picked = np.argpartition(scores, max(width - 1, 0), axis=1)[:, :width]
        parents, terms = np.divmod(picked, self.members.shape[2])
        return parents, terms

    def _project(self, parents: NDArray[np.intp], terms: NDArray[np.intp]) -> None:
        """Move on to the given supports: project the added term out of everything left."""
        rows = np.arange(len(self.rest))[:, None]
        fresh = self.rest[rows, parents, :, terms]
        lengths = np.linalg.norm(fresh, axis=2, keepdims=True)
        # A required term that depends on the others adds nothing.
        fresh = np.where(lengths**2 > _DEPENDENT, fresh, 0.0) / np.maximum(lengths, 1e-300)
        rest = self.rest[rows, parents]
        rest -= fresh[..., None] * np.matmul(fresh[:, :, None, :], rest)
        self.rest = rest
        self.members = self.members[rows, parents]
        np.put_along_axis(self.members, terms[:, :, None], True, axis=2)

    def _note(self) -> None:
        """Keep the best support of this size where it beats the smaller ones."""
        chi2 = np.einsum("bwp,bwp->bw", self.rest[..., -1], self.rest[..., -1])
        first = np.argmin(chi2, axis=1)
        each = np.arange(first.size)
        score = (chi2[each, first] + self.outside) / self.variance + self.penalty * self.size
        better = score < self.best_score[self.active]
        self.best_score[self.active[better]] = score[better]
        self.best[self.active[better]] = self.members[each, first][better]

    def _retire(self) -> None:
        """Drop the resamples in which even a perfect larger structure would score worse."""
        reachable = self.outside / self.variance + self.penalty * (self.size + 1)
        going = reachable < self.best_score[self.active]
        if not going.all():
            self.rest, self.members = self.rest[going], self.members[going]
            self.outside, self.variance = self.outside[going], self.variance[going]
            self.active = self.active[going]


def _without_doubles(scores: FloatArray, marks: IntArray) -> FloatArray:
    """Set the scores of all but one of each equal mark in a row to infinity."""
    # What cannot be taken must not stand for its double: its mark becomes its own.
    marks = np.where(np.isfinite(scores), marks, -1 - np.arange(scores.shape[1]))
    order = np.argsort(marks, axis=1)
    ordered = np.take_along_axis(marks, order, axis=1)
    again = np.zeros(scores.shape, dtype=bool)
    np.put_along_axis(again, order[:, 1:], ordered[:, 1:] == ordered[:, :-1], axis=1)
    return np.where(again, np.inf, scores)
