"""The clock of a file beside a clock that is made from the rate: does it tell of another one?"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field

import numpy as np

from classic_ml.readers.raw_table import TIME_COLUMN, RawFile
from classic_ml.units import Conversion, kind_of_unit, states_a_unit, time_conversion
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["CLOCK_NAMES", "PassedOverClock", "passed_over_clock"]

# What a clock is called, in small letters.
CLOCK_NAMES = (
    *(TIME_COLUMN, "time", "t", "time (s)", "time [s]", "timestamp", "times"),
    "elapsed time",
)
# From so many steps the usual one is known.
LOOKED_AT = 100
# A clock is believed where so many of its steps are even to a tenth.
EVEN_SHARE, EVEN = 0.99, 0.1
GAP_STEPS = 1.5
# As of a clock that is read.
RATE_TOLERANCE = 1e-3
# A clock without a unit may be in these.
SMALLER_UNITS = (1e3, 1e6, 1e9)


def passed_over_clock(
    stored: RawFile, taken: Collection[str], rate_hz: float
) -> PassedOverClock | None:
    """Return what watches the clock that a file has and nobody reads; None where it has none.

    Parameters
    ----------
    stored : RawFile
        The file as it is.
    taken : collection of str
        Columns that feed a channel.
    rate_hz : float
        The rate that the clock is made from instead.
    """
    spare = [name for name in stored.names if name not in taken]
    folded = {name.strip().lower(): name for name in reversed(spare)}
    name = next((name for name in spare if name in stored.stamps), None)
    name = name or next((folded[known] for known in CLOCK_NAMES if known in folded), None)
    if name is None:
        return None
    unit = stored.units.get(name, "")
    stated = states_a_unit(unit) and kind_of_unit(unit) == "time"
    conversion = time_conversion(unit, name) if stated else Conversion()
    return PassedOverClock(stored.source, name, rate_hz, conversion, stated)


@dataclass
class PassedOverClock:
    """What is kept of such a clock from chunk to chunk; no finding depends on their size.

    Parameters
    ----------
    source, name : str
        The file and the column.
    rate_hz : float
        The rate that test.toml states.
    conversion : Conversion
        To seconds.
    stated : bool
        Whether the file states that it is in a unit of time.
    """

    source: str
    name: str
    rate_hz: float
    conversion: Conversion
    stated: bool
    _head: list[float] = field(default_factory=list, init=False)
    _usual_s: float = field(default=np.nan, init=False)
    _last_s: float = field(default=np.nan, init=False)
    _rows: int = field(default=0, init=False)
    _steps: int = field(default=0, init=False)
    _even: int = field(default=0, init=False)
    _even_time_s: float = field(default=0.0, init=False)
    _gap: tuple[float, int] | None = field(default=None, init=False)

    def add(self, values: FloatArray) -> None:
        """Take the next rows into account."""
        time_s = self.conversion.to_si(values)
        if not np.isnan(self._usual_s):
            self._follow(time_s)
            return
        self._head += time_s.tolist()
        if len(self._head) > LOOKED_AT:
            self._begin()

    def finish(self, where: str) -> None:
        """Refuse the file where its clock is even and contradicts the one that is made.

        Parameters
        ----------
        where : str
            File and key of the rate.
        """
        if np.isnan(self._usual_s):
            self._begin()
        if not self._usual_s > 0.0 or self._even < EVEN_SHARE * self._steps:
            return
        title = f"{self.source}: column {self.name}"
        if self._gap is not None:
            step, row = self._gap
            raise InputError(
                title,
                expected='a uniform step, from which clock = "from rate" makes the time',
                found=f"a step of {step:.4g} where others have {self._usual_s:.4g}, before row "
                f"{row}",
                remedy="rows are missing: cut the record there; if this clock is wrong, take its "
                "column out of the file",
            )
        step_s = self._even_time_s / self._even
        ratio = step_s * self.rate_hz
        agreed = (1.0,) if self.stated else (1.0, *SMALLER_UNITS)
        # What steps by one counts rows.
        if step_s == 1.0 or any(abs(ratio / unit - 1.0) <= RATE_TOLERANCE for unit in agreed):
            return
        raise InputError(
            title,
            expected=f"{self.rate_hz:g} samples a second, as {where} says",
            found=f"{1.0 / step_s:g}",
            remedy=f"write sample_rate_hz = {1.0 / step_s:g}; if this clock is wrong, take its "
            "column out of the file",
        )

    def _begin(self) -> None:
        head = np.array(self._head)
        steps = np.diff(head[: LOOKED_AT + 1])
        steps = steps[np.isfinite(steps)]
        self._usual_s = float(np.median(steps)) if steps.size else 0.0
        self._head = []
        self._follow(head)

    def _follow(self, time_s: FloatArray) -> None:
        if not time_s.size:
            return
        steps = np.diff(time_s, prepend=self._last_s)
        steps, first = (steps[1:], 1) if self._rows == 0 else (steps, 0)
        even = np.abs(steps - self._usual_s) <= EVEN * self._usual_s
        self._steps += steps.size
        self._even += int(np.count_nonzero(even))
        self._even_time_s += float(np.sum(steps[even]))
        gaps = np.flatnonzero(steps > GAP_STEPS * self._usual_s)
        if gaps.size and self._gap is None:
            self._gap = float(steps[gaps[0]]), self._rows + first + int(gaps[0]) + 1
        self._rows += time_s.size
        self._last_s = float(time_s[-1])
