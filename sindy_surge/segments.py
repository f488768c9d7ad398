"""Runs of rows, the surge cycles that φ shows in them, and blocks of rows to leave out or draw."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from surge_core.errors import InputError
from surge_core.leave_out import block_edges
from surge_core.segments import runs_of
from surge_core.types import FloatArray, IndexArray

__all__ = ["Segments", "block_slices", "cycle_blocks", "surge_period_s"]


# The range of φ without spikes. The band of the hysteresis is its middle third: about a standard
# deviation of a surge wave, more than rotating stall and noise make from peak to peak.
_RANGE = (0.02, 0.98)
_BAND = 1 / 3
# Surge repeats: of cycles that wander from 5 to 7 Hz all lie within 20 % of their median. The
# crossings of a random excitation spread over a decade, and 30-60 % of them lie within 30 %.
_NEAR_MEDIAN = 0.3
_SHARE_NEAR = 0.75
# With fewer rows within cycles, what was seen is flutter about the band.
_LEAST_COVERED = 0.05
_MOST_BLOCKS = 60


@dataclass(frozen=True)
class Segments:
    """Contiguous runs of rows, between which no equation is formed.

    Parameters
    ----------
    starts : ndarray of shape (n_segments,)
        First row of each segment.
    stops : ndarray of shape (n_segments,)
        One past the last row of each segment.
    """

    starts: IndexArray
    stops: IndexArray

    @classmethod
    def from_labels(cls, labels: ArrayLike | None, n_rows: int) -> Segments:
        """Cut the rows wherever the label changes.

        Parameters
        ----------
        labels : array-like of shape (n_rows,) or None
            Integer label of each row; None makes all rows one segment.
        n_rows : int
            Number of rows.

        Raises
        ------
        InputError
            If the labels are not one integer a row.
        """
        values = np.zeros(n_rows) if labels is None else np.asarray(labels)
        number = np.issubdtype(values.dtype, np.number)
        if not (number and np.all(np.isfinite(values)) and np.all(values == np.round(values))):
            raise InputError(
                "segments",
                expected="integer labels",
                found=f"values of type {values.dtype}",
                remedy="number the intervals 1, 2, …",
            )
        runs = runs_of(labels, n_rows)
        return cls(
            np.array([run.start for run in runs], dtype=np.intp),
            np.array([run.stop for run in runs], dtype=np.intp),
        )

    @property
    def lengths(self) -> IndexArray:
        """Number of rows in each segment."""
        return self.stops - self.starts

    @property
    def n_rows(self) -> int:
        """Number of rows in all segments together."""
        return int(self.stops[-1]) if self.stops.size else 0

    @property
    def later(self) -> IndexArray:
        """Rows that have a predecessor in their own segment: one equation each."""
        keep = np.ones(self.n_rows, dtype=bool)
        keep[self.starts] = False
        return np.flatnonzero(keep)

    def slices(self) -> list[slice]:
        """Return the rows of each segment."""
        return [slice(int(a), int(b)) for a, b in zip(self.starts, self.stops, strict=True)]

    def offsets(self) -> IndexArray:
        """Return the number of samples since the start of the row's own segment."""
        return np.arange(self.n_rows) - np.repeat(self.starts, self.lengths)

    def within(self, rows: IndexArray) -> IndexArray:
        """Return rows moved to the first or last of the segment of their place in the array."""
        last = np.repeat(self.stops, self.lengths) - 1
        return np.clip(rows, np.repeat(self.starts, self.lengths), last)


def block_slices(segments: Segments, shortest: int) -> list[slice]:
    """Cut rows into blocks for leaving out; see `surge_core.leave_out.block_edges`."""
    blocks = []
    inner = block_edges(segments.lengths, shortest)
    for rows, cuts in zip(segments.slices(), inner, strict=True):
        edges = [rows.start, *(rows.start + cuts).tolist(), rows.stop]
        blocks += [slice(low, high) for low, high in pairwise(edges)]
    return blocks


def surge_period_s(phi: FloatArray, segments: Segments, sample_period_s: float) -> float | None:
    """Return the median period in seconds of the surge cycles that φ, of shape (n_rows,), shows.

    A cycle runs from one rise of φ through the middle third of its range to the next in the same
    segment. None if no two are seen, or what is seen does not repeat (a random excitation).
    """
    samples = _period(_rises(phi, segments), segments)
    return None if samples is None else samples * sample_period_s


def cycle_blocks(phi: FloatArray, segments: Segments, shortest: int) -> list[slice]:
    """Cut the rows at whole surge cycles, for resampling or leaving out.

    Segments without a whole cycle stay whole; what shows no cycle for longer than two periods is
    cut evenly into about one period each; a piece of fewer than `shortest` rows is joined to its
    neighbour. Beyond sixty blocks, adjacent ones of a segment are joined. Without cycles the
    blocks are those of `block_slices`.
    """
    rises = _rises(phi, segments)
    period = _period(rises, segments)
    if period is None:
        return block_slices(segments, shortest)
    edges = []
    for rows in segments.slices():
        inside = rises[(rises > rows.start) & (rises < rows.stop)]
        cuts = inside.tolist() if inside.size > 1 else []
        edges.append(_cut([rows.start, *cuts, rows.stop], period, shortest))
    together = -(-sum(len(e) - 1 for e in edges) // _MOST_BLOCKS)
    blocks = []
    for own in edges:
        # Join so many adjacent pieces, evenly over the segment.
        parts = -(-(len(own) - 1) // together)
        kept = np.linspace(0, len(own) - 1, parts + 1).round().astype(int)
        blocks += [slice(own[a], own[b]) for a, b in pairwise(kept.tolist())]
    return blocks


def _rises(phi: FloatArray, segments: Segments) -> IndexArray:
    """Return the rows at which φ leaves the band upwards, having come from below it."""
    low, high = np.quantile(phi, _RANGE)
    middle, half = (low + high) / 2, _BAND * (high - low) / 2
    side = (phi > middle + half).astype(int) - (phi < middle - half).astype(int)
    outside = np.flatnonzero(side)
    home = _home(outside, segments)
    risen = (side[outside[1:]] > side[outside[:-1]]) & (home[1:] == home[:-1])
    found: IndexArray = outside[1:][risen]
    return found


def _home(rows: IndexArray, segments: Segments) -> IndexArray:
    """Return the number of each row's segment."""
    return np.searchsorted(segments.starts, rows, side="right").astype(np.intp)


def _period(rises: IndexArray, segments: Segments) -> float | None:
    home = _home(rises, segments)
    lengths = np.diff(rises)[home[1:] == home[:-1]]
    if lengths.size < 2:
        return None
    median = float(np.median(lengths))
    near = np.abs(lengths - median) <= _NEAR_MEDIAN * median
    covered = lengths.sum() >= _LEAST_COVERED * segments.n_rows
    return median if covered and near.mean() >= _SHARE_NEAR else None


def _cut(edges: list[int], period: float, shortest: int) -> list[int]:
    """Cut stretches longer than two periods evenly, and drop edges that leave a short piece."""
    filled = edges[:1]
    for start, stop in pairwise(edges):
        parts = round((stop - start) / period) if stop - start > 2 * period else 1
        filled += np.linspace(start, stop, parts + 1)[1:].astype(int).tolist()
    first, *inner, last = filled
    kept = [first]
    for edge in inner:
        if edge - kept[-1] >= shortest and last - edge >= shortest:
            kept.append(edge)
    return [*kept, last]
