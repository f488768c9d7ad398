"""Marks of single readings that do not count, and groups of channels that are alike."""

from __future__ import annotations

from collections.abc import Iterable

from classic_ml.description import PressureChannel, TemperatureChannel

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
