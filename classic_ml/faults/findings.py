"""What the searches for faults find: marks of single readings, and findings about channels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from classic_ml.records import Record, fault_name

__all__ = [
    "BEYOND_LIMITS",
    "CLIPPED",
    "MARK_WORDS",
    "SPIKED",
    "STUCK",
    "Finding",
    "marked_rows",
]

# Kinds of mark in the channels `fault_NAME`, added up where they coincide.
CLIPPED = 1
STUCK = 2
BEYOND_LIMITS = 4
SPIKED = 8
MARK_WORDS = {
    CLIPPED: "clipped",
    STUCK: "stuck or dropped out",
    BEYOND_LIMITS: "beyond its limits",
    SPIKED: "spiked",
}


@dataclass(frozen=True)
class Finding:
    """Something that a search has found.

    Parameters
    ----------
    kind : str
        What was searched for, e.g. ``"marked"``, ``"held"`` or ``"gain"``.
    sentence : str
        What the ledger prints.
    channel : str
        The channel, empty where it is several.
    """

    kind: str
    sentence: str
    channel: str = ""


def marked_rows(record: Record, channel: str) -> NDArray[np.uint8] | None:
    """Return the marks of a channel's readings, added up, or None where it has none."""
    name = fault_name(channel)
    return record[name].astype(np.uint8, copy=False) if name in record else None
