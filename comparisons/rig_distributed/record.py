"""One simulated test: raw record, description and truth, and their files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from comparisons.rig_distributed.gas import GAMMA, R
from comparisons.rig_distributed.instruments import Instruments, draw_instruments
from comparisons.rig_distributed.machine import Machine, draw
from comparisons.rig_distributed.plant import PLANT_HZ, PlantRun, lay_out, run_plant
from comparisons.rig_distributed.rakes import NEAR_STALL_S, Channels, near_stall_reading, read_rakes
from surge_core.errors import InputError
from surge_core.record_folder import write_record_folder
from surge_core.types import FloatArray

DURATION_S = 4.0
_SHORTEST_S, _LONGEST_S = 0.2, 60.0
# A drawn machine counts as one that surges with so many reversals and recoveries in 4 s.
FEWEST_REVERSALS, FEWEST_RECOVERIES = 8, 3
# 23 of 24 draws do.
_MOST_DRAWS = 50
# Where the table of the in-stall curve begins.
_LEAST_PHI = -0.05
# Near stall the flow swings by no more than this share of its mean.
_QUIET = 0.02
_STANDARD_PA, _STANDARD_K = 101_325.0, 288.15


@dataclass(frozen=True)
class DistributedRun:
    """What one test leaves behind.

    Parameters
    ----------
    raw : mapping of str to ndarray
        Codes and kelvin by channel.
    test : mapping
        What ``test.toml`` holds.
    truth : mapping of str to ndarray
        The plant at the record's rate, before any sensor.
    truth_parameters : mapping
        What ``truth.toml`` holds: τ, in-stall curve, machine, instruments, transducers.
    rate_hz : float
        Samples a second.
    """

    raw: Mapping[str, FloatArray]
    test: Mapping[str, Any]
    truth: Mapping[str, FloatArray]
    truth_parameters: Mapping[str, Any]
    rate_hz: float


def simulate(
    machine: Machine | None = None,
    instruments: Instruments | None = None,
    *,
    seed: int = 0,
    duration_s: float = DURATION_S,
) -> DistributedRun:
    """Simulate one surge test; the same arguments always give the same run.

    Parameters
    ----------
    machine : Machine, optional
        The machine; one of medium size by default.
    instruments : Instruments, optional
        The instruments.
    seed : int
        Seed of what the instruments add.
    duration_s : float
        Length of the record, 0.2 to 60 s.

    Raises
    ------
    InputError
        When the duration is unusable, or the machine has no flow that stays finite.
    """
    if not _SHORTEST_S <= duration_s <= _LONGEST_S:
        possible = f"{_SHORTEST_S} to {_LONGEST_S:.0f} seconds"
        raise InputError("duration_s", expected=possible, found=f"{duration_s!r}")
    machine = machine if machine is not None else Machine()
    fitted = instruments if instruments is not None else Instruments()
    n_rows = round(duration_s * fitted.rate_hz) * round(PLANT_HZ / fitted.rate_hz) + 1
    run = run_plant(machine, n_rows=n_rows)
    rng = np.random.default_rng(seed)
    reading = near_stall_reading(run, fitted, rng)
    channels = read_rakes(machine, run, fitted, rng)
    truth = _truth(machine, run, fitted)
    return DistributedRun(
        channels.values,
        _description(machine, fitted, reading, channels),
        truth,
        _parameters(machine, fitted, truth, channels) | {"seed": seed},
        fitted.rate_hz,
    )


def draw_run(seed: int, duration_s: float = DURATION_S) -> DistributedRun:
    """Draw machines and instruments until one surges, and simulate its test.

    Parameters
    ----------
    seed : int
        Of machine, instruments and noise.
    duration_s : float
        Length of the record.

    Raises
    ------
    InputError
        When the duration is unusable.
    """
    rng = np.random.default_rng(seed)
    for _ in range(_MOST_DRAWS):
        machine, fitted = draw(rng), draw_instruments(rng)
        noise = int(rng.integers(1 << 30))
        try:
            phi = run_plant(machine, n_rows=round(DURATION_S * PLANT_HZ))["phi"]
        except InputError:
            continue
        if _is_usable(phi, machine):
            return simulate(machine, fitted, seed=noise, duration_s=duration_s)
    raise InputError("seed", expected="one whose machines surge", found=str(seed))


def _is_usable(phi: FloatArray, machine: Machine) -> bool:
    """Return whether a flow, over 4 s, is steady at first and then surges often enough."""
    before = phi[: round(NEAR_STALL_S * PLANT_HZ)]
    reversals = np.count_nonzero((phi[1:] < 0.0) & (phi[:-1] >= 0.0))
    # Of the way up from reversed flow, as often as it passes the peak.
    marks = np.where(phi < 0.0, -1, np.where(phi > machine.peak_phi, 1, 0))
    marks = marks[marks != 0]
    recoveries = np.count_nonzero((marks[1:] > 0) & (marks[:-1] < 0))
    often = reversals >= FEWEST_REVERSALS and recoveries >= FEWEST_RECOVERIES
    return bool(np.ptp(before) <= _QUIET * np.mean(before) and often)


def draw_record(seed: int, folder: str | Path) -> None:
    """Draw a machine that surges and write its record, description and truth.

    Parameters
    ----------
    seed : int
        Seed of all.
    folder : str or Path
        A folder that does not exist yet, or an empty one.
    """
    write_run(draw_run(seed), folder)


def _truth(machine: Machine, run: PlantRun, fitted: Instruments) -> dict[str, FloatArray]:
    """Return the plant's signals at the record's rate, named as in the files of the format."""
    corrected = run["W25"] * np.sqrt(run["T25"] / _STANDARD_K) * _STANDARD_PA / run["P25"]
    speed = machine.design_speed_ratio * np.sqrt(machine.supply_k / run["T25"])
    same = ("phi", "psi_p", "psi", "psi_p_lagged", "psi_p_qs", "psi_qs")
    columns = {name: run[name] for name in same} | {
        "W25_kg_s": run["W25"],
        "dW25_kg_s2": np.gradient(run["W25"], 1.0 / PLANT_HZ),
        "W31_kg_s": run["W31"],
        "Wc25_kg_s": corrected,
        "P25_Pa": run["P25"],
        "P31_Pa": run["P31"],
        "T25_K": run["T25"],
        "T31_K": run["T31"],
        "Nc_frac": speed,
        "in_stall": run["in_stall"],
        "cell_amplitude": run["amplitude"],
        "throttle_frac": run["throttle"],
    }
    step = round(PLANT_HZ / fitted.rate_hz)
    return {name: values[::step] for name, values in columns.items()}


def _description(
    machine: Machine, fitted: Instruments, reading: Mapping[str, float], channels: Channels
) -> dict[str, Any]:
    """Return what ``test.toml`` holds."""
    path = lay_out(machine)
    inertia, volume = path.between_planes
    rpm = machine.rotation_per_s * 30.0 / np.pi
    theta = machine.supply_k / _STANDARD_K
    return {
        "test": {
            "name": "simulated rig with distributed ducts",
            "sample_rate_hz": fitted.rate_hz,
            "rotor_speed_rpm": float(rpm),
            "design_corrected_speed_rpm": float(rpm / np.sqrt(theta) / machine.design_speed_ratio),
        },
        "compressor": {
            "mean_radius_m": machine.mean_radius_m,
            "inertia_per_m": float(f"{inertia:.4g}"),
            "internal_volume_m3": float(f"{volume:.4g}"),
            "gamma": GAMMA,
            "gas_constant_J_kg_K": R,
        },
        "planes": {
            "25": {"area_m2": machine.inlet_area_m2},
            "31": {"area_m2": machine.exit_area_m2},
        },
        "adc": {"bits": fitted.bits, "low_V": -fitted.half_scale_v, "high_V": fitted.half_scale_v},
        "near_stall": dict(reading),
        "channels": channels.described,
    }


def _parameters(
    machine: Machine, fitted: Instruments, truth: Mapping[str, FloatArray], channels: Channels
) -> dict[str, Any]:
    """Return what ``truth.toml`` holds."""
    stalled = truth["in_stall"] > 0.5
    change = np.diff(stalled.astype(np.int64))
    phi = np.linspace(_LEAST_PHI, machine.peak_phi, 81)
    return {
        "tau_s": machine.tau_s,
        "reverse_loss": machine.reverse_loss,
        "rotor_velocity_m_s": machine.rotor_velocity_m_s,
        "stall_times_s": (np.flatnonzero(change > 0) + 1).astype(float) / fitted.rate_hz,
        "recovery_times_s": (np.flatnonzero(change < 0) + 1).astype(float) / fitted.rate_hz,
        "quasi_steady": {"phi": phi, "psi_p": machine.steady_psi_p(phi)},
        "machine": asdict(machine),
        "instruments": asdict(fitted),
        "sensors": channels.truth,
    }


def write_run(run: DistributedRun, folder: str | Path) -> None:
    """Write ``raw.csv`` and ``test.toml``, and in ``truth`` ``truth.csv`` and ``truth.toml``.

    Parameters
    ----------
    run : DistributedRun
        The run.
    folder : str or Path
        A folder that does not exist yet, or an empty one.

    Raises
    ------
    InputError
        When the folder holds something already, or is a file.
    """
    time_s = np.arange(next(iter(run.raw.values())).size) / run.rate_hz
    columns = {
        place: {"time_s": (time_s, "%.4f")} | {name: (v, "%.9g") for name, v in values.items()}
        for place, values in (("raw.csv", run.raw), ("truth/truth.csv", run.truth))
    }
    tables = {"test.toml": run.test, "truth/truth.toml": run.truth_parameters}
    write_record_folder(Path(folder), columns, tables)
