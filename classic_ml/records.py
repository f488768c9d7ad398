"""Record: one run of a test as named channels with SI units and a memory of what was done to it."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from classic_ml.columns.computed import ComputedColumn
from classic_ml.columns.workspace import IN_MEMORY, Workspace
from surge_core.display import Displayed, Field, Grid, Sheet
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["Channel", "Dropped", "LedgerEntry", "Record"]


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
        The samples, read-only; a copy unless they were read-only float64 before. In a record that
        is larger than memory they may be computed where they are asked for, slice by slice.
    unit : str
        SI unit (``"Pa"``, ``"K"``, ``"kg/s"``, ``"1"``), or ``"count"`` before calibration.
    """

    name: str
    values: FloatArray
    unit: str

    def __post_init__(self) -> None:
        given: object = self.values
        if isinstance(given, ComputedColumn):
            return
        values = np.asarray(given, dtype=np.float64)
        if values.flags.writeable:
            values = values.copy()
        if values.ndim != 1:
            raise InputError(
                f"channel {self.name}", expected="one value a sample", found=f"shape {values.shape}"
            )
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
    workspace : Workspace
        Where the steps put their results: in memory, or on disk for a record larger than that.

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
    workspace: Workspace = field(default=IN_MEMORY, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "channels", MappingProxyType(dict(self.channels)))
        lengths = {channel.values.size for channel in self.channels.values()}
        if len(lengths) > 1:
            raise InputError(
                f"record {self.source}",
                expected="channels of one length",
                found=f"lengths {sorted(lengths)}",
            )
        if not (np.isfinite(self.sample_rate_hz) and self.sample_rate_hz > 0.0):
            raise InputError(
                f"record {self.source}",
                expected="a positive sample rate in Hz",
                found=f"{self.sample_rate_hz}",
            )

    @classmethod
    def from_arrays(
        cls,
        arrays: Mapping[str, tuple[ArrayLike, str]],
        *,
        sample_rate_hz: float,
        start_s: float = 0.0,
        source: str = "",
    ) -> Record:
        """Build a record from ``{name: (values, unit)}``."""
        channels = {
            name: Channel(name, np.asarray(values, dtype=np.float64), unit)
            for name, (values, unit) in arrays.items()
        }
        return cls(channels, sample_rate_hz, start_s, source)

    def __getitem__(self, name: str) -> FloatArray:
        """Return the samples of one channel."""
        return self.channel(name).values

    def __contains__(self, name: object) -> bool:
        """Tell whether the record holds a channel of that name."""
        return name in self.channels

    def __reduce__(self) -> tuple[object, ...]:
        """Survive pickling, which a mapping proxy does not."""
        fields = (
            dict(self.channels),
            self.sample_rate_hz,
            self.start_s,
            self.source,
            self.history,
        )
        return (Record, fields)

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

    def rows_between(self, from_s: float, to_s: float) -> slice:
        """Return the rows from one time to another, each within half a sample.

        Parameters
        ----------
        from_s, to_s : float
            On the facility clock.

        Returns
        -------
        slice
            Rows of the record, an empty slice where there are none.
        """
        half = 0.5 * self.sample_period_s
        first = _first_row(lambda row: self.time_at_s(row) >= from_s - half, self.n_samples)
        stop = _first_row(lambda row: self.time_at_s(row) > to_s + half, self.n_samples)
        return slice(first, max(first, stop))

    def _sheet(self) -> Sheet:
        n = self.n_samples
        end_s = self.start_s + (n - 1) / self.sample_rate_hz
        fields = (
            Field("source", self.source or "none"),
            Field("rows", f"{n} at {self.sample_rate_hz:g} Hz"),
            Field("facility clock", f"{self.start_s:.3f} to {end_s:.3f} s"),
            Field("ledger", ledger_words(self.history)),
        )
        rows = tuple((name, channel.unit) for name, channel in self.channels.items())
        title = f"{len(rows)} channels"
        channels = Grid(title, ("channel", "unit"), rows, frozenset({0, 1}), folded=len(rows) > 12)
        return Sheet("Record", fields, (channels, *ledger_grid(self.history)))

    def after(
        self,
        entry: LedgerEntry,
        *,
        add: Iterable[Channel] = (),
        drop: Iterable[str] = (),
    ) -> Record:
        """Return the record after one step.

        Parameters
        ----------
        entry : LedgerEntry
            What the step did; appended to the history.
        add : iterable of Channel
            Channels that are new or replace those of the same name.
        drop : iterable of str
            Names of channels that the step leaves out.

        Returns
        -------
        Record
            A new record; this one is unchanged.
        """
        gone = set(drop)
        kept = {name: channel for name, channel in self.channels.items() if name not in gone}
        kept.update({channel.name: channel for channel in add})
        return replace(self, channels=kept, history=(*self.history, entry))


def _first_row(holds: Callable[[int], bool], n_rows: int) -> int:
    """Return the first row for which a condition on the clock holds, by bisection."""
    return bisect_left(range(n_rows), True, key=holds)


def ledger_words(history: tuple[LedgerEntry, ...]) -> str:
    """Return a ledger in a line.

    Parameters
    ----------
    history : tuple of LedgerEntry
        The ledger.
    """
    dropped = sum(len(entry.dropped) for entry in history)
    flags = sum(len(entry.flags) for entry in history)
    left_out, flagged = _count(dropped, "thing"), _count(flags, "flag")
    return f"{_count(len(history), 'step')}; {left_out} left out, {flagged}"


def ledger_grid(history: tuple[LedgerEntry, ...]) -> tuple[Grid, ...]:
    """Return a ledger as a folded table, or none where it is empty.

    Parameters
    ----------
    history : tuple of LedgerEntry
        The ledger.
    """
    rows = tuple(
        (
            entry.step,
            entry.did,
            _parameters(entry.parameters),
            "; ".join(f"{d.what} ({d.count}): {d.why}" for d in entry.dropped) or "nothing",
            "; ".join(entry.flags) or "none",
        )
        for entry in history
    )
    header = ("step", "did", "parameters", "left out", "flags")
    words = frozenset(range(len(header)))
    return (Grid("Ledger", header, rows, words, folded=True),) if rows else ()


def _parameters(parameters: Mapping[str, str | int | float | bool]) -> str:
    listed = (
        f"{name} = {f'{value:.6g}' if isinstance(value, float) else value}"
        for name, value in parameters.items()
    )
    return "; ".join(listed) or "none"


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" + ("" if number == 1 else "s")
