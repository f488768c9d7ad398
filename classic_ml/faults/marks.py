"""The marks of readings that do not count: a channel ``fault_NAME`` for each that has some."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from classic_ml.columns.computed import as_stored
from classic_ml.columns.workspace import blocks
from classic_ml.records import Channel, Record

__all__ = [
    "BEYOND_LIMITS",
    "CLIPPED",
    "KIND_WORDS",
    "SPIKED",
    "STUCK",
    "Marks",
    "fault_counts",
    "fault_name",
    "has_fault",
    "kinds_of_fault",
]

# Kinds of fault in the channels `fault_NAME`, added up where they coincide.
CLIPPED = 1
STUCK = 2
BEYOND_LIMITS = 4
SPIKED = 8
KIND_WORDS = {
    CLIPPED: "clipped",
    STUCK: "stuck or dropped out",
    BEYOND_LIMITS: "beyond its limits",
    SPIKED: "spiked",
}
# Which sums of kinds have a kind in them.
_WITH_KIND = {kind: np.flatnonzero(np.arange(1 << len(KIND_WORDS)) & kind) for kind in KIND_WORDS}


def fault_name(channel: str) -> str:
    """Return the name of the channel that marks the faulty rows of another."""
    return f"fault_{channel}"


@dataclass(frozen=True)
class Marks:
    """The marks of one channel.

    Parameters
    ----------
    column : ndarray of uint8, shape (n,)
        The kinds of fault of each row, added up.
    counts : mapping of int to tuple of int
        For each kind that there is its number of rows, the first and the last.
    """

    column: NDArray[np.uint8]
    counts: Mapping[int, tuple[int, int, int]]

    def channel(self, record: Record, name: str) -> Channel:
        """Return them as a channel."""
        return Channel(fault_name(name), record.workspace.widened(self.column), "1")

    def described(self, record: Record, name: str) -> list[str]:
        """Return one sentence a kind."""
        texts = []
        for kind, word in KIND_WORDS.items():
            if kind in self.counts:
                n, *ends = self.counts[kind]
                first_s, last_s = (record.time_at_s(row) for row in ends)
                texts.append(f"{name}: {n} rows {word}, {first_s:.3f} to {last_s:.3f} s")
        return texts


def kinds_of_fault(record: Record, name: str, rows: slice) -> NDArray[np.uint8]:
    """Return the kinds of fault, added up, of some rows of a channel that has some."""
    marks: NDArray[np.uint8] = as_stored(record[fault_name(name)])[rows].astype(
        np.uint8, copy=False
    )
    return marks


def fault_counts(record: Record, name: str, rows: slice) -> dict[int, int]:
    """Return in how many rows of a slice a channel has a fault of each kind, and of any (0)."""
    by_marks = np.zeros(1 << len(KIND_WORDS), dtype=np.int64)
    for block in blocks(rows.stop, rows.start):
        marks = kinds_of_fault(record, name, block)
        if marks.any():
            by_marks += np.bincount(marks, minlength=by_marks.size)
        record.workspace.release()
    counts = {kind: int(by_marks[which].sum()) for kind, which in _WITH_KIND.items()}
    return {**counts, 0: int(by_marks[1:].sum())}


def has_fault(record: Record, name: str, kind: int) -> bool:
    """Tell whether a channel has a fault of a kind anywhere."""
    if fault_name(name) not in record:
        return False
    for rows in blocks(record.n_samples):
        found = bool(np.any(kinds_of_fault(record, name, rows) & np.uint8(kind)))
        record.workspace.release()
        if found:
            return True
    return False
