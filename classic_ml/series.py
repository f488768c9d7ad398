"""CoefficientSeries: φ, ψ' and ψ over time, as the estimators take them."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from classic_ml.clock import uniform_period_s
from classic_ml.errors import InputError
from classic_ml.records import FloatArray, LedgerEntry

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
TRUTH_COLUMNS = ("in_stall", "stalled")
COUNT_COLUMNS = ("segment", "free_run")
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
class CoefficientSeries:
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

    def __post_init__(self) -> None:
        for name in COLUMNS:
            values = getattr(self, name)
            if values is not None:
                object.__setattr__(self, name, _frozen_column(name, values, self.source))
        _check_lengths(self)
        uniform_period_s(self.time_s, f"{self.source}: column time_s")
        _check_values(self)

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


def _frozen_column(name: str, values: NDArray[np.generic], source: str) -> NDArray[np.generic]:
    column: NDArray[np.generic]
    numbers = np.asarray(values, dtype=np.float64)
    if numbers.ndim != 1:
        raise InputError(
            f"{source}: column {name}",
            expected="one value a row",
            found=f"shape {numbers.shape}",
        )
    bad = np.flatnonzero(~np.isfinite(numbers))
    if bad.size:
        raise InputError(
            f"{source}: column {name}",
            expected="a finite number in every row",
            found=f"{numbers[bad[0]]} in row {bad[0] + 1}"
            + (f" and {bad.size - 1} more" if bad.size > 1 else ""),
            remedy="cut the record there or repair the channel",
        )
    if name in COUNT_COLUMNS:
        if np.any(numbers != np.round(numbers)) or np.any(numbers < 0):
            raise InputError(
                f"{source}: column {name}",
                expected="whole numbers from 0 on",
                found=f"{numbers[(numbers != np.round(numbers)) | (numbers < 0)][0]}",
            )
        column = numbers.astype(np.int64)
    elif name in TRUTH_COLUMNS:
        if not np.all(np.isin(numbers, (0.0, 1.0))):
            raise InputError(
                f"{source}: column {name}",
                expected="0 or 1",
                found=f"{numbers[~np.isin(numbers, (0.0, 1.0))][0]}",
            )
        column = numbers.astype(np.bool_)
    else:
        column = numbers.copy()
    column.setflags(write=False)
    return column


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


def _check_values(series: CoefficientSeries) -> None:
    columns = series.columns()
    for name, (low, high) in POSSIBLE.items():
        if name not in columns:
            continue
        values = columns[name].astype(np.float64)
        bad = np.flatnonzero((values < low) | (values > high))
        if bad.size:
            raise InputError(
                f"{series.source}: column {name}",
                expected=f"values between {low:g} and {high:g}{_shown_unit(name)}",
                found=f"{values[bad[0]]:g} in row {bad[0] + 1}",
                remedy="check the units and the calibration",
            )
    for name in ("phi", "psi_p"):
        if np.ptp(columns[name]) == 0.0:
            raise InputError(
                f"{series.source}: column {name}",
                expected="a signal that moves",
                found=f"the constant {columns[name][0]:g}",
                remedy="a lag cannot be identified without excitation",
            )


def __getattr__(name: str) -> object:
    """Lend the names of the file functions, which need this module themselves."""
    if name not in ("ledger_path", "read_series", "write_series"):
        raise AttributeError(f"module 'classic_ml.series' has no attribute {name!r}")
    return getattr(import_module("classic_ml.readers.series_files"), name)
