"""A small surge test with known flows and pressures, as counts and test.toml.

The gas laws are written out here a second time, on purpose: a wrong equation must not cancel out.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from classic_ml.description import Compressor
from classic_ml.io import TestDescription, read_raw
from classic_ml.records import Record

LBM = 0.45359237
AREAS = {25: 0.2938, 31: 0.065}
GAMMA, GAS = 1.4, 287.05
SPEED_RPM, DESIGN_RPM, RADIUS_M = 11400.084, 12303.0, 0.28
INERTIA_PER_M = 10.7
U_M_S = 2 * np.pi * SPEED_RPM / 60 * RADIUS_M
CELL_HZ = 82.5
AIR = Compressor(
    mean_radius_m=RADIUS_M,
    inertia_per_m=INERTIA_PER_M,
    internal_volume_m3=0.08,
    gamma=GAMMA,
    gas_constant_J_kg_K=GAS,
)


def corrected(mach: np.ndarray, area: float) -> np.ndarray:
    """Eq 3 at γ = 1.4, where its exponent is 3."""
    constant = area * 101325.0 / np.sqrt(288.15) * np.sqrt(GAMMA / GAS)
    return constant * mach / (1 + 0.2 * mach**2) ** 3


def mach_of(flow: np.ndarray, area: float) -> np.ndarray:
    table = np.linspace(-0.95, 0.95, 400_001)
    return np.interp(flow, corrected(table, area), table)


@dataclass
class RawTest:
    """One made-up test: raw columns, the content of test.toml, and the truth."""

    columns: dict[str, np.ndarray]
    description: dict[str, Any]
    truth: dict[str, np.ndarray]

    def load(self) -> tuple[Record, TestDescription]:
        """Write the test and read it back."""
        with TemporaryDirectory() as folder:
            return read_raw(*self.write(Path(folder)))

    def write(self, folder: Path) -> tuple[Path, Path]:
        raw, test = folder / "raw.csv", folder / "test.toml"
        write_csv(raw, self.columns)
        test.write_text(to_toml(self.description), "utf-8")
        return raw, test


def write_csv(path: Path, columns: dict[str, np.ndarray]) -> None:
    lines = [",".join(columns)]
    lines += [",".join(repr(float(v)) for v in row) for row in zip(*columns.values(), strict=True)]
    path.write_text("\n".join(lines) + "\n", "utf-8")


def pascals_of(
    columns: Mapping[str, np.ndarray], channels: Mapping[str, Any]
) -> dict[str, np.ndarray]:
    """The pressures of a record by their zero and calibrate readings in Pa, temperatures in K."""
    found = {}
    for name, table in channels.items():
        values = columns[name]
        if table["kind"] == "pressure":
            gain = (table["calibrate_count"] - table["zero_count"]) / table["calibrate_pressure_Pa"]
            values = (values - table["zero_count"]) / gain + table["zoc_reference_Pa"]
        found[name] = values
    return found


def to_toml(tables: Mapping[str, Any], path: str = "") -> str:
    """Return tables as TOML, with any text in keys and values."""
    text = f"[{path}]\n" if path else ""
    for key, value in tables.items():
        if not isinstance(value, Mapping):
            text += f"{toml_key(key)} = {toml_value(value)}\n"
    for key, value in tables.items():
        if isinstance(value, Mapping):
            text += to_toml(value, f"{path}.{toml_key(key)}" if path else toml_key(key))
    return text


def toml_key(name: str) -> str:
    is_bare = name.isascii() and name.replace("_", "").replace("-", "").isalnum()
    return name if is_bare else json.dumps(name)


def toml_value(value: Any) -> str:
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    return json.dumps(value) if isinstance(value, str | bool) else repr(value)


def surge_waves(time_s: np.ndarray, period_s: float, surge: bool) -> dict[str, np.ndarray]:
    """Flow in lbm/s and pressures in Pa: near stall, a blowdown, then cycles that repeat."""
    start = 0.3
    since = np.maximum(time_s - start, 0.0)
    after = 1.0 / (1.0 + np.exp(-(time_s - start) / 0.004)) if surge else np.zeros(time_s.size)
    grown = 1.0 - np.exp(-since / 0.15)
    angle = 2 * np.pi * since / period_s
    cycle = 30.0 - 36.0 * np.cos(angle) + 4.0 * np.cos(2 * angle)
    flow = 112.0 * (1 - after) + after * (grown * cycle + (1 - grown) * -6.0)
    p31_cycle = 300e3 + 120e3 * np.sin(angle - 2.2)
    p31 = 1.285e6 * (1 - after) + after * (
        p31_cycle * grown + (1 - grown) * 300e3 + 9e5 * np.exp(-since / 0.06)
    )
    p25 = 55e3 * (1 - after) + after * (120e3 - 50e3 * np.exp(-since / 0.1))
    p25 = p25 + after * grown * 4e3 * np.sin(angle)
    t25 = 255.0 * (1 - after) + after * (440.0 - 180.0 * np.exp(-since / 0.2))
    t31 = 698.0 * (1 - after) + after * (630.0 + 20.0 * np.cos(angle))
    return {"flow": flow, "P25": p25, "P31": p31, "T25": t25, "T31": t31, "after": after}


def make_test(
    *,
    seed: int = 0,
    seconds: float = 3.0,
    rate_hz: float = 1000.0,
    period_s: float = 0.14,
    surge: bool = True,
    cells_lbm_s: float = 0.0,
    noise_counts: float = 0.0,
    quantise: bool = True,
    lag_thermocouples: bool = False,
) -> RawTest:
    rng = np.random.default_rng(seed)
    time_s = np.arange(round(seconds * rate_hz) + 1) / rate_hz
    waves = surge_waves(time_s, period_s, surge)
    columns: dict[str, np.ndarray] = {"time_s": np.round(time_s, 6)}
    channels: dict[str, Any] = {}
    for plane in (25, 31):
        for rake in "AB":
            for immersion in ("tip", "hub"):
                sign = 1.0 if immersion == "hub" else -1.0
                shift = waves["after"] * (waves["flow"] < 50) * 8.0
                cells = waves["after"] * cells_lbm_s * np.sin(2 * np.pi * CELL_HZ * time_s)
                flow = waves["flow"] + (sign * shift + cells) * (plane == 25)
                if plane == 31:
                    flow = corrected_at_31(waves)
                slope, offset = (1.1, 0.012) if immersion == "tip" else (1.08, 0.010)
                total = waves[f"P{plane}"]
                mach = mach_of(flow * LBM, AREAS[plane])
                calc = np.maximum(np.abs(mach) - offset, 0.0) / slope
                wake = total / (1 + 0.2 * calc**2) ** 3.5
                forward = np.where(mach > 0, total, wake)
                aft = np.where(mach > 0, wake, total)
                for facing, pressure in (("forward", forward), ("aft", aft)):
                    name = f"P{plane}_{rake}_{immersion}_{facing}"
                    table = pressure_table(plane, rake, immersion, facing, slope, offset, rng)
                    channels[name] = table
                    columns[name] = to_counts(pressure, table, rng, noise_counts, quantise)
            name = f"T{plane}_{rake}"
            channels[name] = {
                "kind": "temperature",
                "unit": "K",
                "plane": plane,
                "rake": rake,
                "recovery_factor": 0.994,
                "time_constant_s": 0.010,
            }
            gas_K = waves[f"T{plane}"]
            seen = first_order(gas_K, 0.010, rate_hz) if lag_thermocouples else gas_K
            columns[name] = 0.994 * seen + 1e-3 * rng.standard_normal(time_s.size)
    return RawTest(columns, describe(channels, rate_hz), truth_of(waves, time_s))


def corrected_at_31(waves: dict[str, np.ndarray]) -> np.ndarray:
    """The corrected flow of plane 25 carried to plane 31 without storage, in lbm/s."""
    to_physical = waves["P25"] / np.sqrt(waves["T25"])
    return waves["flow"] * to_physical / (waves["P31"] / np.sqrt(waves["T31"]))


def first_order(values: np.ndarray, tau_s: float, rate_hz: float) -> np.ndarray:
    """Exact response of a first-order lag to straight lines between samples."""
    step = 1.0 / (rate_hz * tau_s)
    decay = np.exp(-step)
    out = np.empty_like(values)
    out[0] = values[0]
    for k in range(1, values.size):
        slope = (values[k] - values[k - 1]) / step
        steady = values[k - 1] - slope
        out[k] = (out[k - 1] - steady) * decay + values[k] - slope
    return out


def pressure_table(
    plane: int,
    rake: str,
    immersion: str,
    facing: str,
    slope: float,
    offset: float,
    rng: np.random.Generator,
) -> dict[str, Any]:
    span, reference = (41368.542, 90000.0) if plane == 25 else (455053.962, 758423.27)
    zero = 2048.0 + rng.uniform(-40, 40)
    return {
        "kind": "pressure",
        "unit": "count",
        "plane": plane,
        "rake": rake,
        "immersion": immersion,
        "facing": facing,
        "probe_slope": slope,
        "probe_offset": offset,
        "zoc_reference_Pa": reference,
        "zero_count": float(zero),
        "calibrate_count": float(zero + 1230.0 * rng.uniform(0.96, 1.04)),
        "calibrate_pressure_Pa": span,
    }


def to_counts(
    pressure: np.ndarray,
    table: dict[str, Any],
    rng: np.random.Generator,
    noise: float,
    quantise: bool,
) -> np.ndarray:
    gain = (table["calibrate_count"] - table["zero_count"]) / table["calibrate_pressure_Pa"]
    counts = table["zero_count"] + gain * (pressure - table["zoc_reference_Pa"])
    counts = counts + noise * rng.standard_normal(counts.size)
    return np.clip(np.round(counts), 0, 4095) if quantise else counts


def describe(channels: dict[str, Any], rate_hz: float) -> dict[str, Any]:
    return {
        "test": {
            "name": "made up",
            "sample_rate_hz": rate_hz,
            "rotor_speed_rpm": SPEED_RPM,
            "design_corrected_speed_rpm": DESIGN_RPM,
        },
        "compressor": {
            "mean_radius_m": RADIUS_M,
            "inertia_per_m": INERTIA_PER_M,
            "internal_volume_m3": 0.08,
            "gamma": GAMMA,
            "gas_constant_J_kg_K": GAS,
        },
        "planes": {"25": {"area_m2": AREAS[25]}, "31": {"area_m2": AREAS[31]}},
        "adc": {"bits": 12, "low_V": -5.0, "high_V": 5.0},
        "segmentation": {"threshold_lbm_s": 50.0},
        "near_stall": {
            "from_s": 0.0,
            "to_s": 0.2,
            "P25_Pa": 55e3,
            "T25_K": 255.0,
            "P31_Pa": 1.285e6,
            "T31_K": 698.0,
        },
        "channels": channels,
    }


def truth_of(waves: dict[str, np.ndarray], time_s: np.ndarray) -> dict[str, np.ndarray]:
    """φ and ψ' of the test, from the waves alone."""
    mach = mach_of(waves["flow"] * LBM, AREAS[25])
    static = waves["T25"] / (1 + 0.2 * mach**2)
    phi = mach * np.sqrt(GAMMA * GAS * static) / U_M_S
    flow = waves["flow"] * LBM * waves["P25"] / 101325.0 * np.sqrt(288.15 / waves["T25"])
    delivered = waves["P31"] + INERTIA_PER_M * np.gradient(flow, time_s)
    heat = GAMMA * GAS / (GAMMA - 1)
    rise = (delivered / waves["P25"]) ** ((GAMMA - 1) / GAMMA) - 1
    psi_p = 2 * heat * waves["T25"] / U_M_S**2 * rise
    return {"phi": phi, "psi_p": psi_p, "W25_kg_s": flow, **waves}
