"""Which further measurement would tell aliases apart: from simulation, and true of what it says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from effect_data import series_of

from classic_ml.series import CoefficientSeries
from comparisons.missing_effect.catalogue import find_effect
from comparisons.missing_effect.diagnosis import diagnose, diagnose_data
from comparisons.missing_effect.fit import fit_structure
from comparisons.missing_effect.lag_data import LATER, OTHER, TRAIN, LagData
from comparisons.missing_effect.loading import load_data
from comparisons.missing_effect.noise import Metric
from comparisons.missing_effect.results import Diagnosis
from comparisons.missing_effect.separate import (
    CHANGES,
    TOLD_APART,
    Change,
    Separation,
    _Rivals,
    changed,
    separating_measurements,
)
from comparisons.rig.coefficient_tests import simulate_test

TERMS = ("1", "phi", "phi^2", "phi^3")
BY_NAME = {change.name: change for change in CHANGES}


def records(effect: str | None, strength: float, rows: int = 900) -> list[CoefficientSeries]:
    test = simulate_test(effect, strength=strength, seed=0, n_samples=rows)
    return series_of(test)


@pytest.fixture(scope="module")
def late() -> Diagnosis:
    diagnosis = diagnose(records("transport_delay", 1.5), degree=3)
    assert set(diagnosis.missing[0].alias_set) == {"transport_delay", "second_order_lag"}
    return diagnosis


@pytest.fixture(scope="module")
def drifting() -> Diagnosis:
    diagnosis = diagnose(records("sensitivity_drift", 0.7), degree=3)
    assert {"sensitivity_drift", "facility_heating"} <= set(diagnosis.missing[0].alias_set)
    return diagnosis


@pytest.fixture(scope="module")
def separated(late: Diagnosis) -> Separation:
    return separating_measurements(late)


def split(data: LagData) -> LagData:
    """Hold out the end of each record and the whole of the last one, as on loading."""
    part = np.full(data.n_samples, LATER, dtype=np.int8)
    for record in np.unique(data.record):
        rows = np.flatnonzero(data.record == record)
        part[rows[: int(0.6 * rows.size)]] = TRAIN
    part[data.record == data.record.max()] = OTHER
    return replace(data, part=part)


def test_a_delay_and_a_second_pole_part_where_the_flow_is_faster(separated: Separation) -> None:
    (one,) = separated.sets
    sigma = {m.name: m.sigma for m in one.measurements}
    recorded = one.as_recorded.sigma
    # They differ in the second order of frequency times delay.
    assert sigma["faster_2"] > 1.8 * recorded
    assert sigma["slower_2"] < 0.8 * recorded
    assert sigma["slower_4"] < sigma["slower_2"]
    # Four times the rows: twice the distance.
    assert sigma["longer_4"] == pytest.approx(2.0 * recorded, rel=0.35)
    assert sigma["larger_swing"] > recorded


def test_the_distance_is_what_noisy_records_win_on_average(late: Diagnosis) -> None:
    names = [find_effect(name) for name in ("transport_delay", "second_order_lag")]
    rivals = _Rivals.of(late, late.missing[0].effect, names)
    rng = np.random.default_rng(5)
    faster = changed(rivals.data, BY_NAME["faster_2"])
    (distance,) = [
        d for d in rivals.distances(BY_NAME["faster_2"], rng) if d.truth == "transport_delay"
    ]
    clean = rivals._simulated(rivals.fits["transport_delay"], faster, rng)
    metric = Metric(late.noise.innovation)
    gains = []
    for _ in range(8):
        data = faster.with_measured(clean + metric.sigma * rng.standard_normal(clean.size))
        cost = [
            fit_structure(fit.structure, data, metric, [fit.nonlinear]).cost
            for fit in (rivals.fits[effect.name] for effect in names)
        ]
        gains.append(cost[1] - cost[0])
    # The gain scatters by D about D²/2.
    error = distance.sigma / np.sqrt(len(gains))
    assert abs(float(np.mean(gains)) - 0.5 * distance.sigma**2) < 4.0 * error


def test_the_workflow_names_one_where_it_is_said_to(late: Diagnosis) -> None:
    names = [find_effect(name) for name in ("transport_delay", "second_order_lag")]
    rivals = _Rivals.of(late, late.missing[0].effect, names)
    change = BY_NAME["faster_larger"]
    rng = np.random.default_rng(2)
    told = rivals.distances(change, rng)
    assert all(d.sigma > 1.3 * d.asked for d in told)
    for truth, fit in rivals.fits.items():
        there = changed(rivals.data, change)
        clean = rivals._simulated(fit, there, rng)
        noise = late.noise.sigma * rng.standard_normal(clean.size)
        found = diagnose_data(split(there.with_measured(clean + noise)), TERMS)
        assert [item.alias_set for item in found.missing] == [(truth,)]


def test_a_second_tap_tells_a_transducer_from_the_machine(drifting: Diagnosis) -> None:
    found = separating_measurements(drifting, changes=(BY_NAME["longer_4"],))
    (one,) = found.sets
    sigma = {m.name: m.sigma for m in one.measurements}
    assert one.as_recorded.sigma < TOLD_APART
    assert sigma["longer_4"] > one.as_recorded.sigma
    assert sigma["second_tap"] > 20.0
    assert one.best is not None
    assert one.best.name == "second_tap"
    assert "second tap" in found.lines[-1]


def test_a_slower_flow_passes_the_same_values_at_half_the_rate() -> None:
    data = load_data(records(None, 0.0, 400))
    slow = changed(data, BY_NAME["slower_2"])
    assert slow.n_samples == 2 * data.n_samples - len(data.runs)
    first, last = slow.fine_runs[0]
    own = data["phi"][slice(*data.fine_runs[0])]
    np.testing.assert_allclose(slow["phi"][first:last:2], own, atol=1e-12)
    rate = data["dphi_s"][slice(*data.fine_runs[0])]
    np.testing.assert_allclose(
        slow["dphi_s"][first:last:2][10:-10], 0.5 * rate[10:-10], atol=0.02 * np.std(rate)
    )
    # No record begins before the last has ended, and the pauses between them stay.
    assert np.all(np.diff(slow["time_s"]) > 0.0)
    for runs in (data, slow):
        ends = [runs["time_s"][stop - 1] for _, stop in runs.fine_runs[:-1]]
        starts = [runs["time_s"][first] for first, _ in runs.fine_runs[1:]]
        np.testing.assert_allclose(np.subtract(starts, ends), starts[0] - ends[0], rtol=1e-6)


@pytest.mark.parametrize("change", CHANGES, ids=lambda change: change.name)
def test_every_experiment_is_one_that_a_compressor_could_make(change: Change) -> None:
    data = load_data(records(None, 0.0, 400))
    there = changed(data, change)
    phi, span = data["phi"], float(np.ptp(data["phi"]))
    assert there.n_samples == pytest.approx(change.length * data.n_samples, rel=0.01)
    assert all(np.all(np.isfinite(values)) for values in there.signals.values())
    assert set(there.signals) >= {"phi", "dphi_s", "amplitude", "T25_K", "Nc_frac", "in_stall"}
    assert set(np.unique(there["in_stall"])) <= set(np.unique(data["in_stall"]))
    assert np.all(there["T25_K"] > 200.0)
    assert there["phi"].mean() == pytest.approx(phi.mean() - change.lower * span, abs=0.1 * span)
    if not change.settings:
        assert np.ptp(there["phi"]) == pytest.approx(change.swing * span, rel=0.02)
    assert np.all(there.part == TRAIN)
