"""Studies run: the same table whatever the workers, the order and the accidents."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from comparisons.study.design import cells_of, tasks_of
from comparisons.study.run import FINISHED, RESULTS, run_study, run_task
from comparisons.study.spec import StudySpec, spec_from
from surge_core.errors import InputError

EXAMPLE = Path(__file__).parents[3] / "examples" / "study.toml"
SUPPORT = str(Path(__file__).parents[2] / "support")
GIVEN: dict[str, Any] = {
    "title": "small",
    "seeds": 2,
    "record": {"duration_s": 4.0, "noise_percent": [1.0, 5.0], "n_records": 2},
    "fit": {"degree": [2, 3]},
    "method": [
        {"name": "classic_ml_arx"},
        {"name": "line", "class": "sklearn.linear_model:LinearRegression"},
        {"name": "draws", "class": "study_methods:Scales"},
    ],
}


def spec(**changes: Any) -> StudySpec:
    """A study that takes a second."""
    return spec_from({**GIVEN, **changes})


def assert_same(one: pd.DataFrame, other: pd.DataFrame) -> None:
    kept = [name for name in one if not name.startswith("seconds")]
    pd.testing.assert_frame_equal(one[kept], other[kept], check_exact=True)


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[pd.DataFrame, Path]:
    folder = tmp_path_factory.mktemp("study") / "out"
    return run_study(spec(), folder), folder


def test_one_row_a_cell_with_its_truth(done: tuple[pd.DataFrame, Path]) -> None:
    table, folder = done
    assert table["cell"].tolist() == list(range(24))
    assert set(table["state"]) == {"ok"}
    lags = table[table["method"] == "classic_ml_arx"]
    assert np.all(np.abs(lags["tau_error_ms"]) < 6.0 * lags["tau_stderr_ms"] + 8.0)
    line = table[table["method"] == "line"]
    assert line["tau_ms"].isna().all()
    # A line through φ is no lag: its free run is far worse on every record.
    both = lags.groupby("record")["free_run_rms"].max()
    assert np.all(line.groupby("record")["free_run_rms"].min() > 2.0 * both)
    # One that divides what it is given by a thousand predicts next to nothing.
    assert np.all(table[table["method"] == "draws"]["free_run_percent"] < 1.0)
    assert_same(pd.read_parquet(folder / RESULTS), table)


def test_workers_and_order_leave_the_numbers(
    done: tuple[pd.DataFrame, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", SUPPORT)
    assert_same(run_study(spec(), tmp_path / "two", jobs=2), done[0])
    alone = {row["key"]: row for row in run_task(tasks_of(cells_of(spec()))[-1])}
    for cell in cells_of(spec()):
        if row := alone.get(cell.key):
            assert row["free_run_rms"] == done[0]["free_run_rms"][cell.number]


def test_a_study_that_stopped_goes_on_with_the_rest(
    done: tuple[pd.DataFrame, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    table, folder = done
    lines = (folder / FINISHED).read_text("utf-8").splitlines(keepends=True)
    # As a kill leaves it: some cells are missing, and the last line is torn.
    (tmp_path / FINISHED).write_text("".join(lines[:7]) + lines[7][:40], "utf-8")
    worked: list[str] = []

    def counted(cells: Any) -> Any:
        worked.extend(cell.key for cell in cells)
        return run_task(cells)

    monkeypatch.setattr("comparisons.study.run.run_task", counted)
    with pytest.raises(InputError, match="--resume"):
        run_study(spec(), tmp_path)
    assert_same(run_study(spec(), tmp_path, resume=True), table)
    assert len(worked) == len(table) - 7
    # A longer study keeps what it shares with the shorter one.
    more = run_study(spec(seeds=3), tmp_path, resume=True)
    assert (len(more), len(worked)) == (36, len(table) - 7 + 12)


def test_a_cell_that_fails_is_a_row_with_its_reason(tmp_path: Path) -> None:
    names = ("Breaks", "Short", "Blank")
    others = [{"name": name, "class": f"study_methods:{name}"} for name in names]
    made = spec(
        record={"duration_s": 4.0, "sample_period_s": [0.01, 0.1]},
        method=[{"name": "classic_ml_arx"}, *others],
        seeds=1,
        fit={},
    )
    table = run_study(made, tmp_path / "out").set_index(["record.sample_period_s", "method"])
    assert table.loc[(0.01, "classic_ml_arx"), "state"] == "ok"
    assert table.loc[(0.01, "Breaks"), "state"] == "failed"
    assert "ZeroDivisionError: nothing to divide by" in table.loc[(0.01, "Breaks"), "reason"]
    assert "predict" in table.loc[(0.01, "Short"), "reason"]
    assert "finite" in table.loc[(0.01, "Blank"), "reason"]
    lost = table.loc[0.1]
    assert set(lost["state"]) == {"failed"}
    assert all("100 rows" in reason for reason in lost["reason"])


def test_failed_cells_are_run_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = spec(method=[{"name": "m", "class": "study_methods:Fails"}], seeds=1, fit={})
    monkeypatch.setenv("STUDY_METHODS_FAIL", "1")
    assert set(run_study(made, tmp_path)["state"]) == {"failed"}
    monkeypatch.delenv("STUDY_METHODS_FAIL")
    assert set(run_study(made, tmp_path, resume=True)["state"]) == {"ok"}


def test_a_cluster_gives_the_same_numbers(done: tuple[pd.DataFrame, Path], tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None
    ) as cluster:
        table = run_study(spec(), tmp_path, scheduler=cluster.scheduler_address)
    assert_same(table, done[0])
    with pytest.raises(InputError, match="--scheduler"):
        run_study(spec(), tmp_path / "none", scheduler="nonsense://x")


def test_the_example_runs(tmp_path: Path) -> None:
    given = tomllib.loads(EXAMPLE.read_text("utf-8"))
    assert 50 <= len(cells_of(spec_from(given))) <= 80
    given["seeds"] = 1
    given["record"]["noise_percent"] = 1.0
    table = run_study(spec_from(given), tmp_path)
    assert set(table["state"]) == {"ok"}
    assert np.all(np.abs(table["tau_error_ms"]) < 2.0)


def test_raw_counts_and_files_go_through_a_study(tmp_path: Path) -> None:
    """A record of the rig is reduced in two ways; its files give the same numbers again."""
    from comparisons.rig import simulate, write_run

    rig: dict[str, Any] = {
        "seeds": [3],
        "record": {"source": "rig", "case": "985"},
        "reduction": {"cutoff_hz": [30.0, 48.0]},
        "method": [{"name": "paper"}],
    }
    table = run_study(spec_from(rig), tmp_path / "rig")
    assert table["tau_ms"].nunique() == 2
    assert table["tau_error_ms"].notna().all()
    write_run(simulate("985", seed=3), tmp_path / "raw")
    files: dict[str, Any] = {
        "record": {"source": "files", "path": str(tmp_path / "raw")},
        "reduction": {"cutoff_hz": 30.0},
        "method": [{"name": "paper"}],
    }
    read = run_study(spec_from(files), tmp_path / "files")
    assert read["tau_ms"][0] == table["tau_ms"][0]
    assert read["tau_error_ms"].isna().all()
