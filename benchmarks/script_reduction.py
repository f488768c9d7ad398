"""The reduction as one would write it in an afternoon: pandas, numpy and scipy, whole arrays.

Counts to pascal, near-stall match, 48 Hz both ways, Eq 1 to 4 at each probe pair, plane means,
Eq 7 and Eq 5. It shares nothing with `classic_ml`, and does without what that does besides: no
search for faults or for the window, no unfiltered series, no ψ, no stall state, no history.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

FloatArray = NDArray[np.float64]
P_STANDARD_PA, T_STANDARD_K = 101_325.0, 288.15
ORDER, CUTOFF_HZ = 3, 48.0
MACH_TABLE_ROWS = 20_001


def read(folder: Path) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Return the table of raw.csv and what test.toml says."""
    test = tomllib.loads((folder / "test.toml").read_text("utf-8"))
    return pd.read_csv(folder / "raw.csv"), test


def reduce_by_script(raw: pd.DataFrame, test: dict[str, Any]) -> tuple[FloatArray, FloatArray]:
    """Return φ and ψ' from channels in counts and kelvin, and what test.toml says of them."""
    machine, channels = test["compressor"], test["channels"]
    gamma, gas = machine["gamma"], machine["gas_constant_J_kg_K"]
    heat = gamma * gas / (gamma - 1.0)
    rotor_m_s = 2.0 * np.pi * test["test"]["rotor_speed_rpm"] / 60.0 * machine["mean_radius_m"]
    rate_hz = test["test"]["sample_rate_hz"]
    physical = _matched(_physical(raw, test), raw["time_s"].to_numpy(), test)
    sections = butter(ORDER, CUTOFF_HZ, fs=rate_hz, output="sos")
    smooth = pd.DataFrame(
        sosfiltfilt(sections, physical.to_numpy(), axis=0), columns=physical.columns
    )
    corrected, total = {}, {}
    for plane in (25, 31):
        area = test["planes"][str(plane)]["area_m2"]
        pairs = [n for n, c in channels.items() if c["plane"] == plane and n.endswith("_forward")]
        flows, pressures = [], []
        for name in pairs:
            forward = smooth[name].to_numpy()
            aft = smooth[name.replace("_forward", "_aft")].to_numpy()
            high, low = np.maximum(forward, aft), np.minimum(forward, aft)
            calculated = np.sqrt(2 / (gamma - 1) * ((high / low) ** ((gamma - 1) / gamma) - 1))
            probe = channels[name]
            mach = np.maximum(probe["probe_slope"] * calculated + probe["probe_offset"], 0.0)
            flows.append(np.sign(forward - aft) * _flow(mach, area, gamma, gas))
            pressures.append(high)
        corrected[plane], total[plane] = np.mean(flows, axis=0), np.mean(pressures, axis=0)
    couples = [n for n, c in channels.items() if c["kind"] == "temperature" and c["plane"] == 25]
    inlet_K = smooth[couples].mean(axis=1).to_numpy()
    mach_table = np.linspace(0.0, 1.0, MACH_TABLE_ROWS)
    area = test["planes"]["25"]["area_m2"]
    flow_table = _flow(mach_table, area, gamma, gas)
    mach = np.sign(corrected[25]) * np.interp(np.abs(corrected[25]), flow_table, mach_table)
    static_K = inlet_K / (1 + (gamma - 1) / 2 * mach**2)
    phi = mach * np.sqrt(gamma * gas * static_K) / rotor_m_s
    flow_kg_s = corrected[25] * total[25] / P_STANDARD_PA * np.sqrt(T_STANDARD_K / inlet_K)
    inertia_Pa = machine["inertia_per_m"] * np.gradient(flow_kg_s, 1.0 / rate_hz)
    ratio = (total[31] + inertia_Pa) / total[25]
    psi_p = 2 * heat * inlet_K / rotor_m_s**2 * (ratio ** ((gamma - 1) / gamma) - 1)
    return phi, psi_p


def _flow(mach: FloatArray, area_m2: float, gamma: float, gas: float) -> FloatArray:
    """Return the corrected flow in kg/s (Eq 3)."""
    constant = area_m2 * P_STANDARD_PA * np.sqrt(gamma / (gas * T_STANDARD_K))
    power = (gamma + 1) / (2 * (gamma - 1))
    return np.asarray(constant * mach / (1 + (gamma - 1) / 2 * mach**2) ** power)


def _physical(raw: pd.DataFrame, test: dict[str, Any]) -> pd.DataFrame:
    """Turn counts into pascal and indicated into total temperatures; two-point calibration."""
    columns = {}
    for name, channel in test["channels"].items():
        if channel["kind"] == "temperature":
            columns[name] = raw[name] / channel["recovery_factor"]
            continue
        # The volts of a count cancel between the reading and its two references.
        span = channel["calibrate_count"] - channel["zero_count"]
        share = (raw[name] - channel["zero_count"]) / span
        columns[name] = share * channel["calibrate_pressure_Pa"] + channel["zoc_reference_Pa"]
    return pd.DataFrame(columns)


def _matched(physical: pd.DataFrame, time_s: FloatArray, test: dict[str, Any]) -> pd.DataFrame:
    """Move each pair, and each thermocouple, to the facility's reading near stall."""
    steady = test["near_stall"]
    half = 0.5 / test["test"]["sample_rate_hz"]
    rows = (time_s >= steady["from_s"] - half) & (time_s <= steady["to_s"] + half)
    shifted = {}
    for name, channel in test["channels"].items():
        letter = "T" if channel["kind"] == "temperature" else "P"
        unit = "K" if letter == "T" else "Pa"
        leader = name.replace("_aft", "_forward")
        shift = steady[f"{letter}{channel['plane']}_{unit}"] - physical.loc[rows, leader].mean()
        shifted[name] = physical[name] + shift
    return pd.DataFrame(shifted)
