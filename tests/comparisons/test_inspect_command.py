"""`sindy-surge inspect`: what is wrong with a file is found, and the draft is a test.toml."""

from __future__ import annotations

import fnmatch
import json
import re
import tomllib
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from raw_data import RawTest, make_test, to_toml, write_csv

from classic_ml.inspect import Inspection, draft_test_toml, inspect_file
from classic_ml.io import read_raw
from classic_ml.io.description_file import read_test_description
from comparisons.cli import main
from surge_core.errors import InputError

Columns = dict[str, np.ndarray]


@pytest.fixture(scope="module")
def made() -> RawTest:
    return make_test(seconds=0.5)


def inspected(folder: Path, columns: Columns) -> Inspection:
    write_csv(folder / "raw.csv", columns)
    return inspect_file(folder / "raw.csv")


def test_ranges_and_faults_are_those_of_the_columns(tmp_path: Path) -> None:
    """Against a second way to count them, on columns with every kind of fault."""
    n, rng = 2000, np.random.default_rng(7)
    noise = rng.normal(size=n)
    clipped = np.clip(noise, -1.2, 3.0)
    clipped[800:809] = -1.2
    stuck = rng.normal(size=n)
    stuck[1000:1040] = stuck[1000]
    spoiled = np.array(noise)
    spoiled[[41, 700]] = np.nan, np.inf
    columns = {
        "time_s": np.arange(n) / 500.0,
        "noise": noise,
        "clipped": clipped,
        "stuck": stuck,
        "spoiled": spoiled,
        "still": np.full(n, 7.0),
        "codes": np.minimum(rng.integers(0, 4200, n), 4095),
    }
    found = inspected(tmp_path, columns)
    assert (found.rows, len(found.channels)) == (n, 7)
    for channel in found.channels:
        values = columns[channel.name][np.isfinite(columns[channel.name])]
        assert (channel.minimum, channel.maximum) == (values.min(), values.max())
        assert channel.mean == pytest.approx(values.mean(), rel=1e-12)
        assert channel.at_minimum == np.count_nonzero(values == values.min())
        assert channel.not_finite == n - values.size
    facts = {channel.name: channel for channel in found.channels}
    assert facts["still"].constant
    assert facts["noise"].plateaus == ()
    assert facts["clipped"].plateaus == ("minimum",)
    assert facts["codes"].plateaus == ("maximum",)
    assert facts["codes"].whole_numbers
    assert facts["stuck"].longest_run == 40


def test_the_clock_is_followed_over_gaps_repeats_and_steps_back(tmp_path: Path) -> None:
    steps = np.full(1999, 2e-3)
    steps[[99, 700]] = 0.5, 0.01
    steps[300] = 0.0
    steps[[1200, 1300]] = -0.004
    steps[50] = 2.2e-3
    time_s = np.concatenate(([10.0], 10.0 + np.cumsum(steps)))
    clock = inspected(tmp_path, {"Elapsed Time": time_s, "P": np.arange(2000.0) ** 2}).clock
    assert clock is not None
    assert clock.name == "Elapsed Time"
    assert clock.troubles == {"gap": (2, 101), "repeat": (1, 302), "step back": (2, 1202)}
    assert clock.jitter == pytest.approx(0.1, rel=1e-6)
    assert clock.rate_hz == pytest.approx(500.0, rel=1e-3)


def test_a_clock_that_jitters_is_drafted_as_it_can_be_read(made: RawTest, tmp_path: Path) -> None:
    rng, columns = np.random.default_rng(0), dict(made.columns)
    columns["time_s"] = columns["time_s"] + 2e-4 * rng.standard_normal(501)
    draft = tomllib.loads(draft_test_toml(inspected(tmp_path, columns)))
    assert draft["test"]["sample_rate_hz"] == pytest.approx(1000.0, rel=3e-4)
    toml = tmp_path / "test.toml"
    toml.write_text(to_toml(made.description), "utf-8")
    with pytest.raises(InputError, match=r'no row is missing.*clock = "from rate"'):
        read_raw(tmp_path / "raw.csv", toml)
    toml.write_text(to_toml({**made.description, "file": draft["file"]}), "utf-8")
    assert read_raw(tmp_path / "raw.csv", toml)[0].n_samples == 501


def test_a_file_that_is_looked_through_in_pieces_is_found_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(2)
    time_s = np.arange(1000) / 100.0
    time_s[500:] += 0.3
    wave = np.sin(np.arange(1000) / 15.0) + 1e-3 * rng.standard_normal(1000)
    gone = np.where(wave > 0.9, np.nan, wave)
    whole = inspected(tmp_path, {"t": time_s, "nan": gone, "cut": np.minimum(wave, 0.8)})
    facts = {channel.name: channel for channel in whole.channels}
    assert facts["cut"].plateaus == ("maximum",)
    monkeypatch.setattr("classic_ml.io.csv.BLOCK_BYTES", 16_000)
    pieces = inspect_file(tmp_path / "raw.csv")
    for one, other in zip(whole.channels, pieces.channels, strict=True):
        assert one.mean == pytest.approx(other.mean, rel=1e-12)
        for name in ("rows", "not_finite", "minimum", "maximum", "at_minimum", "at_maximum"):
            assert getattr(one, name) == getattr(other, name)
        assert one.plateaus == other.plateaus
    for found in (whole, pieces):
        assert found.clock is not None
        assert found.clock.troubles == {"gap": (1, 501)}
        assert found.clock.rate_hz == pytest.approx(100.0)


def test_the_part_of_a_long_record_that_surges_is_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A minute at near stall, ten seconds of surge with a pause of one, then quiet again."""
    rng = np.random.default_rng(5)
    time_s = np.arange(80_000) / 1000.0
    surging = (time_s > 60.0) & (time_s < 70.0) & ~((time_s > 64.0) & (time_s < 65.0))
    swing = surging * np.sin(2.0 * np.pi * 7.0 * time_s)
    columns = {"Zeit": time_s, "throttle": np.full(time_s.size, 31.5)}
    for number in range(6):
        noise = 0.02 * rng.standard_normal(time_s.size)
        columns[f"P{number}"] = 14.7 + 0.001 * time_s + noise + (1.0 + 0.1 * number) * swing
    found = inspected(tmp_path, columns)
    assert found.surges_s is not None
    assert found.surges_s == pytest.approx((60.0, 70.0), abs=0.6)
    code, out, _ = run(capsys, tmp_path / "raw.csv")
    assert code == 0
    assert "surge or rotating stall: the channels swing from 59." in out
    quiet = {name: values[:50_000] for name, values in columns.items()}
    assert inspected(tmp_path, quiet).surges_s is None


def run(capsys: pytest.CaptureFixture[str], *arguments: Any) -> tuple[int, str, str]:
    code = main(["inspect", *map(str, arguments)])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_what_does_not_fit_the_test_is_reported(
    made: RawTest, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    columns = {n.replace("T25_A", "T25 A"): v for n, v in made.columns.items()}
    raw, toml = tmp_path / "raw.csv", tmp_path / "test.toml"
    write_csv(raw, columns)
    toml.write_text(to_toml(made.description), "utf-8")
    code, out, _ = run(capsys, raw, "--test", toml)
    assert code == 0
    assert re.search(r"T25_A +T25_A +K +no such column", out)
    assert "columns that feed nothing: T25 A" in out
    assert "reduce would refuse it:" in out


def filled_in(draft: str, made: RawTest) -> str:
    """The draft with every commented key filled from the description that it is to become."""
    table, lines = "", []
    for line in draft.splitlines():
        head = re.match(r"\[(?P<path>[^\]]+)\]", line)
        key = re.match(r"# (?P<key>\w+) =", line)
        if head:
            table = head["path"]
        if key:
            values = made.description
            for part in _described(table, made).split("."):
                values = values[part]
        filled = f"{key['key']} = {json.dumps(values[key['key']])}" if key else line
        lines.append(filled)
    return "\n".join(lines)


def _described(table: str, made: RawTest) -> str:
    """The table of the description that holds the values of a table of the draft."""
    if not table.startswith("defaults."):
        return table
    pattern = table.removeprefix("defaults.").strip('"').replace("temperature", "T*")
    return "channels." + fnmatch.filter(made.description["channels"], pattern)[0]


def test_the_draft_filled_in_is_the_description_of_the_test(
    made: RawTest, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Kinds, units and the rate are in it; the rest is in comments."""
    raw, toml = made.write(tmp_path)
    draft = tmp_path / "draft.toml"
    code, out, _ = run(capsys, raw, "--draft", draft)
    assert code == 0
    assert f"draft: {draft}" in out
    draft.write_text(filled_in(draft.read_text("utf-8"), made), "utf-8")
    found, expected = read_test_description(draft), read_test_description(toml)
    assert {c.name: c for c in found.pressures} == {c.name: c for c in expected.pressures}
    assert found.sample_rate_hz == expected.sample_rate_hz
    assert [c.plane for c in found.temperatures] == [c.plane for c in expected.temperatures]
    before = draft.read_bytes()
    code, out, err = run(capsys, raw, "--draft", draft)
    assert (code, out) == (2, "")
    assert "nothing was overwritten" in err
    assert draft.read_bytes() == before


def test_a_draft_of_users_names_is_toml_and_keeps_their_units(tmp_path: Path) -> None:
    time_ms = np.arange(300.0) * 0.5
    rng = np.random.default_rng(0)
    columns = {
        "Time [ms]": time_ms,
        'PT25 "A" tip fwd [psia]': rng.normal(14.0, 0.1, 300),
        "TT31-B (degF)": rng.normal(800.0, 1.0, 300),
        "P31 rake C hub aft [kPa]": rng.normal(900.0, 1.0, 300),
        "Ölstand\t2": rng.normal(size=300),
    }
    header = ",".join('"' + name.replace('"', '""') + '"' for name in columns)
    rows = [",".join(repr(float(v)) for v in row) for row in zip(*columns.values(), strict=True)]
    (tmp_path / "raw.csv").write_text("\n".join([header, *rows]), "utf-8")
    found = tomllib.loads(draft_test_toml(inspect_file(tmp_path / "raw.csv")))
    assert found["test"]["sample_rate_hz"] == 2000.0
    assert found["file"] == {"time": "Time [ms]", "time_unit": "ms", "other_columns": "ignore"}
    keys = ("column", "kind", "unit", "plane", "rake", "immersion", "facing")
    _, forward, heat, aft, _ = columns
    assert [tuple(map(channel.get, keys)) for channel in found["channels"].values()] == [
        (forward, "pressure", "psia", 25, "A", "tip", "forward"),
        (heat, "temperature", "degF", 31, "B", None, None),
        (aft, "pressure", "kPa", 31, "C", "hub", "aft"),
    ]
    assert list(found["defaults"]) == ["*25*tip*", "temperature", "*31*hub*"]
    assert "adc" not in found


def test_channels_of_another_rate_are_named(
    made: RawTest, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Pressures at 1 kHz, thermocouples at 100 Hz."""
    _, toml = made.write(tmp_path)
    path, held = tmp_path / "two.h5", "51 values where the record has 501"
    with h5py.File(path, "w") as file:
        for name, values in made.columns.items():
            is_slow = name[0] == "T"
            file[f"slow/{name}" if is_slow else name] = values[:: 10 if is_slow else 1]
    assert f"  slow/T25_A: {held}" in run(capsys, path)[1]
    with pytest.raises(InputError, match=f"T25_A: .* 'slow/T25_A': {held}"):
        read_raw(path, toml)
    assert inspect_file(path, group="slow").rows == 51
