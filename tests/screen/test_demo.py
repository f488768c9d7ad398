"""The demo leaves what it says, report and all; it takes half a minute."""

from __future__ import annotations

from pathlib import Path

import pytest

from comparisons.cli import main


def run(*arguments: object) -> int:
    return main([str(argument) for argument in arguments])


def test_the_demo_leaves_what_it_says(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "demo"
    # What an earlier demo left in the folder does not stand in the way.
    assert run("simulate", "--case", "985", "--seed", 4, "-o", out / "raw_985") == 0
    assert run("demo", "--out", out, "--seed", 3) == 0
    said = capsys.readouterr().out
    assert str(out / "report.html") in said
    assert "found against the truth of the rig" in said
    assert (out / "report.html").stat().st_size > 100_000
    assert {"series_985.csv", "series_90.csv", "models_985.json"} <= {p.name for p in out.iterdir()}
    raw, again = tmp_path / "raw", tmp_path / "again.csv"
    assert run("simulate", "--case", "985", "--seed", 3, "-o", raw) == 0
    assert run("reduce", raw / "raw.csv", "--test", raw / "test.toml", "-o", again) == 0
    assert again.read_bytes() == (out / "series_985.csv").read_bytes()
