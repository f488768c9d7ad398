"""Marks of single readings that do not count, and groups of channels that are alike."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from classic_ml.description import PressureChannel, TemperatureChannel
from classic_ml.records import Record, fault_name

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
