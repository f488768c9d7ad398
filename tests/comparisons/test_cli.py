"""The command line as a user meets it: what works, and what each mistake is told."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from commands import refused, run
from lag_data import PERIOD_S, TAU_S, flow, lagged

from comparisons.rig import simulate, write_run


def series_table(n: int = 3000, seed: int = 0) -> pd.DataFrame:
    rng = np.random.default_rng(seed)
    phi = flow(n, rng)
    psi_p = lagged(phi, "first") + 0.003 * rng.standard_normal(n)
    return pd.DataFrame({"time_s": np.arange(n) * PERIOD_S, "phi": phi, "psi_p": psi_p})


@pytest.fixture(scope="module")
def raw(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("raw") / "985"
    write_run(simulate("985", seed=5), folder)
    return folder


def test_simulate_reduce_compare_save_reconstruct(raw: Path, tmp_path: Path) -> None:
    second = tmp_path / "second"
    assert run("simulate", "--case", "985-second", "--seed", 6, "-o", second) == 0
    files = []
    for folder, suffix in ((raw, ".csv"), (second, ".nc")):
        files.append(tmp_path / f"{folder.name}{suffix}")
        assert (
            run("reduce", folder / "raw.csv", "--test", folder / "test.toml", "-o", files[-1]) == 0
        )
    model, report = tmp_path / "m.json", tmp_path / "r.html"
    assert run("compare", files[0], "--no-twins", "--save", model, "--report", report) == 0
    assert "<html" in report.read_text("utf-8")
    out, scores = tmp_path / "rec.csv", tmp_path / "rec.json"
    again = ("reconstruct", model, files[1], "--estimator", "paper")
    assert run(*again, "-o", out, "--json", scores, "--report", tmp_path / "v.html") == 0
    table = pd.read_csv(out)
    error = table["psi_p"] - table["psi_p_reconstructed"]
    other = json.loads(scores.read_text("utf-8"))["reconstructions"][0]
    assert other["fitted_to_it"] is False
    assert run("reconstruct", model, files[0], "--json", tmp_path / "own.json") == 0
    own = json.loads((tmp_path / "own.json").read_text("utf-8"))["reconstructions"]
    assert all(each["fitted_to_it"] for each in own)
    score = other["free_run"]
    assert np.sqrt(np.mean(error**2)) == pytest.approx(score["rms"], rel=1e-9)
    assert score["r2"] > 0.8


def test_a_plain_series_of_three_columns_is_enough(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, out, model = tmp_path / "s.csv", tmp_path / "c.json", tmp_path / "m.json"
    series_table().to_csv(file, index=False)
    assert run("compare", file, "--json", out, "--degree", 2, "--save", model) == 0
    assert run("reconstruct", model, file) == 0
    assert "armax on the rows" in capsys.readouterr().out.split("models were fitted")[1]
    estimators = json.loads(out.read_text("utf-8"))["estimators"]
    for name in ("classic_ml", "sindy"):
        tau = estimators[name]["time_constant_s"]
        assert abs(tau["value"] - TAU_S) < 4 * tau["stderr"]
        assert tau["ci95"][0] < tau["value"] < tau["ci95"][1]


def nothing_but(folder: Path, *names: str) -> bool:
    return sorted(p.name for p in folder.iterdir()) == sorted(names)


def test_missing_files_and_folders_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "s.csv"
    assert "no such file" in refused(capsys, "compare", file)
    series_table(300).to_csv(file, index=False)
    assert "folder" in refused(capsys, "compare", file, "--json", tmp_path / "none" / "c.json")
    assert ".html" in refused(capsys, "compare", file, "--report", tmp_path / "r.txt")
    assert "folder" in refused(capsys, "compare", file, "--save", tmp_path)
    assert "no such file" in refused(capsys, "reconstruct", tmp_path / "m.json", file)
    # The inputs are looked for before any of them is read.
    (tmp_path / "bad.csv").write_text("nothing", "utf-8")
    absent = ("compare", tmp_path / "bad.csv", "--model", tmp_path / "m.json")
    assert "m.json: expected a file that exists" in refused(capsys, *absent)
    (tmp_path / "bad.csv").unlink()
    assert nothing_but(tmp_path, "s.csv")


def test_no_output_replaces_an_input_or_another_output(
    raw: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, model = tmp_path / "s.csv", tmp_path / "m.json"
    series_table(600).to_csv(file, index=False)
    before = file.read_bytes()
    again = tmp_path / "." / "s.csv"
    assert "input" in refused(capsys, "compare", file, "--json", again)
    assert "input" in refused(capsys, "compare", file, "--save", file)
    assert "another output" in refused(capsys, "compare", file, "--json", model, "--save", model)
    counts = (raw / "raw.csv").read_bytes()
    assert "input" in refused(
        capsys, "reduce", raw / "raw.csv", "--test", raw / "test.toml", "-o", raw / "raw.csv"
    )
    assert (raw / "raw.csv").read_bytes() == counts
    assert file.read_bytes() == before
    assert nothing_but(tmp_path, "s.csv")


def test_an_interrupt_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("comparisons.cli.command.Command._check_files", interrupted)
    assert run("compare", tmp_path / "s.csv") == 130
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("compare", "s.csv", "--degree", "two"), "found 'two'"),
        (("orders", "s.csv", "--degrees", "-1"), "--degrees: expected a whole number"),
        (("compare", "s.csv", "--hold", "second"), "--hold: invalid choice"),
        (("compare", "s.csv", "--tau", "-5ms"), "above 0 and up to 10 s, found -0.005 s"),
        (("compare", "s.csv", "--tau", "abc"), "a time constant such as 18ms"),
        (("compare",), "SERIES"),
        ((), "COMMAND"),
    ],
)
def test_bad_options_exit_with_2_and_one_sentence(
    arguments: tuple[str, ...], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        run(*arguments)
    assert stop.value.code == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1


def test_orders_recommends_the_right_model(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, out = tmp_path / "s.csv", tmp_path / "o.json"
    series_table().to_csv(file, index=False)
    assert run("orders", file, "--degrees", 1, 2, 3, "--lags", 0, 1, "--json", out) == 0
    document = json.loads(out.read_text("utf-8"))
    assert document["recommended"]["degree"] == 2
    assert document["recommended"]["input_lag"] == 0
    # arx, armax with C of order 1 and 2, and output error.
    assert len(document["rows"]) == 4 * 3 * 2
    text = capsys.readouterr().out
    assert document["reason"] in text
    assert "*" in text
