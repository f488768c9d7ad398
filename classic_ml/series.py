"""CoefficientSeries: φ, ψ' and ψ over time, as the estimators take them."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from classic_ml.records import LedgerEntry, counted, ledger_grid, ledger_words
from surge_core.display import Displayed, Field, Sheet
from surge_core.errors import InputError
from surge_core.rounding import significant
from surge_core.types import BoolArray, FloatArray, IntArray

# A clock printed with few digits jitters by one digit, which is 0.12 of a step for 0.1 ms at
# 1234.5 Hz; a clock that jitters more does not say when its rows were taken.
CLOCK_TOLERANCE = 0.15
# A mean of 24 times, at the ends of the clock of 6, jitters by less than half a step where each
# time does by 0.2 steps rms; a row that is missing moves it by a whole one.
FEWEST_TIMES, MOST_TIMES = 6, 24
# A rate that drifts by 0.8 % leaves its line by so much of the rows.
SLOW_DRIFT = 1e-3


def jittering_period_s(time_s: FloatArray) -> float:
    """Return the step of a clock by a line through all its times; NaN where rows are missing.

    Jitter, rounding and slow drift leave the means of some times beside each other where the line
    has them; rows that are missing or doubled, and a step back, do not. Of times rounded until
    some are alike, what is less than half of these is not seen.
    """
    steps = np.diff(time_s)
    moves = np.count_nonzero(steps)
    row = np.arange(time_s.size) - 0.5 * steps.size
    period_s = float(np.dot(row, time_s - time_s[0]) / np.dot(row, row)) if moves else np.nan
    if not np.min(steps, initial=np.inf) > -0.5 * period_s:
        return np.nan
    alike = math.ceil(steps.size / moves)
    at = np.arange(alike * FEWEST_TIMES, time_s.size - alike * FEWEST_TIMES + 1)
    width = np.minimum(np.minimum(at, time_s.size - at), alike * MOST_TIMES)
    off = (time_s - time_s[0]) / period_s - row
    total = np.concatenate(([0.0], np.cumsum(off)))
    moved = (total[at + width] - 2.0 * total[at] + total[at - width]) / width
    is_drift_slow = np.ptp(off) < alike * FEWEST_TIMES + SLOW_DRIFT * time_s.size
    is_whole = is_drift_slow and np.max(np.abs(moved), initial=0.0) < 0.5 * alike
    return period_s if is_whole else np.nan


def uniform_period_s(
    time_s: FloatArray, where: str, taken: str = "interpolate them onto an even clock"
) -> float:
    """Return the mean step of a uniform clock, or refuse one that is called ``where``.

    It may not repeat, run back, have a gap or drift off its straight line by more than 0.15 of a
    step, nor may a step differ from the others by as much. ``taken`` says what to do with rows that
    were taken so.
    """
    steps = np.diff(time_s)
    mean_s = float((time_s[-1] - time_s[0]) / steps.size)
    line = time_s[0] + np.arange(1, time_s.size) * mean_s
    off = (steps <= 0.0) | (np.abs(steps - mean_s) > CLOCK_TOLERANCE * mean_s)
    off |= np.abs(time_s[1:] - line) > CLOCK_TOLERANCE * mean_s
    if not off.any():
        return mean_s
    remedy = "fill the gap at the source or write one file a record"
    if np.isfinite(period_s := jittering_period_s(time_s)):
        remedy = (
            "no row is missing: where the clock alone is uneven, count the rows at "
            f"{1.0 / period_s:.6g} Hz and write row / rate as the time (a raw record: "
            'sample_rate_hz and [file] clock = "from rate" in test.toml; its times then count from '
            f"0); where rows were taken at these times, {taken}"
        )
    back = np.flatnonzero(steps <= 0.0)
    if back.size:
        row = int(back[0]) + 1
        kind = "repeats" if steps[row - 1] == 0.0 else "runs back"
        raise InputError(
            where,
            expected="a clock that runs forward",
            found=f"that it {kind} at row {row + 1} ({time_s[row]:g} s)",
            remedy=remedy if np.isfinite(period_s) else "",
        )
    # A gap moves the mean: what is off is judged by the step that most rows have.
    usual_s = float(np.median(steps))
    worst = np.flatnonzero(np.abs(steps - usual_s) > CLOCK_TOLERANCE * usual_s)
    row = int(worst[0]) if worst.size else int(np.argmax(off))
    raise InputError(
        where,
        expected=f"a uniform step (here {usual_s:g} s)",
        found=f"a step of {steps[row]:g} s after {time_s[row]:g} s (row {row + 1})",
        remedy=remedy,
    )


MINIMUM_ROWS = 100


class Column(NamedTuple):
    """Unit of a column, what it is, beyond which values no compressor works, and its type."""

    unit: str
    long_name: str
    low: float = -np.inf
    high: float = np.inf
    kind: type[np.generic] = np.float64


# φ = 1 is already an axial Mach number of order one at any useful wheel speed, and ψ' = 100 would
# be a pressure ratio beyond 10^4 at 300 m/s.
KNOWN = {
    "time_s": Column("s", "facility clock"),
    "phi": Column("1", "flow coefficient", -3.0, 3.0),
    "psi_p": Column("1", "instantaneous pressure coefficient", -100.0, 100.0),
    "psi": Column("1", "instantaneous work coefficient", -1000.0, 1000.0),
    "T25_K": Column("K", "inlet total temperature", 50.0, 3000.0),
    "Nc_frac": Column("1", "corrected speed over design corrected speed", 0.01, 2.0),
    "in_stall": Column("1", "in stall by the rule of the reduction", 0, 1, np.bool_),
    "segment": Column(
        "1", "number of the interval to be fitted, 0 outside of all", 0, kind=np.int64
    ),
    "phi_unfiltered": Column("1", "flow coefficient from unfiltered pressures", -3.0, 3.0),
    "psi_p_unfiltered": Column(
        "1", "instantaneous pressure coefficient from unfiltered pressures", -100.0, 100.0
    ),
    "stalled": Column("1", "in stall as hub and tip flow show it", 0, 1, np.bool_),
    "free_run": Column("1", "free run: 0 outside, 1 simulated through, 2 scored", 0, 2, np.int64),
}
COLUMNS = tuple(KNOWN)
# Of every probe pair, unfiltered: its flow and total pressure; and what goes with them.
RAKE_COLUMN = re.compile(r"(Wc|Pt)(25|31)_\w+_(kg_s|Pa)|T25_unfiltered_K|readings_count")
REQUIRED_COLUMNS = COLUMNS[:3]

# What a display shows of the signals: label, factor and unit.
SHOWN = {
    "phi": ("φ", 1.0, ""),
    "psi_p": ("ψ'", 1.0, ""),
    "psi": ("ψ", 1.0, ""),
    "T25_K": ("T25", 1.0, " K"),
    "Nc_frac": ("corrected speed", 100.0, " % of design"),
}


@dataclass(frozen=True)
class CoefficientSeries(Displayed):
    """Flow and pressure coefficients of one record on a uniform clock.

    Parameters
    ----------
    time_s : ndarray of shape (n,)
        Facility clock, in seconds.
    phi : ndarray of shape (n,)
        Flow coefficient C_z/U.
    psi_p : ndarray of shape (n,)
        Instantaneous pressure coefficient ψ'.
    segment : ndarray of int, shape (n,)
        1, 2, … in the intervals to be fitted, 0 elsewhere.
    psi : ndarray of shape (n,), optional
        Instantaneous work coefficient ψ.
    T25_K : ndarray of shape (n,), optional
        Inlet total temperature, in kelvin.
    Nc_frac : ndarray of shape (n,), optional
        Corrected speed as a fraction of design.
    in_stall : ndarray of bool, shape (n,), optional
        True while the machine is in stall.
    phi_unfiltered, psi_p_unfiltered : ndarray of shape (n,), optional
        φ and ψ' from unfiltered pressures, with the lag of the thermocouples undone: what a free
        run through the whole record is fitted to.
    stalled : ndarray of bool, shape (n,), optional
        In-stall state as the machine itself shows it (hub-minus-tip flow).
    free_run : ndarray of int, shape (n,), optional
        0 outside the free run, 1 where it is simulated through, 2 where it is scored.
    rakes : mapping of str to ndarray of float32, shape (n,)
        Unfiltered flow and total pressure of every probe pair, as in ``"Wc25_A_tip_kg_s"``, from
        which τ is estimated; what single precision leaves is a thousandth of a probe's noise.
    source : str
        File or record that the series came from.
    history : tuple of LedgerEntry
        What was done to get here.

    Raises
    ------
    InputError
        For fewer than 100 rows, non-finite or impossible values, a clock that is not uniform,
        constant φ or ψ'.
    """

    time_s: FloatArray
    phi: FloatArray
    psi_p: FloatArray
    segment: IntArray
    psi: FloatArray | None = None
    T25_K: FloatArray | None = None
    Nc_frac: FloatArray | None = None
    in_stall: BoolArray | None = None
    phi_unfiltered: FloatArray | None = None
    psi_p_unfiltered: FloatArray | None = None
    stalled: BoolArray | None = None
    free_run: IntArray | None = None
    rakes: Mapping[str, NDArray[np.floating]] = field(default_factory=dict)
    source: str = "series"
    history: tuple[LedgerEntry, ...] = ()

    def __post_init__(self) -> None:
        for name in COLUMNS:
            given = getattr(self, name)
            if given is not None:
                object.__setattr__(self, name, _checked_column(self.source, name, given))
        single = {
            name: values.astype(np.float32, copy=False) for name, values in self.rakes.items()
        }
        object.__setattr__(self, "rakes", single)
        lengths = {name: values.size for name, values in self.columns().items()}
        if len(set(lengths.values())) > 1:
            raise InputError(self.source, expected="columns of one length", found=str(lengths))
        n_rows, expected = self.n_samples, f"at least {MINIMUM_ROWS} rows"
        if n_rows < MINIMUM_ROWS:
            raise InputError(self.source, expected=expected, found=f"{n_rows}")
        uniform_period_s(self.time_s, f"{self.source}: column time_s")
        for name in ("phi", "psi_p"):
            values = getattr(self, name)
            if np.ptp(values) == 0.0:
                raise InputError(
                    f"{self.source}: column {name}",
                    expected="a signal that moves",
                    found=f"the constant {values[0]:g}",
                    remedy="a lag cannot be identified without excitation",
                )

    @property
    def n_samples(self) -> int:
        """Number of rows."""
        return int(self.time_s.size)

    @property
    def sample_period_s(self) -> float:
        """Time between two rows, in seconds."""
        return float((self.time_s[-1] - self.time_s[0]) / (self.time_s.size - 1))

    @property
    def sample_rate_hz(self) -> float:
        """Rows a second."""
        return 1.0 / self.sample_period_s

    @property
    def scored(self) -> BoolArray:
        """Rows that lie in an interval to be fitted."""
        return np.asarray(self.segment > 0)

    @property
    def n_segments(self) -> int:
        """Number of intervals to be fitted."""
        return int(np.unique(self.segment[self.segment > 0]).size)

    def columns(self) -> dict[str, NDArray[np.generic]]:
        """Return the columns that are known, in the order of the series file."""
        present = {name: getattr(self, name) for name in COLUMNS}
        return {n: v for n, v in present.items() if v is not None} | dict(self.rakes)

    def fields(self) -> tuple[Field, ...]:
        """Return what is shown of the columns and the ledger."""
        fitted = int(np.count_nonzero(self.segment))
        fields = [
            Field("rows", f"{self.n_samples} at {self.sample_rate_hz:g} Hz"),
            Field("facility clock", f"{self.time_s[0]:.3f} to {self.time_s[-1]:.3f} s"),
            Field("to be fitted", f"{fitted} rows in {counted(self.n_segments, 'segment')}"),
        ]
        for name, (label, factor, unit) in SHOWN.items():
            values = getattr(self, name)
            if values is not None:
                low, high = factor * float(np.min(values)), factor * float(np.max(values))
                shown = f"{significant(low, 3)} to {significant(high, 3)}{unit}"
                fields.append(Field(label, shown))
        if self.in_stall is not None:
            share = 100.0 * float(np.mean(self.in_stall))
            fields.append(Field("in stall", f"{share:.0f} % of rows"))
        if self.free_run is not None:
            scored = int(np.count_nonzero(self.free_run == 2))
            fields.append(Field("whole run", f"unfiltered columns are there; {scored} rows scored"))
        fields.append(Field("ledger", ledger_words(self.history)))
        return tuple(fields)

    def _sheet(self) -> Sheet:
        fields = (Field("source", self.source), *self.fields())
        return Sheet("CoefficientSeries", fields, ledger_grid(self.history))


def _checked_column(source: str, name: str, given: NDArray[np.generic]) -> NDArray[np.generic]:
    """Return a column read-only and of its type, or refuse its first row that is impossible."""
    values: NDArray[Any] = np.asarray(given)
    where, known = f"{source}: column {name}", KNOWN[name]
    if values.ndim != 1:
        raise InputError(where, expected="one value a row", found=f"shape {values.shape}")
    finite, expected = np.isfinite(values), "a finite number in every row"
    possible = finite
    if finite.all():
        possible = (values >= known.low) & (values <= known.high)
        expected = f"values between {known.low:g} and {known.high:g}"
        expected += "" if known.unit == "1" else f" {known.unit}"
        if known.kind is not np.float64:
            possible &= values == np.round(values.astype(np.float64))
            expected = "0 or 1" if known.kind is np.bool_ else "whole numbers from 0 on"
    bad = np.flatnonzero(~possible)
    if bad.size:
        raise InputError(
            where,
            expected=expected,
            found=f"{values[bad[0]]:g} in row {bad[0] + 1}",
            remedy="check the units and the calibration, or cut the record there",
        )
    if values.dtype == known.kind and not values.flags.writeable:
        return values
    column: NDArray[np.generic] = values.astype(known.kind)
    column.setflags(write=False)
    return column
