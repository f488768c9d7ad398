"""By how much plane 31 is recorded later than plane 25, as the flows of both planes show it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from classic_ml.description import TestDescription
from classic_ml.records import LedgerEntry, Record
from classic_ml.work.balance import exit_flow_at_inlet
from surge_core.lag import FirstOrderLag
from surge_core.types import FloatArray

# On 57 records of four rigs whose ducts carry no waves, with nothing moved, 0.19 ms rms was found,
# at most 0.48; 4, 5 and 10 ms that were put in were found as well. Four times that is no chance.
ACCURACY_S = 0.19e-3
ON_TIME_S = 4.0 * ACCURACY_S
STANDARD_ERRORS = 3.0
# Gains and laws of the probes make of one flow a smooth function of the other.
DEGREE = 3
# Each finds what the straight line of the one before left: 10 ms is a third of a blowdown.
PASSES = 4
# Of blocks with fewer than 20 rows the scatter says nothing.
BLOCKS, FEWEST_ROWS = 10, 200


@dataclass(frozen=True)
class Alignment:
    """How plane 31 follows plane 25; NaN where it is not known.

    Parameters
    ----------
    late_s, stderr_s : float
        By how much plane 31 is late, and the standard error of that.
    lag_z : float
        By how many standard errors a lag explains its flow better than a shift in time does.
    wave_s : float
        What a wave takes from plane to plane, by which it may be early on one clock.
    """

    late_s: float = math.nan
    stderr_s: float = math.nan
    lag_z: float = math.nan
    wave_s: float = math.nan

    @property
    def known(self) -> bool:
        """Whether the flows of both planes were compared."""
        return math.isfinite(self.late_s)

    @property
    def on_time(self) -> bool:
        """Whether both planes are known, beyond chance, to show their flow on one clock."""
        return max(abs(self.late_s), STANDARD_ERRORS * self.stderr_s) <= ON_TIME_S

    @property
    def beyond_chance_s(self) -> float:
        """How far off one clock it must be to be so beyond chance."""
        return max(ON_TIME_S, STANDARD_ERRORS * self.stderr_s)

    @property
    def late(self) -> bool:
        """Whether plane 31 is later than one clock allows, beyond chance."""
        return self.late_s > self.beyond_chance_s

    @property
    def early(self) -> bool:
        """Whether plane 31 is early, as waves or another clock make it.

        A surge comes out of the plenum, and where the duct carries waves plane 31 reverses first.
        """
        return -self.late_s > self.beyond_chance_s

    @property
    def off_clock(self) -> bool:
        """Whether no wave explains it: plane 31 is late, or earlier than one makes it."""
        return self.late or -self.late_s > self.wave_s + self.beyond_chance_s

    @property
    def words(self) -> str:
        """What the flows show."""
        return (
            f"by their flows plane 31 is {abs(1e3 * self.late_s):.2f} ± {1e3 * self.stderr_s:.2f} "
            f"ms {'early' if self.late_s < 0.0 else 'late'} against plane 25"
        )

    def entry(self) -> LedgerEntry:
        """Return the step of the ledger that says so."""
        if not self.known:
            return LedgerEntry("alignment", "not known: the window is too short")
        flag, clock = self.words, "check that all channels share one clock"
        waves = f"{1e3 * self.wave_s:.2f} ms that a wave takes through the duct"
        if self.late:
            flag += f": a delay is read as the lag; {clock}"
        elif self.off_clock:
            flag += f", by more than the {waves}: τ reads low; {clock}"
        else:
            flag += f", within the {waves}: it makes it so, or a clock, by which τ would read low"
        flags = (flag,) * (self.late or self.early)
        return LedgerEntry("alignment", self.words, flags=flags)


def alignment_of(record: Record, test: TestDescription, window: slice) -> Alignment:
    """Return by how much plane 31 shows the same flow later than plane 25.

    Both planes pass one flow but for what the gas between them stores. Where plane 31 shows a
    function g of the flow a time L ago,

        W31 + storage = g(W25(t − L)) ≈ g(W25) − L dg(W25)/dt,

    and around closed cycles no function of W25 goes with its derivative. No lag of ψ' enters. The
    error is that over blocks left out in turn. Of a short window nothing is known. A duct of
    inertia I = ∫dx/A and volume V is √(I V) long for a wave: on 12 records of a rig whose ducts
    carry waves plane 31 was early by 0.2 to 0.9 of what that takes.

    Parameters
    ----------
    record : Record
        Averages of both planes, filtered alike.
    test : TestDescription
        The machine.
    window : slice
        Rows of the surge cycles.
    """
    if window.stop - window.start < FEWEST_ROWS:
        return Alignment()
    period_s, flow = record.sample_period_s, record["W25_kg_s"]
    # T31 is slow, and often out of its range: its reading near stall does as well.
    exit_K = np.full(flow.size, test.near_stall.temperature_K(31))
    shown, index = exit_flow_at_inlet(record, test, exit_K), np.arange(flow.size)
    flow = flow / float(np.max(np.abs(flow[window])))
    powers, late_s = np.vander(flow, DEGREE + 1), 0.0
    inlet = powers @ _least(powers[window], shown[window])
    for _ in range(PASSES):
        columns = np.column_stack([powers, -np.gradient(inlet, period_s)])[window]
        moved = np.interp(index + late_s / period_s, index, shown)[window]
        found = _least(columns, moved)
        late_s += float(found[-1])
        inlet = powers @ found[:-1]
    block = np.arange(moved.size) * BLOCKS // moved.size
    left = [_least(columns[block != b], moved[block != b])[-1] for b in range(BLOCKS)]
    stderr_s = math.sqrt(BLOCKS - 1) * float(np.std(left))

    def errors(of: Callable[[float], FloatArray]) -> FloatArray:
        """Return the squared errors of the blocks for the best time around the one found."""
        tried = []
        for share in np.linspace(0.8, 1.6, 17):
            columns = np.vander(of(share * late_s), DEGREE + 1)[window]
            error = shown[window] - columns @ _least(columns, shown[window])
            tried.append(np.asarray(np.bincount(block, error**2), dtype=np.float64))
        return min(tried, key=np.sum)

    lag_z = 0.0
    if late_s > ON_TIME_S:
        shifted = errors(lambda time_s: np.interp(index - time_s / period_s, index, flow))
        lagged = errors(
            lambda time_s: FirstOrderLag(time_s, period_s, "first").respond(flow, flow[0])
        )
        gain = shifted - lagged
        lag_z = math.sqrt(BLOCKS) * float(np.mean(gain) / np.std(gain, ddof=1))
    machine, inlet_K = test.compressor, test.near_stall.temperature_K(25)
    sound_m_s = math.sqrt(machine.gamma * machine.gas_constant_J_kg_K * inlet_K)
    wave_s = math.sqrt(machine.inertia_per_m * machine.internal_volume_m3) / sound_m_s
    return Alignment(late_s, stderr_s, lag_z, wave_s)


def _least(columns: FloatArray, values: FloatArray) -> FloatArray:
    size = np.linalg.norm(columns, axis=0)
    return np.asarray(np.linalg.lstsq(columns / size, values)[0] / size)
