"""The bench counts what methods state, and its critical difference is the published one."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from comparisons.cli import main
from comparisons.study.bench import bench_rows, bench_spec, ranks_of
from comparisons.study.spec import BUILT_IN

NAN = float("nan")


def table(errors_ms: dict[str, list[float]], true_ms: float = 20.0) -> pd.DataFrame:
    rows = [
        {
            "record": f"r{i}", "method": method, "tau_error_ms": error, "tau_ms": true_ms + error,
            "tau_covered": NAN if np.isnan(error) else float(abs(error) < 1.0),
            "curve_rms_error": 0.1, "seconds": 1.0, "reason": "", "firm_names": NAN,
            "false_names": NAN,
        }
        for method, errors in errors_ms.items()
        for i, error in enumerate(errors)
    ]  # fmt: skip
    return pd.DataFrame(rows)


def test_answers_are_counted_by_what_they_are_worth() -> None:
    good, bad = bench_rows(table({"good": [0.5, -1.9, 2.1, NAN], "bad": [7.0, 5.0, NAN, NAN]}))
    names = ("machines", "answers", "within", "covered", "gross")
    assert [good[name] for name in names] == [4, 3, 2, 1, 0]
    assert [bad[name] for name in names[1:]] == [2, 0, 0, 1]


def test_the_critical_difference_is_that_of_demsar() -> None:
    """His table 5a: q = 2.569 for four methods; a refusal ranks last."""
    rng = np.random.default_rng(3)
    errors = {
        name: list(rng.normal(0.0, size, 30))
        for name, size in zip("abcd", (1, 1, 1, 9), strict=True)
    }
    errors["d"][0] = NAN
    ranks = ranks_of(table(errors))
    assert ranks["critical_difference"] == pytest.approx(
        2.569 * np.sqrt(4 * 5 / (6 * 30)), rel=1e-3
    )
    assert ranks["methods"][-1] == "d"
    assert ranks["p_value"] < 0.01
    assert sum(ranks["mean"]) == pytest.approx(10.0)


def test_a_namer_is_counted_apart_and_does_not_rank() -> None:
    names = table({"fit": [1.0, 2.0], "other": [2.0, 1.0], "namer": [NAN, NAN]})
    names.loc[names["method"] == "namer", ["firm_names", "false_names"]] = [[1.0, 0.0], [2.0, 1.0]]
    fit, _, namer = bench_rows(names)
    assert (namer["named"], namer["false_names"], namer["answers"]) == (2, 1, 0)
    assert (fit["named"], fit["false_names"]) == (0, 0)
    assert set(ranks_of(names)["methods"]) == {"fit", "other"}


def test_friedman_holds_its_five_percent() -> None:
    rng = np.random.default_rng(4)
    tests = [
        ranks_of(table({name: list(rng.normal(size=12)) for name in "abc"}))["p_value"] < 0.05
        for _ in range(300)
    ]
    assert 0.02 < np.mean(tests) < 0.085


def test_machines_have_seeds_of_their_own_that_hang_on_the_bench_alone() -> None:
    assert bench_spec(8, 1).seeds == bench_spec(8, 1).seeds
    assert not set(bench_spec(8, 1).seeds) & set(bench_spec(8, 2).seeds)


def test_a_bench_of_the_distributed_rig(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = ["--machines", "1", "--rig", "distributed", "--jobs", "1", "--out", str(tmp_path / "b")]
    assert main(["bench", *given, "--json", str(tmp_path / "b.json")]) == 0
    found = json.loads((tmp_path / "b.json").read_text("utf-8"))
    assert found["schema"] == "sindy-surge/bench/1"
    assert {row["method"] for row in found["methods"]} == {*BUILT_IN, "diagnose"}
    assert all(row["crashes"] == 0 for row in found["methods"])
    assert "critical difference" in capsys.readouterr().out
    assert main(["bench", "--machines", "1", "--rig", "nowhere", "--out", str(tmp_path / "c")]) == 2
