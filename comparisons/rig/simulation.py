"""One simulated surge test: the raw record, what describes it, apart from both the truth; files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from classic_ml.records import LedgerEntry, Record
from comparisons.rig.cases import CASES, RigCase
from comparisons.rig.gas import GAMMA, GAS_CONSTANT_J_KG_K
from comparisons.rig.hidden import BUMP_PHI, BUMP_WIDTH_PHI, hide_effect
from comparisons.rig.instrument import (
    RAW_RATE_HZ,
    Instruments,
    corrected_plane_flow_kg_s,
    instrument,
)
from comparisons.rig.plant import PLANT_RATE_HZ, PlantRun, run_plant
from comparisons.rig.sensors import ADC_BITS, ADC_HIGH_V, ADC_LOW_V, SensorSettings
from surge_core.errors import InputError
from surge_core.record_folder import write_record_folder
from surge_core.types import FloatArray

# The near-stall reading ends at 0.14 s; a record must hold it and a little more. The whole run is
# held in memory at 10 kHz, 2 MB a second.
_SHORTEST_S = 0.2
_LONGEST_S = 120.0


@dataclass(frozen=True)
class RigRun:
    """What one simulated test leaves behind.

    Parameters
    ----------
    raw : Record
        Sixteen pressure channels in counts and four temperatures in K, at 1 kHz.
    test : mapping
        What ``test.toml`` holds: everything a reduction may know.
    truth : Record
        The plant at 1 kHz, before any sensor.
    truth_parameters : mapping
        The parameters behind it: τ, characteristic, plant, each transducer's own values and, under
        ``hidden``, the effect that was hidden.
    """

    raw: Record
    test: Mapping[str, Any]
    truth: Record
    truth_parameters: Mapping[str, Any]


def simulate(
    case: str | RigCase = "985",
    *,
    seed: int = 0,
    duration_s: float = 4.0,
    sensors: SensorSettings | None = None,
    hide: str | None = None,
    hide_size: float | None = None,
) -> RigRun:
    """Simulate one surge test; the same arguments always give the same run.

    Parameters
    ----------
    case : str or RigCase
        A name out of `CASES`, or a case altered with `dataclasses.replace`.
    seed : int
        Seed of the sensors' noise, bias and sensitivity. The plant itself has no randomness.
    duration_s : float
        Length of the record in seconds, 0.2 to 120.
    sensors : SensorSettings, optional
        The imperfections; by default those of the paper's instrumentation.
    hide : str, optional
        An effect out of `comparisons.rig.HIDEABLE` to hide where it happens. Record and test
        description do not name it; the truth parameters do.
    hide_size : float, optional
        Its size; by default the one that `HIDEABLE` states.

    Returns
    -------
    RigRun
        Raw record, test description, truth.

    Raises
    ------
    InputError
        When the case or the effect is unknown, the duration or size is unusable, or the altered
        plant does not stay finite.
    """
    plant = case if isinstance(case, RigCase) else CASES.get(case)
    if plant is None:
        raise InputError(
            "case", expected="one of " + ", ".join(CASES), found=f"{case!r}", remedy="name one"
        )
    settings = SensorSettings() if sensors is None else sensors
    if not _SHORTEST_S <= duration_s <= _LONGEST_S:
        possible = f"{_SHORTEST_S} to {_LONGEST_S:.0f} seconds"
        raise InputError("duration_s", expected=possible, found=f"{duration_s!r}")
    altered, hidden = hide_effect(hide, hide_size)
    n_samples = round(duration_s * RAW_RATE_HZ) + 1
    n_rows = (n_samples - 1) * round(PLANT_RATE_HZ / RAW_RATE_HZ) + 1
    run = run_plant(plant, n_rows=n_rows, altered=altered)
    rng = np.random.default_rng(seed)
    chain = instrument(plant, run, settings, rng, altered)
    source = f"simulated rig, case {plant.name}, seed {seed}"
    did = LedgerEntry(
        "simulate",
        f"simulated {n_samples} samples of case {plant.name}",
        {"case": plant.name, "seed": int(seed), "duration_s": float(duration_s)},
    )
    raw = Record.from_arrays(
        {name: (values, chain.channels[name]["unit"]) for name, values in chain.values.items()},
        sample_rate_hz=settings.sample_rate_hz,
        source=source,
    ).after(did)
    truth = _truth(plant, run, source + ", truth").after(did)
    parameters = _truth_table(chain, int(seed), truth)
    if hidden:
        parameters["hidden"] = hidden
    return RigRun(raw, _test_table(chain), truth, parameters)


def _truth(case: RigCase, run: PlantRun, source: str) -> Record:
    """Return the plant's own signals at 1 kHz."""
    wc25 = corrected_plane_flow_kg_s(run, 25)
    shift = case.hub_tip_flow_kg_s * run["blend"]
    speed = case.corrected_speed_frac * np.sqrt(case.supply_temperature_k / run["T25"])
    arrays = {
        "phi": (run["phi"], "1"),
        "psi_p": (run["psi_p_total"], "1"),
        "psi": (run["psi"], "1"),
        "psi_p_lagged": (run["psi_p_lagged"], "1"),
        "psi_p_qs": (run["psi_p_qs"], "1"),
        "psi_qs": (run["psi_qs"], "1"),
        "W25_kg_s": (run["W25"], "kg/s"),
        "dW25_kg_s2": (run["dW25"], "kg/s^2"),
        "W31_kg_s": (run["W31"], "kg/s"),
        "Wc25_kg_s": (wc25, "kg/s"),
        "Wc25_hub_kg_s": (wc25 + shift, "kg/s"),
        "Wc25_tip_kg_s": (wc25 - shift, "kg/s"),
        "P25_Pa": (run["P25"], "Pa"),
        "P31_Pa": (run["P31"], "Pa"),
        "T25_K": (run["T25"], "K"),
        "T31_K": (run["T31"], "K"),
        "Nc_frac": (speed, "1"),
        "in_stall": (run["in_stall"], "1"),
        "stall_blend": (run["blend"], "1"),
        "cell_amplitude": (run["cells"], "1"),
        "throttle_frac": (run["throttle"], "1"),
    }
    step = round(PLANT_RATE_HZ / RAW_RATE_HZ)
    return Record.from_arrays(
        {name: (values[::step], unit) for name, (values, unit) in arrays.items()},
        sample_rate_hz=RAW_RATE_HZ,
        source=source,
    )


def _test_table(chain: Instruments) -> dict[str, Any]:
    """Return what ``test.toml`` holds, in the order of the file."""
    case, settings, factor = chain.case, chain.settings, chain.altered["flow_inertia"]
    # All digits of the product would give the factor away.
    inertia = case.inertia_per_m if factor == 1.0 else float(f"{case.inertia_per_m * factor:.5g}")
    bits = ADC_BITS if settings.bits is None else settings.bits
    threshold = "none" if case.segmentation is None else case.segmentation
    table: dict[str, Any] = {
        "test": {
            "name": f"simulated rig, case {case.name}",
            "sample_rate_hz": settings.sample_rate_hz,
            "rotor_speed_rpm": case.rotor_speed_rpm,
            "design_corrected_speed_rpm": case.design_speed_rpm,
        },
        "compressor": {
            "mean_radius_m": case.mean_radius_m,
            "inertia_per_m": inertia,
            "internal_volume_m3": case.internal_volume_m3,
            "gamma": GAMMA,
            "gas_constant_J_kg_K": GAS_CONSTANT_J_KG_K,
        },
        "planes": {"25": {"area_m2": case.inlet_area_m2}, "31": {"area_m2": case.exit_area_m2}},
        "adc": {"bits": bits, "low_V": ADC_LOW_V, "high_V": ADC_HIGH_V},
        "near_stall": dict(chain.near_stall),
        "segmentation": {"threshold_lbm_s": threshold},
    }
    if case.window_s is not None:
        table["window"] = {"from_s": case.window_s[0], "to_s": case.window_s[1]}
    if settings.acquisition_limits and case.t31_limit_k is not None:
        table["limits"] = {f"T31_{rake}": list(case.t31_limit_k) for rake in ("A", "B")}
    table["channels"] = {name: dict(entry) for name, entry in chain.channels.items()}
    return table


def _truth_table(chain: Instruments, seed: int, truth: Record) -> dict[str, Any]:
    """Return the parameters behind a run; everything that must not reach a reduction."""
    case = chain.case
    turns = np.diff((truth["in_stall"] > 0.0).astype(np.int64), prepend=0)
    phi = np.linspace(-0.05, case.recovery_phi, 81)
    bump = np.exp(-(((phi - BUMP_PHI) / BUMP_WIDTH_PHI) ** 2))
    psi_p = case.in_stall_psi_p(phi) + chain.altered["characteristic_shape"] * bump
    return {
        "tau_s": case.tau_s,
        "beta": list(case.pressure_terms),
        "reverse_loss": case.reverse_loss,
        "psi_intercept": case.work_intercept,
        "psi_slopes": list(case.work_slopes),
        "psi_breaks": list(case.work_breaks),
        "rotor_velocity_m_s": case.rotor_velocity_m_s,
        "seed": seed,
        "stall_times_s": truth.time_s[np.flatnonzero(turns > 0)].tolist(),
        "recovery_times_s": truth.time_s[np.flatnonzero(turns < 0)].tolist(),
        "case": asdict(case),
        "sensor_settings": asdict(chain.settings),
        "sensors": {name: dict(entry) for name, entry in chain.truth.items()},
        "quasi_steady": {"phi": phi.tolist(), "psi_p": psi_p.tolist()},
    }


def write_run(run: RigRun, folder: str | Path) -> None:
    """Write a run: the raw record as a test would leave it, and the truth in a folder of its own.

    ``folder/raw.csv`` and ``folder/test.toml`` are all that a reduction needs; ``folder/truth``
    holds ``truth.csv`` and ``truth.toml``.

    Parameters
    ----------
    run : RigRun
        The run.
    folder : str or Path
        A folder that does not exist yet, or an empty one.

    Raises
    ------
    InputError
        When the folder holds something already, or is a file.
    """
    columns = {"raw.csv": _columns(run.raw), "truth/truth.csv": _columns(run.truth)}
    tables = {"test.toml": run.test, "truth/truth.toml": run.truth_parameters}
    write_record_folder(Path(folder), columns, tables)


def _columns(record: Record) -> dict[str, tuple[FloatArray, str]]:
    """Return the columns of a file with their formats: kelvin to 1 mK, the rest to 9 digits."""
    channels = record.channels.items()
    clock = "%.3f" if record.sample_rate_hz <= RAW_RATE_HZ else "%.4f"
    return {"time_s": (record.time_s, clock)} | {
        name: (c.values, "%.3f" if c.unit == "K" else "%.9g") for name, c in channels
    }
