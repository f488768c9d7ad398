"""Mistakes in the readings of a raw record: their units, whose they are, and how a probe fails."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from mistake import FLAGGED, HARMLESS, REFUSED, Mistake
from spoiling import Values, at_rows, channel, every, exchanged, table, toml

__all__ = ["PROBES"]

PROBE = "P31_B_hub_aft"
COUPLES = ("T25_A", "T25_B")
SAME = (1e-9, 1e-9)
# What leaving out one of four pairs, or a straight line over a few rows, may change.
NEAR = (0.01, 0.05)


def pair(name: str) -> tuple[str, str]:
    """Return the two probes of a pair, forward first."""
    return f"P{name}_forward", f"P{name}_aft"


PAIRS_25 = tuple(pair(f"25_{rake}_{place}") for rake in "AB" for place in ("tip", "hub"))
PAIRS_31 = tuple(pair(f"31_{rake}_{place}") for rake in "AB" for place in ("tip", "hub"))


def _spikes(values: Values) -> Values:
    values[900:1900:97] += 700.0
    return np.clip(values, 0.0, 4095.0)


def _three_spikes(values: Values) -> Values:
    values[[850, 1303, 1711]] += 700.0
    return np.clip(values, 0.0, 4095.0)


def _warm_row(values: Values) -> Values:
    values[1500] += 60.0
    return values


def _every(rows: int) -> Callable[[Values], Values]:
    """Return what keeps every so many-th value until the next one comes."""
    return lambda values: np.repeat(values[::rows], rows)[: values.size]


def _wide_converter(folder: Path) -> None:
    """Clip a few readings at 12 bits, and state 16."""
    channel(("P31_A_tip_forward", PROBE), at_rows(slice(330, 345), 4095.0))(folder)
    toml(("adc/bits", 16))(folder)


def _noise(values: Values) -> Values:
    return np.round(np.random.default_rng(3).normal(2048.0, 5.0, values.size))


def _wanders(values: Values) -> Values:
    noise = np.random.default_rng(3).normal(0.0, 1.0, values.size)
    values[1000:] = np.round(2400.0 + noise[1000:])
    return values


def _held(values: Values) -> Values:
    rising = np.flatnonzero(np.arange(values.size) > 0.312e3)
    values[rising] = values[rising[0]]
    return values


PROBES = (
    Mistake(
        "counts-16-bit",
        "the codes are those of a 16-bit converter, test.toml says 12",
        REFUSED,
        ("raw.csv", "12-bit", "4095"),
        spoil=every("P", lambda v: v * 16.0),
    ),
    Mistake(
        "counts-signed",
        "the codes are signed, test.toml's calibration is not",
        REFUSED,
        ("raw.csv", "12-bit", "-"),
        spoil=every("P", lambda v: v - 2048.0),
    ),
    Mistake(
        "counts-bits",
        "test.toml says 16 bits for the codes of a 12-bit converter",
        HARMLESS,
        within=SAME,
        why="pressures come from ratios of codes, and none of them is clipped",
        spoil=toml(("adc/bits", 16)),
    ),
    Mistake(
        "counts-bits-clipped",
        "test.toml says 16 bits for a 12-bit converter of which some codes are clipped",
        FLAGGED,
        ("no code is above 4095", "is the converter one of 12 bits", f"{PROBE}: 15 rows clipped"),
        within=SAME,
        spoil=_wide_converter,
    ),
    Mistake(
        "counts-volts",
        "the pressures are in volts",
        REFUSED,
        ("raw.csv", "P25_A_tip_forward"),
        spoil=every("P", lambda v: -5.0 + v * 10.0 / 4096.0),
    ),
    Mistake(
        "counts-psi",
        "the pressures are in psi and no counts",
        REFUSED,
        ("raw.csv", "P25_A_tip_forward", "near stall", "unit"),
        spoil=every("P25", lambda v: 8.0 + v / 4096.0),
    ),
    Mistake(
        "counts-kpa",
        "one pressure is in kPa and no counts",
        REFUSED,
        ("raw.csv", "P31_A_tip_forward", "near stall", "unit"),
        spoil=channel("P31_A_tip_forward", lambda v: 1285.0 + 0.1 * v),
    ),
    Mistake(
        "counts-pascal",
        "the pressures are in Pa and no counts",
        REFUSED,
        ("raw.csv", "12-bit", "unit"),
        spoil=every("P", lambda v: 55e3 + v),
    ),
    Mistake(
        "couples-celsius",
        "the thermocouples of plane 25 are in °C",
        REFUSED,
        ("raw.csv", "T25_A", "K"),
        spoil=channel(COUPLES, lambda v: v - 273.15),
    ),
    Mistake(
        "couples-warm-celsius",
        "the thermocouples of plane 31 are in °C",
        REFUSED,
        ("raw.csv", "T31_A", "K", "unit"),
        spoil=every("T31", lambda v: v - 273.15),
    ),
    Mistake(
        "couples-fahrenheit",
        "the thermocouples of plane 31 are in °F",
        REFUSED,
        ("raw.csv", "T31_A", "K", "unit"),
        spoil=every("T31", lambda v: 1.8 * v - 459.67),
    ),
    Mistake(
        "couples-rankine",
        "the thermocouples are in °R",
        REFUSED,
        ("raw.csv", "T25_A", "K", "unit"),
        spoil=every("T", lambda v: 1.8 * v),
    ),
    Mistake(
        "swapped-planes",
        "probes of two planes are exchanged",
        REFUSED,
        ("raw.csv", "near stall"),
        spoil=exchanged(("P25_A_tip_forward", "P31_A_tip_forward")),
    ),
    Mistake(
        "swapped-couples",
        "thermocouples of two planes are exchanged",
        REFUSED,
        ("raw.csv", "T25_A", "near stall"),
        spoil=exchanged(("T25_A", "T31_A")),
    ),
    Mistake(
        "swapped-facing",
        "forward and aft probe of one pair are exchanged",
        REFUSED,
        ("raw.csv", "25_A_tip", "forward and aft exchanged"),
        spoil=exchanged(pair("25_A_tip")),
    ),
    Mistake(
        "swapped-facing-31",
        "forward and aft probe of one pair at plane 31 are exchanged",
        REFUSED,
        ("raw.csv", "31_B_hub", "forward and aft exchanged"),
        spoil=exchanged(pair("31_B_hub")),
    ),
    Mistake(
        "swapped-facing-all",
        "forward and aft are exchanged in all pairs",
        REFUSED,
        ("raw.csv", "forward and aft exchanged"),
        spoil=exchanged(*PAIRS_25, *PAIRS_31),
    ),
    Mistake(
        "swapped-immersions",
        "hub and tip pair of one rake are exchanged",
        FLAGGED,
        ("25_A",),
        spoil=exchanged(*zip(pair("25_A_tip"), pair("25_A_hub"), strict=True)),
    ),
    Mistake(
        "swapped-rakes",
        "the pairs of two rakes at one immersion are exchanged",
        FLAGGED,
        ("P25_A_tip_forward", "P25_B_tip_forward"),
        why="the rakes see the same: told by each other's calibrations, where these differ",
        spoil=exchanged(*zip(pair("25_A_tip"), pair("25_B_tip"), strict=True)),
    ),
    Mistake(
        "swapped-mates",
        "the aft probes of two rakes are exchanged",
        FLAGGED,
        ("P25_A_tip_aft", "P25_B_tip_aft"),
        why="both rakes see the same: told by each other's calibrations, where these differ",
        spoil=exchanged(("P25_A_tip_aft", "P25_B_tip_aft")),
    ),
    Mistake(
        "drifted",
        "the zero of a probe drifts by 80 counts from near stall to the end",
        FLAGGED,
        ("P25_A_tip_aft",),
        spoil=channel("P25_A_tip_aft", lambda v: np.round(v + 80.0 * np.arange(v.size) / v.size)),
    ),
    Mistake(
        "channel-copied",
        "a probe's readings were copied into another's column",
        FLAGGED,
        ("P25_A_tip_aft", "P25_B_tip_aft"),
        spoil=table(lambda t: t.assign(P25_A_tip_aft=t["P25_B_tip_aft"])),
    ),
    Mistake(
        "inverted-codes",
        "a channel is wired the other way round",
        REFUSED,
        ("raw.csv", "P31_A_tip_forward", "near stall"),
        spoil=channel("P31_A_tip_forward", lambda v: 4095.0 - v),
    ),
    Mistake(
        "disconnected",
        "a probe's cable is off: noise about the middle of the range",
        REFUSED,
        ("raw.csv", "P25_B_hub_aft"),
        spoil=channel("P25_B_hub_aft", _noise),
    ),
    Mistake(
        "lost-later",
        "a probe's tube comes off within the record: it reads a steady noise from then on",
        FLAGGED,
        ("P25_B_hub_aft",),
        within=NEAR,
        spoil=channel("P25_B_hub_aft", _wanders),
    ),
    Mistake(
        "clipped-outside",
        "a probe is clipped for some rows outside the window",
        FLAGGED,
        ("P31_B_hub_aft", "outside the window"),
        within=SAME,
        spoil=channel(PROBE, at_rows(slice(330, 345), 4095.0)),
    ),
    Mistake(
        "clipped-window",
        "a probe is clipped in 5 % of the window",
        FLAGGED,
        ("pair 31_B_hub", "clipped"),
        within=NEAR,
        spoil=channel(PROBE, at_rows(slice(1000, 1065), 4095.0)),
    ),
    Mistake(
        "clipped-near-stall",
        "a probe is clipped while the machine is near stall",
        FLAGGED,
        ("pair 31_B_hub", "clipped", "near stall"),
        within=NEAR,
        spoil=channel(PROBE, at_rows(slice(0, 190), 4095.0)),
    ),
    Mistake(
        "clipped-last",
        "all hub probes of a plane are clipped",
        REFUSED,
        ("raw.csv", "P25", "clipped"),
        spoil=channel(("P25_A_hub_forward", "P25_B_hub_forward"), at_rows(slice(700, 1500), 0.0)),
    ),
    Mistake(
        "stuck",
        "a probe stands still from the surge on",
        FLAGGED,
        ("pair 31_B_hub", "stuck"),
        within=NEAR,
        spoil=channel(PROBE, _held),
    ),
    Mistake(
        "dropout",
        "a probe drops to zero for 20 rows",
        FLAGGED,
        ("pair 31_B_hub",),
        within=NEAR,
        spoil=channel(PROBE, at_rows(slice(1100, 1120), 0.0)),
    ),
    Mistake(
        "dropout-word",
        "a probe drops to the same wrong code for 20 rows",
        FLAGGED,
        ("pair 31_B_hub", "dropped out"),
        within=NEAR,
        spoil=channel(PROBE, at_rows(slice(1100, 1120), 100.0)),
    ),
    Mistake(
        "spikes",
        "a probe has single wrong codes (a bit that flips)",
        FLAGGED,
        ("P25_A_tip_aft",),
        within=NEAR,
        spoil=channel("P25_A_tip_aft", _spikes),
    ),
    Mistake(
        "spikes-three",
        "a probe has three wrong codes in two seconds",
        FLAGGED,
        ("P31_A_tip_aft: 3 rows spiked",),
        within=NEAR,
        spoil=channel("P31_A_tip_aft", _three_spikes),
    ),
    Mistake(
        "spike-couple",
        "a thermocouple is off by 60 K in one row",
        FLAGGED,
        ("T25_B: 1 rows spiked",),
        within=NEAR,
        spoil=channel("T25_B", _warm_row),
    ),
    Mistake(
        "held-plane",
        "the pressures of plane 31 were recorded at half the rate, and each value written twice",
        REFUSED,
        ("raw.csv", "P31_A_tip_forward and 7 more", "each value 2 times", "late"),
        spoil=every("P31", _every(2)),
    ),
    Mistake(
        "held-probe",
        "one pressure was recorded at a quarter of the rate and held",
        REFUSED,
        ("raw.csv", PROBE, "each value 4 times", "late"),
        spoil=channel(PROBE, _every(4)),
    ),
    Mistake(
        "held-all",
        "every reading is there in two rows",
        FLAGGED,
        ("P25_A_tip_forward and 15 more: each value is there 2 times", "T25_A and 3 more"),
        spoil=every("", lambda v: v if np.all(np.diff(v) > 0.0) else _every(2)(v)),
    ),
    Mistake(
        "held-couples",
        "the thermocouples were recorded at a quarter of the rate and held",
        FLAGGED,
        ("T25_A and 3 more: each value is there 4 times",),
        within=NEAR,
        spoil=every("T", _every(4)),
    ),
    Mistake(
        "couple-dead",
        "both thermocouples of plane 31 stand still",
        FLAGGED,
        ("T31",),
        within=NEAR,
        spoil=every("T31", lambda v: np.full(v.size, 0.994 * 698.0)),
    ),
    Mistake(
        "couples-25-dead",
        "both thermocouples of plane 25 stand still",
        REFUSED,
        ("T25",),
        spoil=every("T25", lambda v: np.full(v.size, 0.994 * 255.0)),
    ),
)
