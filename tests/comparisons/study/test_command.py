"""``sindy-surge study`` as it is typed."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from comparisons.cli import main

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
name = "classic_ml_output_error"
"""


def declared(folder: Path, text: str = SMALL) -> str:
    path = folder / "study.toml"
    path.write_text(text, "utf-8")
    return str(path)


def test_the_command_leaves_table_report_and_words(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "deep" / "out"
    out.parent.mkdir()
    assert main(["study", declared(tmp_path), "--out", str(out), "--jobs", "1"]) == 0
    said = capsys.readouterr()
    assert "8 cells" in said.out
    assert "error of τ" in said.out
    assert said.err == ""
    assert len(pd.read_parquet(out / "results.parquet")) == 8
    page = (out / "report.html").read_text("utf-8")
    assert "classic_ml_output_error" in page
    assert {p.name for p in out.iterdir()} == {
        "journal.jsonl",
        "provenance.json",
        "report.html",
        "results.parquet",
        "study.json",
    }
    assert main(["study", declared(tmp_path), "--out", str(out), "--jobs", "1"]) == 2
    assert "--resume" in capsys.readouterr().err
    again = ["study", declared(tmp_path), "--out", str(out), "--jobs", "1", "--resume"]
    assert main(again) == 0


def test_a_dry_run_computes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert main(["study", declared(tmp_path), "--out", str(out), "--dry-run"]) == 0
    assert "8 cells" in capsys.readouterr().out
    assert not out.exists()


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("seeds = 'many'", "study.toml: seeds: expected a whole number from 1 on"),
        ("title = ", "study.toml: expected a TOML file"),
        ("[record]\nsource = 'moon'", "study.toml: record.source"),
        ("[[method]]\nname='m'\nclass='no_such_package:A'", "method m: expected a class at"),
    ],
)
def test_a_mistake_is_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, told: str
) -> None:
    out = tmp_path / "out"
    assert main(["study", declared(tmp_path, text), "--out", str(out)]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert told in said.err
    assert said.err.count("\n") == 1
    assert not out.exists()


@pytest.mark.parametrize("place", ["taken", "taken/deep/out"])
def test_a_folder_that_cannot_be_is_refused_before_anything_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], place: str
) -> None:
    (tmp_path / "taken").write_text("mine", "utf-8")
    out = tmp_path / place
    assert main(["study", declared(tmp_path), "--out", str(out), "--jobs", "1"]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert f"{out}: expected a folder, found" in said.err
    assert (tmp_path / "taken").read_text("utf-8") == "mine"


def test_a_study_that_is_there_is_not_run_over(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    for text in ("{", "[" * 100_000):
        (out / "study.json").write_text(text, "utf-8")
        assert main(["study", declared(tmp_path), "--out", str(out), "--resume"]) == 2
        said = capsys.readouterr()
        assert said.out == ""
        assert "study.json: expected the JSON that a study wrote" in said.err
    assert main(["study", declared(tmp_path), "--out", str(out)]) == 2
    said = capsys.readouterr()
    assert (said.out, "--resume goes on with it" in said.err) == ("", True)
