"""Studies run: the same table whatever the engine, the order and the accidents."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from comparisons.cli import main
from comparisons.study.design import Task, count_cells
from comparisons.study.engines import Outcome, joblib_engine, serial_engine
from comparisons.study.journal import Journal, read_rows
from comparisons.study.run import StudyFiles, run_study
from comparisons.study.spec import StudySpec, spec_from
from comparisons.study.work import run_task
from surge_core.errors import InputError

EXAMPLE = Path(__file__).parents[3] / "examples" / "study.toml"
SUPPORT = str(Path(__file__).parents[2] / "support")
GIVEN: dict[str, Any] = {
    "title": "small",
    "seeds": 2,
    "record": {"duration_s": 4.0, "noise_percent": [1.0, 5.0], "n_records": 2},
    "series": {"keep_every": [1, 2]},
    "fit": {"degree": 3},
    "method": [
        {"name": "classic_ml_arx"},
        {"name": "classic_ml_output_error"},
        {"name": "line", "class": "sklearn.linear_model:LinearRegression"},
    ],
}


def spec(**changes: Any) -> StudySpec:
    """A study that takes a second or two."""
    return spec_from({**GIVEN, **changes})


def without_times(table: pd.DataFrame) -> pd.DataFrame:
    return table[[c for c in table if not c.startswith("seconds")]]


def assert_same(one: pd.DataFrame, other: pd.DataFrame) -> None:
    pd.testing.assert_frame_equal(without_times(one), without_times(other), check_exact=True)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> tuple[pd.DataFrame, StudyFiles]:
    folder = tmp_path_factory.mktemp("study") / "out"
    return run_study(spec(), folder), StudyFiles(folder)


def test_one_row_a_cell_with_its_truth(undisturbed: tuple[pd.DataFrame, StudyFiles]) -> None:
    table, files = undisturbed
    assert table["cell"].tolist() == list(range(count_cells(spec())))
    assert set(table["state"]) == {"ok"}
    lags = table[table["method"] != "line"]
    assert np.all(np.abs(lags["tau_error_ms"]) < 6.0 * lags["tau_stderr_ms"] + 8.0)
    line = table[table["method"] == "line"]
    assert line["tau_ms"].isna().all()
    # A line through φ is no lag: its free run is far worse on every record.
    both = lags.groupby("record")["free_run_rms"].max()
    assert np.all(line.groupby("record")["free_run_rms"].min() > 2.0 * both)
    assert_same(pd.read_parquet(files.results), table)
    document = json.loads(files.spec.read_text("utf-8"))
    assert document["cells"] == len(table)
    assert document["seeds"] == [0, 1]
    runs = json.loads(files.provenance.read_text("utf-8"))["runs"]
    assert [run["cells"] for run in runs] == [len(table)]


def test_a_record_is_made_once_for_all_its_fits(
    undisturbed: tuple[pd.DataFrame, StudyFiles],
) -> None:
    table, _ = undisturbed
    made = (table["seconds_record"] > 0.0).groupby(table["record"]).sum()
    assert set(made) == {1}
    reduced = (table["seconds_reduction"] > 0.0).groupby([table["record"], table["reduction"]])
    assert set(reduced.sum()) == {1}


def test_joblib_gives_the_same_bits(
    undisturbed: tuple[pd.DataFrame, StudyFiles], tmp_path: Path
) -> None:
    assert_same(run_study(spec(), tmp_path / "two", engine=joblib_engine(2)), undisturbed[0])


def test_the_order_of_tasks_leaves_the_table(
    undisturbed: tuple[pd.DataFrame, StudyFiles], tmp_path: Path
) -> None:
    def backwards(tasks: Iterable[Task]) -> Iterator[Outcome]:
        yield from serial_engine(reversed(list(tasks)))

    assert_same(run_study(spec(), tmp_path / "back", engine=backwards), undisturbed[0])


def test_a_study_that_stops_goes_on_with_the_rest(
    undisturbed: tuple[pd.DataFrame, StudyFiles], tmp_path: Path
) -> None:
    folder = tmp_path / "stopped"

    def breaks(tasks: Iterable[Task]) -> Iterator[Outcome]:
        for k, outcome in enumerate(serial_engine(tasks)):
            if k == 7:
                raise KeyboardInterrupt
            yield outcome

    with pytest.raises(KeyboardInterrupt):
        run_study(spec(), folder, engine=breaks)
    kept = {row["cell"] for row in read_rows(StudyFiles(folder).journal)}
    assert len(kept) == 7
    again: list[int] = []

    def counted(tasks: Iterable[Task]) -> Iterator[Outcome]:
        for task, rows in serial_engine(tasks):
            again.extend(row["cell"] for row in rows)
            yield task, rows

    table = run_study(spec(), folder, engine=counted, resume=True)
    assert not kept & set(again)
    assert_same(table, undisturbed[0])
    # Once more there is nothing left to do.
    assert_same(run_study(spec(), folder, engine=counted, resume=True), undisturbed[0])
    assert len(again) == len(table) - len(kept)


def test_a_torn_last_line_is_run_again(
    undisturbed: tuple[pd.DataFrame, StudyFiles], tmp_path: Path
) -> None:
    table, files = undisturbed
    whole = files.journal.read_bytes()
    for cut in (1, 40, len(whole) // 2):
        folder = tmp_path / f"torn {cut}"
        folder.mkdir()
        (folder / files.spec.name).write_bytes(files.spec.read_bytes())
        (folder / files.journal.name).write_bytes(whole[:-cut])
        assert_same(run_study(spec(), folder, resume=True), table)


def test_a_journal_that_is_none_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    path.write_bytes(b'{"cell": 1}\nnonsense\n{"cell": 2}\n')
    with pytest.raises(InputError, match="line 2"):
        list(read_rows(path))


def test_values_survive_the_journal_bit_for_bit(tmp_path: Path) -> None:
    values = [0.1, 1e-300, -0.0, float("nan"), float("inf"), np.nextafter(1.0, 2.0)]
    with Journal(tmp_path / "j") as journal:
        journal.write({"cell": i, "x": float(v), "t": "ψ'\n\"é"} for i, v in enumerate(values))
    back = list(read_rows(tmp_path / "j"))
    assert np.array([r["x"] for r in back]).tobytes() == np.array(values).tobytes()
    assert {r["t"] for r in back} == {"ψ'\n\"é"}


def test_another_study_in_the_folder_is_left_alone(
    undisturbed: tuple[pd.DataFrame, StudyFiles],
) -> None:
    _, files = undisturbed
    before = files.journal.read_bytes()
    with pytest.raises(InputError, match="--resume"):
        run_study(spec(), files.folder)
    with pytest.raises(InputError, match="seeds"):
        run_study(spec(seeds=3), files.folder, resume=True)
    assert files.journal.read_bytes() == before


def test_a_cell_that_fails_is_a_row_with_its_reason(tmp_path: Path) -> None:
    broken = {"name": "broken", "class": "study_methods:Breaks"}
    short = {"name": "short", "class": "study_methods:Short"}
    made = spec(
        record={"duration_s": 4.0, "sample_period_s": [0.01, 0.1]},
        method=[{"name": "classic_ml_arx"}, broken, short],
        seeds=1,
        series={},
    )
    table = run_study(made, tmp_path / "out").set_index(["record.sample_period_s", "method"])
    assert table.loc[(0.01, "classic_ml_arx"), "state"] == "ok"
    assert table.loc[(0.01, "broken"), "state"] == "failed"
    assert table.loc[(0.01, "broken"), "reason"] == "ZeroDivisionError: nothing to divide by"
    assert "predict" in table.loc[(0.01, "short"), "reason"]
    lost = table.loc[0.1]
    assert set(lost["state"]) == {"failed"}
    assert all("100 rows" in reason for reason in lost["reason"])


@pytest.mark.parametrize(
    ("entry", "told"),
    [
        ({"class": "no_such_package:Thing"}, "no_such_package"),
        ({"class": "study_methods:Nothing"}, "Nothing"),
        ({"class": "study_methods:Short", "parameters": {"colour": 1}}, "no arguments"),
        ({"class": "study_methods:NoFit"}, "without fit"),
    ],
)
def test_a_class_that_cannot_be_had_is_told_before_the_study(
    tmp_path: Path, entry: dict[str, Any], told: str
) -> None:
    with pytest.raises(InputError, match=told):
        run_study(spec(method=[{"name": "m", **entry}]), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_worker_that_dies_takes_only_its_own_task_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", SUPPORT)
    made = spec(
        seeds=1,
        method=[
            {"name": "classic_ml_arx"},
            {"name": "dies", "class": "study_methods:KillsItself", "parameters": {"noise": 0.03}},
        ],
        record={"duration_s": 4.0, "noise_percent": [1.0, 5.0], "n_records": 1},
        series={},
    )
    table = run_study(made, tmp_path / "out", engine=joblib_engine(2))
    assert len(table) == count_cells(made)
    dead = table[table["state"] == "failed"]
    assert 0 < len(dead) < len(table)
    assert set(dead["reason"]) == {"its worker died each time it was tried"}
    # The other method on the same record is not lost with it.
    assert set(dead["method"]) == {"dies"}
    assert set(dead["record.noise_percent"]) == {5.0}


def test_a_killed_command_loses_no_finished_cell(tmp_path: Path) -> None:
    """kill -9 of the command and of a worker; what goes on gives an undisturbed table."""
    declared = tmp_path / "study.toml"
    declared.write_text(
        "seeds = 5\n[record]\nduration_s = 4.0\n"
        '[[method]]\nname = "classic_ml_output_error"\n[[method]]\nname = "classic_ml_arx"\n',
        "utf-8",
    )
    run = "from comparisons.cli.parser import main; raise SystemExit(main())"
    line = [sys.executable, "-c", run, "study", str(declared), "--jobs", "2", "--out"]
    killed, whole = StudyFiles(tmp_path / "killed"), StudyFiles(tmp_path / "whole")
    process = subprocess.Popen(
        [*line, str(killed.folder)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    deadline = time.monotonic() + 120.0
    while not list(read_rows(killed.journal)) and time.monotonic() < deadline:
        assert process.poll() is None
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    kept = {row["cell"]: row for row in read_rows(killed.journal)}
    assert 0 < len(kept) < 10
    assert not killed.results.exists()
    resumed = [*line, str(killed.folder), "--resume"]
    said = subprocess.run(resumed, capture_output=True, text=True, check=False)
    assert said.returncode == 0, said.stderr
    assert main(["study", str(declared), "--jobs", "1", "--out", str(whole.folder)]) == 0
    table = pd.read_parquet(killed.results)
    assert_same(table, pd.read_parquet(whole.results))
    for number, row in kept.items():
        assert table["seconds_fit"][number] == row["seconds_fit"]


def test_a_task_is_the_same_in_any_process() -> None:
    """Nothing is remembered from one task to the next."""
    from comparisons.study.design import tasks_of

    tasks = list(tasks_of(spec(seeds=1)))
    alone = run_task(tasks[1])
    run_task(tasks[0])
    again = run_task(tasks[1])
    for one, other in zip(alone, again, strict=True):
        for name in one:
            if not name.startswith("seconds"):
                assert one[name] == other[name] or (one[name] != one[name])


def test_the_example_runs(tmp_path: Path) -> None:
    given = tomllib.loads(EXAMPLE.read_text("utf-8"))
    given["seeds"] = 1
    given["record"]["noise_percent"] = 1.0
    table = run_study(spec_from(given), tmp_path / "out")
    assert set(table["state"]) == {"ok"}
    assert np.all(np.abs(table["tau_error_ms"]) < 2.0)


def test_what_a_class_does_to_its_data_and_to_the_process_stays_its_own(tmp_path: Path) -> None:
    names = ("Scales", "LeavesState", "Exits", "Blank", "Imaginary")
    others = [{"name": name, "class": f"study_methods:{name}"} for name in names]
    made = spec(
        method=[*others, {"name": "classic_ml_arx"}, {"name": "sindy"}],
        record={"duration_s": 4.0},
        series={},
        seeds=1,
    )
    table = run_study(made, tmp_path / "out").set_index("method")
    alone = run_study(
        spec(
            method=made_of("classic_ml_arx", "sindy"),
            record={"duration_s": 4.0},
            series={},
            seeds=1,
        ),
        tmp_path / "alone",
    ).set_index("method")
    for name in alone.index:
        for score in ("tau_ms", "free_run_rms", "held_out_rms"):
            assert table.loc[name, score] == alone.loc[name, score]
    # It divides what it is given by a thousand: its error is that of predicting nothing.
    assert table.loc["Scales", "free_run_percent"] < 1.0
    failed = {name: table.loc[name, "reason"] for name in ("Exits", "Blank", "Imaginary")}
    assert failed["Exits"].startswith("SystemExit")
    assert "finite" in failed["Blank"]
    assert "complex" in failed["Imaginary"]


def made_of(*names: str) -> list[dict[str, str]]:
    return [{"name": name} for name in names]


def test_failed_cells_are_run_again_when_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = spec(method=[{"name": "m", "class": "study_methods:Fails"}], seeds=1, series={})
    monkeypatch.setenv("STUDY_METHODS_FAIL", "1")
    folder = tmp_path / "out"
    assert set(run_study(made, folder)["state"]) == {"failed"}
    monkeypatch.delenv("STUDY_METHODS_FAIL")
    assert set(run_study(made, folder, resume=True)["state"]) == {"failed"}
    mended = run_study(made, folder, resume=True, retry_failed=True)
    assert set(mended["state"]) == {"ok"}
    assert mended["cell"].tolist() == list(range(count_cells(made)))


def test_a_journal_without_its_study_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "journal.jsonl").write_bytes(b"")
    with pytest.raises(InputError, match="a journal alone"):
        run_study(spec(), tmp_path)


def test_raw_counts_and_files_go_through_a_study(tmp_path: Path) -> None:
    """One record of the rig is reduced in two ways; its files give the same numbers again."""
    from comparisons.rig import simulate, write_run

    rig: dict[str, Any] = {
        "seeds": [3],
        "record": {"source": "rig", "case": "985", "hide": ["none", "sensitivity_drift"]},
        "reduction": {"cutoff_hz": [30.0, 48.0]},
        "method": [{"name": "classic_ml"}, {"name": "paper"}],
    }
    table = run_study(spec_from(rig), tmp_path / "rig")
    plain = table[table["record.hide"] == "none"]
    whole = plain[plain["method"] == "classic_ml"]
    # The whole run is fitted to unfiltered signals: the filter leaves its τ, not the paper's.
    assert np.all(np.abs(whole["tau_error_ms"]) < 2.0)
    assert whole["tau_ms"].nunique() == 1
    assert plain[plain["method"] == "paper"]["tau_ms"].nunique() == 2
    # A fit that says itself that its τ is not to be used states no interval.
    assert table.loc[table["state"] != "ok", "tau_covered"].isna().all()
    write_run(simulate("985", seed=3), tmp_path / "raw")
    files: dict[str, Any] = {
        "record": {"source": "files", "path": str(tmp_path / "raw")},
        "reduction": {"cutoff_hz": 30.0},
        "method": [{"name": "paper"}],
    }
    read = run_study(spec_from(files), tmp_path / "files")
    made = plain[(plain["method"] == "paper") & (plain["reduction.cutoff_hz"] == 30.0)]
    assert read["tau_ms"].tolist() == made["tau_ms"].tolist()
    assert read["tau_error_ms"].isna().all()
