"""The quasi-steady surge cycles of a record."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.signal import find_peaks

from classic_ml.filters import filter_channels
from classic_ml.flow import LBM_KG
from classic_ml.records import Record
from surge_core.errors import InputError
from surge_core.segments import intervals_where
from surge_core.types import BoolArray, FloatArray, IntArray

# Surge is below 20 Hz; what lies above (cells, noise) must not make peaks of its own.
CYCLE_BAND_HZ = 30.0
# A cycle fills and empties the plenum: P31 rises by at least this share of its mean.
LEAST_SWING = 0.15
# What it rises above is looked for so far around it, which is many of the slowest cycles.
SURROUNDINGS_S = 60.0
# Between deep cycles the machine may oscillate mildly in stall; a cycle has at least this share
# of the deepest one's rise.
DEEP_SHARE = 0.5
# A machine in deep surge pumps again in every cycle, so that its flow swings by 0.58 to 0.89 of
# what it was before, in all cycles of the simulated cases at 90 to 98.5 % speed, whether they leave
# stall or not. In stall before them it oscillates too, by 0.33 at most and running backwards now
# and then, for ten cycles and more: they alone are in a record that ends early.
LEAST_FLOW_SWING = 0.45
# Ten or twelve of those come before the first deep cycle. Where so many follow one another and no
# deep one, they are the surge of this machine: small limit cycles about its stalled branch.
MANY_MILD = 30
# How far a cycle may be from the median of the record and still repeat it.
RISE_SPREAD = 0.3
PERIOD_SPREAD = 0.4
# The inlet heats up after the first reversal; settled when N_c is this near its later median.
SPEED_SPREAD = 0.025
MINIMUM_CYCLES = 3
FEW_CYCLES = 6


@dataclass(frozen=True)
class SurgeCycles:
    """The repetitive cycles of a record, from trough to trough of P31.

    Their period is the median one; ``left_out`` cycles before or after do not repeat the others.
    ``flow_swing`` is how far the flow swings in the median cycle, as a share of its level before
    the surge; infinite where nothing was before.
    """

    from_s: float
    to_s: float
    n_cycles: int
    period_s: float
    first_reversal_s: float
    left_out: int
    flow_swing: float

    @property
    def mild(self) -> bool:
        """Whether the machine oscillates in stall rather than surge deeply."""
        return self.flow_swing < LEAST_FLOW_SWING


def find_cycles(record: Record) -> SurgeCycles:
    """Find the quasi-steady surge cycles of a record.

    A cycle is a rise of P31 by at least half of the deepest one's in which the flow swings by about
    half of what it was before the surge, unless the machine does nothing else but oscillate less
    for many cycles, or surges deeply too seldom between many smaller loops; those that count agree
    with the others in rise, period and corrected speed, and follow one another without a break. A
    record without surge, or with fewer than three such cycles, is refused.
    """
    slow, start = _slow(record, "Wc25_kg_s", "P31_Pa"), first_reversal(record)
    if start is None:
        raise InputError(
            f"{record.source}: plane 25",
            expected="reversed flow, with which every deep surge begins",
            found="no surge that reverses it, the corrected flow stays above "
            f"{slow['Wc25_kg_s'].min() / LBM_KG:.1f} lbm/s",
            remedy="where the machine is in rotating stall without surge name the rows ([window] "
            "from_s, to_s); else check units and zero readings of the probes at plane 25",
        )
    pressure = slow["P31_Pa"]
    after = pressure[start:]
    around = max(3, round(SURROUNDINGS_S * record.sample_rate_hz))
    least = LEAST_SWING * float(np.median(after))
    peaks, found = find_peaks(after, prominence=least, wlen=around)
    peaks, rises = peaks + start, found["prominences"]
    if peaks.size == 0:
        raise InputError(
            f"{record.source}: P31",
            expected="surge cycles after the first reversal of the flow",
            found=f"no rise of P31 by {LEAST_SWING:.0%} of its mean with a fall behind it",
            remedy="take a record, or a part, that surges: `sindy-surge inspect` says when it does",
        )
    deep = deep_ones(rises)
    try:
        return _repeating(record, slow, peaks[deep], rises[deep], start)
    except InputError:
        if np.count_nonzero(~deep) < MANY_MILD:
            raise
        return _repeating(record, slow, peaks, rises, start)


def _repeating(
    record: Record, slow: Record, peaks: IntArray, rises: FloatArray, start: int
) -> SurgeCycles:
    """Return the longest run of cycles that repeat each other among the rises of P31."""
    pressure = slow["P31_Pa"]
    swings = _swings(slow, _troughs(pressure, peaks, start), start)
    pumping = swings >= LEAST_FLOW_SWING
    mild = int(np.count_nonzero(~pumping))
    if np.count_nonzero(pumping) < MINIMUM_CYCLES and mild >= MANY_MILD:
        pumping[:] = True
    peaks, rises, swings = peaks[pumping], rises[pumping], swings[pumping]
    if peaks.size < MINIMUM_CYCLES:
        raise _too_few(record, peaks.size, f" beside {mild} mild oscillations in stall")
    edges = _troughs(pressure, peaks, start)
    runs = intervals_where(_repeats(record, peaks, rises, edges))
    lengths = np.diff(runs, axis=1)
    if np.max(lengths, initial=0) < MINIMUM_CYCLES:
        raise _too_few(record, int(np.max(lengths, initial=0)))
    first, last = runs[np.argmax(lengths)].tolist()
    return SurgeCycles(
        from_s=record.time_at_s(int(edges[first])),
        to_s=record.time_at_s(int(edges[last])),
        n_cycles=last - first,
        period_s=float(np.median(np.diff(peaks[first:last]))) / record.sample_rate_hz,
        first_reversal_s=record.time_at_s(start),
        left_out=int(peaks.size - (last - first)),
        flow_swing=float(np.median(swings[first:last])),
    )


def first_reversal(record: Record) -> int | None:
    """Return the row at which the flow at plane 25 first runs backwards; None without one."""
    backwards = _slow(record, "Wc25_kg_s")["Wc25_kg_s"] < 0.0
    return int(np.argmax(backwards)) if backwards.any() else None


def deep_ones(rises: FloatArray) -> BoolArray:
    """Return which rises of P31 are those of cycles: at least half of the deepest one's."""
    # The second deepest of many, so that one freak cycle does not set the scale.
    scale = np.sort(rises)[-2:][0]
    return np.asarray(rises >= DEEP_SHARE * scale)


def _slow(record: Record, *names: str) -> Record:
    """Return the record with what is too fast for surge taken out of some channels."""
    if record.sample_rate_hz <= 4.0 * CYCLE_BAND_HZ:
        return record
    return filter_channels(record, names, order=3, cutoff_hz=CYCLE_BAND_HZ, phase="zero")


def _swings(slow: Record, edges: IntArray, start: int) -> FloatArray:
    """Return by how much of its level before the surge the flow swings between each two edges."""
    if start == 0:
        # Nothing was before.
        return np.full(edges.size - 1, np.inf)
    flow = slow["Wc25_kg_s"]
    inside, first = flow[: edges[-1]], edges[:-1]
    swing = np.maximum.reduceat(inside, first) - np.minimum.reduceat(inside, first)
    return np.asarray(swing / np.median(flow[:start]))


def _troughs(pressure: FloatArray, peaks: IntArray, start: int) -> IntArray:
    """Rows of least P31 before, between and after the peaks: one more than there are peaks."""
    period = int(np.median(np.diff(peaks))) if peaks.size > 1 else pressure.size
    first = max(start, int(peaks[0]) - period)
    last = min(pressure.size, int(peaks[-1]) + period)
    bounds = [first, *peaks.tolist(), last]
    return np.array([low + np.argmin(pressure[low:high]) for low, high in pairwise(bounds)])


def _repeats(record: Record, peaks: IntArray, rises: FloatArray, edges: IntArray) -> BoolArray:
    lengths = np.diff(edges).astype(np.float64)
    speeds = np.add.reduceat(record["Nc_frac"][: edges[-1]], edges[:-1]) / lengths
    later = speeds[speeds.size // 2 :]
    good = np.abs(rises / np.median(rises) - 1.0) <= RISE_SPREAD
    good &= np.abs(lengths / np.median(np.diff(peaks)) - 1.0) <= PERIOD_SPREAD
    good &= np.abs(speeds - np.median(later)) <= SPEED_SPREAD
    return np.asarray(good)


def _too_few(record: Record, found: int, beside: str = "") -> InputError:
    return InputError(
        f"{record.source}: P31",
        expected=f"at least {MINIMUM_CYCLES} surge cycles that repeat each other",
        found=f"{found}{beside}",
        remedy="name the window in test.toml ([window] from_s, to_s) if there are more",
    )
