"""Flow and total pressure of every probe pair, unfiltered, and the planes that they add up to.

With what lies between the air and the readings of each pair, as it travels with a series.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace

import numpy as np

from classic_ml.calibration import near_stall_rows
from classic_ml.coefficients import flow_coefficient, pressure_coefficient
from classic_ml.description import Compressor, TestDescription
from classic_ml.faults.search import SPIKED
from classic_ml.flow import (
    T_STANDARD_K,
    choked_flow,
    corrected_flow,
    mach_from_corrected_flow,
    physical_flow,
)
from classic_ml.records import LedgerEntry, Record
from classic_ml.series import CoefficientSeries
from classic_ml.work.alignment import Alignment
from surge_core.types import BoolArray, FloatArray

STEP = "rakes"
# Beyond this share of the choked flow a pair is overloaded: Eq 3 has no inverse at the choke.
LARGEST_SHARE = 0.98
_MACHINE, _ALIGNMENT = "compressor.", "alignment."
# What the ledger carries of a pair, in the order of its fields.
_OF_PAIR = ("slope", "offset", "noise_Pa", "noise_aft_Pa")
_Parameters = Mapping[str, str | int | float | bool]


def _numbers_under(head: str, given: _Parameters) -> dict[str, float]:
    return {k.removeprefix(head): float(v) for k, v in given.items() if k.startswith(head)}


@dataclass(frozen=True)
class PairChain:
    """A forward and an aft probe."""

    name: str  # Plane, rake and immersion, e.g. ``"25_A_tip"``
    slope: float  # a and b of Eq 2
    offset: float
    noise_Pa: float  # Standard deviation of the white noise of the two channels
    noise_aft_Pa: float

    @property
    def plane(self) -> int:
        """25 or 31."""
        return int(self.name.partition("_")[0])

    @property
    def rake(self) -> str:
        """Such as ``"A"``."""
        return self.name.split("_")[1]

    @property
    def immersion(self) -> str:
        """``"hub"``, ``"tip"``, or the name of one between."""
        return self.name.rpartition("_")[2]


@dataclass(frozen=True)
class Chain:
    """The probe pairs of a record that count, and the constants of Eq 1 to 8."""

    pairs: tuple[PairChain, ...]
    areas_m2: Mapping[int, float]  # Flow area of each plane
    compressor: Compressor
    rotor_speed_rpm: float  # Physical speed, and 100 % corrected speed
    design_corrected_speed_rpm: float
    near_stall_rows: int  # Rows of the reading to which the channels were matched
    alignment: Alignment = field(default_factory=Alignment)  # Of plane 31 with plane 25

    @property
    def rotor_velocity_m_s(self) -> float:
        """Mean rotor velocity U = 2π N r."""
        return 2.0 * np.pi * self.rotor_speed_rpm / 60.0 * self.compressor.mean_radius_m

    def of_plane(self, plane: int) -> tuple[PairChain, ...]:
        """Return the pairs of a plane."""
        return tuple(pair for pair in self.pairs if pair.plane == plane)

    def largest_flow_kg_s(self, plane: int) -> float:
        """Return the corrected flow beyond which a pair of a plane is overloaded."""
        return LARGEST_SHARE * choked_flow(self.areas_m2[plane], self.compressor)

    def corrected_speed(self, inlet_K: FloatArray) -> FloatArray:
        """Return N_c = N/√θ as a fraction of the design corrected speed."""
        corrected = self.rotor_speed_rpm / np.sqrt(inlet_K / T_STANDARD_K)
        return np.asarray(corrected / self.design_corrected_speed_rpm)

    def entry(self) -> LedgerEntry:
        """Return the step of the ledger that carries the chain."""
        parameters: dict[str, str | int | float | bool] = {
            "near_stall_rows": self.near_stall_rows,
            "rotor_speed_rpm": self.rotor_speed_rpm,
            "design_corrected_speed_rpm": self.design_corrected_speed_rpm,
        }
        parameters |= {f"area_{plane}_m2": area for plane, area in self.areas_m2.items()}
        parameters |= {f"{_MACHINE}{k}": v for k, v in self.compressor.model_dump().items()}
        if self.alignment.known:
            parameters |= {f"{_ALIGNMENT}{k}": v for k, v in asdict(self.alignment).items()}
        for pair in self.pairs:
            parameters |= {f"{pair.name}.{what}": getattr(pair, what) for what in _OF_PAIR}
        did = (
            f"unfiltered flow and total pressure of {len(self.pairs)} probe pairs kept, with what "
            "lies between the air and their readings: the time constant is estimated from these"
        )
        return LedgerEntry(STEP, did, parameters)

    @classmethod
    def from_parameters(cls, given: _Parameters) -> Chain:
        """Read the chain back from the parameters of its step."""
        names = [name.removesuffix(".slope") for name in given if name.endswith(".slope")]
        pairs = tuple(
            PairChain(name, *(float(given[f"{name}.{what}"]) for what in _OF_PAIR))
            for name in names
        )
        areas = {int(k[5:-3]): float(v) for k, v in given.items() if k.startswith("area_")}
        return cls(
            pairs,
            areas,
            Compressor.model_validate(_numbers_under(_MACHINE, given)),
            float(given["rotor_speed_rpm"]),
            float(given["design_corrected_speed_rpm"]),
            int(given["near_stall_rows"]),
            Alignment(**_numbers_under(_ALIGNMENT, given)),
        )


# The fourth difference passes white noise with the square of its coefficients and hardly any of
# what is slower than a tenth of the sample rate.
DIFFERENCE, GAIN = 4, 70.0
# Below this share of P25 a P31 is noise.
LEAST_RATIO = 1e-3
INLET, COUNTS = "T25_unfiltered_K", "readings_count"


@dataclass(frozen=True)
class Planes:
    """Averages over the probe pairs of each plane."""

    corrected_kg_s: FloatArray  # Corrected flow at plane 25
    inlet_Pa: FloatArray  # Total pressures P25 and P31
    exit_Pa: FloatArray


@dataclass(frozen=True)
class RakeSignals:
    """What every probe pair of a record reads, before any filter."""

    # By pair, as in ``"25_A_tip"``: corrected flow of the inlet's (Eq 3), total pressure of all
    flow_kg_s: Mapping[str, FloatArray]
    total_Pa: Mapping[str, FloatArray]
    inlet_K: FloatArray  # T25 with the thermocouples' lag undone
    counts: BoolArray  # Rows in which all readings count
    sample_period_s: float
    chain: Chain  # The pairs and the constants of the machine

    def mean(self, signals: Mapping[str, FloatArray], plane: int) -> FloatArray:
        """Return the average over the rakes at each immersion and then over the immersions."""
        levels = [self.at(signals, plane, immersion) for immersion in self.immersions(plane)]
        return np.asarray(np.mean([level for level in levels if level is not None], axis=0))

    def immersions(self, plane: int) -> list[str]:
        """Return the immersions of a plane at which there is a pair."""
        return sorted({pair.immersion for pair in self.chain.of_plane(plane)}, reverse=True)

    def at(
        self, signals: Mapping[str, FloatArray], plane: int, immersion: str
    ) -> FloatArray | None:
        """Return the average over the rakes at one immersion, None without a pair there."""
        found = self._alike(signals, plane, immersion)
        return np.asarray(np.mean(found, axis=0)) if found else None

    def _alike(
        self, signals: Mapping[str, FloatArray], plane: int, immersion: str
    ) -> list[FloatArray]:
        pairs = [pair for pair in self.chain.of_plane(plane) if pair.immersion == immersion]
        return [signals[pair.name] for pair in pairs if pair.name in signals]

    @property
    def one_rake(self) -> bool:
        """Whether plane 25 has a single rake."""
        return len({pair.rake for pair in self.chain.of_plane(25)}) == 1

    def cell_differences(self, plane: int) -> list[tuple[FloatArray, FloatArray]]:
        """Return what two probes of a plane read differently: cells and noise, no surge.

        Beside each their mean, which has surge. Two rakes at one immersion; with one rake the total
        pressures of its two immersions, which the cells reach unalike. Flow is left out there: it
        shifts between hub and tip in stall.
        """
        if self.one_rake:
            tip, hub = (self.at(self.total_Pa, plane, immersion) for immersion in ("tip", "hub"))
            return [] if tip is None or hub is None else [(tip - hub, 0.5 * (tip + hub))]
        found = []
        for signals in (self.flow_kg_s, self.total_Pa):
            for immersion in self.immersions(plane):
                own = self._alike(signals, plane, immersion)
                found += [(first - own[0], 0.5 * (first + own[0])) for first in own[1:]]
        return found

    def planes(self) -> Planes:
        """Return the averages as they are, cells and all."""
        return Planes(
            self.mean(self.flow_kg_s, 25),
            self.mean(self.total_Pa, 25),
            self.mean(self.total_Pa, 31),
        )

    def hub_minus_tip(self) -> FloatArray | None:
        """Return how much more flow the hub passes than the tip; None with one immersion."""
        hub, tip = (self.at(self.flow_kg_s, 25, immersion) for immersion in ("hub", "tip"))
        return None if hub is None or tip is None else hub - tip

    def overloaded(self) -> BoolArray:
        """Return the rows in which a pair reads what no probe can: choked flow, no pressure."""
        over = ~self.counts
        for flow in self.flow_kg_s.values():
            over = over | (np.abs(flow) > self.chain.largest_flow_kg_s(25))
        for pressure in self.total_Pa.values():
            over = over | ~(pressure > 0.0)
        return np.asarray(over)

    def coefficients(
        self, planes: Planes, *, stored: bool = False
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return φ (Eq 7), ψ' (Eq 5) and N_c of plane averages; NaN where they have none.

        With ``stored`` the inertia acts on the flow in the middle between the planes.
        """
        machine, speed = self.chain.compressor, self.chain.rotor_velocity_m_s
        area_m2 = self.chain.areas_m2[25]
        limit = self.chain.largest_flow_kg_s(25)
        flow = np.clip(planes.corrected_kg_s, -limit, limit)
        phi = flow_coefficient(flow, self.inlet_K, area_m2, speed, machine)
        with np.errstate(invalid="ignore"):
            accelerated = physical_flow(planes.corrected_kg_s, planes.inlet_Pa, self.inlet_K)
            if stored:
                gas_kg = self._gas_between(planes)
                accelerated = accelerated - 0.5 * np.gradient(gas_kg, self.sample_period_s)
            rate = np.gradient(accelerated, self.sample_period_s)
            # Where the noise of dW/dt leaves no pressure the row is left out by its NaN.
            least = LEAST_RATIO * planes.inlet_Pa - machine.inertia_per_m * rate
            exit_Pa = np.maximum(planes.exit_Pa, least)
            psi_p = pressure_coefficient(
                planes.inlet_Pa, exit_Pa, self.inlet_K, rate, machine.inertia_per_m, speed, machine
            )
        psi_p = np.where(exit_Pa > planes.exit_Pa, np.nan, psi_p)
        return phi, psi_p, self.chain.corrected_speed(self.inlet_K)

    def _gas_between(self, planes: Planes) -> FloatArray:
        """Return the mass between the planes in kg, its state halfway, compressed isentropically.

        Of the inlet's temperature the mean: twice differentiated, its noise is all there is.
        """
        machine = self.chain.compressor
        ratio = np.maximum(planes.exit_Pa / planes.inlet_Pa, LEAST_RATIO)
        hotter = ratio ** (1.0 - 1.0 / machine.gamma)
        pressure_Pa = 0.5 * (planes.inlet_Pa + planes.exit_Pa / hotter)
        gas_J_kg = machine.gas_constant_J_kg_K * float(np.mean(self.inlet_K[self.counts]))
        return np.asarray(machine.internal_volume_m3 * pressure_Pa / gas_J_kg)

    def ramped(self, below: float) -> RakeSignals:
        """Return the flows by a law of the probes that has no jump at zero flow.

        Eq 2 reads |M| = a M_calc + b for any flow; here b falls to nothing in proportion to M_calc
        below a calculated Mach number.
        """
        machine, area_m2 = self.chain.compressor, self.chain.areas_m2[25]
        limit, flows = self.chain.largest_flow_kg_s(25), {}
        for pair in self.chain.of_plane(25):
            flow = self.flow_kg_s[pair.name]
            mach = mach_from_corrected_flow(np.clip(flow, -limit, limit), area_m2, machine)
            calculated = np.maximum(np.abs(mach) - pair.offset, 0.0) / pair.slope
            ramp = pair.slope * calculated + pair.offset * np.minimum(calculated / below, 1.0)
            moved = corrected_flow(np.copysign(ramp, mach), area_m2, machine)
            flows[pair.name] = np.where((mach != 0.0) & (calculated < below), moved, flow)
        return replace(self, flow_kg_s=flows)

    def columns(self) -> dict[str, FloatArray]:
        """Return what a series file carries of them, a column each."""
        flows = {f"Wc{name}_kg_s": values for name, values in self.flow_kg_s.items()}
        totals = {f"Pt{name}_Pa": values for name, values in self.total_Pa.items()}
        return {**flows, **totals, INLET: self.inlet_K, COUNTS: self.counts.astype(np.float64)}


def rake_signals(record: Record, test: TestDescription) -> RakeSignals:
    """Take the pairs out of a record with their local flows and inverted thermocouples."""
    # A record that continues another holds no reading near stall: its noise is that of all rows.
    apart = bool(test.near_stall_shifts)
    reading = slice(0, record.n_samples) if apart else near_stall_rows(record, test)
    counts = np.ones(record.n_samples, dtype=np.bool_)
    pairs = []
    for pair in (pair for plane in test.areas_m2 for pair in test.pairs(plane)):
        if f"Pt{pair.name}_Pa" not in record:
            continue
        noise = []
        for probe in (pair.forward, pair.aft):
            # Across a spike, of one or two rows, there is a straight line.
            counts &= record.marks(probe.name) & ~np.uint8(SPIKED) == 0
            steps = np.diff(record[probe.name][reading], n=DIFFERENCE)
            noise.append(float(np.std(steps) / np.sqrt(GAIN)))
        law = pair.forward.probe_slope, pair.forward.probe_offset
        pairs.append(PairChain(pair.name, *law, *noise))
    chain = Chain(
        tuple(pairs),
        dict(test.areas_m2),
        test.compressor,
        test.rotor_speed_rpm,
        test.design_corrected_speed_rpm,
        reading.stop - reading.start,
    )
    couples = [c.name for c in test.thermocouples(25) if c.name in record]
    return RakeSignals(
        {pair.name: record[f"Wc{pair.name}_kg_s"] for pair in chain.of_plane(25)},
        {pair.name: record[f"Pt{pair.name}_Pa"] for pair in chain.pairs},
        np.asarray(np.mean([record[name] for name in couples], axis=0)),
        counts,
        record.sample_period_s,
        chain,
    )


def rake_signals_of(series: CoefficientSeries) -> RakeSignals | None:
    """Return the pairs that a series carries, None where it or its ledger lacks them."""
    entries = [entry for entry in series.history if entry.step == STEP]
    if not entries:
        return None
    chain = Chain.from_parameters(entries[-1].parameters)
    flows = {pair.name: f"Wc{pair.name}_kg_s" for pair in chain.of_plane(25)}
    totals = {pair.name: f"Pt{pair.name}_Pa" for pair in chain.pairs}
    needed = {*flows.values(), *totals.values(), INLET, COUNTS}
    if not flows or not needed <= series.rakes.keys():
        return None
    columns = {name: values.astype(np.float64) for name, values in series.rakes.items()}
    return RakeSignals(
        {pair: columns[name] for pair, name in flows.items()},
        {pair: columns[name] for pair, name in totals.items()},
        columns[INLET],
        columns[COUNTS] > 0.5,
        series.sample_period_s,
        chain,
    )
