"""The plant seen through its sensors: the twenty channels of a raw record, and their tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import pi, radians
from typing import Any

import numpy as np

from comparisons.rig.cases import RigCase
from comparisons.rig.gas import P_REF_PA, PSI_PA, T_REF_K, probe_pressures_pa
from comparisons.rig.hidden import SECOND_CELL_ROTOR_FRAC, WAKE_TIME_S, Alteration
from comparisons.rig.plant import PLANT_RATE_HZ, PlantRun
from comparisons.rig.sensors import (
    ADC_HIGH_V,
    ADC_LOW_V,
    SensorSettings,
    anti_alias,
    counts_from_volts,
    lag,
    rake_temperature_k,
    tube,
)
from surge_core.types import FloatArray

RAW_RATE_HZ = 1_000.0
# Facility readings average this long before the throttle closes, as in the independent record.
NEAR_STALL_S = (0.0, 0.14)
# Nominal ranges ±10 psi (plane 25) and ±110 psi (plane 31) over ±5 V; calibrate pressures 6 and
# 66 psi: as in the independent record.
_RANGE_PA = {25: 10.0 * PSI_PA, 31: 110.0 * PSI_PA}
_CALIBRATE_PA = {25: 6.0 * PSI_PA, 31: 66.0 * PSI_PA}
_PLANES = (25, 31)
_RAKES = ("A", "B")
_IMMERSIONS = ("tip", "hub")
# Constants (a, b) of Eq 2, a pair each: as in the independent record. The aft hole reads slightly
# above static, so that M_calc < M_true and a > 1.
_PROBES = {
    (25, "tip"): (1.10, 0.012),
    (25, "hub"): (1.08, 0.010),
    (31, "tip"): (1.09, 0.011),
    (31, "hub"): (1.07, 0.010),
}
# Lock-in of the independent record at 82.5 and 165 Hz: the cell reaches rake B 110° after rake A,
# the tip swings 1.3 and the hub 0.7 times the mean, pressure leads flow by 30°.
_RAKE_ANGLE = {"A": 0.0, "B": radians(-110.0)}
_REACH = {"tip": 1.3, "hub": 0.7}
_PRESSURE_LEAD = radians(30.0)
_SIDE = {"tip": -1.0, "hub": 1.0}
_HALF_SCALE_V = 0.5 * (ADC_HIGH_V - ADC_LOW_V)


@dataclass(frozen=True)
class Instruments:
    """The sensors of one record, and what they read, in the order of the file."""

    case: RigCase
    run: PlantRun
    settings: SensorSettings
    altered: Alteration  # What is hidden in the sensors
    rng: np.random.Generator
    # What is drawn for the wakes leaves every other number as it was.
    wakes: np.random.Generator
    rake_k: Mapping[int, FloatArray]  # Temperature of the transducers of each plane
    # The ZOC reference of each plane: as it is, as tape and facility read it, in Pa.
    references: Mapping[int, tuple[float, float, float]]
    near_stall: Mapping[str, float]  # The facility's reading
    values: dict[str, FloatArray] = field(default_factory=dict)  # Counts or kelvin
    # The table of each channel in ``test.toml``.
    channels: dict[str, dict[str, Any]] = field(default_factory=dict)
    # What no reduction may know: each transducer's sensitivity, bias and operate reading, and the
    # reference as it is and as the tape reads it.
    truth: dict[str, dict[str, float]] = field(default_factory=dict)

    def read_pair(self, plane: int, rake: str, immersion: str) -> None:
        """Add the forward and the aft channel of one probe pair."""
        case, settings, rng = self.case, self.settings, self.rng
        slope, offset = _PROBES[plane, immersion]
        offset *= settings.probe_offset
        flow, total = self._local_flow(plane, rake, immersion)
        area_m2 = case.inlet_area_m2 if plane == 25 else case.exit_area_m2
        pressures = probe_pressures_pa(
            flow, total, area_m2=area_m2, slope=slope, offset=offset, ramp=settings.probe_ramp
        )
        if plane == 25 and self.altered["flow_noise"]:
            pressures = self._with_wake_noise(*pressures)
        true, _, facility = self.references[plane]
        for facing, pressure in zip(("forward", "aft"), pressures, strict=True):
            # Sensitivity, in V/Pa, at the rake temperature of the calibrate reading; bias in V.
            scatter, offset_v = map(float, rng.standard_normal(2))
            nominal = ADC_HIGH_V / _RANGE_PA[plane]
            sensitivity = nominal * (1.0 + settings.sensitivity_scatter * scatter)
            bias_v = settings.bias_scatter_v * offset_v
            zero, calibrate, operate = (
                self._reading(bias_v + sensitivity * difference)
                for difference in (0.0, _CALIBRATE_PA[plane], float(pressure[0]) - true)
            )
            name = f"P{plane}_{rake}_{immersion}_{facing}"
            self.values[name] = self._pressure_counts(plane, pressure, sensitivity, bias_v)
            self.channels[name] = {
                "kind": "pressure",
                "unit": "count",
                "plane": plane,
                "rake": rake,
                "immersion": immersion,
                "facing": facing,
                "probe_slope": slope,
                "probe_offset": offset,
                "zoc_reference_Pa": facility,
                "zero_count": zero,
                "calibrate_count": calibrate,
                "calibrate_pressure_Pa": _CALIBRATE_PA[plane],
            }
            self.truth[name] = {
                "sensitivity_V_Pa": sensitivity,
                "bias_V": bias_v,
                "operate_count": operate,
            }

    def _local_flow(self, plane: int, rake: str, immersion: str) -> tuple[FloatArray, FloatArray]:
        """Return corrected flow in kg/s and total pressure in Pa at one probe pair.

        Equation: W_c + J A w (sin θ + h₂ sin 2θ) ± q ΔW_c, θ = 2π f t + angle of the rake; the
        total pressure moves in proportion. Over the plane hub and tip shift cancel; the cells do
        not, because two rakes do not resolve them. At `PLANT_RATE_HZ`; the flow is what the whole
        plane would pass if all were like this spot. A second cell pattern that is hidden, slower
        than the first, shows here.
        """
        case, run, settings, altered = self.case, self.run, self.settings, self.altered
        share = 1.0 if plane == 25 else case.exit_cell_frac
        mean = corrected_plane_flow_kg_s(run, plane)
        time_s = np.arange(mean.size) / PLANT_RATE_HZ
        angle = 2.0 * pi * case.cell_frequency_hz * time_s + _RAKE_ANGLE[rake]
        reach = share * settings.cells * run["cells"] * _REACH[immersion]
        shift = share * settings.hub_tip * case.hub_tip_flow_kg_s * run["blend"] * _SIDE[immersion]
        shift = shift * (1.0 + settings.hub_tip_bend * (mean / np.mean(mean) - 1.0))
        flow = mean + reach * case.cell_flow_kg_s * _wave(case, angle) + shift
        ripple = reach * case.cell_pressure_frac * _wave(case, angle + _PRESSURE_LEAD)
        if altered["rotating_stall_ripple"]:
            turn = SECOND_CELL_ROTOR_FRAC * 2.0 * pi * case.rotor_speed_rpm / 60.0
            angle = turn * time_s + _RAKE_ANGLE[rake]
            reach = share * altered["rotating_stall_ripple"] * run["cells"] * _REACH[immersion]
            flow = flow + reach * case.cell_flow_kg_s * np.sin(angle)
            ripple = ripple + reach * case.cell_pressure_frac * np.sin(angle + _PRESSURE_LEAD)
        return flow, run[f"P{plane}"] * (1.0 + ripple)

    def _with_wake_noise(
        self, forward_pa: FloatArray, aft_pa: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Shake the hole of a pair that lies downstream, in the wake of the probe's own support."""
        white = self.wakes.standard_normal(forward_pa.size)
        eddies = lag(white, time_constant_s=WAKE_TIME_S)
        shake = self.altered["flow_noise"] * eddies / np.std(eddies) * np.abs(forward_pa - aft_pa)
        forward_flow = forward_pa >= aft_pa
        shaken = np.where(forward_flow, forward_pa, forward_pa + shake)
        return shaken, np.where(forward_flow, aft_pa + shake, aft_pa)

    def _reading(self, volts: float) -> float:
        """Return the mean counts of a zero, calibrate or operate reading before the surge."""
        settings = self.settings
        noise = settings.reading_noise_percent / 100.0 * _HALF_SCALE_V
        samples = volts + noise * self.rng.standard_normal(settings.reading_samples)
        return float(np.mean(counts_from_volts(samples, settings.bits)))

    def _pressure_counts(
        self, plane: int, pressure_pa: FloatArray, sensitivity_v_pa: float, bias_v: float
    ) -> FloatArray:
        """Return the converter's counts: tube, transducer, tape, anti-alias filter, converter."""
        settings, altered = self.settings, self.altered
        if plane == 31:
            pressure_pa = lag(pressure_pa, time_constant_s=altered["second_order_lag"])
            if altered["transport_delay"]:
                rows = np.arange(pressure_pa.size, dtype=np.float64)
                late = rows - altered["transport_delay"] * PLANT_RATE_HZ
                pressure_pa = np.interp(late, rows, pressure_pa)
        felt = tube(
            pressure_pa, frequency_hz=settings.tube_frequency_hz, damping=settings.tube_damping
        )
        warmth = self.rake_k[plane] - self.rake_k[plane][0]
        sensitivity = sensitivity_v_pa * (1.0 + settings.sensitivity_per_k * warmth)
        zero_v = np.full(felt.size, bias_v)
        if plane == 31:
            time_s = np.arange(felt.size) / PLANT_RATE_HZ
            sensitivity = sensitivity * (1.0 + altered["sensitivity_drift"] * time_s)
            zero_v = zero_v + altered["bias_drift"] * time_s
        noise = settings.noise_percent / 100.0 * _HALF_SCALE_V
        tape = zero_v + sensitivity * (felt - self.references[plane][0])
        tape = tape + noise * self.rng.standard_normal(felt.size)
        volts = anti_alias(tape, corner_hz=settings.anti_alias_hz)[:: settings.step]
        return counts_from_volts(volts, settings.bits)

    def read_thermocouple(self, plane: int, rake: str) -> None:
        """Add one thermocouple: recovery, lag, noise, and the range's limit."""
        settings, name = self.settings, f"T{plane}_{rake}"
        unstated_s = self.altered["thermocouple_lag"] if plane == 25 else 0.0
        junction = lag(
            settings.recovery_factor * self.run[f"T{plane}"],
            time_constant_s=settings.thermocouple_lag_s + unstated_s,
        )[:: settings.step]
        reading = junction + settings.thermocouple_noise_k * self.rng.standard_normal(junction.size)
        limit = self.case.t31_limit_k
        if plane == 31 and settings.acquisition_limits and limit is not None:
            reading = np.clip(reading, *limit)
        self.values[name] = np.asarray(reading, dtype=np.float64)
        self.channels[name] = {
            "kind": "temperature",
            "unit": "K",
            "plane": plane,
            "rake": rake,
            "recovery_factor": settings.recovery_factor,
            "time_constant_s": settings.thermocouple_lag_s,
        }


def instrument(
    case: RigCase,
    run: PlantRun,
    settings: SensorSettings,
    rng: np.random.Generator,
    altered: Alteration,
) -> Instruments:
    """Pass a plant run through every sensor.

    The random numbers drawn do not depend on the settings' sizes, so that switching one
    imperfection off leaves the others as they were.
    """
    near_stall = _near_stall(run, settings, rng)
    references = {}
    for plane, true in zip(_PLANES, (case.zoc_inlet_pa, case.zoc_exit_pa), strict=True):
        tape, facility = true * (1.0 + settings.reference_error * rng.standard_normal(2))
        references[plane] = (true, float(tape), float(facility))
    rake_k = {plane: rake_temperature_k(plane, run[f"T{plane}"], settings) for plane in _PLANES}
    wakes = rng.spawn(1)[0]
    out = Instruments(case, run, settings, altered, rng, wakes, rake_k, references, near_stall)
    for plane, (true, tape, _) in references.items():
        for rake in _RAKES:
            for immersion in _IMMERSIONS:
                out.read_pair(plane, rake, immersion)
            out.read_thermocouple(plane, rake)
        out.truth[f"zoc_{plane}"] = {"true_Pa": true, "tape_Pa": tape}
    return out


def corrected_plane_flow_kg_s(run: PlantRun, plane: int) -> FloatArray:
    """Return the mean corrected flow W √(T/T_o) / (P/P_o) of a plane (Eq N1), in kg/s."""
    theta = run[f"T{plane}"] / T_REF_K
    return np.asarray(run[f"W{plane}"] * np.sqrt(theta) / (run[f"P{plane}"] / P_REF_PA))


def _wave(case: RigCase, angle: FloatArray) -> FloatArray:
    return np.asarray(np.sin(angle) + case.cell_second_harmonic * np.sin(2.0 * angle))


def _near_stall(
    run: PlantRun, settings: SensorSettings, rng: np.random.Generator
) -> dict[str, float]:
    """Take the facility's near-stall reading, means over `NEAR_STALL_S`, as in ``test.toml``.

    Pressures come from remote transducers on the leak path of the rakes' tubes, so slow that the
    steady pressure passes and surge does not; temperatures from the facility's own thermocouples.
    """
    rows = slice(0, round(NEAR_STALL_S[1] * PLANT_RATE_HZ) + 1)
    reading = {"from_s": NEAR_STALL_S[0], "to_s": NEAR_STALL_S[1]}
    for name, error in zip(("P25", "T25", "P31", "T31"), rng.standard_normal(4), strict=True):
        if name.startswith("T"):
            off = settings.facility_temperature_error_k * float(error)
            reading[f"{name}_K"] = float(np.mean(run[name][rows])) + off
        else:
            remote = lag(run[name][rows], time_constant_s=settings.leak_lag_s)
            share = 1.0 + settings.facility_error * float(error)
            reading[f"{name}_Pa"] = float(np.mean(remote)) * share
    return reading
