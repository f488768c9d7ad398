"""Mistakes in the clock of a raw record, and records that are not of a surge test."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from mistake import FLAGGED, REFUSED, UNNOTICED, Mistake, Spoil
from mistake_desk import CLEAN
from raw_data import make_test
from spoiling import Values, as_lines, at_rows, channel, table, toml

from comparisons.rig import simulate, write_run

__all__ = ["CLOCKS", "TESTS"]


def _without(rows: slice, *, renumbered: bool = False) -> Spoil:
    def change(read: pd.DataFrame) -> pd.DataFrame:
        kept = read.drop(index=range(rows.start, rows.stop)).reset_index(drop=True)
        return kept.assign(time_s=read["time_s"].iloc[: len(kept)]) if renumbered else kept

    return table(change)


def _clock(change: Callable[[Values], Values]) -> Spoil:
    return channel("time_s", change)


def _dates(rows: list[str]) -> list[str]:
    return [rows[0], *(f"2026-01-01 00:00:{row}" for row in rows[1:])]


def _rate(factor: float, *, both: bool) -> Spoil:
    clock = channel("time_s", lambda t: np.round(t / factor, 9))
    rate = toml(("test/sample_rate_hz", 1000.0 * factor))

    def spoil(folder: Path) -> None:
        if both:
            clock(folder)
            _window(folder, factor)
        rate(folder)

    return spoil


def _window(folder: Path, factor: float) -> None:
    toml(("near_stall/to_s", 0.2 / factor))(folder)


def _made(**settings: Any) -> Spoil:
    def spoil(folder: Path) -> None:
        make_test(**{**CLEAN, **settings}).write(folder)

    return spoil


def _renumbered(rows: Callable[[int], np.ndarray]) -> Spoil:
    """Write other rows under an even clock."""

    def change(read: pd.DataFrame) -> pd.DataFrame:
        again = read.iloc[rows(len(read))].reset_index(drop=True)
        return again.assign(time_s=np.arange(len(again)) / 1000.0)

    return table(change)


def _ends_in_stall(folder: Path) -> None:
    """Put the beginning of a surge in place: the stall before the cycles oscillates mildly."""
    for file in ("raw.csv", "test.toml"):
        (folder / file).unlink()
    run = folder / "run"
    write_run(simulate("985", seed=1, duration_s=1.5), run)
    for file in ("raw.csv", "test.toml"):
        (run / file).replace(folder / file)
    shutil.rmtree(run)


def _stalled(read: pd.DataFrame) -> pd.DataFrame:
    rng = np.random.default_rng(5)
    for name in read.columns.drop("time_s"):
        spread = 1.0 if name.startswith("P") else 0.01
        noise = rng.normal(0.0, spread, len(read) - 700)
        held = read[name].iloc[700] + noise
        read[name] = np.concatenate([read[name].iloc[:700], held.round(0 if spread == 1.0 else 4)])
    return read


CLOCKS = (
    Mistake(
        "clock-gap",
        "rows are missing, and the clock shows it",
        REFUSED,
        ("raw.csv", "time_s", "uniform step", "0.999"),
        spoil=_without(slice(1000, 1020)),
    ),
    Mistake(
        "clock-repeats",
        "a row is there twice",
        REFUSED,
        ("raw.csv", "time_s", "repeats", "row 1001"),
        spoil=table(lambda t: pd.concat([t.iloc[:1000], t.iloc[999:]])),
    ),
    Mistake(
        "clock-back",
        "the clock runs back by one step",
        REFUSED,
        ("raw.csv", "time_s", "back", "row 1001"),
        spoil=_clock(at_rows(slice(1000, 1001), 0.998)),
    ),
    Mistake(
        "clock-block-twice",
        "a block of rows was written twice",
        REFUSED,
        ("raw.csv", "time_s", "back", "row 1101"),
        spoil=table(lambda t: pd.concat([t.iloc[:1100], t.iloc[1000:]])),
    ),
    Mistake(
        "clock-renumbered",
        "25 rows are missing and the clock was renumbered",
        FLAGGED,
        ("1.2",),
        spoil=_without(slice(1200, 1225), renumbered=True),
    ),
    Mistake(
        "clock-block-renumbered",
        "a block of 100 rows is there twice and the clock was renumbered",
        FLAGGED,
        ("100 rows repeat earlier ones", "1.1"),
        spoil=_renumbered(lambda n: np.r_[0:1100, 1000:n]),
    ),
    Mistake(
        "clock-row-renumbered",
        "a row is there twice and the clock was renumbered",
        FLAGGED,
        ("1 row repeats the readings of the row before", "1.201"),
        spoil=_renumbered(lambda n: np.r_[0:1201, 1200:n]),
    ),
    Mistake(
        "clock-tiled",
        "a short record was made longer by copies of its cycles",
        FLAGGED,
        ("1120 rows repeat earlier ones",),
        spoil=_renumbered(lambda n: np.r_[0:1260, np.tile(np.arange(700, 1260), 2)]),
    ),
    Mistake(
        "clock-ms",
        "the clock is in milliseconds",
        REFUSED,
        ("raw.csv", "time_s", "1000 samples a second", "ms"),
        spoil=_clock(lambda t: t * 1e3),
    ),
    Mistake(
        "clock-dates",
        "the clock is a date and a time of day",
        REFUSED,
        ("raw.csv", "time_s", "2026-01-01", "row 1"),
        spoil=as_lines(_dates),
    ),
    Mistake(
        "clock-samples",
        "the clock counts samples",
        REFUSED,
        ("raw.csv", "time_s", "1000 samples a second"),
        spoil=_clock(lambda t: np.arange(t.size, dtype=float)),
    ),
    Mistake(
        "clock-constant",
        "the clock stands still",
        REFUSED,
        ("raw.csv", "time_s", "repeats"),
        spoil=_clock(np.zeros_like),
    ),
    Mistake(
        "rate-half",
        "test.toml states half the sample rate of the clock",
        REFUSED,
        ("raw.csv", "time_s", "500", "1000", "sample_rate_hz"),
        spoil=_rate(0.5, both=False),
    ),
    Mistake(
        "rate-one-per-cent",
        "test.toml states a sample rate 1 % off the clock",
        REFUSED,
        ("raw.csv", "time_s", "1010", "sample_rate_hz"),
        spoil=_rate(1.01, both=False),
    ),
    Mistake(
        "rate-both-wrong",
        "clock and test.toml agree on a sample rate that is 1 % wrong",
        UNNOTICED,
        why="no reading tells the rate of its own clock; τ comes out 1 % wrong. A tone of known "
        "frequency (the rotor's once-per-revolution) on a spare channel would tell",
        within=(0.02, 0.1),
        spoil=_rate(1.01, both=True),
    ),
    Mistake(
        "clock-late",
        "the clock starts at the facility's time of day, [near_stall] counts from zero",
        REFUSED,
        ("test.toml", "[near_stall]", "7200"),
        spoil=_clock(lambda t: t + 7200.0),
    ),
)

TESTS = (
    Mistake(
        "no-surge",
        "there is no surge in the record",
        REFUSED,
        ("raw.csv", "no surge"),
        spoil=_made(surge=False),
    ),
    Mistake(
        "before-surge",
        "the record ends before the surge",
        REFUSED,
        ("raw.csv", "no surge"),
        spoil=as_lines(lambda rows: rows[:280]),
    ),
    Mistake(
        "one-cycle",
        "the record ends after the first cycle",
        REFUSED,
        ("raw.csv", "surge cycles"),
        spoil=as_lines(lambda rows: rows[:520]),
    ),
    Mistake(
        "two-cycles",
        "the record holds two cycles",
        REFUSED,
        ("raw.csv", "at least 3", "cycles"),
        spoil=as_lines(lambda rows: rows[:680]),
    ),
    Mistake(
        "mild-oscillations",
        "the record ends before the cycles begin, while the stall oscillates mildly",
        REFUSED,
        ("raw.csv", "at least 3", "mild oscillations in stall"),
        spoil=_ends_in_stall,
    ),
    Mistake(
        "few-cycles",
        "the record holds four cycles that repeat each other",
        FLAGGED,
        ("cycles", "uncertain"),
        spoil=as_lines(lambda rows: rows[:1340]),
    ),
    Mistake(
        "never-recovers",
        "the machine stays in rotating stall after the first blowdown",
        REFUSED,
        ("raw.csv", "surge"),
        spoil=table(_stalled),
    ),
    Mistake(
        "begins-in-surge",
        "the record begins in the surge: there is no near-stall part",
        REFUSED,
        ("test.toml", "[near_stall]"),
        spoil=as_lines(lambda rows: [rows[0], *rows[700:]]),
    ),
)
