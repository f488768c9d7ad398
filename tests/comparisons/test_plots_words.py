"""What is said below the pictures: the numbers are those of the signals."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest
from comparison_data import made_comparison, made_series
from made_diagnosis import made_diagnosis
from raw_data import make_test

from classic_ml.reduction import Reduction, reduce_record
from classic_ml.series import CoefficientSeries
from comparisons.harness.reconstruction import reconstruct_record
from comparisons.missing_effect.shown import contributions, steady_curves, where_of
from comparisons.results import Truth
from comparisons.show.plots_fit_words import (
    characteristics_words,
    reconstruction_words,
    residual_structure_words,
    residuals_words,
    validation_words,
)
from comparisons.show.plots_missing_effect_words import (
    characteristics_words as diagnosis_curve_words,
)
from comparisons.show.plots_missing_effect_words import (
    contributions_words,
    diagnosis_words,
    spectra_words,
)
from comparisons.show.plots_record_words import (
    hub_and_tip_words,
    inlet_spectra_words,
    loops_words,
    operating_points_words,
    series_words,
    surge_cycles_words,
)

RATE_HZ = 1000.0


def swinging(lag_s: float, slope: float = 2.0, surge_hz: float = 5.0) -> CoefficientSeries:
    """ψ' of a straight characteristic behind an exact lag, once its start is forgotten."""
    time_s = np.arange(4000) / RATE_HZ
    omega = 2.0 * np.pi * surge_hz
    phi = 0.1 + 0.08 * np.sin(omega * time_s)
    gain, delay = 1.0 / np.hypot(1.0, omega * lag_s), np.arctan(omega * lag_s)
    psi_p = 1.0 + slope * (0.1 + 0.08 * gain * np.sin(omega * time_s - delay))
    return CoefficientSeries(time_s, phi, psi_p, np.ones(4000, dtype=np.int64), source="s.csv")


def numbers(text: str) -> list[float]:
    return [float(found) for found in re.findall(r"(?<![\w.])[-+]?\d+(?:\.\d+)?", text)]


@pytest.mark.parametrize("surge_hz", [3.0, 5.0, 11.0])
def test_a_cycle_takes_as_long_as_it_was_made(surge_hz: float) -> None:
    words = series_words(swinging(0.02, surge_hz=surge_hz))
    told = float(re.search(r"A cycle takes ([\d.]+) ms", words).group(1))  # type: ignore[union-attr]
    assert told == pytest.approx(1e3 / surge_hz, rel=0.01)
    assert "φ 0.0200 to 0.180" in words
    assert "100 % of these rows" in words


@pytest.mark.parametrize(("slope", "way"), [(2.0, "falls"), (-2.0, "rises")])
def test_a_loop_is_as_wide_as_its_lag_makes_it(slope: float, way: str) -> None:
    lag_s, omega = 0.02, 2.0 * np.pi * 5.0
    words = loops_words(swinging(lag_s, slope))
    found = re.search(r"widest at φ = ([\d.]+): ψ' is ([\d.]+) higher there while φ (\w+)", words)
    assert found is not None
    # At the middle of the swing the two branches lie 2 · 0.08 |slope| ωτ / (1 + (ωτ)²) apart.
    apart = 0.16 * abs(slope) * omega * lag_s / (1.0 + (omega * lag_s) ** 2)
    assert float(found.group(2)) == pytest.approx(apart, rel=0.05)
    assert float(found.group(1)) == pytest.approx(0.1, abs=0.03)
    assert found.group(3) == way


def test_without_a_lag_no_loop_is_open() -> None:
    assert loops_words(swinging(0.0)).endswith("No loop is open.")


@pytest.fixture(scope="module")
def reduction() -> Reduction:
    return reduce_record(*make_test(cells_lbm_s=8.0, noise_counts=1.5).load())


def test_a_reduction_is_told_by_its_own_channels(reduction: Reduction) -> None:
    record = reduction.record
    keep = (record.time_s >= reduction.window_s[0]) & (record.time_s <= reduction.window_s[1])
    flow = record["Wc25_kg_s"][keep]
    for words in (operating_points_words(reduction), surge_cycles_words(reduction)):
        found = re.findall(r"flow (-?[\d.]+) to (-?[\d.]+) kg/s", words)[-1]
        assert [float(end) for end in found] == pytest.approx([flow.min(), flow.max()], rel=0.01)
    told = re.search(r"A cycle takes ([\d.]+) ms", surge_cycles_words(reduction))
    crossings = np.count_nonzero(np.diff(np.sign(flow - flow.mean())) > 0)
    assert told is not None
    window_ms = 1e3 * (reduction.window_s[1] - reduction.window_s[0])
    assert float(told.group(1)) == pytest.approx(window_ms / crossings, rel=0.1)
    for place in ("tip", "hub"):
        share = 100.0 * np.mean(record[f"Wc25_{place}_kg_s"][keep] < 0.0)
        found = re.search(
            rf"{place} -?[\d.]+ to [^;]*reversed (\d+) %", hub_and_tip_words(reduction)
        )  # type: ignore[assignment]
        assert float(found.group(1)) == pytest.approx(share, abs=0.51)  # type: ignore[attr-defined]
    spectra = inlet_spectra_words(reduction)
    changes = [float(db) for db in re.findall(r"by ([-+][\d.]+) dB", spectra)]
    assert len(changes) == 2
    assert all(change < -15.0 for change in changes)


def test_a_comparison_is_told_by_its_errors() -> None:
    fit = made_comparison()
    rows = fit.rows
    for words, part in (
        (residuals_words(fit), "reconstruction"),
        (reconstruction_words(fit), "trained"),
    ):
        for result in fit.results:
            error = rows.measured - getattr(result, part)
            rms = float(np.sqrt(np.mean(error**2)))
            told = words.split(result.label, 1)[1]
            assert numbers(told)[0] == pytest.approx(rms, rel=0.06)
    best = fit.result(fit.table[0].estimator)
    at = int(np.argmax(np.abs(rows.measured - best.trained)))
    assert f"part most at {rows.time_s[at]:.2f} s" in reconstruction_words(fit)
    truth = Truth(0.018, np.linspace(-1, 1, 50), np.linspace(-1, 1, 50), "truth")
    curves = characteristics_words(fit, truth)
    low, high = fit.valid_phi
    assert f"φ = {low:.3f} and φ = {high:.3f}" in curves
    assert curves.rstrip(".").endswith(f"truth {low:#.3g} and {high:#.3g}")
    assert "of its lags outside the band" in residual_structure_words(fit)


def test_a_fit_that_was_refused_is_told_without_numbers() -> None:
    fit = made_comparison()
    lost = np.full(fit.rows.phi.size, np.nan)
    refused = dataclasses.replace(
        fit.results[0], reconstruction=lost, trained=lost, errors_one_step=lost
    )
    fit = dataclasses.replace(fit, results=(refused, *fit.results[1:]))
    with np.errstate(invalid="ignore"):
        for words in (residuals_words(fit), reconstruction_words(fit)):
            assert "nan" not in words
            assert "n/a" in words


def test_a_validation_says_how_far_phi_went_beyond() -> None:
    model = made_comparison().results[0].model
    run = reconstruct_record(model, made_series(5, "other.csv"))
    words = validation_words((run,))
    assert f"In {100.0 * run.outside:.0f} % of the rows" in words
    assert "other.csv" in words
    assert numbers(words.split("rms", 1)[1])[0] == pytest.approx(run.score.rms, rel=0.06)


@pytest.mark.parametrize("verdict", ["named", "alias_set", "nothing_missing"])
def test_a_diagnosis_is_told_by_its_gap_and_curves(verdict: str) -> None:
    d = made_diagnosis(verdict)
    told = numbers(diagnosis_words(d).split("rms of ψ'", 1)[1])
    assert told[0] == pytest.approx(d.gap.before_rms, rel=0.01)
    before, after = where_of(d, d.before), where_of(d, d.after)
    largest = max(row.ratio for row in before.frequency)
    assert f"{largest:.3g} times" in spectra_words(before, after if d.missing else None)
    words = diagnosis_curve_words(d)
    old = steady_curves(d.before, d.data)[0]
    assert f"{old.value[0]:.3g} to {old.value[-1]:.3g}" in words
    if not d.missing:
        assert "nothing was added" in words
        return
    for part in contributions(d):
        assert f"{part.effect} rms {part.rms:.3g}" in contributions_words(d)
