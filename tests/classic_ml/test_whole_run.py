"""One free run through whole records: the truth recovered, invariances, refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from classic_ml.faults.search import SPIKED
from classic_ml.filters import period_average
from classic_ml.records import Channel, LedgerEntry, Record
from classic_ml.segments import (
    cell_period_s,
    extend_while_settled,
    free_run_rows,
    hub_tip_stall,
    near,
)
from classic_ml.series import CoefficientSeries
from classic_ml.whole_run import fit_whole_runs
from classic_ml.whole_run_rows import has_whole_run, whole_run_rows
from surge_core.errors import InputError
from surge_core.fit_state import FitState
from surge_core.lag import FirstOrderLag

BETA = np.array([1.2, 3.0, 47.0])
TAU_S = 0.018
PERIOD_S = 1.0 / 82.5
RATE_HZ = 1000.0
N_ROWS = 4000
LOSS = 1400.0


def series(
    seed: int,
    *,
    noise: float = 0.01,
    ripple: float = 0.05,
    loss: float = LOSS,
    forward: float = 1.0,
) -> CoefficientSeries:
    """Make cycles with reversed flow, an unstalled phase and stall cells, marked as reduced."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(N_ROWS) / RATE_HZ
    angle = 2.0 * np.pi * 7.0 * time_s + 0.3 * np.sin(2.0 * np.pi * 0.7 * time_s)
    phi = 0.12 + 0.145 * np.sin(angle) + 0.03 * np.sin(2.0 * angle)
    phi = np.where(phi < 0.0, 0.3 * phi, phi) * forward - (1.0 - forward) * 0.03
    # Stall ends as φ rises through .2 and begins again as it falls below .24.
    stalled = np.ones(N_ROWS, dtype=bool)
    for k in range(1, N_ROWS):
        rising = phi[k] > phi[k - 1]
        stalled[k] = phi[k] < 0.2 if stalled[k - 1] and rising else phi[k] < 0.24
    quasi_steady = np.where(stalled, np.vander(phi, 3)[:, ::-1] @ BETA, 4.0 + 1.5 * (phi - 0.25))
    lag = FirstOrderLag(TAU_S, 1.0 / RATE_HZ, "first")
    psi_p = lag.respond(quasi_steady, quasi_steady[0])
    cells = ripple * np.sin(2.0 * np.pi * 82.5 * time_s)
    measured = psi_p + np.where(phi < 0.0, loss * phi**2, 0.0) + 5.0 * cells
    measured += noise * rng.standard_normal(N_ROWS)
    average = period_average(phi, PERIOD_S, RATE_HZ)
    switch = np.zeros(N_ROWS, dtype=bool)
    switch[1:] = stalled[1:] != stalled[:-1]
    scored = stalled & ~near(average <= 0.01, 7, 2) & ~near(switch, 8, 12)
    scored[:10] = scored[-10:] = False
    entry = LedgerEntry("free run", "made for a test", {"average_s": PERIOD_S})
    return CoefficientSeries(
        time_s=time_s,
        phi=average,
        psi_p=period_average(measured, PERIOD_S, RATE_HZ),
        segment=stalled.astype(np.int64),
        phi_unfiltered=phi + cells * 0.2,
        psi_p_unfiltered=measured,
        stalled=stalled,
        free_run=1 + scored.astype(np.int64),
        source=f"made {seed}",
        history=(entry,),
    )


def test_the_truth_is_recovered_over_seeds() -> None:
    at = np.array([0.02, 0.08, 0.14])
    z_tau, z_curve = [], []
    for seed in range(12):
        fit = fit_whole_runs([series(seed, ripple=0.0)])
        assert fit.fit_state_ is FitState.CONVERGED
        z_tau.append((fit.time_constant_s_ - TAU_S) / fit.time_constant_stderr_s_)
        value, stderr = fit.characteristic(at)
        z_curve.append((value - np.vander(at, 3)[:, ::-1] @ BETA) / stderr)
    # The stated error holds a share for what all cycles have in common, so it is never too small.
    assert np.max(np.abs(z_tau)) < 3.0
    assert np.max(np.abs(z_curve)) < 3.5


def test_without_noise_it_is_exact() -> None:
    """Every nuisance is needed for this: the loss, its derivative, the unstalled line."""
    fit = fit_whole_runs([series(0, noise=0.0, ripple=0.0)])
    assert fit.time_constant_s_ == pytest.approx(TAU_S, abs=2e-6)
    assert fit.coef_ == pytest.approx(BETA, rel=2e-3)


def test_the_jackknife_states_the_scatter_and_the_choices_of_the_fit_come_on_top() -> None:
    fits = [fit_whole_runs([series(seed, ripple=0.0)]) for seed in range(30)]
    scatter = np.array([fit.model_.time_constant_stderr_s_ for fit in fits])
    stated = np.array([fit.time_constant_stderr_s_ for fit in fits])
    apart = np.array([fit.time_constant_s_ for fit in fits]) - TAU_S
    # The rms of thirty z is itself known to 13 %.
    assert 0.65 < np.sqrt(np.mean((apart / scatter) ** 2)) < 1.5
    assert 0.6 < np.sqrt(np.mean((apart / stated) ** 2)) < 1.3
    assert np.all(stated > scatter)


def test_stall_cells_average_out() -> None:
    plain = fit_whole_runs([series(3, ripple=0.0)])
    rippled = fit_whole_runs([series(3, ripple=0.05)])
    assert rippled.time_constant_s_ == pytest.approx(plain.time_constant_s_, rel=0.05)


def test_rows_of_reversed_flow_are_not_read_as_dynamics() -> None:
    with_loss = fit_whole_runs([series(4)])
    without = fit_whole_runs([series(4, loss=0.0)])
    assert with_loss.time_constant_s_ == pytest.approx(without.time_constant_s_, rel=0.06)


def test_several_records_are_one_fit_in_any_order() -> None:
    records = [series(seed) for seed in (5, 6, 7)]
    forth, back = fit_whole_runs(records), fit_whole_runs(records[::-1])
    assert forth.time_constant_s_ == pytest.approx(back.time_constant_s_, rel=1e-4)
    assert forth.coef_ == pytest.approx(back.coef_, rel=1e-3)
    assert forth.time_constant_stderr_s_ < fit_whole_runs(records[:1]).time_constant_stderr_s_


def test_tau_can_be_held() -> None:
    fit = fit_whole_runs([series(8)], time_constant_s=0.025)
    assert fit.time_constant_s_ == pytest.approx(0.025)
    assert fit.time_constant_stderr_s_ == 0.0


def test_what_is_held_out_does_not_reach_the_fit() -> None:
    record = series(9)
    spoilt = np.array(record.psi_p_unfiltered)
    spoilt[3000:] += 5.0
    fits = [
        fit_whole_runs([one], until_s=[2.9])
        for one in (record, replace(record, psi_p_unfiltered=spoilt, psi_p=spoilt))
    ]
    assert fits[0].time_constant_s_ == pytest.approx(fits[1].time_constant_s_, rel=1e-6)


def test_hardly_any_forward_flow_is_refused() -> None:
    record = series(10)
    free_run = np.where(np.arange(N_ROWS) < 3700, np.minimum(record.free_run, 1), record.free_run)
    fit = fit_whole_runs([replace(record, free_run=free_run)])
    assert fit.fit_state_ is FitState.BLOWDOWN
    assert np.isnan(fit.time_constant_s_)
    assert "none is stated" in fit.fit_state_.advice


def test_nothing_to_score_is_refused_and_not_fitted_to_what_is_held_out() -> None:
    fit = fit_whole_runs([series(10)], until_s=[-1.0])
    assert fit.fit_state_ is FitState.BLOWDOWN
    assert fit.n_scored_ == 0
    assert not hasattr(fit.model_, "coef_")
    assert fit.checks((0.0, 0.1)) == ()


def test_a_held_tau_is_not_taken_back() -> None:
    record = series(10)
    free_run = np.where(np.arange(N_ROWS) < 3700, np.minimum(record.free_run, 1), record.free_run)
    fit = fit_whole_runs([replace(record, free_run=free_run)], time_constant_s=0.02)
    assert fit.fit_state_ is FitState.BLOWDOWN
    assert fit.time_constant_s_ == pytest.approx(0.02)


def test_a_record_without_unstalled_rows_goes_with_one_that_has_them() -> None:
    first = series(11, noise=0.0, ripple=0.0)
    phi = 0.02 + 0.1 * (1.0 + np.sin(2.0 * np.pi * 7.0 * first.time_s))
    quasi_steady = np.vander(phi, 3)[:, ::-1] @ BETA
    lag = FirstOrderLag(TAU_S, 1.0 / RATE_HZ, "first")
    psi_p = lag.respond(quasi_steady, quasi_steady[0])
    second = replace(
        first,
        phi_unfiltered=phi,
        psi_p_unfiltered=psi_p,
        stalled=np.ones(N_ROWS, dtype=bool),
        free_run=np.r_[np.ones(10), np.full(N_ROWS - 20, 2), np.ones(10)].astype(np.int64),
    )
    fit = fit_whole_runs([first, second])
    assert fit.time_constant_s_ == pytest.approx(TAU_S, abs=2e-6)
    assert fit.coef_ == pytest.approx(BETA, rel=2e-3)


def test_terms_of_any_kind_are_averaged_after_they_were_formed() -> None:
    record = series(12)
    rows = whole_run_rows(record, terms=lambda phi: np.column_stack([phi**2, np.exp(phi)]))
    powers = whole_run_rows(record, degree=2)
    np.testing.assert_allclose(rows.terms[:, 0], powers.terms[:, 2], atol=1e-12)
    kept = powers.weight > 0.0
    # exp has curvature: the average of the ripple's two sides lies above the middle.
    assert np.all(rows.terms[kept, 1] > np.exp(powers.phi[kept]) - 1e-12)
    np.testing.assert_array_equal(rows.nuisance, powers.nuisance)


def test_a_cycle_runs_from_one_entry_into_stall_to_the_next() -> None:
    record = series(13)
    # Chatter at a switch is no cycle of its own: the state is averaged like the signals.
    stalled = np.arange(N_ROWS) % 150 >= 40
    stalled[150 * np.arange(5) + 2] = True
    rows = whole_run_rows(replace(record, stalled=stalled))
    cuts = np.flatnonzero(np.diff(rows.cycle)) + 1
    entries = 150 * np.arange(27) + 40
    assert cuts.size == entries.size
    assert np.max(np.abs(cuts - entries)) <= 1
    always = replace(record, stalled=np.ones(N_ROWS, dtype=bool))
    assert np.all(whole_run_rows(always).cycle == 0)


def test_records_of_unlike_rates_and_no_records_are_refused() -> None:
    record = series(0)
    slow = replace(record, time_s=2.0 * record.time_s)
    for records in ([record, slow], []):
        with pytest.raises(InputError, match="one sample rate"):
            fit_whole_runs(records)


def test_a_series_without_the_columns_is_told() -> None:
    record = replace(series(0), phi_unfiltered=None)
    assert not has_whole_run(record)
    with pytest.raises(InputError, match="phi_unfiltered"):
        whole_run_rows(record)
    unlike = [LedgerEntry("free run", "", {"average_s": s}) for s in ("x", float("nan"), 12.0)]
    for history in ((), *((entry,) for entry in unlike)):
        with pytest.raises(InputError, match="ledger"):
            whole_run_rows(replace(series(0), history=history))


def made_record(seed: int, *, cells: float, shift: float) -> tuple[Record, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    truth = series(seed)
    stalled = np.asarray(truth.stalled)
    time_s = truth.time_s
    wave = cells * np.sin(2.0 * np.pi * 82.5 * time_s) * stalled
    noise = rng.standard_normal((3, N_ROWS))
    record = Record.from_arrays(
        {
            "P25_unfiltered_Pa": (1e5 + 1e4 * truth.phi + 500.0 * (wave + noise[0]), "Pa"),
            "Wc25_hub_kg_s": (80.0 * truth.phi + shift * stalled + 0.2 * noise[1], "kg/s"),
            "Wc25_tip_kg_s": (80.0 * truth.phi - shift * stalled + 0.2 * noise[2], "kg/s"),
            "Nc_frac": (np.where(time_s < 0.5, 0.9, 0.75), "1"),
            "P25_A_tip_forward": (1e5 + 1e4 * truth.phi, "Pa"),
            "fault_P25_A_tip_forward": ((time_s > 3.8).astype(float), "1"),
        },
        sample_rate_hz=RATE_HZ,
        source="made",
    )
    return record, np.asarray(truth.phi_unfiltered), stalled


def test_every_row_left_out_of_the_free_run_is_named_once() -> None:
    record, phi, stalled = made_record(0, cells=8.0, shift=4.0)
    record = record.after(LedgerEntry("phi", "unfiltered"), add=[Channel("phi", phi, "1")])
    window = slice(0, N_ROWS)
    period_s, has_cells = cell_period_s(record, window, 12_000.0)
    assert has_cells
    assert period_s == pytest.approx(PERIOD_S, rel=0.01)
    state = hub_tip_stall(record, window, 1.0 / period_s, slice(0))
    assert state is not None
    assert np.mean(state == stalled) > 0.95
    free_run, entry = free_run_rows(record, state, window, period_s)
    assert sum(d.count for d in entry.dropped) + np.count_nonzero(free_run == 2) == N_ROWS
    said = " ".join(d.why for d in entry.dropped)
    for word in ("blows down", "smears", "unstalled"):
        assert word in said
    assert not np.any((free_run == 2) & ~state)


def test_the_window_grows_over_the_settled_machine_only() -> None:
    record, _, _ = made_record(2, cells=8.0, shift=4.0)
    grown = extend_while_settled(record, slice(1500, 3000))
    # N_c settles at 0.5 s (its average a little about that), readings fail from 3.8 s on.
    assert 450 <= grown.start <= 580
    assert grown.stop == 3801


@pytest.mark.parametrize("row", [1500, 2998, 2999])
def test_a_fault_inside_the_window_does_not_keep_it_from_growing(row: int) -> None:
    record, _, _ = made_record(2, cells=8.0, shift=4.0)
    faults = np.zeros(N_ROWS)
    faults[[row, 3400]] = 1.0
    faults[3200] = SPIKED  # bridged
    record = replace(
        record, channels={**record.channels, "fault_P": Channel("fault_P", faults, "1")}
    )
    assert extend_while_settled(record, slice(1500, 3000)).stop == 3400
