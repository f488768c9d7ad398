"""What the searches for faults find: one table of kinds, and the marks of single readings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import nan

import numpy as np
from numpy.typing import NDArray

from classic_ml.records import Record, fault_name

__all__ = [
    "BEYOND_LIMITS",
    "CLIPPED",
    "FINDINGS",
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

# Every kind of finding, and how the ledger prints it.
FINDINGS = {
    "marked": "{channel}: {rows} rows {word}, {from_s:.3f} to {to_s:.3f} s",
    "range end within limits": "{channel}: {rows} rows at its {end} reading of {reading:.6g} "
    "{unit}, where it stands still again and again: does its range end there? [limits] of {source} "
    "lets them count",
    "held": "channel {channel}{more}: each value is there {times}: recorded at {rate_hz:.3g} "
    "samples a second and held? {effect}: keep the rows alone in which there is a new value",
    "kept": "{channel}: {rows} faulty rows in the window, few enough to keep it",
    "faulty outside": "{channel}: faulty rows outside the window only",
    "gain": "{channel} moves {gain:.2f} times as much as the probes beside it, {apart:.0%} apart "
    "from them: check its zero and calibrate readings",
    "exchanged immersions": "plane {plane}: the hub of rake {first} goes with the tip of rake "
    "{second}, and the reverse: are hub and tip exchanged on one of them?",
    "drifted apart": "{channel} is {apart:.1%} above {other} in the window, though both were "
    "matched near stall: has the zero of one drifted, or is its sensitivity wrong?",
    "common shift": "near stall all probes of plane {plane} read {share:.1%} {side} the facility "
    "({shift_Pa:.3g} Pa, {spread_Pa:.2g} Pa apart): is P{plane}_Pa of [near_stall] in {source} "
    "right, or the calibrate_pressure_Pa and zoc_reference_Pa of all of them? the match hides it, "
    "and τ follows",
    "pairs differ": "near stall the corrected flow is {highest:.3g} kg/s at {high} and "
    "{lowest:.3g} at {low}: check their calibrations",
    "planes differ": "near stall W25 is {inlet:.4g} kg/s and W31 {leaving:.4g} kg/s{how}: check "
    "area_m2 of [planes.25] and [planes.31] in {source}",
    "unusual machine": "near stall {what}: check rotor_speed_rpm, mean_radius_m and "
    "design_corrected_speed_rpm in {source}",
}


@dataclass(frozen=True)
class Finding:
    """Something that a search has found.

    Parameters
    ----------
    kind : str
        A key of ``FINDINGS``.
    channel : str
        The channel, empty where it is several.
    rows : int
        How many rows it concerns, where that is known.
    from_s, to_s : float
        Facility clock of the first and the last of them.
    details : mapping of str to str or float
        The numbers and names behind it, by what ``FINDINGS`` calls them.
    """

    kind: str
    channel: str = ""
    rows: int = 0
    from_s: float = nan
    to_s: float = nan
    details: Mapping[str, str | float] = field(default_factory=dict)

    @property
    def sentence(self) -> str:
        """What the ledger prints."""
        return FINDINGS[self.kind].format(
            channel=self.channel,
            rows=self.rows,
            from_s=self.from_s,
            to_s=self.to_s,
            **self.details,
        )


def marked_rows(record: Record, channel: str) -> NDArray[np.uint8] | None:
    """Return the marks of a channel's readings, added up, or None where it has none."""
    name = fault_name(channel)
    return record[name].astype(np.uint8, copy=False) if name in record else None
