from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rig_records import rig_run

from comparisons.rig import CASES, RigRun, SensorSettings, simulate, write_run
from surge_core.errors import InputError

Table = dict[str, np.ndarray]


def _decode(run: RigRun) -> Table:
    """Counts to local flow by the paper's equations, written here a third time."""
    test: Any = run.test
    out: Table = {}
    pressures: Table = {}
    for name, channel in test["channels"].items():
        values = run.raw[name]
        if channel["kind"] == "temperature":
            out[name] = values / channel["recovery_factor"]
            continue
        per_pa = (channel["calibrate_count"] - channel["zero_count"]) / channel[
            "calibrate_pressure_Pa"
        ]
        pressures[name] = (values - channel["zero_count"]) / per_pa + channel["zoc_reference_Pa"]
    for plane in (25, 31):
        area = test["planes"][str(plane)]["area_m2"]
        flows, totals = [], []
        for rake in "AB":
            for immersion in ("tip", "hub"):
                stem = f"P{plane}_{rake}_{immersion}"
                front, back = pressures[f"{stem}_forward"], pressures[f"{stem}_aft"]
                ratio = np.maximum(front, back) / np.minimum(front, back)
                mach = np.sqrt(5.0 * (ratio ** (2.0 / 7.0) - 1.0))
                pair = test["channels"][f"{stem}_forward"]
                mach = np.where(mach > 0.0, pair["probe_slope"] * mach + pair["probe_offset"], 0.0)
                flow = np.sign(front - back) * area * 416.8648 * mach / (1.0 + 0.2 * mach**2) ** 3
                out[stem] = flow
                flows.append(flow)
                totals.append(np.maximum(front, back))
        out[f"Wc{plane}"] = np.mean(flows, axis=0)
        out[f"P{plane}"] = np.mean(totals, axis=0)
        out[f"T{plane}"] = 0.5 * (out[f"T{plane}_A"] + out[f"T{plane}_B"])
        out[f"W{plane}"] = (
            out[f"Wc{plane}"] * out[f"P{plane}"] / 101_325.0 * np.sqrt(288.15 / out[f"T{plane}"])
        )
    return out


@pytest.mark.parametrize("name", CASES)
def test_ideal_sensors_hide_nothing(name: str) -> None:
    run = rig_run(name, sensors=SensorSettings.ideal())
    got, truth = _decode(run), run.truth
    for mine, theirs in (("P25", "P25_Pa"), ("P31", "P31_Pa"), ("T25", "T25_K"), ("T31", "T31_K")):
        assert got[mine] == pytest.approx(truth[theirs], rel=1e-9)
    # The lumped plant knows no choking at plane 31: recoveries of the blowdown case, whose large
    # volume keeps P31 low, pass it for a few rows, and probes cannot show more than M = 1.
    theta, delta = truth["T31_K"] / 288.15, truth["P31_Pa"] / 101_325.0
    subsonic = truth["W31_kg_s"] * np.sqrt(theta) / delta < 0.99 * 0.065 * 416.86 / 1.728
    assert np.mean(subsonic) > (0.97 if name == "blowdown" else 0.999)
    for mine, theirs in (("Wc25", "Wc25_kg_s"), ("W25", "W25_kg_s"), ("W31", "W31_kg_s")):
        error = np.abs(got[mine] - truth[theirs])[subsonic]
        assert np.max(error) < 1e-4 * np.max(np.abs(truth[theirs]))


def test_written_files_hold_the_run(tmp_path: Path) -> None:
    run = rig_run("90")
    write_run(run, tmp_path / "out" / "run")
    folder = tmp_path / "out" / "run"
    assert sorted(p.name for p in folder.iterdir()) == ["raw.csv", "test.toml", "truth"]
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["run"]
    with (folder / "test.toml").open("rb") as file:
        assert tomllib.load(file) == dict(run.test)
    with (folder / "truth" / "truth.toml").open("rb") as file:
        written, known = tomllib.load(file), dict(run.truth_parameters)
    for table in (written, known):
        case = table.pop("case")
        assert case["pressure_terms"][2] == CASES["90"].pressure_terms[2]
    assert written == known
    for record, path in ((run.raw, "raw.csv"), (run.truth, "truth/truth.csv")):
        header = (folder / path).read_text(encoding="utf-8").splitlines()[0].split(",")
        assert header == ["time_s", *record.channels]
        table = np.loadtxt(folder / path, delimiter=",", skiprows=1)
        assert table[:, 0] == pytest.approx(record.time_s, abs=1e-9)
        for column, name in enumerate(record.channels, start=1):
            if record.channel(name).unit == "count":
                assert np.array_equal(table[:, column], record[name])
            else:
                assert table[:, column] == pytest.approx(record[name], abs=6e-4, rel=1e-8)
    assert "." not in (folder / "raw.csv").read_text(encoding="utf-8").splitlines()[1].split(",")[1]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"case": "98.5"}, "case: expected one of 985, 90"),
        ({"duration_s": -1.0}, "duration_s: expected 0.2 to 120 seconds, found -1.0"),
    ],
)
def test_unusable_arguments_are_named_in_one_sentence(
    arguments: dict[str, Any], words: str
) -> None:
    with pytest.raises(InputError) as caught:
        simulate(**{"case": "985", **arguments})
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


WINDOW = slice(1_000, 3_901)


def curve(name: str, phi: np.ndarray) -> np.ndarray:
    return np.polynomial.polynomial.polyval(phi, CASES[name].pressure_terms)


def test_the_machine_sits_in_stall_while_the_throttle_moves() -> None:
    run = rig_run("75-stall")
    onset = int(np.flatnonzero(run.truth["in_stall"])[0])
    assert np.all(run.truth["in_stall"][onset:] == 1.0)
    assert run.truth_parameters["recovery_times_s"] == []
    # Rotating stall, not surge: no reversed flow, and both ways of the sweep in the window.
    phi = run.truth["phi"][WINDOW]
    assert run.truth["phi"].min() > 0.0
    assert phi.min() < 0.03
    assert phi.max() > 0.14
    assert np.any(np.diff(phi) < 0.0)
    assert np.any(np.diff(phi) > 0.0)
    assert run.truth["cell_amplitude"][WINDOW].min() > 0.99
    assert 0.73 < run.truth["Nc_frac"][WINDOW].min() <= run.truth["Nc_frac"].max() <= 0.7501


def test_it_is_steady() -> None:
    truth = rig_run("75-stall").truth
    off = truth["psi_p"][WINDOW] - truth["psi_p_qs"][WINDOW]
    assert np.max(np.abs(off)) < 0.02
    assert truth["psi_p_qs"][WINDOW] == pytest.approx(curve("75-stall", truth["phi"][WINDOW]))
    # The same curve on the way out and on the way back, but for twice that.
    slope = np.gradient(truth["phi"])[WINDOW]
    phi, value = truth["phi"][WINDOW], truth["psi_p"][WINDOW]
    back, out = (np.argsort(phi[way]) for way in (slope < 0.0, slope > 0.0))
    grid = np.linspace(0.04, 0.13, 20)
    down = np.interp(grid, phi[slope < 0.0][back], value[slope < 0.0][back])
    up = np.interp(grid, phi[slope > 0.0][out], value[slope > 0.0][out])
    assert down == pytest.approx(up, abs=0.04)
