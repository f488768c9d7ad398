"""What the searches for faults find: marks of single readings, and findings about channels."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from classic_ml.description import PressureChannel, TemperatureChannel
from classic_ml.records import Record, fault_name

__all__ = [
    "BEYOND_LIMITS",
    "CLIPPED",
    "MARK_WORDS",
    "SPIKED",
    "STUCK",
    "Finding",
    "alike",
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

    ``kind`` is what was searched for, e.g. ``"marked"``, ``"held"`` or ``"gain"``; ``sentence`` is
    what the ledger prints; ``channel`` is empty where it is several.
    """

    kind: str
    sentence: str
    channel: str = ""


def alike(channels: Iterable[PressureChannel | TemperatureChannel], *keys: str) -> list[list[str]]:
    """Return the names of the channels that are alike in some of their places, in groups."""
    groups: dict[tuple[object, ...], list[str]] = {}
    for channel in channels:
        place = tuple(getattr(channel, key) for key in keys)
        groups.setdefault(place, []).append(channel.name)
    return list(groups.values())


def marked_rows(record: Record, channel: str) -> NDArray[np.uint8] | None:
    """Return the marks of a channel's readings, added up, or None where it has none."""
    name = fault_name(channel)
    return record[name].astype(np.uint8, copy=False) if name in record else None
