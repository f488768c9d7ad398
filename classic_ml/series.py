"""CoefficientSeries: φ, ψ' and ψ over time, as the estimators take them."""

from __future__ import annotations

from dataclasses import dataclass, field
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from classic_ml.columns.clock import uniform_period_s
from classic_ml.columns.computed import as_stored, is_computed
from classic_ml.columns.workspace import IN_MEMORY, Workspace, blocks
from classic_ml.records import LedgerEntry, ledger_grid, ledger_words
from surge_core.display import Displayed, Field, Sheet
from surge_core.errors import InputError
from surge_core.rounding import significant
from surge_core.types import FloatArray

if TYPE_CHECKING:
    from classic_ml.readers.series_files import ledger_path, read_series, write_series

__all__ = ["MINIMUM_ROWS", "CoefficientSeries", "ledger_path", "read_series", "write_series"]

MINIMUM_ROWS = 100
REQUIRED_COLUMNS = ("time_s", "phi", "psi_p")
OPTIONAL_COLUMNS = (
    "psi",
    "T25_K",
    "Nc_frac",
    "in_stall",
    "segment",
    "phi_unfiltered",
    "psi_p_unfiltered",
    "stalled",
    "free_run",
)
COLUMNS = REQUIRED_COLUMNS + OPTIONAL_COLUMNS
UNITS = {
    "time_s": "s",
    "phi": "1",
    "psi_p": "1",
    "psi": "1",
    "T25_K": "K",
    "Nc_frac": "1",
    "in_stall": "1",
    "segment": "1",
    "phi_unfiltered": "1",
    "psi_p_unfiltered": "1",
    "stalled": "1",
    "free_run": "1",
}
LONG_NAMES = {
    "time_s": "facility clock",
    "phi": "flow coefficient",
    "psi_p": "instantaneous pressure coefficient",
    "psi": "instantaneous work coefficient",
    "T25_K": "inlet total temperature",
    "Nc_frac": "corrected speed over design corrected speed",
    "in_stall": "in stall by the rule of the reduction",
    "segment": "number of the interval to be fitted, 0 outside of all",
    "phi_unfiltered": "flow coefficient from unfiltered pressures",
    "psi_p_unfiltered": "instantaneous pressure coefficient from unfiltered pressures",
    "stalled": "in stall as hub and tip flow show it",
    "free_run": "free run: 0 outside, 1 simulated through, 2 scored",
}
TRUTH_COLUMNS = ("in_stall", "stalled")
COUNT_COLUMNS = ("segment", "free_run")
LARGEST = float(np.finfo(np.float64).max)
# Beyond these no compressor works: φ = 1 is already an axial Mach number of order one at any
# useful wheel speed, and ψ' = 100 would be a pressure ratio beyond 10^4 at 300 m/s.
POSSIBLE = {
    "phi": (-3.0, 3.0),
    "psi_p": (-100.0, 100.0),
    "psi": (-1000.0, 1000.0),
    "T25_K": (50.0, 3000.0),
    "Nc_frac": (0.01, 2.0),
    "phi_unfiltered": (-3.0, 3.0),
    "psi_p_unfiltered": (-100.0, 100.0),
    "free_run": (0.0, 2.0),
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
    source : str
        File or record that the series came from.
    history : tuple of LedgerEntry
        What was done to get here.
    workspace : Workspace
        Where the columns lie, which are not copied where they are read-only and of their type. On
        disk some are computed where they are asked for.

    Raises
    ------
    InputError
        For anything DESIGN section 5 refuses: fewer than 100 rows, non-finite or impossible
        values, a clock that is not uniform, constant φ or ψ'.
    """

    time_s: FloatArray
    phi: FloatArray
    psi_p: FloatArray
    segment: NDArray[np.int64]
    psi: FloatArray | None = None
    T25_K: FloatArray | None = None
    Nc_frac: FloatArray | None = None
    in_stall: NDArray[np.bool_] | None = None
    phi_unfiltered: FloatArray | None = None
    psi_p_unfiltered: FloatArray | None = None
    stalled: NDArray[np.bool_] | None = None
    free_run: NDArray[np.int64] | None = None
    source: str = "series"
    history: tuple[LedgerEntry, ...] = ()
    workspace: Workspace = field(default=IN_MEMORY, repr=False, compare=False)

    def __post_init__(self) -> None:
        extremes = {}
        for name in COLUMNS:
            given = getattr(self, name)
            if given is not None:
                values = _vector(self, name, given)
                extremes[name] = _extremes(as_stored(values), self.workspace)
                object.__setattr__(self, name, _frozen_column(self, name, values, extremes[name]))
        _check_lengths(self)
        uniform_period_s(self.time_s, f"{self.source}: column time_s", workspace=self.workspace)
        for name, bounds in POSSIBLE.items():
            if name in extremes and not _within(extremes[name], bounds):
                _check_range(self, name, bounds)
        for name in ("phi", "psi_p"):
            if extremes[name][0] == extremes[name][1]:
                raise _constant(self, name)

    def __reduce__(self) -> tuple[object, ...]:
        """Survive pickling, which a place on disk does not: the copy lies in memory."""
        names = [name for name in self.__dataclass_fields__ if name != "workspace"]
        return (_rebuild, ({name: getattr(self, name) for name in names},))

    def _sheet(self) -> Sheet:
        fields = (Field("source", self.source), *series_fields(self))
        return Sheet("CoefficientSeries", fields, ledger_grid(self.history))

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
    def scored(self) -> NDArray[np.bool_]:
        """Rows that lie in an interval to be fitted."""
        return np.asarray(self.segment > 0)

    @property
    def n_segments(self) -> int:
        """Number of intervals to be fitted."""
        return int(np.unique(self.segment[self.segment > 0]).size)

    def columns(self) -> dict[str, NDArray[np.generic]]:
        """Return the columns that are known, in the order of the series file."""
        present = {name: getattr(self, name) for name in COLUMNS}
        return {name: values for name, values in present.items() if values is not None}


def _rebuild(known: dict[str, Any]) -> CoefficientSeries:
    return CoefficientSeries(**known)


def _vector(
    series: CoefficientSeries, name: str, values: NDArray[np.generic]
) -> NDArray[np.generic]:
    given = values if is_computed(values) else np.asarray(values)
    if given.ndim != 1:
        raise InputError(
            f"{series.source}: column {name}",
            expected="one value a row",
            found=f"shape {given.shape}",
        )
    return given if given.dtype.kind in "fbiu" else given.astype(np.float64)


def _extremes(values: NDArray[Any], workspace: Workspace) -> tuple[float, float]:
    """Return the least and the largest value, which are NaN where one value is."""
    low, high = np.inf, -np.inf
    for rows in blocks(values.size):
        low = np.minimum(low, values[rows].min())
        high = np.maximum(high, values[rows].max())
        workspace.release()
    return float(low), float(high)


def _within(extremes: tuple[float, float], bounds: tuple[float, float]) -> bool:
    return bounds[0] <= extremes[0] and extremes[1] <= bounds[1]


def _frozen_column(
    series: CoefficientSeries,
    name: str,
    given: NDArray[np.generic],
    extremes: tuple[float, float],
) -> NDArray[np.generic]:
    """Check a column, block by block where something is wrong; return it read-only, of its type."""
    if not _within(extremes, (-LARGEST, LARGEST)):
        _check_rows(
            series,
            name,
            given,
            (-LARGEST, LARGEST),
            expected="a finite number in every row",
            found="{0} in row {1}{2}",
            remedy="cut the record there or repair the channel",
        )
    if name in TRUTH_COLUMNS + COUNT_COLUMNS:
        expected = "0 or 1" if name in TRUTH_COLUMNS else "whole numbers from 0 on"
        bounds = (0.0, 1.0 if name in TRUTH_COLUMNS else LARGEST)
        if given.dtype.kind == "f" or not _within(extremes, bounds):
            _check_rows(series, name, given, bounds, whole=True, expected=expected)
    if given.dtype == _column_type(name) and (is_computed(given) or not given.flags.writeable):
        return given
    column: NDArray[np.generic] = given.astype(_column_type(name))
    column.setflags(write=False)
    return column


def _column_type(name: str) -> type[np.generic]:
    if name in COUNT_COLUMNS:
        return np.int64
    return np.bool_ if name in TRUTH_COLUMNS else np.float64


def _check_rows(
    series: CoefficientSeries,
    name: str,
    values: NDArray[np.generic],
    bounds: tuple[float, float],
    *,
    expected: str,
    whole: bool = False,
    found: str = "{0}",
    remedy: str = "",
) -> None:
    """Refuse the first row out of bounds or not whole: its value, number, how many more."""
    first, number, n_bad = -1, 0.0, 0
    whole = whole and values.dtype.kind not in "biu"
    for rows in blocks(values.size):
        bad = _bad_rows(values[rows], bounds, whole)
        if bad.size:
            if not n_bad:
                first = int(rows.start + bad[0])
                number = float(np.float64(values[first]))
            n_bad += bad.size
        series.workspace.release()
    if n_bad:
        more = f" and {n_bad - 1} more" if n_bad > 1 else ""
        raise InputError(
            f"{series.source}: column {name}",
            expected=expected,
            found=found.format(number, first + 1, more),
            remedy=remedy,
        )


def _bad_rows(numbers: NDArray[Any], bounds: tuple[float, float], whole: bool) -> NDArray[np.int64]:
    if not whole and numbers.min() >= bounds[0] and numbers.max() <= bounds[1]:
        return np.zeros(0, dtype=np.int64)
    good = (numbers >= bounds[0]) & (numbers <= bounds[1])
    if whole:
        good &= numbers == np.round(numbers)
    return np.flatnonzero(~good)


def _check_range(series: CoefficientSeries, name: str, bounds: tuple[float, float]) -> None:
    _check_rows(
        series,
        name,
        getattr(series, name),
        bounds,
        expected=f"values between {bounds[0]:g} and {bounds[1]:g}{_shown_unit(name)}",
        found="{0:g} in row {1}",
        remedy="check the units and the calibration",
    )


def _check_lengths(series: CoefficientSeries) -> None:
    lengths = {name: values.size for name, values in series.columns().items()}
    if len(set(lengths.values())) > 1:
        raise InputError(series.source, expected="columns of one length", found=str(lengths))
    if series.n_samples < MINIMUM_ROWS:
        raise InputError(
            series.source, expected=f"at least {MINIMUM_ROWS} rows", found=f"{series.n_samples}"
        )


def _shown_unit(name: str) -> str:
    return "" if UNITS[name] == "1" else f" {UNITS[name]}"


def _constant(series: CoefficientSeries, name: str) -> InputError:
    return InputError(
        f"{series.source}: column {name}",
        expected="a signal that moves",
        found=f"the constant {getattr(series, name)[0]:g}",
        remedy="a lag cannot be identified without excitation",
    )


def __getattr__(name: str) -> object:
    """Lend the names of the file functions, which need this module themselves."""
    if name not in ("ledger_path", "read_series", "write_series"):
        raise AttributeError(f"module 'classic_ml.series' has no attribute {name!r}")
    return getattr(import_module("classic_ml.readers.series_files"), name)


_SIGNALS = {
    "phi": ("φ", 1.0, ""),
    "psi_p": ("ψ'", 1.0, ""),
    "psi": ("ψ", 1.0, ""),
    "T25_K": ("T25", 1.0, " K"),
    "Nc_frac": ("corrected speed", 100.0, " % of design"),
}


def series_fields(series: CoefficientSeries) -> tuple[Field, ...]:
    """Return what is shown of a series.

    Parameters
    ----------
    series : CoefficientSeries
        The series.
    """
    fitted = int(np.count_nonzero(series.segment))
    segments = f"{series.n_segments} segment{'' if series.n_segments == 1 else 's'}"
    fields = [
        Field("rows", f"{series.n_samples} at {series.sample_rate_hz:g} Hz"),
        Field("facility clock", f"{series.time_s[0]:.3f} to {series.time_s[-1]:.3f} s"),
        Field("to be fitted", f"{fitted} rows in {segments}"),
    ]
    for name, (label, factor, unit) in _SIGNALS.items():
        values = getattr(series, name)
        if values is not None:
            fields.append(Field(label, f"{_range(values, factor)}{unit}"))
    if series.in_stall is not None:
        fields.append(Field("in stall", f"{100.0 * float(np.mean(series.in_stall)):.0f} % of rows"))
    if series.free_run is not None:
        scored = int(np.count_nonzero(series.free_run == 2))
        fields.append(Field("whole run", f"unfiltered columns are there; {scored} rows scored"))
    fields.append(Field("ledger", ledger_words(series.history)))
    return tuple(fields)


def _range(values: NDArray[np.float64], factor: float) -> str:
    low, high = factor * float(np.min(values)), factor * float(np.max(values))
    return f"{significant(low, 3)} to {significant(high, 3)}"
