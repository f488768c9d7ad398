"""The command `structure`: the terms of known truths, what is written, and a refusal."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from commands import run
from scipy.signal import lfilter, lfiltic

PERIOD_S = 1e-3
TAU_S = 0.018
BETA = {"1": 0.3, "phi": 2.0, "phi^2": -6.0}
SUB = 20


def series_table(late: int = 0, n: int = 3000, noise: float = 0.02, seed: int = 0) -> pd.DataFrame:
    """ψ' of a parabola behind a lag, by the trapezoid rule at a twentieth of the sample period."""
    rng = np.random.default_rng(seed)
    t = np.arange((n - 1) * SUB + 1) * PERIOD_S / SUB
    phi = 0.10 + 0.13 * np.sin(2 * np.pi * 3.1 * t) + 0.05 * np.sin(2 * np.pi * 7.3 * t + 1.0)
    rest = BETA["1"] + BETA["phi"] * phi + BETA["phi^2"] * phi**2
    half = PERIOD_S / SUB / TAU_S / 2
    b, a = np.array([half, half]) / (1 + half), [1.0, -(1 - half) / (1 + half)]
    psi_p = lfilter(b, a, rest, zi=lfiltic(b, a, rest[:1], rest[:1]))[0]
    x, y = phi[::SUB], psi_p[::SUB]
    y = np.concatenate([np.full(late, y[0]), y[: n - late]])
    return pd.DataFrame(
        {
            "time_s": np.arange(n) * PERIOD_S,
            "phi": x + noise * x.std() * rng.standard_normal(n),
            "psi_p": y + noise * y.std() * rng.standard_normal(n),
        }
    )


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("clean") / "s.csv"
    series_table().to_csv(file, index=False)
    return file


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A series reduced from a simulated record: it carries a whole unfiltered run."""
    folder = tmp_path_factory.mktemp("whole")
    assert run("simulate", "--duration", 3, "-o", folder) == 0
    out = folder / "s.csv"
    assert run("reduce", folder / "raw.csv", "--test", folder / "test.toml", "-o", out) == 0
    return out


def numbers(folder: Path, *arguments: object) -> dict[str, Any]:
    out = folder / "numbers.json"
    assert run("structure", *arguments, "--json", out) == 0
    document: dict[str, Any] = json.loads(out.read_text("utf-8"))
    return document


@pytest.fixture(scope="module")
def written(clean: Path) -> Path:
    """The folder with all that the command can write of the clean series."""
    folder = clean.parent
    assert run("structure", clean, "--json", folder / "n.json") == 0
    return folder


def test_terms_lag_and_errors_of_a_parabola_are_found(written: Path) -> None:
    found = json.loads((written / "n.json").read_text("utf-8"))
    assert found["schema"] == "sindy-surge/structure/1"
    assert found["fitted_to"] == "rows"
    assert found["state"]["code"] == "ok"
    assert [term["name"] for term in found["terms"]] == list(BETA)
    for term in found["terms"]:
        assert abs(term["coefficient"] - BETA[term["name"]]) < 4 * term["stderr"]
        assert term["stderr"] < 0.02 * abs(BETA[term["name"]])
        assert term["inclusion_probability"] > 0.8
    tau = found["time_constant_s"]
    assert abs(tau["value"] - TAU_S) < 4 * tau["stderr"] < 0.05 * TAU_S
    assert tau["ci95"][0] < tau["value"] < tau["ci95"][1]
    assert found["dead_time_s"]["value"] == 0.0
    signals = series_table(noise=0.0)
    for name in ("phi", "psi_p"):
        assert found["noise"][name] == pytest.approx(0.02 * signals[name].std(), rel=0.2)


def test_whole_runs_are_fitted_where_a_record_carries_one(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report = tmp_path / "r.html"
    run_through = numbers(tmp_path, whole, "--report", report)
    assert run_through["fitted_to"] == "whole runs"
    assert "in one simulation" in capsys.readouterr().out
    tau = run_through["time_constant_s"]
    # The rig's truth is 18 ms; its rms error over records is a millisecond.
    assert abs(tau["value"] - 0.018) < 0.003
    assert run_through["dead_time_s"] == {"value": None, "stderr": None}
    assert report.read_text("utf-8").count("<img") == 1


def test_rows_behind_a_low_pass_carry_the_word_on_tau(whole: Path, tmp_path: Path) -> None:
    rows = tmp_path / "rows.csv"
    pd.read_csv(whole)[["time_s", "phi", "psi_p", "segment"]].to_csv(rows, index=False)
    shutil.copy(whole.with_suffix(".ledger.json"), rows.with_suffix(".ledger.json"))
    found = numbers(tmp_path, rows)
    assert found["fitted_to"] == "rows"
    assert any("low-passed" in caution for caution in found["cautions"])


def test_a_blowdown_is_refused_in_words(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("simulate", "--case", "blowdown", "--duration", 3, "-o", tmp_path) == 0
    file = tmp_path / "s.csv"
    assert run("reduce", tmp_path / "raw.csv", "--test", tmp_path / "test.toml", "-o", file) == 0
    capsys.readouterr()
    found = numbers(tmp_path, file, "--report", tmp_path / "r.html")
    assert found["state"]["code"] == "blowdown"
    assert found["equation"] is None
    assert found["terms"] == []
    assert "no structure (blowdown)" in capsys.readouterr().out
    assert "<img" not in (tmp_path / "r.html").read_text("utf-8")


def test_rows_that_bear_no_curve_get_no_equation(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # Near stall and steady: φ hardly moves, and a curve through it may be anything.
    table, rng = series_table(), np.random.default_rng(0)
    table["phi"] = 0.4 + 0.003 * rng.standard_normal(len(table))
    table["psi_p"] = 0.6 + 0.004 * rng.standard_normal(len(table))
    table.to_csv(tmp_path / "steady.csv", index=False)
    document = numbers(tmp_path, tmp_path / "steady.csv")
    assert document["equation"] is None
    assert "no structure (lag_undetermined)" in capsys.readouterr().out
    assert run("diagnose", tmp_path / "steady.csv") == 0
    assert "These records do not hold τ" in capsys.readouterr().out
