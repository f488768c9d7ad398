"""What was measured, as the total-system fit takes it: three outputs, the states, the start."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from classic_ml.coefficients import flow_coefficient, pressure_coefficient
from classic_ml.description import TestDescription
from classic_ml.filters import period_average
from classic_ml.flow import corrected_from_physical, physical_flow
from classic_ml.records import Record
from classic_ml.reduction import reduce_record
from classic_ml.reduction_settings import ReductionSettings
from comparisons.total_system.model import (
    N_STATES,
    STEPS_PER_SECOND,
    TotalSystemModel,
    integrate,
    latches_of,
)
from surge_core.errors import InputError
from surge_core.types import FloatArray

# One period of the stall cells (82.5 Hz on this machine, claim 17) leaves no ripple.
SMOOTHING_S = 1.0 / 82.5
# The collapse takes 17 ms; a cell period would move its zero by 3 to 4 ms, 3 ms by less than one.
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
    window_s : tuple of float
        Quasi-steady cycles; all that follows the first reversal where they are not known.
    smoothing_s : float
        Width of the moving average behind states that are read off the record.
    source : str
        The record.
    """

    test: TestDescription
    time_s: FloatArray
    W25: FloatArray
    P25: FloatArray
    P31: FloatArray
    T25: FloatArray
    near_stall_flow_kg_s: float
    reversal_s: float
    window_s: tuple[float, float]
    smoothing_s: float
    source: str

    @property
    def period_s(self) -> float:
        """Sample period, in seconds."""
        return float(self.time_s[1] - self.time_s[0])

    @property
    def outputs(self) -> FloatArray:
        """P31, P25 and W25, of shape (n, 3), in this order."""
        return np.column_stack([self.P31, self.P25, self.W25])

    def smooth(self, values: FloatArray) -> FloatArray:
        """Return a signal averaged over the smoothing width."""
        return period_average(values, self.smoothing_s, 1.0 / self.period_s)

    def rows(self, from_s: float, to_s: float) -> slice:
        """Return the rows from one time to another."""
        first, last = np.searchsorted(self.time_s, (from_s - 1e-9, to_s + 1e-9))
        return slice(int(first), int(last))


def measured_signals(
    record: Record, test: TestDescription, smoothing_s: float = SMOOTHING_S
) -> Measured:
    """Take the signals of the fit out of a record.

    Parameters
    ----------
    record : Record
        A raw record, which is reduced without a low-pass filter; or a record of ``W25_kg_s``,
        ``P25_Pa``, ``P31_Pa`` and ``T25_K``.
    test : TestDescription
        The test it belongs to.
    smoothing_s : float
        Width of the moving average behind states that are read off the record; 0 for signals
        without noise.

    Raises
    ------
    InputError
        When a channel is missing, no near-stall reading is in the record, or the flow never
        reverses.
    """
    window: tuple[float, float] | None = None
    if all(name in record for name in test.channel_names):
        settings = ReductionSettings(phase="none", thermocouple_inversion=True)
        reduction = reduce_record(record, test, settings)
        window, record = reduction.window_s, reduction.record
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
    width = min(smoothing_s, _CROSSING_S)
    reversal_s = first_reversal_s(time_s, period_average(w25, width, record.sample_rate_hz))
    if reversal_s is None:
        raise InputError(
            f"{record.source}: plane 25",
            expected="a record that begins before the first reversal of the flow and holds it",
            found="reversed flow in the first row" if w25[0] < 0.0 else "no reversed flow",
            remedy="the total-system method needs the start of the surge",
        )
    flow, window = float(np.mean(w25[reading])), window or (reversal_s + SMOOTHING_S, time_s[-1])
    signals = (time_s, w25, p25, p31, t25)
    return Measured(test, *signals, flow, reversal_s, window, smoothing_s, record.source)


def first_reversal_s(time_s: FloatArray, flow: FloatArray) -> float | None:
    """Return when a flow first crosses zero, between two rows; None where it does not."""
    back = np.flatnonzero(~(flow > 0.0))
    if back.size == 0 or back[0] == 0 or not np.isfinite(flow[back[0]]):
        return None
    i = int(back[0])
    share = flow[i - 1] / (flow[i - 1] - flow[i])
    return float(time_s[i - 1] + share * (time_s[i] - time_s[i - 1]))


def observed_states(measured: Measured, model: TotalSystemModel) -> tuple[FloatArray, FloatArray]:
    """Return the model's states and stall latch at each row, as the measurement gives them.

    W25, P31 and the pressure of the inlet volume are read off; ψ' is that of the momentum
    equation without the unlagged reverse loss; the rest follows from the facility's balances, and ψ
    from the model's τ. States (n, 11) are in the order of `STATES`, latches (n, 4) branch, armed,
    since when and from which blend.
    """
    test, machine, c = measured.test, measured.test.compressor, model.constants()
    flow, p25, p31, t25 = (
        measured.smooth(v) for v in (measured.W25, measured.P25, measured.P31, measured.T25)
    )
    slope, velocity = np.gradient(flow, measured.period_s), test.rotor_velocity_m_s
    corrected = corrected_from_physical(flow, p25, t25)
    phi = flow_coefficient(corrected, t25, test.areas_m2[25], velocity, machine)
    psi_p = pressure_coefficient(p25, p31, t25, slope, machine.inertia_per_m, velocity, machine)
    lagged = psi_p - c.compressor_reverse_loss * np.minimum(phi, 0.0) ** 2
    p_in = p25 + c.loss * flow * np.abs(flow) + c.inlet_inertia_per_m * slope
    first, period_s = float(measured.time_s[0]), measured.period_s
    latches = latches_of(c, phi, t25, first, period_s)
    columns = np.column_stack([flow, lagged, p31, p_in, t25])
    steps = max(1, round(period_s * STEPS_PER_SECOND))
    begin = model.near_stall_state()
    rows = integrate(c, begin, latches[0], first, flow.size, period_s, steps, latches, columns)
    return rows[:, :N_STATES], latches
