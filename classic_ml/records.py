"""Record: one run of a test as named channels with SI units and a memory of what was done to it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import PurePath
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surge_core.display import Displayed, Field, Grid, Sheet
from surge_core.errors import InputError
from surge_core.types import FloatArray


@dataclass(frozen=True)
class Dropped:
    """Something that a step left out, and why.

    Parameters
    ----------
    what : str
        The channel, probe pair, segment or kind of row.
    count : int
        How many rows (or probes, or segments) it concerns.
    why : str
        The reason, in words.
    """

    what: str
    count: int
    why: str


@dataclass(frozen=True)
class LedgerEntry:
    """What one step did to a record.

    Parameters
    ----------
    step : str
        Name of the step, e.g. ``"calibrate"``.
    did : str
        One sentence with the numbers that mattered.
    parameters : mapping of str to str, int, float or bool
        The settings the step ran with.
    dropped : tuple of Dropped
        What was left out, and why; empty when nothing was.
    flags : tuple of str
        Warnings for the reader: data that were kept but are suspect.
    """

    step: str
    did: str
    parameters: Mapping[str, str | int | float | bool] = field(default_factory=dict)
    dropped: tuple[Dropped, ...] = ()
    flags: tuple[str, ...] = ()


@dataclass(frozen=True)
class Channel:
    """One measured or derived signal.

    Parameters
    ----------
    name : str
        Channel name, unique in its record.
    values : ndarray of shape (n_samples,)
        The samples, a read-only view as float64 (marks of faults may be uint8).
    unit : str
        SI unit (``"Pa"``, ``"K"``, ``"kg/s"``, ``"1"``), or ``"count"`` before calibration.
    """

    name: str
    values: NDArray[Any]
    unit: str

    def __post_init__(self) -> None:
        given = np.asarray(self.values)
        kind = np.uint8 if given.dtype == np.uint8 else np.float64
        values = given.astype(kind, copy=False).view()
        values.setflags(write=False)
        object.__setattr__(self, "values", values)


@dataclass(frozen=True)
class Record(Displayed):
    """One run: channels that share a uniform clock, where they came from, and their history.

    Parameters
    ----------
    channels : mapping of str to Channel
        The channels by name, all of one length.
    sample_rate_hz : float
        Samples a second.
    start_s : float
        Facility clock at the first sample.
    source : str
        File or generator that the record came from.
    history : tuple of LedgerEntry
        One entry for each step applied so far.

    Raises
    ------
    InputError
        When the channels differ in length or the sample rate is not positive.
    """

    channels: Mapping[str, Channel]
    sample_rate_hz: float
    start_s: float = 0.0
    source: str = ""
    history: tuple[LedgerEntry, ...] = ()

    def __post_init__(self) -> None:
        lengths = {channel.values.size for channel in self.channels.values()}
        where = f"record {self.source}"
        if len(lengths) > 1:
            raise InputError(
                where, expected="channels of one length", found=f"lengths {sorted(lengths)}"
            )
        rate = self.sample_rate_hz
        if not (np.isfinite(rate) and rate > 0.0):
            raise InputError(where, expected="a positive sample rate in Hz", found=f"{rate}")

    @classmethod
    def from_arrays(
        cls, arrays: Mapping[str, tuple[ArrayLike, str]], *, sample_rate_hz: float, source: str = ""
    ) -> Record:
        """Build a record from ``{name: (values, unit)}``."""
        channels = {n: Channel(n, np.array(v), unit) for n, (v, unit) in arrays.items()}
        return cls(channels, sample_rate_hz, source=source)

    def __getitem__(self, name: str) -> FloatArray:
        """Return the samples of one channel."""
        return self.channel(name).values

    def __contains__(self, name: object) -> bool:
        """Return whether the record holds a channel of that name."""
        return name in self.channels

    def channel(self, name: str) -> Channel:
        """Return one channel, or raise an InputError that names those there are."""
        if name not in self.channels:
            raise InputError(
                f"channel {name}",
                expected="it in the record",
                found="only " + ", ".join(self.channels),
            )
        return self.channels[name]

    @property
    def n_samples(self) -> int:
        """Number of samples in each channel."""
        return next((c.values.size for c in self.channels.values()), 0)

    @property
    def sample_period_s(self) -> float:
        """Time between two samples, in seconds."""
        return 1.0 / self.sample_rate_hz

    @property
    def time_s(self) -> FloatArray:
        """Facility clock of each sample, in seconds."""
        return self.start_s + np.arange(self.n_samples) / self.sample_rate_hz

    def time_at_s(self, row: int) -> float:
        """Return the facility clock at one sample, as :attr:`time_s` has it."""
        return float(self.start_s + row / self.sample_rate_hz)

    def marks(self, name: str) -> NDArray[np.uint8]:
        """Return the marks of a channel's readings that do not count, 0 for those that do."""
        fault = fault_name(name)
        if fault not in self:
            return np.zeros(self.n_samples, dtype=np.uint8)
        return self[fault].astype(np.uint8, copy=False)

    def rows_between(self, from_s: float, to_s: float) -> slice:
        """Return the rows from one time to another on the facility clock, within half a sample."""
        first, last = (self.sample_rate_hz * (at_s - self.start_s) for at_s in (from_s, to_s))
        bounds = np.array([np.ceil(first - 0.5), np.floor(last + 0.5) + 1.0])
        start, stop = np.clip(bounds, 0, self.n_samples).astype(int).tolist()
        return slice(start, max(start, stop))

    def part(self, rows: slice) -> Record:
        """Return some rows of the record, with the clock that they have."""
        channels = {n: replace(c, values=c.values[rows]) for n, c in self.channels.items()}
        return replace(self, channels=channels, start_s=self.time_at_s(rows.start))

    def without(self, names: Iterable[str]) -> Record:
        """Return the record without some channels."""
        gone = set(names)
        kept = {name: c for name, c in self.channels.items() if name not in gone}
        return replace(self, channels=kept)

    def after(self, entry: LedgerEntry, *, add: Iterable[Channel] = ()) -> Record:
        """Return the record after one step, with its entry in the history and further channels.

        Channels of the same name are replaced; this record is unchanged.
        """
        channels = {**self.channels, **{channel.name: channel for channel in add}}
        return replace(self, channels=channels, history=(*self.history, entry))

    def _sheet(self) -> Sheet:
        end_s = self.time_at_s(self.n_samples - 1)
        fields = (
            Field("source", self.source or "none"),
            Field("rows", f"{self.n_samples} at {self.sample_rate_hz:g} Hz"),
            Field("facility clock", f"{self.start_s:.3f} to {end_s:.3f} s"),
            Field("ledger", ledger_words(self.history)),
        )
        rows = tuple((name, channel.unit) for name, channel in self.channels.items())
        title = f"{len(rows)} channels"
        channels = Grid(title, ("channel", "unit"), rows, frozenset({0, 1}), folded=len(rows) > 12)
        return Sheet("Record", fields, (channels, *ledger_grid(self.history)))


def fault_name(channel: str) -> str:
    """Return the name of the channel that marks the readings of another that do not count."""
    return f"fault_{channel}"


def ledger_words(history: tuple[LedgerEntry, ...]) -> str:
    """Return in one line how long a history is."""
    dropped = sum(len(entry.dropped) for entry in history)
    flags = sum(len(entry.flags) for entry in history)
    left_out, flagged = counted(dropped, "thing"), counted(flags, "flag")
    return f"{counted(len(history), 'step')}; {left_out} left out, {flagged}"


def short_names(sources: Iterable[str]) -> str:
    """Return the names of files, with their folders where two are alike."""
    paths = [PurePath(source) for source in sources]
    alike = len({path.name for path in paths}) < len(paths)
    return ", ".join("/".join(path.parts[-2:]) if alike else path.name for path in paths)


def counted(number: int, noun: str) -> str:
    """Return a number and its noun, in the plural where it is not one."""
    return f"{number} {noun}" + ("" if number == 1 else "s")


def ledger_lines(history: Iterable[LedgerEntry]) -> list[str]:
    """Return a history line by line, for a terminal."""
    lines = []
    for entry in history:
        lines.append(f"{entry.step}: {entry.did}")
        lines += [f"  left out {d.what} ({d.count}): {d.why}" for d in entry.dropped]
        lines += [f"  note: {flag}" for flag in entry.flags]
    return lines


def ledger_grid(history: Sequence[LedgerEntry]) -> tuple[Grid, ...]:
    """Return a history as a table, or nothing where there is none."""
    rows = tuple(
        (
            entry.step,
            entry.did,
            "; ".join(
                f"{name} = {f'{value:.6g}' if isinstance(value, float) else value}"
                for name, value in entry.parameters.items()
            )
            or "none",
            "; ".join(f"{d.what} ({d.count}): {d.why}" for d in entry.dropped) or "nothing dropped",
            "; ".join(entry.flags) or "none",
        )
        for entry in history
    )
    header = ("step", "did", "parameters", "left out", "flags")
    words = frozenset(range(len(header)))
    return (Grid("Ledger", header, rows, words, folded=True),) if rows else ()
