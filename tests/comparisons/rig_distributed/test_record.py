from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from commands import refused

from classic_ml.io.raw import read_raw
from classic_ml.reduction import reduce_record
from comparisons.rig_distributed import (
    DistributedRun,
    Instruments,
    Machine,
    draw_record,
    simulate,
    write_run,
)
from comparisons.rig_distributed.rakes import hole_pressures_pa
from surge_core.errors import InputError

QUIET = Instruments(noise_frac=0.0, junction_noise_k=0.0, facility_frac=0.0, facility_k=0.0)


@pytest.fixture(scope="module")
def quiet() -> DistributedRun:
    # Rakes that do not see the cell: what they read is the mean of the plane.
    return simulate(Machine(cell_reach=0.0), QUIET, seed=3, duration_s=0.2)


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drawn") / "record"
    draw_record(3, folder)
    return folder


def pressure_pa(run: DistributedRun, name: str) -> np.ndarray:
    entry = run.test["channels"][name]
    per_count = entry["calibrate_pressure_Pa"] / (entry["calibrate_count"] - entry["zero_count"])
    return entry["zoc_reference_Pa"] + per_count * (run.raw[name] - entry["zero_count"])


@pytest.mark.parametrize("plane", [25, 31])
def test_counts_give_back_the_pressures_within_the_resolution(
    quiet: DistributedRun, plane: int
) -> None:
    before = slice(20, 120)
    for name, entry in quiet.test["channels"].items():
        if entry["kind"] != "pressure" or entry["plane"] != plane or entry["facing"] != "forward":
            continue
        step_pa = entry["calibrate_pressure_Pa"] / (entry["calibrate_count"] - entry["zero_count"])
        apart = pressure_pa(quiet, name)[before] - quiet.truth[f"P{plane}_Pa"][before]
        assert np.max(np.abs(apart)) < 3.0 * step_pa


def test_a_pair_gives_back_the_flow_by_equations_1_to_3(quiet: DistributedRun) -> None:
    flows = []
    for rake in "AB":
        for immersion in ("hub", "tip"):
            pair = f"P25_{rake}_{immersion}"
            law = quiet.test["channels"][f"{pair}_aft"]
            forward = np.mean(pressure_pa(quiet, f"{pair}_forward")[20:120])
            aft = np.mean(pressure_pa(quiet, f"{pair}_aft")[20:120])
            calculated = np.sqrt(5.0 * ((forward / aft) ** (1.0 / 3.5) - 1.0))
            mach = law["probe_slope"] * calculated + law["probe_offset"]
            area_m2 = quiet.test["planes"]["25"]["area_m2"]
            flows.append(416.86 * area_m2 * mach / (1.0 + 0.2 * mach**2) ** 3)
    assert np.mean(flows) == pytest.approx(np.mean(quiet.truth["Wc25_kg_s"][20:120]), rel=0.003)


def test_the_law_of_the_probes_has_no_jump_at_zero_flow() -> None:
    mach = np.array([-0.2, -2e-5, -1e-5, 1e-5, 2e-5, 0.2])
    forward, aft = hole_pressures_pa(mach, np.full(6, 1e5), slope=1.1, offset=0.012, knee=0.02)
    calculated = np.sqrt(
        5.0 * ((np.maximum(forward, aft) / np.minimum(forward, aft)) ** (2 / 7) - 1)
    )
    # Far from zero it is Eq 2; near zero a line through it, steeper by b over the knee.
    assert calculated[-1] == pytest.approx((0.2 - 0.012) / 1.1, rel=1e-6)
    assert calculated[2:4] == pytest.approx(1e-5 / (1.1 + 0.012 / 0.02), rel=1e-3)
    assert np.all((forward > aft) == (mach > 0.0))
    assert forward[::-1] == pytest.approx(aft)


def test_a_thermocouple_reads_the_gas_by_its_recovery(quiet: DistributedRun) -> None:
    reading = np.mean(quiet.raw["T25_A"][20:120]) / QUIET.recovery_factor
    assert reading == pytest.approx(np.mean(quiet.truth["T25_K"][20:120]), abs=0.05)
    assert quiet.test["near_stall"]["T25_K"] == pytest.approx(reading, abs=0.05)


def test_the_same_seed_gives_the_same_record(quiet: DistributedRun) -> None:
    noisy = replace(QUIET, noise_frac=0.002)
    same = [simulate(Machine(), noisy, seed=seed, duration_s=0.2).raw for seed in (1, 1, 2)]
    assert all(np.array_equal(same[0][name], same[1][name]) for name in same[0])
    assert not np.array_equal(same[0]["P25_A_tip_aft"], same[2]["P25_A_tip_aft"])


def test_a_drawn_machine_surges_and_its_record_reduces_to_its_truth(drawn: Path) -> None:
    truth = pd.read_csv(drawn / "truth" / "truth.csv")
    phi = truth["phi"].to_numpy()
    about = tomllib.loads((drawn / "truth" / "truth.toml").read_text("utf-8"))
    assert np.count_nonzero((phi[1:] < 0.0) & (phi[:-1] >= 0.0)) >= 8
    assert len(about["recovery_times_s"]) >= 3
    assert 0.010 <= about["tau_s"] <= 0.030
    # The lag that the truth states is that of the series.
    lagged, target = truth["psi_p_lagged"].to_numpy(), truth["psi_p_qs"].to_numpy()
    step_s = float(truth["time_s"][1])
    apart = about["tau_s"] * np.gradient(lagged, step_s) + lagged - target
    assert np.std(apart) < 0.02 * np.std(target)
    series = reduce_record(*read_raw(drawn / "raw.csv", drawn / "test.toml")).series
    stalled = (truth["in_stall"] > 0.5) & (phi > 0.05) & (truth["time_s"] > 1.0)
    assert np.std((series.psi_p - truth["psi_p"])[stalled]) < 0.1
    assert abs(np.mean((series.phi - phi)[stalled])) < 0.03


def test_a_folder_that_holds_something_is_refused(quiet: DistributedRun, drawn: Path) -> None:
    with pytest.raises(InputError, match="a folder with files"):
        write_run(quiet, drawn)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--rig", "distributed", "--case", "90"], "--case"),
        (["--rig", "distributed", "--hide", "flow_inertia"], "--hide"),
        (["--rig", "distributed", "--hide-size", "1.2"], "--hide-size"),
        (["--draw"], "--draw"),
        (["--rig", "distributed", "--duration", "0.01"], "duration_s"),
    ],
)
def test_what_a_rig_lacks_is_refused_in_one_sentence(
    options: list[str], named: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert named in refused(capsys, "simulate", *options, "-o", tmp_path / "r")
