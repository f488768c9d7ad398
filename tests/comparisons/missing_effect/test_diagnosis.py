"""Names from records: right ones, sets where the data cannot tell, and none where none is due."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from effect_data import (
    CUBIC,
    STUDY,
    diagnosed,
    firm,
    hidden,
    named_sets,
    series_of,
    without_channels,
)

from classic_ml.series import CoefficientSeries
from comparisons.missing_effect import CATALOGUE, Diagnosis, diagnose
from comparisons.missing_effect.lag_data import LATER, OTHER, TRAIN
from comparisons.missing_effect.loading import load_data
from comparisons.rig.coefficient_effects import EFFECTS, OUTSIDE
from comparisons.rig.coefficient_tests import NOISES
from surge_core.errors import InputError

Records = list[CoefficientSeries]
SHORT = {"seed": 3, "n_samples": 1000}


def error_percent(diagnosis: Diagnosis, tau_s: float) -> float:
    return 100.0 * abs(diagnosis.tau_after_s / tau_s - 1.0)


@pytest.mark.parametrize("effect", EFFECTS)
def test_a_hidden_effect_is_named_and_its_gap_closed(effect: str) -> None:
    test, d = diagnosed(effect, **SHORT)
    assert d.verdict in ("named", "alias_set")
    (names,) = named_sets(d)
    assert effect in names
    assert len(names) <= 3
    assert d.verdict == ("named" if len(names) == 1 else "alias_set")
    found = d.missing[0]
    assert found.effect == found.alias_set[0]
    assert not found.provisional
    assert d.gap.shrink >= 0.9
    assert d.gap.after_rms == pytest.approx(test.sigma, rel=0.06)
    assert d.gap.before_rms > 1.2 * test.sigma
    assert d.gap.floor_rms == pytest.approx(test.sigma, rel=0.06)
    assert error_percent(d, test.tau_s) < 1.0
    assert set(d.tau_by_alias_s) == names
    assert d.tau_by_alias_s[found.effect] == d.tau_after_s
    assert not d.leftover.structured
    for number in ("train_gain", "later_gain", "other_record_gain", "score"):
        assert found.evidence[number] > 0.0
    assert found.evidence["p_value"] < 1e-4


def test_most_names_are_alone_and_tau_is_put_right() -> None:
    tests = [diagnosed(effect, **SHORT) for effect in EFFECTS]
    alone = [d.verdict == "named" for _, d in tests]
    assert np.mean(alone) >= 0.7
    after = [error_percent(d, test.tau_s) for test, d in tests]
    before = [100.0 * abs(d.tau_before_s / test.tau_s - 1.0) for test, d in tests]
    assert np.median(after) < 0.2
    assert np.max(before) > 3.0
    assert np.median([d.gap.shrink for _, d in tests]) > 0.95
    first = [d.names[0] == effect for effect, (_, d) in zip(EFFECTS, tests, strict=True)]
    assert np.mean(first) >= 0.85


@pytest.mark.parametrize("noise", NOISES)
def test_nothing_missing_is_said_and_noise_is_called_noise(noise: str) -> None:
    test, d = diagnosed(None, seed=0, noise=noise)
    assert error_percent(d, test.tau_s) < 0.3
    assert d.gap.shrink == pytest.approx(0.0, abs=0.01)
    if noise.startswith("phi"):
        assert set(d.names) <= {"flow_noise"}
        share = 0.01 * float(noise.removeprefix("phi"))
        true = share * np.sqrt(np.mean([np.var(record.phi) for record in test.records]))
        assert d.noise.flow_sigma == pytest.approx(true, rel=0.3)
    else:
        assert d.missing == ()
        assert d.noise.flow is None
    assert d.verdict == ("nothing_missing" if noise == "white" else "noise_model_wrong")
    if noise == "ar1":
        assert d.noise.ar[0] == pytest.approx(0.7, abs=0.05)
    assert d.noise.heavy_tailed is (noise in ("t3", "outliers"))


@pytest.mark.parametrize("noise", ["ar1", "t3"])
def test_a_name_is_found_through_noise_of_another_kind(noise: str) -> None:
    test, d = diagnosed("flow_inertia", **SHORT, noise=noise)
    assert named_sets(d) == [{"flow_inertia"}]
    assert error_percent(d, test.tau_s) < 1.0


# Three more go through the command line in test_verdicts_command.py.
@pytest.mark.parametrize(
    "effect", sorted(set(OUTSIDE) - {"second_slow_mode", "sensor_quadratic", "amplitude_memory"})
)
def test_what_stands_in_no_catalogue_gets_no_firm_name(effect: str) -> None:
    _, d = diagnosed(effect, **SHORT)
    assert not firm(d)
    assert d.verdict != "nothing_missing"


TAKEN_OUT = [("hysteresis", 3), ("amplitude_dependent_lag", 3), ("sensitivity_drift", 3)]
TAKEN_OUT += [(e, 9812) for e in ("transport_delay", "second_order_lag", "reverse_flow_branch")]


@pytest.mark.parametrize(("effect", "seed"), TAKEN_OUT)
def test_an_effect_taken_out_is_not_called_by_another_name(effect: str, seed: int) -> None:
    records = series_of(hidden(effect, seed=seed, n_samples=1000 if seed == 3 else 2000))
    d = diagnose(records, 3, catalogue=[e for e in CATALOGUE if e.name != effect])
    assert not firm(d)
    assert d.verdict != "nothing_missing"


# The last two are so strong that either without the other leaves coloured errors full of outliers.
PAIRS = {
    ("amplitude_dependent_lag", "transport_delay"): 2.0,
    ("flow_inertia", "bias_drift"): 2.0,
    ("hysteresis", "transport_delay"): 6.0,
}


@pytest.mark.parametrize("pair", PAIRS, ids=" and ".join)
def test_two_effects_at_once_are_both_named(pair: tuple[str, str]) -> None:
    test, d = diagnosed(pair, **SHORT, strength=PAIRS[pair])
    sets = named_sets(d)
    assert len(sets) == 2
    assert all(any(name in names for names in sets) for name in pair)
    assert max(len(names) for names in sets) <= 3
    assert error_percent(d, test.tau_s) < 1.0
    assert d.gap.shrink > 0.95


def test_a_base_too_stiff_for_the_data_shows_as_its_shape() -> None:
    test, d = diagnosed(None, degree=2, **SHORT)
    assert "characteristic_shape" in d.names
    assert firm(d)
    assert named_sets(d) == [{"characteristic_shape"}]
    assert d.gap.shrink > 0.99
    assert error_percent(d, test.tau_s) < 0.3
    assert diagnosed(None, degree=5, **SHORT)[1].verdict == "nothing_missing"


def test_an_effect_that_the_base_has_is_not_missing() -> None:
    """The loss in reversed flow, lagged, is a term of the base here."""
    test = hidden("reverse_flow_branch", **SHORT)
    assert test.effects["reverse_flow_branch"]["lagged"] == 1.0
    d = diagnose(series_of(test), terms=(*CUBIC, "phi^2[phi<0]"))
    assert d.verdict == "nothing_missing"
    assert d.after.coefficients[-1] == pytest.approx(
        test.effects["reverse_flow_branch"]["coefficient"], rel=0.05
    )


INVARIANCES: dict[str, Callable[[Records], Records]] = {
    "the order in which the records are given": lambda r: [r[2], r[0], r[1]],
    "psi' ten times as large": lambda r: [replace(x, psi_p=10.0 * x.psi_p) for x in r],
    "a temperature in another unit": lambda r: [replace(x, T25_K=1.8 * x.T25_K) for x in r],
}


def same(d: Diagnosis, records: Records, *, slower: float = 1.0, rel: float = 1e-4) -> Diagnosis:
    other = diagnose(records, 3)
    assert other.verdict == d.verdict
    assert [set(m.alias_set) for m in other.missing] == [set(m.alias_set) for m in d.missing]
    assert other.tau_after_s == pytest.approx(slower * d.tau_after_s, rel=rel)
    return other


@pytest.mark.parametrize("change", INVARIANCES)
def test_what_does_not_matter_changes_nothing(change: str) -> None:
    test, d = diagnosed("thermocouple_lag", **SHORT)
    other = same(d, INVARIANCES[change](series_of(test)))
    assert other.gap.shrink == pytest.approx(d.gap.shrink, abs=1e-3)


# A clock that ran before the test, and one that has run for hours.
@pytest.mark.parametrize(
    ("effect", "shift_s"), [("sensitivity_drift", 60.0), ("rotating_stall_ripple", 12_345.6)]
)
def test_a_clock_that_reads_otherwise_changes_no_name(effect: str, shift_s: float) -> None:
    test, d = diagnosed(effect, **SHORT)
    other = same(d, [replace(r, time_s=r.time_s + shift_s) for r in series_of(test)])
    if effect != "rotating_stall_ripple":
        return  # The rate of a drift is a share of the reading at zero of the clock.
    for one, two in zip(d.missing[0].parameters, other.missing[0].parameters, strict=True):
        assert two.value == pytest.approx(one.value, rel=1e-3)
        assert two.stderr == pytest.approx(one.stderr, rel=0.2)


# Rigs faster at the sample rate that suits them, one with an a2 below 1e-4 s², and a slower one.
FASTER = [("facility_heating", 0.1), ("second_order_lag", 0.1), ("second_order_lag", 4.0)]


@pytest.mark.parametrize(("effect", "factor"), FASTER)
def test_a_rig_of_another_speed_has_the_same_names(effect: str, factor: float) -> None:
    test, d = diagnosed(effect, **SHORT)
    timed = [replace(r, time_s=factor * r.time_s) for r in series_of(test)]
    same(d, timed, slower=factor, rel=1e-3)


def in_segments(effect: str | None) -> Records:
    return series_of(hidden(effect, **STUDY, gaps=True))


@pytest.mark.parametrize("effect", ["flow_inertia", None], ids=str)
def test_records_in_segments_are_diagnosed_as_whole_ones(effect: str | None) -> None:
    """In the gaps the machine is on another characteristic, which must not be seen."""
    test, d = diagnosed(effect, **STUDY, gaps=True)
    assert named_sets(d) == ([] if effect is None else [{effect}])
    assert d.verdict == ("nothing_missing" if effect is None else "named")
    assert error_percent(d, test.tau_s) < 0.3
    renumbered = [
        replace(x, segment=np.where(x.segment > 0, 10 * x.segment, 0)) for x in in_segments(effect)
    ]
    other = diagnose(renumbered, 3)
    assert other.tau_after_s == d.tau_after_s
    assert other.gap == d.gap


def test_later_rows_are_later_whatever_the_segments_are_called() -> None:
    records = in_segments(None)
    backwards = [
        replace(x, segment=np.where(x.segment > 0, 1 + x.segment.max() - x.segment, 0))
        for x in records
    ]
    for records_given in (records, backwards):
        data = load_data(records_given)
        time_s = data.sampled(data["time_s"])
        for number in (0, 1):
            own = (data.record == number) & data.scored()
            fitted, held = own & (data.part == TRAIN), own & (data.part == LATER)
            assert time_s[fitted].max() < time_s[held].min()
            share = np.count_nonzero(fitted) / np.count_nonzero(own)
            assert share == pytest.approx(0.6, abs=0.01)
        assert np.all(data.part[data.record == 2] == OTHER)


def test_one_record_alone_is_judged_by_its_later_part() -> None:
    test = hidden("flow_inertia", seed=3, n_samples=2000)
    d = diagnose(series_of(test)[:1], 3)
    assert named_sets(d) == [{"flow_inertia"}]
    assert np.isnan(d.missing[0].evidence["other_record_gain"])
    assert error_percent(d, test.tau_s) < 0.5


def test_a_channel_that_is_not_there_is_said_and_its_effect_not_blamed_on_another() -> None:
    records = series_of(hidden("thermocouple_lag", **SHORT))
    d = diagnose([without_channels(record) for record in records], 3)
    assert d.unavailable == {
        "speed_droop": "needs the column Nc_frac",
        "thermocouple_lag": "needs the column T25_K",
    }
    assert not firm(d)
    assert d.verdict != "nothing_missing"


def test_a_record_without_the_flag_of_stall_still_shows_its_ripple() -> None:
    test = hidden("rotating_stall_ripple", **SHORT)
    d = diagnose([replace(record, in_stall=None) for record in series_of(test)], 3)
    assert d.names == ("rotating_stall_ripple",)
    frequency, gate = d.missing[0].parameters[1:]
    true = test.effects["rotating_stall_ripple"]
    assert frequency.value == pytest.approx(true["frequency_hz"], abs=0.05)
    assert gate.value == pytest.approx(true["phi_threshold"], abs=0.12)


def hummed(r: CoefficientSeries) -> CoefficientSeries:
    return replace(r, psi_p=r.psi_p + 4e-3 * np.sin(2.0 * np.pi * 31.0 * r.time_s))


def coarse(r: CoefficientSeries) -> CoefficientSeries:
    return replace(r, psi_p=0.025 * np.round(r.psi_p / 0.025))


@pytest.mark.parametrize(
    ("made", "effect", "why"),
    [(hummed, None, "weaker out of stall"), (coarse, "speed_droop", "readings of ψ' step by")],
)
def test_what_readings_make_themselves_stands_behind_no_firm_name(
    made: Callable[..., CoefficientSeries], effect: str | None, why: str
) -> None:
    d = diagnose([made(record) for record in series_of(hidden(effect, **SHORT))], 3)
    assert {why in " ".join(item.doubts) for item in d.missing} == {True}


@pytest.fixture
def records() -> Records:
    return series_of(hidden(None, seed=3, n_samples=300))


def marked(record: CoefficientSeries, rows: int) -> CoefficientSeries:
    return replace(record, segment=np.where(np.arange(300) < rows, 1, 0))


def at_half_the_rate(r: CoefficientSeries) -> CoefficientSeries:
    return replace(r, time_s=r.time_s[0] + 2.0 * (r.time_s - r.time_s[0]))


REFUSED: dict[str, Callable[[Records], Records]] = {
    "records of one sample rate, found none": lambda r: [],
    "one sample rate, found 100 Hz and 50 Hz": lambda r: [r[0], at_half_the_rate(r[1])],
    r"record-1\.csv: expected at least 60 rows to fit, found": lambda r: [marked(r[0], 70)],
    r"record-1\.csv: expected a segment of at least 15 rows": lambda r: [marked(r[0], 0), *r[1:]],
}


@pytest.mark.parametrize("why", REFUSED)
def test_records_that_hold_no_diagnosis_are_refused(why: str, records: Records) -> None:
    with pytest.raises(InputError, match=why):
        diagnose(REFUSED[why](records))


def test_a_degree_or_a_term_that_is_no_characteristic_is_refused(records: Records) -> None:
    with pytest.raises(InputError, match="degree: expected 1 to 8, found 9"):
        diagnose(records, 9)
    with pytest.raises(InputError, match=r"term sin\(phi\): expected 1, phi, phi\^2"):
        diagnose(records, terms=("1", "sin(phi)"))
