"""Methods compared over pairs: known differences come back, their errors cover, nothing unlike."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.stats import t as student_t

from comparisons.study.comparison import compare_methods, jackknife
from comparisons.study.scores import Score
from surge_core.errors import InputError

RMS = "curve_rms_error"


def made_study(
    shifts: dict[str, float],
    *,
    seed: int = 0,
    n_records: int = 20,
    n_reductions: int = 2,
    record_spread: float = 3.0,
    shared_spread: float = 0.0,
    noise: float = 0.2,
    score: str = RMS,
) -> pd.DataFrame:
    """Return a study in which each record is hard or easy for all methods alike.

    `shared_spread` is a preference of a record for a method, the same in all its reductions: it
    makes the cells of one record dependent.
    """
    rng = np.random.default_rng(seed)
    rows: list[dict[str, Any]] = []
    for k in range(n_records):
        hard = 10.0 + record_spread * rng.normal()
        taste = {name: shared_spread * rng.normal() for name in shifts}
        for c in range(n_reductions):
            for name, shift in shifts.items():
                value = hard + shift + taste[name] + noise * rng.normal()
                rows.append(
                    {
                        "cell": len(rows),
                        "record": f"r-{k:03d}",
                        "reduction": f"d-{k}-{c}",
                        "method": name,
                        "seed": k,
                        "reduction.cutoff_hz": 20.0 + c,
                        "record.case": "ab"[k % 2],
                        "state": "ok",
                        "reason": "",
                        score: value,
                    }
                )
    return pd.DataFrame(rows)


def where(table: pd.DataFrame, method: str, record: str | None = None) -> pd.Series[bool]:
    chosen = table["method"] == method
    return chosen if record is None else chosen & (table["record"] == record)


def compared(table: pd.DataFrame, score: str = RMS, **options: Any) -> Any:
    return compare_methods(table, score, **options)[0]


def test_a_known_difference_comes_back_with_an_honest_error() -> None:
    # 0.5 worse; records differ by 3, so that the unpaired error is many times the paired one.
    z, ratios = [], []
    for seed in range(40):
        table = made_study({"a": 0.0, "b": 0.5}, seed=seed, shared_spread=0.3)
        row = compared(table, reference="a").row("b")
        z.append((row.difference - 0.5) / row.stderr)
        ratios.append(row.mean_stderr / row.stderr)
    assert abs(np.mean(z)) < 3.0 / np.sqrt(40)
    assert np.std(z) == pytest.approx(1.0, abs=0.3)
    assert min(ratios) > 3.0


@pytest.mark.parametrize("n_records", [5, 25])
def test_the_95_percent_interval_covers_with_few_records_and_with_many(n_records: int) -> None:
    held = []
    for seed in range(120):
        table = made_study(
            {"a": 0.0, "b": 0.5},
            seed=seed,
            n_records=n_records,
            n_reductions=3,
            shared_spread=0.3,
            noise=0.1,
        )
        pair = compared(table, reference="a").row("b")
        reach = float(student_t.ppf(0.975, pair.n_records - 1)) * pair.stderr
        held.append(abs(pair.difference - 0.5) <= reach)
    # 120 draws: the binomial error is 2 %.
    assert 0.91 < np.mean(held) < 0.99


def test_the_jackknife_is_the_textbook_error_where_records_are_single_cells() -> None:
    values = np.random.default_rng(1).normal(3.0, 2.0, size=17)
    mean, error = jackknife(values, np.arange(17))
    assert mean == pytest.approx(values.mean())
    assert error == pytest.approx(values.std(ddof=1) / np.sqrt(17))


def test_errors_on_other_rows_are_no_pair() -> None:
    score = "held_out_rms"
    table = made_study({"a": 0.0, "b": 0.5, "whole": -5.0}, score=score)
    table["scored"] = np.where(table["method"] == "whole", "unfiltered", "filtered")
    group = compared(table, score, reference="a")
    assert group.row("whole").n_pairs == 0
    assert group.row("whole").rank is None
    assert "other rows" in group.row("whole").trust
    assert group.best == "a"
    assert group.row("b").difference == pytest.approx(0.5, abs=0.2)


def test_ties_share_a_rank() -> None:
    table = made_study({"a": 0.0, "far": 2.0})
    twin = table[table["method"] == "a"].assign(method="twin")
    # Worse by 0.01 on the average of records that differ by 0.1 either way: an error of 0.02.
    sway = np.where(twin["record"].str[-1].astype(int) % 2, 0.11, -0.09)
    near = twin.assign(method="near", **{RMS: twin[RMS] + sway})
    group = compared(pd.concat([table, twin, near]), reference="a")
    assert (group.row("a").rank, group.row("twin").rank) == (1, 1)
    assert group.row("near").rank == 3
    assert group.row("near").difference == pytest.approx(0.01)
    assert group.row("near").stderr == pytest.approx(0.1 / np.sqrt(19))
    assert group.row("far").rank == 4
    assert group.row("a").difference == 0.0


@pytest.mark.parametrize(
    ("better", "values", "best"),
    [
        ("smaller", {"a": 1.0, "b": 2.0, "c": -3.0}, "c"),
        ("larger", {"a": 1.0, "b": 2.0, "c": -3.0}, "b"),
        ("zero", {"a": 1.0, "b": 2.0, "c": -3.0}, "a"),
    ],
)
def test_better_means_what_the_score_says(better: Any, values: dict[str, float], best: str) -> None:
    score = Score("x", "x", "", better)
    table = made_study(values, score="x", record_spread=0.0, noise=0.01)
    table["x"] -= 10.0
    group = compare_methods(table, score)[0]
    assert (group.reference, group.best) == (best, best)
    for row in group.rows:
        loss = {"smaller": 1.0, "larger": -1.0}.get(better)
        worth = {m: abs(v) if loss is None else loss * v for m, v in values.items()}
        assert row.difference == pytest.approx(worth[row.method] - worth[best], abs=0.02)
        assert row.mean == pytest.approx(values[row.method], abs=0.02)


def test_coverage_is_compared_by_the_distance_of_its_share_from_the_target() -> None:
    rng = np.random.default_rng(4)
    table = made_study({"honest": 0.0, "bold": 0.0, "timid": 0.0}, n_records=200, n_reductions=1)
    share = table["method"].map({"honest": 0.95, "bold": 0.6, "timid": 1.0})
    table["tau_covered"] = (rng.random(len(table)) < share).astype(float)
    group = compared(table, "tau_covered", reference="honest")
    bold, honest = group.row("bold"), group.row("honest")
    # A cell by itself is always 0.05 or 0.95 off: only the share can be near its target.
    assert honest.loss < 0.05
    assert bold.difference == pytest.approx(0.35, abs=4.0 * bold.stderr)
    assert bold.difference > 2.0 * bold.stderr
    assert group.row("timid").difference == pytest.approx(0.05 - honest.loss)


def test_failed_cells_leave_pairs_and_are_compared() -> None:
    table = made_study({"a": 0.0, "b": -1.0})
    # b fails on the hardest half: by its own mean it would look far better than it is.
    level = table.groupby("record")[RMS].transform("mean")
    hard = where(table, "b") & (level > level.median())
    table.loc[hard, "state"] = "failed"
    table.loc[hard, RMS] = -1e6
    row = compared(table, reference="a").row("b")
    assert row.n_failed == hard.sum() > 5
    assert row.n_pairs == row.n_cells - row.n_failed
    assert row.difference == pytest.approx(-1.0, abs=4.0 * row.stderr)
    assert row.mean < compared(table, reference="a").row("a").mean - 2.0
    assert f"no score on {row.n_failed} of its {row.n_cells} cells: survivors only" in row.trust
    assert "survivors" not in compared(table, reference="a").row("a").trust


def test_a_method_without_a_common_record_is_reported_so_and_not_compared() -> None:
    table = made_study({"a": 0.0, "b": 0.5})
    alien = made_study({"alien": -5.0}, seed=9)
    alien["record"] = "other-" + alien["record"]
    alien["reduction"] = "other-" + alien["reduction"]
    group = compared(pd.concat([table, alien]), reference="a")
    row = group.row("alien")
    assert row.rank is None
    assert np.isnan(row.difference)
    assert group.best == "a"
    table.loc[where(table, "a"), RMS] = np.nan
    group = compared(table, reference="a")
    assert "a, the reference, has no value" in group.lead()
    assert group.row("a").trust.startswith("no score on 40 of its 40 cells; ")


def test_a_method_that_fails_nearly_everywhere_does_not_choose_the_reference() -> None:
    table = made_study({"a": 0.0, "b": 0.5, "rare": 9.0})
    kept = table["record"] == "r-002"
    table.loc[(table["method"] == "rare") & ~kept, "state"] = "failed"
    # On the one record that the rare method could score, b happens to be better.
    table.loc[where(table, "b", "r-002"), RMS] -= 2.0
    group = compared(table)
    assert group.reference == "a"
    assert group.row("rare").rank is None


def test_settings_of_the_fit_keep_cells_of_one_reduction_apart() -> None:
    table = made_study({"a": 0.0, "b": 0.5}, n_reductions=1)
    both = pd.concat([table.assign(**{"fit.degree": d}) for d in (2, 3)])
    assert compared(both).row("b").n_pairs == 2 * 20
    assert compared(both).row("b").n_records == 20


def test_a_reference_that_is_no_method_is_refused_in_a_sentence() -> None:
    with pytest.raises(InputError, match="reference"):
        compare_methods(made_study({"a": 0.0, "b": 0.5}), RMS, "other")


def test_the_stated_5_percent_is_5_percent_where_methods_are_equal() -> None:
    """Four equal methods: any word of a difference is false, whoever was chosen as reference."""
    found = {"a": 0, None: 0}
    n = 150
    for seed in range(n):
        methods = dict.fromkeys("abcd", 0.0)
        table = made_study(methods, seed=seed, n_records=12, n_reductions=1, noise=1.0)
        for reference in found:
            group = compared(table, reference=reference, margin=0.001)
            found[reference] += any(row.verdict in ("better", "worse") for row in group.rows)
    error = np.sqrt(0.05 * 0.95 / n)
    # Holm keeps the level exactly for independent tests, and stays below it for these.
    assert 0.01 < found["a"] / n < 0.05 + 3.0 * error
    assert found[None] / n < 0.05 + 3.0 * error


def test_equivalence_is_said_of_methods_at_the_margin_in_5_percent() -> None:
    n, said = 200, {0.0: 0, 1.0: 0}
    for seed in range(n):
        for shift in said:
            table = made_study(
                {"a": 0.0, "b": shift}, seed=seed, n_records=20, n_reductions=1, record_spread=0.0
            )
            # The loss of the reference is 10: its margin is 1.
            said[shift] += compared(table, reference="a").row("b").verdict == "equivalent"
    assert said[0.0] == n
    assert said[1.0] / n == pytest.approx(0.05, abs=3.0 * np.sqrt(0.05 * 0.95 / n))


def test_each_verdict_is_given_where_it_is_due() -> None:
    table = made_study({"a": 0.0, "far": 4.0, "near": 0.1, "less": -4.0}, n_records=30)
    noisy = made_study({"noisy": 0.0}, seed=0, noise=9.0, n_records=30)
    group = compared(pd.concat([table, noisy]), reference="a")
    words = {row.method: row.verdict for row in group.rows}
    assert words == {
        "a": "", "far": "worse", "near": "equivalent", "less": "better", "noisy": "undecided"
    }  # fmt: skip
    assert "far 4.0" in group.lead()
    assert "(worse)" in group.lead()
