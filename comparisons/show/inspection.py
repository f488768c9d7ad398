"""What is in a file, and what reduce would make of it, as text and as JSON."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from math import isnan
from typing import Any

from classic_ml.inspect import ChannelFacts, ChannelMatch, ClockFacts, Inspection, TestMatch
from classic_ml.records import counted, ledger_lines
from surge_core.display import Grid

INSPECT_SCHEMA = "sindy-surge/inspect/1"
# A surging machine moves every probe by many counts in 50 ms; what stands still longer is named,
# whatever the rate from so many rows on.
STILL_S, STILL_ROWS, STILL_LEAST_ROWS = 0.05, 50, 5
# Where the machine surges is shown if it is less than so much of the record.
# Steps that differ by less than this share of one differ by the rounding of the clock.
EVEN = 1e-3
SURGING_SHARE = 0.8


def inspect_text(inspection: Inspection, match: TestMatch | None = None) -> str:
    """Return the findings as text; with a match also what reduce would make of the file."""
    parts = [_file_text(inspection)]
    if match is not None:
        does = "\n".join(["reduce would do this:", *ledger_lines(match.history)])
        refuses = f"reduce would refuse it: {match.refusal}"
        parts += [_match_text(match), refuses if match.refusal else does]
    return "\n\n".join(parts)


def inspect_document(inspection: Inspection, match: TestMatch | None = None) -> dict[str, Any]:
    """Return the findings as plain JSON types; arguments as for :func:`inspect_text`."""
    found = asdict(inspection)
    return {
        "schema": INSPECT_SCHEMA,
        "file": found.pop("source"),
        **found,
        "test": None if match is None else asdict(match),
    }


def _file_text(inspection: Inspection) -> str:
    n = len(inspection.channels)
    lines = [f"{inspection.source}: {inspection.rows} rows, {n} columns"]
    clock = inspection.clock
    lines.append("clock: no column looks like one" if clock is None else _clock_text(clock))
    lines += _surge_text(inspection)
    rate_hz = clock.rate_hz if clock is not None else 0.0
    rows = []
    for channel in inspection.channels:
        is_clock = clock is not None and channel.name == clock.name
        notes = "" if is_clock else "; ".join(_notes(channel, rate_hz))
        ends = (f"{v:.6g}" for v in (channel.minimum, channel.mean, channel.maximum))
        rows.append((channel.name, channel.unit or "-", *ends, notes))
    heads = ("column", "unit", "minimum", "mean", "maximum", "notes")
    lines += ["", *Grid("", heads, tuple(rows), frozenset({0, 1, 5})).lines()]
    if inspection.left_aside:
        lines += ["", "left aside:", *(f"  {n}: {why}" for n, why in inspection.left_aside.items())]
    return "\n".join(lines)


def _clock_text(clock: ClockFacts) -> str:
    text = (
        f"clock: {clock.name} [{clock.unit}], {clock.first_s:.9g} to {clock.last_s:.9g} s, "
        f"{clock.rate_hz:.6g} rows a second, "
        + ("evenly spaced" if clock.jitter < EVEN else f"steps even to {clock.jitter:.2g} of one")
    )
    troubles = [
        f"{kind} {counted(count, 'time')} (the first before row {first})"
        for kind, (count, first) in clock.troubles.items()
    ]
    return f"{text}; " + (", ".join(troubles) or "no gap, repeat or step back")


def _surge_text(inspection: Inspection) -> Iterator[str]:
    """Yield where the machine surges, if that is a part of the record only."""
    if inspection.surges_s is None or inspection.clock is None:
        return
    from_s, to_s = inspection.surges_s
    if to_s - from_s < SURGING_SHARE * (inspection.clock.last_s - inspection.clock.first_s):
        yield (
            f"surge or rotating stall: the channels swing from {from_s:.6g} to {to_s:.6g} s; a "
            "part of a long record is read with --from-s and --to-s, or [window] of test.toml"
        )


def _notes(channel: ChannelFacts, rate_hz: float) -> tuple[str, ...]:
    notes = []
    if channel.not_finite == channel.rows:
        return ("no number in it",)
    if channel.not_finite:
        notes.append(f"{counted(channel.not_finite, 'row')} not finite")
    if channel.constant:
        return (*notes, "constant")
    for end in channel.plateaus:
        rows = channel.at_minimum if end == "minimum" else channel.at_maximum
        share = rows / max(1, channel.rows - channel.not_finite)
        notes.append(f"{rows} rows ({share:.2%}) at its {end}: saturated?")
    still_rows = STILL_S * rate_hz if rate_hz > 0.0 else STILL_ROWS
    if channel.longest_run >= max(STILL_LEAST_ROWS, still_rows):
        notes.append(f"{channel.longest_run} rows alike: stuck?")
    return tuple(notes)


def _match_text(match: TestMatch) -> str:
    lines = [f"as the test '{match.test}':"]
    rows = tuple((c.channel, c.column, c.unit, _range_text(c)) for c in match.channels)
    lines += Grid("", ("channel", "column", "unit", "range"), rows, frozenset(range(4))).lines()
    if match.left_over:
        lines.append("columns that feed nothing: " + ", ".join(match.left_over))
    return "\n".join(lines)


def _range_text(match: ChannelMatch) -> str:
    if isnan(match.minimum):
        return "no such column"
    ends = (match.minimum, match.maximum)
    if match.si_unit == "Pa":
        return " to ".join(f"{end / 1e3:.4g} kPa" for end in ends)
    return " to ".join(f"{end:.5g} {match.si_unit}" for end in ends)
