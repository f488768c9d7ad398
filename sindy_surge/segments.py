"""Runs of rows, and blocks of rows to leave out or draw."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from surge_core.leave_out import block_edges
from surge_core.segments import runs_of
from surge_core.types import IndexArray


@dataclass(frozen=True)
class Segments:
    """Contiguous runs of rows, between which no equation is formed."""

    starts: IndexArray  # (n_segments,): First row of each segment
    stops: IndexArray  # (n_segments,): One past the last row of each segment

    @classmethod
    def from_labels(cls, labels: ArrayLike | None, n_rows: int) -> Segments:
        """Cut the rows wherever the integer label changes; without labels they are one segment."""
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
    """Cut rows into blocks to leave out or draw; see `surge_core.leave_out.block_edges`."""
    blocks = []
    inner = block_edges(segments.lengths, shortest)
    for rows, cuts in zip(segments.slices(), inner, strict=True):
        edges = [rows.start, *(rows.start + cuts).tolist(), rows.stop]
        blocks += [slice(low, high) for low, high in pairwise(edges)]
    return blocks
