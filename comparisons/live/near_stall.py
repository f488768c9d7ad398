"""The near-stall match during a run: known as soon as the near-stall reading has passed."""

from __future__ import annotations

import numpy as np

from classic_ml.calibration import (
    calibrate,
    check_facing,
    match_near_stall,
    near_stall_match,
)
from classic_ml.description import TestDescription
from classic_ml.faults.search import inspect_readings
from comparisons.live.columns import FeedColumns
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["NearStallMatch"]

# Mean values need no more rows than this, however long the reading of the facility took.
MOST_ROWS = 60_000


class NearStallMatch:
    """Gather the rows of the near-stall reading and find by how much each channel is off.

    Parameters
    ----------
    columns : FeedColumns
        The channels.

    Attributes
    ----------
    shifts : dict of str to float, or None
        By channel, what is to be added, in Pa and K; None until the reading has passed.
    problem : str
        Why there is none although it has passed; empty where all is well.
    """

    def __init__(self, columns: FeedColumns) -> None:
        self._columns = columns
        self._rows: list[FloatArray] = []
        self._n_rows = 0
        self._start_s = 0.0
        self.shifts = self._stated()
        self.problem = ""

    @property
    def test(self) -> TestDescription:
        """The test."""
        return self._columns.test

    def _stated(self) -> dict[str, float] | None:
        """Return the shifts that the description of the test states, if it does."""
        if not self.test.near_stall_shifts:
            return None
        nothing = self._columns.record(np.zeros((2, len(self._columns.channels))), 0.0)
        shifts, _ = near_stall_match(nothing, self.test)
        return {name: shifts.get(name, 0.0) for name in self.test.channel_names}

    def restart(self) -> None:
        """Forget rows of a reading that a gap cut short; shifts that are known stay."""
        self._rows, self._n_rows = [], 0

    def rows_to_go(self, time_s: FloatArray) -> int:
        """Return how many of the next rows there are until the shifts become known.

        Parameters
        ----------
        time_s : ndarray of shape (n,)
            Their clock.
        """
        if self.shifts is not None or self.problem:
            return time_s.size
        ends_s = self.test.near_stall.to_s - 0.5 / self.test.sample_rate_hz
        return min(time_s.size, int(np.searchsorted(time_s, ends_s)) + 1)

    def take(self, time_s: FloatArray, readings: FloatArray) -> bool:
        """Take the next rows; True when the shifts have just become known, or known to fail.

        Parameters
        ----------
        time_s : ndarray of shape (n,)
            Clock.
        readings : ndarray of shape (n, n_channels)
            Counts, Pa and K.
        """
        if self.shifts is not None or self.problem:
            return False
        reading, half = self.test.near_stall, 0.5 / self.test.sample_rate_hz
        inside = (time_s >= reading.from_s - half) & (time_s <= reading.to_s + half)
        if inside.any() and self._n_rows < MOST_ROWS:
            if not self._rows:
                self._start_s = float(time_s[inside][0])
            self._rows.append(readings[inside])
            self._n_rows += int(np.count_nonzero(inside))
        if time_s[-1] < reading.to_s - half or not self._rows:
            return False
        self._match()
        return True

    def _match(self) -> None:
        record = self._columns.record(np.concatenate(self._rows), self._start_s)
        try:
            before = calibrate(inspect_readings(record, self.test), self.test)
            check_facing(before, self.test)
            after = match_near_stall(before, self.test)
        except InputError as error:
            self.problem = str(error)
        else:
            names = self.test.channel_names
            self.shifts = {name: float(after[name][0] - before[name][0]) for name in names}
        self._rows = []
