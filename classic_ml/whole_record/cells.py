"""The stall cells that turn past the rakes: their frequency, and the planes without them.

Two rakes read the same surge and other phases of the cells, so that their difference holds the
cells alone. What of a plane's average follows that difference is subtracted from it: nothing is
averaged over a period of the cells, which would smear the passes that hold τ.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from classic_ml.filters import period_average
from classic_ml.whole_record.rakes import Planes, RakeSignals
from surge_core.segments import runs_of
from surge_core.types import BoolArray, FloatArray

# A cell passes the rakes some ten to some two hundred times a second; the upper end is where the
# sampled line still has ten samples in four periods.
LOWEST_HZ, HIGHEST_SHARE = 30.0, 0.4
PIECE_S = 0.5
# Taps of half a period and a little more to either side reach every phase of the cell.
REACH_PERIODS = 0.6
# Of the mean power of the taps: their neighbours are nearly alike.
RIDGE = 1e-3


def cell_frequency_hz(signals: RakeSignals, rows: BoolArray) -> float | None:
    """Return the frequency of the strongest line in the difference of two rakes.

    Parameters
    ----------
    signals : RakeSignals
        The record.
    rows : ndarray of bool, shape (n,)
        Rows that count.

    Returns
    -------
    float or None
        None without a second rake or without rows enough.
    """
    from scipy.signal import welch

    differences = signals.cell_differences(25)
    rate_hz = 1.0 / signals.sample_period_s
    fewest = round(PIECE_S * rate_hz)
    power: FloatArray | float = 0.0
    for run in runs_of(rows, rows.size):
        if differences and rows[run.start] and run.stop - run.start >= fewest:
            piece = differences[0][run]
            frequency, density = welch(piece - np.mean(piece), rate_hz, nperseg=fewest)
            power = power + density * piece.size
    if isinstance(power, float):
        return None
    inside = np.flatnonzero((frequency > LOWEST_HZ) & (frequency < HIGHEST_SHARE * rate_hz))
    top = inside[np.argmax(power[inside])]
    before, peak, after = power[top - 1 : top + 2]
    # The summit of the parabola through the three highest values.
    move = 0.5 * (before - after) / (before - 2.0 * peak + after)
    return float(frequency[top] + move * (frequency[1] - frequency[0]))


@dataclass(frozen=True)
class _Taps:
    """The rake differences of a plane at lags of both signs, without what is slower than a cell."""

    columns: FloatArray
    period_s: float
    rate_hz: float

    def cells_of(self, average: FloatArray, rows: BoolArray) -> FloatArray:
        """Return the part of a plane's average that follows the differences, fitted on rows."""
        quick = average - period_average(average, self.period_s, self.rate_hz)
        inside = self.columns[rows]
        normal = inside.T @ inside
        normal += RIDGE * np.trace(normal) / normal.shape[0] * np.eye(normal.shape[0])
        return np.asarray(self.columns @ np.linalg.solve(normal, inside.T @ quick[rows]))


def without_cells(
    signals: RakeSignals, in_stall: BoolArray, rows: BoolArray, cell_hz: float | None
) -> Planes:
    """Return the planes with the stall cells cancelled.

    Parameters
    ----------
    signals : RakeSignals
        The record.
    in_stall : ndarray of bool, shape (n,)
        Rows in stall, from which the cells are subtracted.
    rows : ndarray of bool, shape (n,)
        Rows that count.
    cell_hz : float or None
        Frequency of the cells; None leaves the planes as they are.
    """
    planes = signals.planes()
    fitted = in_stall & rows
    if cell_hz is None or np.count_nonzero(fitted) * signals.sample_period_s < PIECE_S:
        return planes
    inlet, exit_ = (_taps(signals, plane, cell_hz) for plane in (25, 31))

    def cleaned(average: FloatArray, taps: _Taps | None) -> FloatArray:
        if taps is None:
            return average
        return average - taps.cells_of(average, fitted)

    return Planes(
        cleaned(planes.corrected_kg_s, inlet),
        cleaned(planes.inlet_Pa, inlet),
        cleaned(planes.exit_Pa, exit_),
    )


def _taps(signals: RakeSignals, plane: int, cell_hz: float) -> _Taps | None:
    differences = signals.cell_differences(plane)
    if not differences:
        return None
    period_s, rate_hz = 1.0 / cell_hz, 1.0 / signals.sample_period_s
    reach = round(REACH_PERIODS * period_s * rate_hz)
    columns = []
    for difference in differences:
        quick = difference - period_average(difference, period_s, rate_hz)
        padded = np.pad(quick, reach)
        columns.append(np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1))
    return _Taps(np.hstack(columns), period_s, rate_hz)
