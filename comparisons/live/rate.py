"""The sample rate of a feed by its own clock, before rows are put in order by the one declared."""

from __future__ import annotations

import numpy as np

from classic_ml.description import TestDescription
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["RateCheck"]

# So many rows tell the rate, whatever came twice or out of order among them.
ROWS_TO_TELL = 32
# A step that is off by more may be taken for a gap, or for a row that was had already; what is off
# by less loses no row, and is told at the end by the reader of raw records.
MOST_OFF = 0.25
UNITS = ((1e3, "ms"), (1e6, "us"), (1e9, "ns"))


class RateCheck:
    """Hold the first clocks of a feed against the rate that the test declares.

    Parameters
    ----------
    test : TestDescription
        For the rate.
    column : str
        What the feed calls its clock.
    """

    def __init__(self, test: TestDescription, column: str) -> None:
        self._test = test
        self._column = column
        self._first_s: FloatArray = np.empty(0)

    def take(self, time_s: FloatArray) -> None:
        """Take the clocks of rows as they came.

        Parameters
        ----------
        time_s : ndarray of shape (n,)
            Clocks, in seconds.

        Raises
        ------
        InputError
            Once there are enough, when they run at another rate.
        """
        if self._first_s.size >= ROWS_TO_TELL:
            return
        self._first_s = np.concatenate([self._first_s, time_s[:ROWS_TO_TELL]])
        clocks = np.unique(self._first_s)
        if self._first_s.size < ROWS_TO_TELL or clocks.size < 2:
            return
        step_s = float(np.median(np.diff(clocks)))
        if abs(step_s * self._test.sample_rate_hz - 1.0) > MOST_OFF:
            raise self._other_rate(step_s)

    def _other_rate(self, step_s: float) -> InputError:
        rate_hz, found_hz = self._test.sample_rate_hz, 1.0 / step_s
        periods = step_s * rate_hz
        unit = next((u for factor, u in UNITS if abs(periods / factor - 1.0) <= MOST_OFF), None)
        return InputError(
            f"{self._test.source}: [test] sample_rate_hz",
            expected=f"{found_hz:.4g} Hz, at which the feed's column {self._column} runs",
            found=f"{rate_hz:g} Hz",
            remedy=f"write sample_rate_hz = {found_hz:.4g}, or let the feed run at {rate_hz:g} Hz"
            if unit is None
            else f'is its clock in {unit}? then write time_unit = "{unit}" in [file]',
        )
