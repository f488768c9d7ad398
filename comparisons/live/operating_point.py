"""Counts to operating point, causally: each row from itself and the rows before it.

This is `sindy-surge reduce --phase causal` over rows that keep coming: the same calibration, one
pass of the same low-pass over every channel, Eq 1 to 5 and 7. dW25/dt in ψ' is a central
difference, so that the operating point is known one row late.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from classic_ml.calibration import calibrate
from classic_ml.coefficients import (
    corrected_speed_fraction,
    flow_coefficient,
    pressure_coefficient,
    rate_of_change,
)
from classic_ml.filters import phase_delay_s
from classic_ml.planes import local_flows, plane_averages
from classic_ml.records import Channel, LedgerEntry, Record
from comparisons.live.columns import FeedColumns
from comparisons.live.near_stall import NearStallMatch
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["CUTOFF_HZ", "ORDER", "CausalChain", "OperatingPoints", "low_pass_delay_s"]

# The low-pass of the reduction (ReductionSettings), run once.
ORDER = 3
CUTOFF_HZ = 48.0
# The surge frequencies at which the delay is stated.
SURGE_HZ = 10.0


def low_pass_delay_s(rate_hz: float) -> float:
    """Return by how much one pass of the low-pass is late at surge frequencies.

    Parameters
    ----------
    rate_hz : float
        Sample rate.

    Returns
    -------
    float
        Phase delay at 10 Hz, in seconds; 0 for records too slow to be filtered.
    """
    if not _is_filtered(rate_hz):
        return 0.0
    return phase_delay_s(SURGE_HZ, rate_hz, order=ORDER, cutoff_hz=CUTOFF_HZ)


def _is_filtered(rate_hz: float) -> bool:
    # A record too slow for the low-pass has nothing above it to be taken out.
    return rate_hz > 2.0 * CUTOFF_HZ


@dataclass(frozen=True)
class OperatingPoints:
    """Operating points of rows that follow one another; NaN where a row has none.

    Parameters
    ----------
    time_s : ndarray of shape (n,)
        Facility clock.
    Wc25_kg_s, P25_Pa, P31_Pa, T25_K : ndarray of shape (n,)
        Corrected inlet flow, total pressures and inlet temperature.
    phi, psi_p, Nc_frac : ndarray of shape (n,)
        φ, ψ' and the corrected speed.
    """

    time_s: FloatArray
    Wc25_kg_s: FloatArray
    P25_Pa: FloatArray
    P31_Pa: FloatArray
    T25_K: FloatArray
    phi: FloatArray
    psi_p: FloatArray
    Nc_frac: FloatArray

    @property
    def pressure_ratio(self) -> FloatArray:
        """P31/P25."""
        return self.P31_Pa / self.P25_Pa

    def __len__(self) -> int:
        return int(self.time_s.size)

    def part(self, rows: slice) -> OperatingPoints:
        """Return some of the rows."""
        return OperatingPoints(*(getattr(self, f.name)[rows] for f in fields(self)))


class CausalChain:
    """Turn rows of channels into operating points, keeping its state between batches.

    Parameters
    ----------
    columns : FeedColumns
        The channels.
    match : NearStallMatch
        Where the shifts of the near-stall match come from.
    """

    def __init__(self, columns: FeedColumns, match: NearStallMatch) -> None:
        from scipy.signal import butter

        rate_hz = columns.test.sample_rate_hz
        self._columns = columns
        self._match = match
        self._sections = (
            butter(ORDER, CUTOFF_HZ, fs=rate_hz, output="sos") if _is_filtered(rate_hz) else None
        )
        self._state: FloatArray | None = None
        self._planes: FloatArray | None = None
        self.left_out: frozenset[str] = frozenset()
        self.problem = ""

    def restart(self) -> None:
        """Begin anew behind a gap."""
        self._state = self._planes = None

    def take(self, time_s: FloatArray, readings: FloatArray) -> OperatingPoints:
        """Return the operating points that are known by now.

        Parameters
        ----------
        time_s : ndarray of shape (n,)
            Clock of rows that follow on those before.
        readings : ndarray of shape (n, n_channels)
            Counts, Pa and K.

        Returns
        -------
        OperatingPoints
            Of all rows but the last.
        """
        test = self._columns.test
        record = calibrate(self._columns.record(readings, float(time_s[0])), test)
        record = self._shifted(self._filtered(record))
        try:
            averages = self._plane_averages(record)
            self.problem = ""
        except InputError as error:
            self.problem = str(error)
            averages = np.full((time_s.size, len(_AVERAGES)), np.nan)
        rows = np.column_stack([time_s, averages])
        begins = self._planes is None or len(self._planes) < 2
        if self._planes is not None:
            rows = np.concatenate([self._planes, rows])
        self._planes = rows[-2:]
        return self._points(rows, 0 if begins else 1)

    def _filtered(self, record: Record) -> Record:
        if self._sections is None:
            return record
        from scipy.signal import sosfilt, sosfilt_zi

        names = tuple(record.channels)
        values = np.column_stack([record[name] for name in names])
        if self._state is None:
            self._state = sosfilt_zi(self._sections)[:, :, None] * values[0]
        filtered, self._state = sosfilt(self._sections, values, axis=0, zi=self._state)
        add = [
            Channel(name, column, record.channel(name).unit)
            for name, column in zip(names, filtered.T, strict=True)
        ]
        return record.after(LedgerEntry("filter", "causal"), add=add)

    def _shifted(self, record: Record) -> Record:
        shifts = self._match.shifts or {}
        add = [
            Channel(name, record[name] + shift, record.channel(name).unit)
            for name, shift in shifts.items()
            if shift
        ]
        return record.after(LedgerEntry("near-stall match", "as known"), add=add)

    def _plane_averages(self, record: Record) -> FloatArray:
        test = self._columns.test
        dropped = record.after(LedgerEntry("faults", "as known"), drop=self.left_out)
        planes = plane_averages(local_flows(dropped, test), test)
        return np.column_stack([planes[name] for name in _AVERAGES])

    def _points(self, rows: FloatArray, first: int) -> OperatingPoints:
        """Return the points of rows with a neighbour on either side, or none before the first."""
        test = self._columns.test
        time_s, Wc25, P25, P31, T25, W25 = rows.T
        kept = slice(first, len(rows) - 1)
        if len(rows) < 2:
            return OperatingPoints(*(np.empty(0) for _ in fields(OperatingPoints)))
        machine, speed = test.compressor, test.rotor_velocity_m_s
        slope = rate_of_change(W25, 1.0 / test.sample_rate_hz)
        try:
            phi = flow_coefficient(Wc25, T25, test.areas_m2[25], speed, machine)
            psi_p = pressure_coefficient(
                P25, P31, T25, slope, machine.inertia_per_m, speed, machine
            )
        except InputError as error:
            self.problem = str(error)
            phi = psi_p = np.full(time_s.size, np.nan)
        speed_share = corrected_speed_fraction(T25, test)
        return OperatingPoints(time_s, Wc25, P25, P31, T25, phi, psi_p, speed_share).part(kept)


_AVERAGES = ("Wc25_kg_s", "P25_Pa", "P31_Pa", "T25_K", "W25_kg_s")
