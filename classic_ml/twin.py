"""The record measured again: readings that the fitted model would leave on the same instruments.

Forward from the estimated flow and the fitted lag to the pressures of every probe, with noise and
a fresh error of calibration, and back through Eq 1 to 3. What is needed stands in the test
description and in the record.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from classic_ml.filters import low_pass
from classic_ml.flow import mach_from_corrected_flow, pair_flow, physical_flow
from classic_ml.whole_record.branches import BranchFit, Specification, design, responses
from classic_ml.whole_record.passes import Passes
from classic_ml.whole_record.rakes import Chain, PairChain, Planes, RakeSignals
from surge_core.types import BoolArray, FloatArray, IntArray

# What a twin takes for the truth holds the cells with a harmonic, and hardly any of the noise.
HARMONICS = 2.6
INLET_K_HZ = 60.0
LEAST_PA = 1e3
# Of a numerical derivative, where a record has no noise.
LEAST_STEP_PA = 1.0


@dataclass(frozen=True)
class Twin:
    """A record without noise, which can be measured any number of times.

    Parameters
    ----------
    signals : RakeSignals
        The record; its noise and its probes measure the twin.
    flow_kg_s, total_Pa : mapping of str to ndarray of shape (n,)
        Flow and total pressure of each pair, without noise.
    offset_Pa : float
        Standard deviation of the error of calibration between the two probes of a pair, plane 25.
    """

    signals: RakeSignals
    flow_kg_s: Mapping[str, FloatArray]
    total_Pa: Mapping[str, FloatArray]
    offset_Pa: float = 0.0

    def measured(self, rng: np.random.Generator) -> RakeSignals:
        """Return the twin's readings, with noise and an error of calibration drawn by rng."""
        chain = self.signals.chain
        flow, total = {}, {}
        for pair in chain.pairs:
            pressures = self.total_Pa[pair.name], self.total_Pa[pair.name]
            if pair.name in self.flow_kg_s:
                pressures = _pressures(self.flow_kg_s[pair.name], pressures[0], pair, chain)
                pressures = pressures[0], pressures[1] + self.offset_Pa * rng.standard_normal()
            forward = self._read(pressures[0], pair.noise_Pa, rng)
            aft = self._read(pressures[1], pair.noise_aft_Pa, rng)
            total[pair.name] = forward
            if pair.name in self.flow_kg_s:
                total[pair.name] = np.maximum(forward, aft)
                law = pair.slope, pair.offset, chain.areas_m2[pair.plane]
                flow[pair.name] = pair_flow(forward, aft, *law, chain.compressor)
        return replace(self.signals, flow_kg_s=flow, total_Pa=total)

    def _read(
        self, pressure_Pa: FloatArray, noise_Pa: float, rng: np.random.Generator
    ) -> FloatArray:
        # The mean of the reading to which the channel was matched is as uncertain as this.
        offset_Pa = noise_Pa / np.sqrt(self.signals.chain.near_stall_rows) * rng.standard_normal()
        noise = noise_Pa * rng.standard_normal(pressure_Pa.size)
        return np.asarray(np.maximum(pressure_Pa + offset_Pa + noise, LEAST_PA))


def twin_of(
    signals: RakeSignals, passes: Passes, spec: Specification, in_stall: BoolArray, fit: BranchFit
) -> Twin:
    """Return the twin of a record under a fitted model.

    Parameters
    ----------
    signals : RakeSignals
        The record.
    passes : Passes
        Its signals without cells.
    spec : Specification
        What the fit took for granted.
    in_stall : ndarray of bool, shape (n,)
        The state.
    fit : BranchFit
        The model.
    """
    rate_hz = 1.0 / signals.sample_period_s
    cutoff_hz = min(HARMONICS / passes.period_s, 0.45 * rate_hz)

    def smooth(values: FloatArray, hz: float = cutoff_hz) -> FloatArray:
        return np.asarray(low_pass(values, rate_hz, order=4, cutoff_hz=hz, phase="zero"))

    flow = {name: smooth(values) for name, values in signals.flow_kg_s.items()}
    total = {name: smooth(values) for name, values in signals.total_Pa.items()}
    clean = passes.planes
    planes = Planes(smooth(clean.corrected_kg_s), smooth(clean.inlet_Pa), smooth(clean.exit_Pa))
    inlet_K = smooth(signals.inlet_K, INLET_K_HZ)
    row, machine, speed = passes.row, signals.chain.compressor, signals.chain.rotor_velocity_m_s
    inputs, _ = design(passes, replace(spec, average_s=signals.sample_period_s), in_stall)
    psi_p = responses(fit.tau_s, passes, inputs) @ fit.coefficients
    # Rows that were simulated through hold terms that no scored row has.
    psi_p = np.clip(psi_p, passes.psi_p.min(), passes.psi_p.max())
    rate = np.gradient(
        physical_flow(planes.corrected_kg_s, planes.inlet_Pa, inlet_K), signals.sample_period_s
    )
    # Eq 5 for the pressure behind the blading.
    rise = 1.0 + psi_p * speed**2 / (2.0 * machine.specific_heat_J_kg_K * inlet_K[row])
    ratio = np.maximum(rise, 0.2) ** (machine.gamma / (machine.gamma - 1.0))
    by_model = planes.inlet_Pa[row] * ratio - machine.inertia_per_m * rate[row]
    # P31 is what the model's ψ' makes in forward flow, elsewhere what was measured.
    shift = np.zeros_like(planes.exit_Pa)
    shift[row] = np.where(passes.phi > spec.lowest_phi, by_model - planes.exit_Pa[row], 0.0)
    total |= {name: values + shift for name, values in total.items() if name.startswith("31")}
    low = passes.row[fit.scored & in_stall]
    return Twin(signals, flow, total, _offset_Pa(signals.chain, flow, total, low))


def _offset_Pa(
    chain: Chain,
    flow_kg_s: Mapping[str, FloatArray],
    total_Pa: Mapping[str, FloatArray],
    rows: IntArray,
) -> float:
    """Return by how much the probes of a pair are calibrated apart, from rakes that should agree.

    The near-stall match moves both probes of a pair alike, so the errors of their zero and
    calibrate readings stay in the difference that makes the flow. It weighs most where the flow is
    small: in stall, over whole cycles, rakes at one immersion see the same mean flow.
    """
    apart: list[float] = []
    degrees = 0
    pairs = [pair for pair in chain.of_plane(25) if pair.name in flow_kg_s]
    for immersion in {pair.immersion for pair in pairs}:
        alike = [pair for pair in pairs if pair.immersion == immersion]
        means = np.array([np.mean(flow_kg_s[pair.name][rows]) for pair in alike])
        for pair, mean in zip(alike, means, strict=True):
            pressures = _pressures(flow_kg_s[pair.name], total_Pa[pair.name], pair, chain)
            forward, aft = (each[rows] for each in pressures)
            law = pair.slope, pair.offset, chain.areas_m2[25], chain.compressor
            # Over the width of the noise, which the square root of Eq 1 is averaged over.
            width_Pa = max(pair.noise_aft_Pa, LEAST_STEP_PA)
            more, less = (pair_flow(forward, aft + end, *law) for end in (-width_Pa, width_Pa))
            slope = float(np.mean(less - more)) / (2.0 * width_Pa)
            apart.append(float(mean - np.mean(means)) / slope)
        degrees += len(alike) - 1
    return math.sqrt(float(np.sum(np.square(apart))) / degrees) if degrees else 0.0


def _pressures(
    flow_kg_s: FloatArray, total_Pa: FloatArray, pair: PairChain, chain: Chain
) -> tuple[FloatArray, FloatArray]:
    """Return what the two probes of a pair read of a flow: Eq 3, 2 and 1 backwards."""
    machine, area_m2 = chain.compressor, chain.areas_m2[pair.plane]
    gamma = machine.gamma
    limit = chain.largest_flow_kg_s(pair.plane)
    mach = mach_from_corrected_flow(np.clip(flow_kg_s, -limit, limit), area_m2, machine)
    calculated = np.maximum((np.abs(mach) - pair.offset) / pair.slope, 0.0)
    ratio = (1.0 + 0.5 * (gamma - 1.0) * calculated**2) ** (gamma / (gamma - 1.0))
    high, low = np.maximum(total_Pa, 2.0 * LEAST_PA), np.maximum(total_Pa, 2.0 * LEAST_PA) / ratio
    onward = mach >= 0.0
    return np.where(onward, high, low), np.where(onward, low, high)
