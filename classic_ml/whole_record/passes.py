"""The rows that a free run passes: after the first reversal, without what no probe can read.

And without the stall cells that turn past the rakes. Two rakes read the same surge and other phases
of the cells, so that their difference holds the cells alone. What of a plane's average follows that
difference is subtracted from it: nothing is averaged over a period of the cells, which would smear
the passes that hold τ.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from classic_ml.filters import period_average
from classic_ml.segments import (
    HIGHEST_SHARE,
    PLAIN_PERIOD_S,
    lowest_cell_hz,
    near,
    stall_by_shift,
)
from classic_ml.whole_record.rakes import Planes, RakeSignals
from surge_core.errors import InputError
from surge_core.segments import intervals_where, runs_of
from surge_core.types import BoolArray, FloatArray, IntArray

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
    for start, stop in intervals_where(rows).tolist():
        if differences and stop - start >= fewest:
            # Of total pressure: near zero flow hum grows in the flow (18 kg/s of hum to 6 of the
            # cells on a record where it was 0.6 to 5 kPa in pressure).
            piece = differences[-1][0][start:stop]
            frequency, density = welch(piece - np.mean(piece), rate_hz, nperseg=fewest)
            power = power + density * piece.size
    if isinstance(power, float):
        return None
    lowest_hz = lowest_cell_hz(signals.chain.rotor_speed_rpm)
    inside = np.flatnonzero((frequency > lowest_hz) & (frequency < HIGHEST_SHARE * rate_hz))
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
        padded = [np.pad(quick(each), reach) for each, _ in signals.cell_differences(plane)]
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


# An overload is over when the thermocouple's answer to it is: five of its 10 ms; and the flow that
# leads into it belongs to it.
BEFORE_OVERLOAD_S, AFTER_OVERLOAD_S = 0.02, 0.05
SHORTEST_PIECE_S = 0.1
END_S = 0.01
# Unstalled for longer than this the machine does not surge: the beginning is enough.
LONGEST_QUIET_S, QUIET_KEPT_S, QUIET_END_S = 0.25, 0.1, 0.05
# Hub and tip change over within half a cell period: shorter episodes are chance.
SHORTEST_STATE_S = 0.007
SPEED_AVERAGE_S = 0.02


@dataclass(frozen=True)
class Passes:
    """The signals of a free run, arrays of shape (n,), one piece behind the other."""

    row: IntArray  # Rows of the record
    piece: IntArray  # Number of the piece of each row, from 0 on; the run starts again in each
    phi: FloatArray  # φ and ψ' without the stall cells
    psi_p: FloatArray
    speed: FloatArray  # N_c less its mean
    in_stall: BoolArray  # State by hub and tip alone; where the record does not show it, True
    shift: FloatArray | None  # Hub-minus-tip flow, averaged over one period of the cells
    period_s: float  # That period
    sample_period_s: float
    planes: Planes  # The cleaned planes over the whole record

    @cached_property
    def pieces(self) -> list[slice]:
        """Rows of each piece."""
        return runs_of(self.piece, self.piece.size)

    def smooth(self, values: FloatArray, seconds: float) -> FloatArray:
        """Return the average over so many seconds around each row, within its piece."""
        out = np.empty(values.size)
        for piece in self.pieces:
            own = np.asarray(values[piece], dtype=np.float64)
            out[piece] = period_average(own, seconds, 1.0 / self.sample_period_s)
        return out

    def rows_of(self, seconds: float) -> int:
        """Return how many samples so many seconds have."""
        return round(seconds / self.sample_period_s)

    @cached_property
    def cycle(self) -> IntArray:
        """Number of the surge cycle of each row: from one rise of φ to the next, or a new piece."""
        phi = self.smooth(self.phi, self.period_s)
        low, middle, high = np.percentile(phi, [20.0, 50.0, 80.0])
        # Between low and high the flow has not come back yet.
        level = np.where(
            phi > 0.5 * (middle + high), 1, np.where(phi < 0.5 * (low + middle), -1, 0)
        )
        last = np.maximum.accumulate(np.where(level != 0, np.arange(phi.size), 0))
        risen = level[last] > 0
        begins = np.zeros(phi.size, dtype=np.bool_)
        begins[1:] = (risen[1:] & ~risen[:-1]) | (self.piece[1:] != self.piece[:-1])
        return np.asarray(np.cumsum(begins), dtype=np.int64)


def passes_of(signals: RakeSignals, window: slice | None = None) -> Passes:
    """Choose the rows of a free run, within a window if given, and cancel the stall cells in them.

    A record whose flow never reverses is refused, and one without a piece that is long enough.
    """
    rate_hz = 1.0 / signals.sample_period_s
    flow = signals.mean(signals.flow_kg_s, 25)
    reversed_ = np.flatnonzero(flow < 0.0)
    over = signals.overloaded()
    over = near(over, round(BEFORE_OVERLOAD_S * rate_hz), round(AFTER_OVERLOAD_S * rate_hz))
    usable = ~over
    if window is not None:
        usable[: window.start] = False
        usable[window.stop :] = False
    usable[: _first_forward(flow, reversed_, rate_hz)] = False
    usable[flow.size - round(END_S * rate_hz) :] = False
    cell_hz = cell_frequency_hz(signals, usable)
    period_s = PLAIN_PERIOD_S if cell_hz is None else 1.0 / cell_hz
    shift = signals.hub_minus_tip()
    state = np.ones(flow.size, dtype=np.bool_)
    if shift is not None and usable.any():
        shift = period_average(shift, period_s, rate_hz)
        # A record that continues another begins in surge.
        begins = reversed_.size and signals.chain.near_stall_rows < flow.size
        state, _ = stall_by_shift(shift, usable, int(reversed_[0]) if begins else 0)
        state = _without_short(state, round(SHORTEST_STATE_S * rate_hz))
    for start, stop in intervals_where(~state).tolist():
        if stop - start > LONGEST_QUIET_S * rate_hz:
            first = start + round(QUIET_KEPT_S * rate_hz)
            usable[first : max(first, stop - round(QUIET_END_S * rate_hz))] = False
    planes = without_cells(signals, state, usable, cell_hz)
    phi, psi_p, speed = signals.coefficients(planes)
    usable &= np.isfinite(psi_p)
    runs = intervals_where(usable)
    runs = runs[runs[:, 1] - runs[:, 0] >= SHORTEST_PIECE_S * rate_hz]
    if not runs.size:
        raise InputError(
            "free run",
            expected=f"{SHORTEST_PIECE_S:g} s of readings that count after the first reversal",
            found="none" if reversed_.size else "no reversal of the flow",
        )
    row = np.concatenate([np.arange(*ends) for ends in runs])
    piece = np.repeat(np.arange(len(runs)), runs[:, 1] - runs[:, 0])
    speed = period_average(speed, SPEED_AVERAGE_S, rate_hz)[row]
    return Passes(
        row,
        piece,
        phi[row],
        psi_p[row],
        speed - float(np.mean(speed)),
        state[row],
        None if shift is None else shift[row],
        period_s,
        signals.sample_period_s,
        planes,
    )


def _first_forward(flow: FloatArray, reversed_: IntArray, rate_hz: float) -> int:
    """Return the row in which the flow has come back after the first blowdown."""
    if not reversed_.size:
        return int(flow.size)
    slow = period_average(flow, 0.02, rate_hz)
    first = int(reversed_[0])
    back = np.flatnonzero((slow[first + 1 :] > 0.0) & (slow[first:-1] <= 0.0))
    return first + 1 + int(back[0]) if back.size else first


def _without_short(state: BoolArray, fewest: int) -> BoolArray:
    """Give episodes of few rows the state around them, the unstalled ones first."""
    out = state.copy()
    for kind in (False, True):
        for run in runs_of(out, out.size):
            inner = run.start > 0 and run.stop < out.size
            if inner and out[run.start] == kind and run.stop - run.start < fewest:
                out[run] = not kind
    return out
