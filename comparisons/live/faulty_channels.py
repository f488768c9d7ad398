"""Channels that cannot be used for the operating point now: clipped, stuck or beyond limits."""

from __future__ import annotations

import numpy as np

from classic_ml.faults.choice import BEYOND_SHARE, CLIPPED_SHARE
from classic_ml.faults.findings import BEYOND_LIMITS, CLIPPED, STUCK
from classic_ml.faults.search import inspect_readings
from classic_ml.records import Record, fault_name
from comparisons.live.columns import FeedColumns
from surge_core.types import FloatArray

__all__ = ["FaultyChannels"]

# Readings are judged over stretches of this length by the rules of the reduction, and a channel
# is back once a whole stretch of it was good.
STRETCH_S = 0.5


class FaultyChannels:
    """Judge the readings stretch by stretch.

    Parameters
    ----------
    columns : FeedColumns
        The channels.

    Attributes
    ----------
    left_out : frozenset of str
        Channels not to be used now: the faulty ones, a pressure with its mate. Where all pairs at
        one immersion of a plane are faulty, they are used for want of better ones.
    """

    def __init__(self, columns: FeedColumns) -> None:
        self._columns = columns
        self._rows_wanted = max(2, round(STRETCH_S * columns.test.sample_rate_hz))
        self.left_out: frozenset[str] = frozenset()
        self._faulty: dict[str, str] = {}
        self.restart()

    def restart(self) -> None:
        """Begin a new stretch behind a gap."""
        self._rows: list[FloatArray] = []
        self._n_rows = 0
        self._start_s = 0.0

    @property
    def rows_to_go(self) -> int:
        """How many rows there are until the next verdict."""
        return self._rows_wanted - self._n_rows

    def take(self, time_s: FloatArray, readings: FloatArray) -> list[str]:
        """Take the next rows and tell which channels went out or came back.

        Parameters
        ----------
        time_s : ndarray of shape (n,)
            Clock.
        readings : ndarray of shape (n, n_channels)
            Counts, Pa and K.
        """
        if not self._rows:
            self._start_s = float(time_s[0])
        self._rows.append(readings)
        self._n_rows += len(readings)
        if self._n_rows < self._rows_wanted:
            return []
        record = self._columns.record(np.concatenate(self._rows), self._start_s)
        self.restart()
        before, out_before = self._faulty, self.left_out
        self._faulty = self._judged(record)
        self.left_out = self._with_mates()
        return self._told(before, out_before)

    def _told(self, before: dict[str, str], out_before: frozenset[str]) -> list[str]:
        new = {name: why for name, why in self._faulty.items() if name not in before}
        told = []
        if new:
            parts = [
                f"{why}: {', '.join(name for name in new if new[name] == why)}"
                for why in sorted(set(new.values()))
            ]
            out, kept = self.left_out - out_before, new.keys() - self.left_out
            if out:
                parts.append(f"left out of the operating point: {', '.join(sorted(out))}")
            if kept:
                parts.append(f"used for want of better ones: {', '.join(sorted(kept))}")
            told.append("; ".join(parts))
        back = [name for name in before if name not in self._faulty]
        return told + ([f"sound again: {', '.join(back)}"] if back else [])

    def _judged(self, record: Record) -> dict[str, str]:
        test, n_rows = self._columns.test, record.n_samples
        inspected = inspect_readings(record, test)
        faulty = {}
        for name in test.channel_names:
            if fault_name(name) not in inspected:
                continue
            mark = inspected[fault_name(name)].astype(np.int64)
            for kind, word, share in _RULES:
                if np.count_nonzero(mark & kind) > share * n_rows:
                    faulty[name] = word
        return faulty

    def _with_mates(self) -> frozenset[str]:
        test = self._columns.test
        out = {couple.name for couple in test.temperatures if couple.name in self._faulty}
        for plane in test.areas_m2:
            couples = {couple.name for couple in test.thermocouples(plane)}
            if plane == 25 and couples <= out:
                out -= couples
            for immersion in ("hub", "tip"):
                pairs = [pair for pair in test.pairs(plane) if pair.immersion == immersion]
                names = [{pair.forward.name, pair.aft.name} for pair in pairs]
                bad = [pair for pair in names if pair & self._faulty.keys()]
                if len(bad) < len(names):
                    out.update(*bad)
        return frozenset(out)


_RULES = (
    (CLIPPED, "clipped", CLIPPED_SHARE),
    (STUCK, "stuck or dropped out", 0.0),
    (BEYOND_LIMITS, "beyond its limits", BEYOND_SHARE),
)
