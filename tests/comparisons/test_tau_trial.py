"""τ by trial: the least error is at the true τ, the floor at the noise; and how a user writes τ."""

from __future__ import annotations

from argparse import ArgumentTypeError

import numpy as np
import pytest
from comparison_data import fit_rows
from lag_data import TAU_S, flow, lagged

from comparisons.cli.options import time_constant
from comparisons.harness.tau_trial import reconstruction_error_over_tau, trial_taus
from comparisons.results import FitRows, TauTrial


def rows_of(seed: int, noise: float = 0.003, n: int = 2400) -> FitRows:
    rng = np.random.default_rng(seed)
    phi = flow(n, rng)
    return fit_rows(phi, lagged(phi, "first") + noise * rng.standard_normal(n))


def trial_over(rows: FitRows, taus_s: list[float], **options: object) -> TauTrial:
    terms = np.vander(rows.phi, 3, increasing=True)
    return reconstruction_error_over_tau(rows, terms, np.asarray(taus_s), **options)


def test_the_least_error_is_at_the_true_tau_and_at_the_noise() -> None:
    found, inside, noise = [], 0, []
    for seed in range(12):
        trial = trial_over(rows_of(seed), trial_taus(TAU_S))
        found.append(trial.best_tau_s)
        inside += trial.interval_s[0] <= TAU_S <= trial.interval_s[1]
        noise.append(trial.least_rms)
    assert np.mean(found) == pytest.approx(TAU_S, abs=4 * np.std(found) / np.sqrt(12))
    assert np.std(found) < 0.02 * TAU_S
    assert inside >= 11
    np.testing.assert_allclose(np.mean(noise), 0.003, rtol=0.02)


def test_rows_that_do_not_count_are_simulated_through() -> None:
    rows = rows_of(2, noise=0.0)
    bad = rows.measured.copy()
    bad[900:960] += 3.0
    keep = np.ones(2400, dtype=np.bool_)
    keep[900:960] = False
    spoilt = FitRows(rows.phi, bad, *list(vars(rows).values())[2:])
    trial = trial_over(spoilt, [0.015, TAU_S, 0.022], scored=keep)
    assert trial.least_rms < 1e-12
    assert trial.best_tau_s == pytest.approx(TAU_S, rel=0.03)


@pytest.mark.parametrize("text", ["0.018", "18ms", " 18 ms ", "1.8e-2s", "18000us"])
def test_a_time_constant_is_read_in_seconds_or_with_its_unit(text: str) -> None:
    assert time_constant(text) == pytest.approx(0.018)


@pytest.mark.parametrize("text", ["18", "0", "-0.018", "nan", "18 min", "1.2.3ms", "", "20000ms"])
def test_what_is_no_time_constant_is_refused_in_one_sentence(text: str) -> None:
    with pytest.raises(ArgumentTypeError, match="a time constant such as 18ms") as error:
        time_constant(text)
    assert ("write 18ms" in str(error.value)) is (text == "18")
