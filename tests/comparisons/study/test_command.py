"""``sindy-surge study`` as it is typed."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest
from commands import refused

from comparisons.cli import main
from comparisons.study.spec import read_spec

SMALL = """
title = "small"
seeds = 2
scores = ["tau_error_ms"]
by = ["record.noise_percent"]
[record]
duration_s = 4.0
noise_percent = [1.0, 5.0]
[[method]]
name = "classic_ml_arx"
[[method]]
name = "line"
class = "sklearn.linear_model:LinearRegression"
"""


def declared(folder: Path, text: str = SMALL) -> str:
    path = folder / "study.toml"
    path.write_text(text, "utf-8")
    return str(path)


def test_the_command_leaves_table_and_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    command = ["study", declared(tmp_path), "--out", str(out), "--jobs", "1"]
    assert read_spec(command[1]).title == "small"
    assert main([*command, "--dry-run"]) == 0
    assert not out.exists()
    assert main(command) == 0
    said = capsys.readouterr()
    assert "8 cells" in said.out
    assert "error of τ" in said.out
    assert len(pd.read_parquet(out / "results.parquet")) == 8
    assert "classic_ml_arx" in (out / "report.html").read_text("utf-8")
    assert main(command) == 2
    assert "--resume" in capsys.readouterr().err
    assert main([*command, "--resume"]) == 0


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (
            "seeds = 'many'\n[record]\ndegree = 0",
            "study.toml: seeds: expected a whole number from 1 on, or a list of seeds, found "
            "'many'; record.degree: expected 2 or 3, found 0",
        ),
        ("title = ", "study.toml: expected a TOML file"),
        ("[[method]]\nname='m'\nclass='no_such_package:A'", "method m: expected a class at"),
    ],
)
def test_a_mistake_is_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, sentence: str
) -> None:
    out = tmp_path / "out"
    assert sentence in refused(capsys, "study", declared(tmp_path, text), "--out", out, "--dry-run")
    assert not out.exists()


def test_a_study_without_a_fit_is_refused_in_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # Too few rows for any fit.
    text = SMALL.replace("duration_s = 4.0", "duration_s = 0.5")
    command = ["study", declared(tmp_path, text), "--out", str(tmp_path / "out"), "--jobs", "1"]
    assert main(command) == 2
    said = capsys.readouterr().err
    assert "8 that failed" in said
    assert said.count("\n") == 1
    assert set(pd.read_parquet(tmp_path / "out" / "results.parquet")["state"]) == {"failed"}
