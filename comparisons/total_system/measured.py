"""What was measured, as the total-system fit takes it: three outputs and the surge start."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from classic_ml.description import TestDescription
from classic_ml.filters import period_average
from classic_ml.flow import physical_flow
from classic_ml.records import Record
from classic_ml.reduction import ReductionSettings, reduce_record
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["Measured", "first_reversal_s", "measured_signals"]

# Noise would cross zero early. The collapse takes 17 ms: an average over 3 ms moves its zero by
# less than one.
_CROSSING_S = 0.003


@dataclass(frozen=True)
class Measured:
    """The signals of one record, without a low-pass filter before the flow equations.

    Parameters
    ----------
    test : TestDescription
        The test.
    time_s : ndarray of shape (n,)
        Clock of the record.
    W25, P25, P31, T25 : ndarray of shape (n,)
        Flow in kg/s, pressures in Pa, temperature in K.
    near_stall_flow_kg_s : float
        Mean flow of the near-stall reading.
    reversal_s : float
        When the flow first runs backwards.
    """

    test: TestDescription
    time_s: FloatArray
    W25: FloatArray
    P25: FloatArray
    P31: FloatArray
    T25: FloatArray
    near_stall_flow_kg_s: float
    reversal_s: float

    @property
    def outputs(self) -> FloatArray:
        """P31, P25 and W25, of shape (n, 3), in this order."""
        return np.column_stack([self.P31, self.P25, self.W25])

    def rows(self, from_s: float, to_s: float) -> slice:
        """Return the rows from one time to another."""
        first, last = np.searchsorted(self.time_s, (from_s - 1e-9, to_s + 1e-9))
        return slice(int(first), int(last))


def measured_signals(record: Record, test: TestDescription) -> Measured:
    """Take the signals of the fit out of a record.

    Parameters
    ----------
    record : Record
        A raw record, which is reduced without a low-pass filter; or a record of ``W25_kg_s``,
        ``P25_Pa``, ``P31_Pa`` and ``T25_K``.
    test : TestDescription
        The test it belongs to.

    Raises
    ------
    InputError
        When a channel is missing, no near-stall reading is in the record, or the flow never
        reverses.
    """
    if all(name in record for name in test.channel_names):
        settings = ReductionSettings(phase="none", thermocouple_inversion=True)
        record = reduce_record(record, test, settings).record
        p25, p31 = record["P25_unfiltered_Pa"], record["P31_unfiltered_Pa"]
        t25 = record["T25_K"]
        w25 = physical_flow(record["Wc25_unfiltered_kg_s"], p25, t25)
    else:
        w25, p25, p31, t25 = (record[n] for n in ("W25_kg_s", "P25_Pa", "P31_Pa", "T25_K"))
    near, time_s = test.near_stall, record.time_s
    reading = (time_s >= near.from_s) & (time_s <= near.to_s)
    if not np.any(reading):
        raise InputError(
            record.source,
            expected=f"the near-stall reading of {near.from_s:g} to {near.to_s:g} s in the record",
            found=f"{time_s[0]:g} to {time_s[-1]:g} s",
        )
    smooth = period_average(w25, _CROSSING_S, record.sample_rate_hz)
    reversal_s = first_reversal_s(time_s, smooth)
    if reversal_s is None:
        raise InputError(
            f"{record.source}: plane 25",
            expected="a record that begins before the first reversal of the flow and holds it",
            found="reversed flow in the first row" if w25[0] < 0.0 else "no reversed flow",
            remedy="the total-system method needs the start of the surge",
        )
    flow = float(np.mean(w25[reading]))
    return Measured(test, time_s, w25, p25, p31, t25, flow, reversal_s)


def first_reversal_s(time_s: FloatArray, flow: FloatArray) -> float | None:
    """Return when a flow first crosses zero, between two rows; None where it does not."""
    back = np.flatnonzero(~(flow > 0.0))
    if back.size == 0 or back[0] == 0 or not np.isfinite(flow[back[0]]):
        return None
    i = int(back[0])
    share = flow[i - 1] / (flow[i - 1] - flow[i])
    return float(time_s[i - 1] + share * (time_s[i] - time_s[i - 1]))
