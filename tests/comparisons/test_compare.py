"""Estimators side by side: scores, pairing, held-out cycles and words of trust."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from lag_data import BETA, PERIOD_S, TAU_S, flow, lagged

from classic_ml.series import CoefficientSeries
from comparisons.harness.compare import compare_records
from comparisons.harness.estimators import default_estimators, psi_breakpoints
from comparisons.harness.fit_quality import dwelt_on, score_fit
from comparisons.harness.reconstruction import reconstruct_record, validate_models
from comparisons.harness.rows import stack_rows
from comparisons.results import FittedLag
from comparisons.show.json_output import comparison_document
from surge_core.errors import InputError
from surge_core.files import to_strict_json
from surge_core.paired import block_errors, block_rms, paired_difference

CLASSICAL = default_estimators()[:4]


def series(seed: int, n: int = 3000, n_segments: int = 6, **columns: object) -> CoefficientSeries:
    rng = np.random.default_rng(seed)
    phi = flow(n, rng)
    y = lagged(phi, "first") + 0.003 * rng.standard_normal(n)
    segment = np.zeros(n, dtype=np.int64)
    edges = np.linspace(0, n, n_segments + 1).astype(int)
    for label, (low, high) in enumerate(pairwise(edges), start=1):
        segment[low : high - 20] = label
    if n_segments == 1:
        segment[:] = 1
    return CoefficientSeries(
        np.arange(n) * PERIOD_S + 10.0, phi, y, segment, source=f"record {seed}", **columns
    )


def test_scores_of_known_errors() -> None:
    y = np.array([1.0, 2.0, 3.0, 4.0])
    perfect = score_fit(y, y)
    assert (perfect.rms, perfect.fit_percent, perfect.r2) == (0.0, 100.0, 1.0)
    mean = score_fit(y, np.full(4, 2.5))
    assert mean.r2 == pytest.approx(0.0)
    assert mean.fit_percent == pytest.approx(0.0)
    off = score_fit(y, y + 0.5, np.array([True, True, False, True]))
    assert off.rms == pytest.approx(0.5)
    assert off.n_rows == 3


def test_paired_error_is_smaller_than_the_errors_apart() -> None:
    rng = np.random.default_rng(5)
    hard = rng.uniform(0.5, 2.0, 40)  # some cycles are hard for both
    runs = [slice(50 * i, 50 * i + 50) for i in range(40)]
    base = (hard[:, None] * rng.standard_normal((40, 50))).ravel()
    one, two = block_errors(base, runs), block_errors(1.1 * base, runs)
    difference, paired = paired_difference(two, one)
    assert difference == pytest.approx(0.1 * np.sqrt(np.mean(base**2)))
    other = (rng.permutation(hard)[:, None] * rng.standard_normal((40, 50))).ravel()
    _, unpaired = paired_difference(block_errors(other, runs), one)
    assert paired < 0.2 * unpaired
    value, stderr = block_rms(one)
    assert value == pytest.approx(np.sqrt(np.mean(base**2)))
    assert 0.0 < paired < stderr  # what makes a cycle hard is hard for both
    assert block_errors(np.ones(100), [slice(0, 100)]).shape == (6, 2)  # one segment, six blocks


@pytest.mark.parametrize("n_segments", [1, 2, 6])
def test_all_estimators_find_the_truth_and_are_scored_on_rows_they_did_not_see(
    n_segments: int,
) -> None:
    comparison = compare_records([series(1, n_segments=n_segments)], estimators=CLASSICAL)
    for name in ("classic_ml", "classic_ml_output_error"):
        result = comparison.result(name)
        value, error = result.model.time_constant_s, result.model.time_constant_stderr_s
        assert abs(value - TAU_S) < 4 * error
        assert result.held_out is not None
        assert result.held_out.rms == pytest.approx(0.003, rel=0.25)
        assert result.free_run.r2 > 0.98
    assert 0.5 < comparison.rows.train.mean() < 0.8
    least = min(comparison.results, key=lambda result: result.held_out.rms)
    assert least.difference == 0.0
    # Without whole runs no τ is the compressor's; the fits that fail fewest checks lead.
    assert comparison.recommended is None
    failed = [len(result.failed) for result in comparison.results]
    assert failed == sorted(failed)


def test_the_end_of_every_record_is_held_out() -> None:
    rows = stack_rows([series(3), series(4)])
    for index in (0, 1):
        own = rows.record == index
        assert 0.5 < rows.train[own].mean() < 0.8
        assert rows.time_s[own & rows.train].max() < rows.time_s[own & ~rows.train].min()
    assert set(rows.labels[rows.train]).isdisjoint(rows.labels[~rows.train])


def test_odd_records_are_named() -> None:
    one, other, whole = series(5), series(7), series(6, n_segments=1)
    speeds = [replace(r, Nc_frac=np.full(3000, nc)) for r, nc in ((one, 0.75), (other, 0.70))]
    with_stretch = one.segment.copy()
    with_stretch[480:490] = 99
    for records, code in (
        ([one], "no_ledger"),
        ([whole], "one_segment"),
        (speeds, "speeds_apart"),
        ([replace(one, segment=with_stretch)], "rows_left_out"),
    ):
        found = compare_records(records, estimators=CLASSICAL[:1]).cautions
        assert code in {caution.code for caution in found}
    with pytest.raises(InputError, match="each record once"):
        compare_records([one, one], estimators=CLASSICAL[:1])


def test_the_order_of_records_does_not_change_the_fit() -> None:
    one, two = series(6), series(7)
    forward = compare_records([one, two], estimators=CLASSICAL[:1]).results[0].model
    backward = compare_records([two, one], estimators=CLASSICAL[:1]).results[0].model
    assert forward.time_constant_s == pytest.approx(backward.time_constant_s, rel=1e-6)


def test_records_of_different_rates_and_without_rows_are_refused() -> None:
    one = series(8)
    slow, unmarked = replace(one, time_s=2.0 * one.time_s), replace(one, segment=0 * one.segment)
    for records, target, named in (
        ([series(9), slow], "psi_p", "one sample rate"),
        ([unmarked], "psi_p", "segment"),
        ([one], "psi", "column psi"),
    ):
        with pytest.raises(InputError, match=named):
            compare_records(records, target=target, estimators=CLASSICAL)


def test_json_keeps_the_contract_and_holds_no_nan() -> None:
    comparison = compare_records([series(10)], estimators=CLASSICAL)
    document = json.loads(to_strict_json(comparison_document(comparison)))
    assert document["schema"] == "sindy-surge/compare/1"
    assert set(document) >= {"schema", "records", "estimators", "comparison"}
    assert document["recommended"] is None
    estimate = document["estimators"]["classic_ml"]
    assert estimate["fit_state"]["code"] == "converged"
    assert estimate["fit_state"]["advice"]
    assert set(estimate["time_constant_s"]) == {"value", "stderr", "ci95"}
    assert [term["name"] for term in estimate["terms"]] == ["1", "phi", "phi^2"]
    np.testing.assert_allclose([t["coefficient"] for t in estimate["terms"]], BETA, atol=0.05)
    assert set(estimate["characteristic"]) == {"phi", "psi_p", "stderr"}
    for score in ("free_run", "held_out", "one_step"):
        assert set(estimate["fit"][score]) == {"rms", "fit_percent", "r2"}
    low, high = estimate["valid_phi"]
    assert low < high
    assert {"check", "statistic", "threshold", "passed", "meaning"} <= set(estimate["checks"][0])
    assert estimate["seconds"] > 0.0


def test_reconstruction_of_another_record() -> None:
    model = compare_records([series(11)], estimators=CLASSICAL).result("classic_ml").model
    result = reconstruct_record(model, series(12))
    assert result.score.rms == pytest.approx(0.003, rel=0.2)
    assert 0.0 <= result.outside < 0.5
    lines = result.to_csv().splitlines()
    names = "psi_p_reconstructed,psi_p_low,psi_p_high,outside_valid_phi"
    assert lines[0] == f"time_s,segment,phi,psi_p,{names}"
    assert len(lines) == result.rows.phi.size + 1
    marked = sum(line.endswith(",1") for line in lines)
    assert marked == np.count_nonzero(result.beyond) == result.to_json()["rows_outside_valid_phi"]
    # The free run is known far better than one row is measured; rows scatter as in the fit.
    assert result.inside(result.band) < 0.7
    assert result.inside(result.wide_band) == pytest.approx(0.95, abs=0.03)
    wrong = FittedLag(**{**model.__dict__, "time_constant_s": 0.243})
    far = reconstruct_record(wrong, series(12))
    assert far.score.rms > 5 * result.score.rms
    assert far.inside(far.wide_band) < 0.5


def test_models_on_the_same_rows_are_compared_in_pairs() -> None:
    model = compare_records([series(11)], estimators=CLASSICAL).result("classic_ml").model
    slow = FittedLag(**{**model.__dict__, "estimator": "slow", "time_constant_s": 0.03})
    good, bad = validate_models([model, slow], [series(12)])
    assert (good.difference, good.paired_error) == (0.0, 0.0)
    assert bad.difference == pytest.approx(bad.score.rms - good.score.rms)
    assert bad.difference > 3.0 * bad.paired_error > 0.0
    assert bad.p_value < 0.01
    assert [run.model.estimator for run in validate_models([slow], [series(12)])] == ["slow"]


def test_breakpoints_of_fig_22_are_found_near_the_truth() -> None:
    rng = np.random.default_rng(13)
    phi = flow(4000, rng)
    f = 3.4 - 12.0 * np.minimum(phi, 0.2) + 6.0 * np.clip(phi - 0.2, 0, 0.2)
    f -= 3.0 * np.maximum(phi - 0.4, 0.0)
    a = np.exp(-PERIOD_S / TAU_S)
    y = np.empty_like(f)
    y[0] = f[0]
    for k in range(1, f.size):
        y[k] = a * y[k - 1] + (1 - a) * f[k - 1]
    record = CoefficientSeries(
        np.arange(4000) * PERIOD_S, phi, y, np.ones(4000, dtype=np.int64), psi=y
    )
    low, high = psi_breakpoints(stack_rows([record], "psi"))
    assert low == pytest.approx(0.2, abs=0.06)
    assert high == pytest.approx(0.4, abs=0.06)


def test_a_hole_in_phi_is_not_dwelt_on() -> None:
    phi = np.concatenate([np.linspace(-0.1, -0.05, 50), np.linspace(0.05, 0.3, 300)])
    grid = np.array([-0.12, -0.1, -0.06, -0.045, 0.0, 0.04, 0.045, 0.2, 0.31])
    expected = [False, True, True, True, False, False, True, True, False]
    assert dwelt_on(grid, phi).tolist() == expected
