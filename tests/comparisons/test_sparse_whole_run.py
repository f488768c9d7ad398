"""The sparse regression on whole runs of the rig: the truth, its twin, refusals, a comparison."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from rig_records import rig_run, rig_series, through_files

from classic_ml.reduction import reduce_record
from classic_ml.whole_run import fit_whole_runs
from comparisons.harness.compare import _quotable, compare_records
from comparisons.harness.estimators import default_estimators
from comparisons.harness.fit_quality import trusted_range
from comparisons.harness.reconstruction import validate_models
from comparisons.harness.saved_models import load_models, save_models
from comparisons.harness.sparse_whole_run import SparseWholeRunFit, fit_sparse_whole_runs
from comparisons.harness.tau_trial import trial_of
from comparisons.results import Comparison
from comparisons.rig.drawn import draw_run
from comparisons.show.json_output import comparison_document
from surge_core.errors import InputError
from surge_core.files import to_strict_json
from surge_core.fit_state import FitState

TAU_S = 0.018
AT = np.array([0.0, 0.05, 0.1, 0.15])
RECORDS = (("985", 0), ("985", 1), ("90", 0), ("95", 0))


@cache
def fitted(case: str, seed: int) -> SparseWholeRunFit:
    return fit_sparse_whole_runs([rig_series(case, seed)])


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    specs = [s for s in default_estimators(n_twins=0) if s.name in ("classic_ml", "paper", "sindy")]
    return compare_records([rig_series("985", 0)], estimators=specs)


def test_tau_and_curve_over_seeds_and_speeds() -> None:
    """2.5 ms on one record, 1.2 ms on the mean of four and 0.15 of the curve are noise's share."""
    taus, inside = [], 0
    for case, seed in RECORDS:
        fit = fitted(case, seed)
        taus.append(fit.time_constant_s_)
        inside += abs(taus[-1] - TAU_S) < 2.1 * fit.time_constant_stderr_s_
        beta = rig_run(case, seed).truth_parameters["beta"]
        error = fit.characteristic(AT)[0] - np.polynomial.polynomial.polyval(AT, beta)
        assert np.max(np.abs(error)) < 0.15
    assert np.max(np.abs(np.array(taus) - TAU_S)) < 0.0025
    assert abs(np.mean(taus) - TAU_S) < 0.0012
    assert inside >= 3


def test_the_true_parabola_is_not_left() -> None:
    chosen = [fitted(case, seed).terms_ for case, seed in RECORDS]
    assert chosen == [["1", "phi", "phi^2"]] * 4


def test_without_its_rakes_two_codes_agree_on_the_parabola() -> None:
    """Both are then one least-squares problem, solved by code that has nothing in common."""
    for case, seed in RECORDS:
        record = replace(rig_series(case, seed), rakes={})
        sparse, twin = fit_sparse_whole_runs([record]), fit_whole_runs([record])
        assert sparse.terms_ == ["1", "phi", "phi^2"]
        assert sparse.time_constant_s_ == pytest.approx(twin.time_constant_s_, rel=1e-4)
        np.testing.assert_allclose(sparse.coef_, twin.coef_, rtol=1e-3)
        # The blocks differ: whole cycles here, stretches of scored rows there.
        ratio = sparse.time_constant_stderr_s_ / twin.time_constant_stderr_s_
        assert 0.6 < ratio < 1.6


def test_a_cubic_of_150_beside_the_parabola_is_undecidable() -> None:
    parabola = fitted("985", 0)
    assert parabola.departure_.finding == "undecidable"
    low, high = parabola.departure_.cubic
    assert low < 0.0
    assert high > 150.0
    assert "does not decide" in parabola.cautions_[0]


def test_a_kink_of_the_plant_is_not_taken_for_a_parabola() -> None:
    run, _ = draw_run(np.random.default_rng([81, 9]), "985", "kink 25")
    found = fit_sparse_whole_runs([reduce_record(*through_files(run)).series]).departure_
    assert found.gain > 2.0 * found.needed


@pytest.mark.parametrize("n_scored", [0, 12])
def test_next_to_nothing_to_score_is_refused(n_scored: int) -> None:
    record = rig_series("985", 0)
    scored = record.time_s[record.free_run == 2]
    end = scored[n_scored] - 0.5 * record.sample_period_s
    fit = fit_sparse_whole_runs([record], until_s=[float(end)])
    assert fit.n_scored_ == n_scored
    assert fit.fit_state_ is FitState.BLOWDOWN
    assert np.isnan(fit.time_constant_s_)
    assert fit.terms_ == []
    assert fit.characteristic(AT)[0].tolist() == [0.0] * 4


def test_what_is_held_out_does_not_reach_the_fit() -> None:
    record = rig_series("985", 0)
    end = float(np.quantile(record.time_s[record.free_run == 2], 0.7))
    later = record.time_s > end + 0.05
    spoilt = replace(
        record,
        psi_p=record.psi_p + 5.0 * later,
        psi_p_unfiltered=record.psi_p_unfiltered + 5.0 * later,
        rakes={k: v * (1.0 + 0.3 * later * k.startswith("Pt31")) for k, v in record.rakes.items()},
    )
    plain, other = (fit_sparse_whole_runs([r], until_s=[end]) for r in (record, spoilt))
    assert plain.terms_ == other.terms_
    assert other.time_constant_s_ == pytest.approx(plain.time_constant_s_, rel=1e-6)


def test_several_records_are_one_fit_in_any_order() -> None:
    records = [rig_series("985", seed) for seed in (0, 1)]
    forth, back = fit_sparse_whole_runs(records), fit_sparse_whole_runs(records[::-1])
    assert forth.terms_ == back.terms_
    assert forth.time_constant_s_ == pytest.approx(back.time_constant_s_, rel=1e-5)
    assert forth.n_blocks_ > fitted("985", 0).n_blocks_
    with pytest.raises(InputError, match="one sample rate"):
        fit_sparse_whole_runs([records[0], replace(records[1], time_s=2.0 * records[1].time_s)])


def test_in_a_comparison_it_stands_beside_the_classical_run(
    comparison: Comparison, tmp_path: Path
) -> None:
    assert comparison.quotable == ("classic_ml", "sindy")
    first, result = map(comparison.result, ("classic_ml", "sindy"))
    # What the parabola lacks in one it lacks in the other.
    checks = [replace(c, passed=c.check != "input_correlation") for c in first.checks]
    assert _quotable(comparison.records, (replace(first, checks=tuple(checks)), result)) == ()
    assert result.converged
    assert result.held_out is not None
    assert result.held_out.r2 > 0.9
    assert [check.check for check in result.checks] == [
        check.check for check in comparison.result("classic_ml").checks
    ]
    document = json.loads(to_strict_json(comparison_document(comparison)))
    low, high = document["estimators"]["sindy"]["time_constant_s"]["ci95"]
    assert low < TAU_S < high
    save_models({"sindy": result.model}, tmp_path / "model.json")
    saved = load_models(tmp_path / "model.json")["sindy"]
    # φ is trusted where the estimator scores it.
    inputs = result.whole_run.stacked()
    assert saved.valid_phi == trusted_range(inputs.phi[inputs.scored])
    np.testing.assert_allclose(saved.quasi_steady(AT), result.model.quasi_steady(AT))


def test_each_is_scored_on_the_rows_that_it_was_fitted_to(comparison: Comparison) -> None:
    record = rig_series("985", 0)
    kinds = {result.name: result.rows.kind for result in comparison.results}
    assert kinds == {"classic_ml": "unfiltered", "sindy": "unfiltered", "paper": "filtered"}
    # A difference is one of the same rows: alone on its rows, the paper's way is the least there.
    by_name = {result.name: result for result in comparison.results}
    assert by_name["paper"].difference == 0.0
    assert sorted(by_name[n].difference > 0.0 for n in ("classic_ml", "sindy")) == [False, True]
    rows = comparison.result("classic_ml").rows
    assert set(rows.time_s) <= set(record.time_s[record.free_run == 2])
    # Another record of the speed has errors of calibration of its own; another speed has
    # another curve.
    models = [result.model for result in comparison.results]
    records = [rig_series("985", 1), rig_series("90", 0)]
    runs = {(r.record.source, r.model.estimator): r for r in validate_models(models, records)}
    same, other = (runs[record.source, "classic_ml"] for record in records)
    assert same.rows.kind == other.rows.kind == "unfiltered"
    assert same.score.r2 > 0.8
    assert same.inside(same.wide_band) > 2.0 * other.inside(other.wide_band)
    assert runs[records[0].source, "paper"].rows.kind == "filtered"


def test_tau_by_trial_runs_over_its_rows(comparison: Comparison) -> None:
    alone = replace(comparison, results=(comparison.result("sindy"),))
    trial = trial_of(alone)
    # Trials stand a tenth of a decade or so apart.
    assert trial.best_tau_s == pytest.approx(comparison.result("sindy").model.time_constant_s, 0.05)
