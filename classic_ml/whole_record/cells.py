"""The stall cells that turn past the rakes: their frequency, and the planes without them.

Two rakes read the same surge and other phases of the cells, so that their difference holds the
cells alone. What of a plane's average follows that difference is subtracted from it: nothing is
averaged over a period of the cells, which would smear the passes that hold τ.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

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

    None without a second rake, or without enough ``rows`` that count.
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


def without_cells(
    signals: RakeSignals, in_stall: BoolArray, rows: BoolArray, cell_hz: float | None
) -> Planes:
    """Return the planes without the stall cells, which are fitted in stall on ``rows`` that count.

    Without a frequency of the cells the planes are left as they are.
    """
    planes = signals.planes()
    fitted = in_stall & rows
    if cell_hz is None or np.count_nonzero(fitted) * signals.sample_period_s < PIECE_S:
        return planes
    period_s, rate_hz = 1.0 / cell_hz, 1.0 / signals.sample_period_s
    reach = round(REACH_PERIODS * period_s * rate_hz)

    def quick(values: FloatArray) -> FloatArray:
        return values - period_average(values, period_s, rate_hz)

    def cleaned(plane: int, *averages: FloatArray) -> list[FloatArray]:
        padded = [np.pad(quick(each), reach) for each in signals.cell_differences(plane)]
        if not padded:
            return list(averages)
        # The rake differences at lags of both signs, without what is slower than a cell.
        taps = np.hstack([sliding_window_view(each, 2 * reach + 1) for each in padded])
        inside = taps[fitted]
        normal = inside.T @ inside
        normal += RIDGE * np.trace(normal) / normal.shape[0] * np.eye(normal.shape[0])
        shares = [np.linalg.solve(normal, inside.T @ quick(each)[fitted]) for each in averages]
        return [each - taps @ share for each, share in zip(averages, shares, strict=True)]

    return Planes(
        *cleaned(25, planes.corrected_kg_s, planes.inlet_Pa), *cleaned(31, planes.exit_Pa)
    )
