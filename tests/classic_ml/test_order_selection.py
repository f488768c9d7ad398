"""Selection of orders: the right one is found, for the right reason."""

from __future__ import annotations

import numpy as np
import pytest
from lag_data import PERIOD_S, TAU_S, flow, lagged
from scipy.signal import butter, lfilter, sosfiltfilt

from classic_ml.orders import select_order
from surge_core.errors import InputError

A = float(np.exp(-PERIOD_S / TAU_S))
TRUTHS = {
    "arx": ("arx", 0, [1.0]),
    "armax C1": ("armax", 1, [1.0, -0.6]),
    "armax C2": ("armax", 2, [1.0, -0.9, 0.5]),
    "output-error": ("output-error", 0, None),
}


def record(
    seed: int, c: list[float] | None, lag: int = 0, n_segments: int = 4, n: int = 400
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    X, y = [], []
    for _ in range(n_segments):
        phi = flow(n, rng)
        acting = np.concatenate([np.full(lag, phi[0]), phi[: n - lag]])
        noise = 0.002 * rng.standard_normal(n)
        error = noise if c is None else lfilter(c, [1.0, -A], noise)
        X.append(phi)
        y.append(lagged(acting, "first") + error)
    return np.concatenate(X)[:, None], np.concatenate(y), np.repeat(np.arange(n_segments), n)


@pytest.mark.parametrize("truth", TRUTHS)
def test_bic_finds_the_right_orders(truth: str) -> None:
    noise, order, c = TRUTHS[truth]
    right = 0
    n_seeds = 5
    for seed in range(n_seeds):
        lag = seed % 3
        X, y, labels = record(seed, c, lag, n=250)
        table = select_order(
            X, y, labels, sample_period_s=PERIOD_S, input_lags=(0, 1, 2), degrees=(2, 3)
        )
        best = table.rows[0]
        assert best.bic == 0.0
        found = (best.noise, best.noise_order, best.input_lag, best.degree)
        right += found == (noise, order, lag, 2)
        if table.recommended is best:
            assert "BIC holds" in table.reason
    # Twenty of twenty over the four truths: with 95 % confidence the rate is above 0.05**(1/20),
    # 86 %.
    assert right == n_seeds


def test_tau_of_the_recommended_row_is_right_and_equals_are_listed_with_it() -> None:
    X, y, labels = record(3, TRUTHS["armax C1"][2], lag=1)
    table = select_order(
        X,
        y,
        labels,
        sample_period_s=PERIOD_S,
        noise=("armax", "output-error"),
        input_lags=(0, 1),
        degrees=(2, 3),
    )
    best = table.recommended
    assert best.name == "armax C1, lag 1, degree 2"
    assert abs(best.time_constant_s - TAU_S) < 4 * best.time_constant_stderr_s
    assert best.white
    assert table.ties[0] is best
    # A cubic term or a second C is nothing more: some of those predict as well.
    assert len(table.ties) >= 2
    assert all(abs(r.held_out_rms - best.held_out_rms) <= r.paired_error for r in table.ties)
    wrong = next(r for r in table.rows if r.name == "armax C1, lag 0, degree 2")
    assert wrong.bic > best.bic + 10.0
    assert len(table.rows) == 12


def test_without_white_errors_the_later_cycles_decide() -> None:
    X, y, labels = record(5, None, n_segments=6, n=400)
    smooth = butter(3, 48.0, fs=1.0 / PERIOD_S, output="sos")
    for label in range(6):
        own = labels == label
        y[own] = sosfiltfilt(smooth, y[own])
        X[own, 0] = sosfiltfilt(smooth, X[own, 0])
    table = select_order(X, y, labels, sample_period_s=PERIOD_S, input_lags=(0,), degrees=(1, 2, 3))
    assert not table.rows[0].white
    assert "not white" in table.reason
    assert table.recommended.noise == "output-error"
    assert table.recommended.degree >= 2
    best = min(row.held_out_rms for row in table.rows)
    assert table.recommended.held_out_rms < 1.2 * best


def test_one_segment_is_parted_in_time() -> None:
    X, y, _ = record(6, [1.0], n_segments=1, n=1200)
    table = select_order(X, y, sample_period_s=PERIOD_S, noise=("arx",), input_lags=(0,))
    assert table.recommended.degree == 2
    assert abs(table.recommended.time_constant_s - TAU_S) < 4e-3
    assert table.recommended.held_out_rms < 0.1


@pytest.mark.parametrize(
    "options",
    [
        {"noise": ("white",)},
        {"input_lags": (-1,)},
        {"degrees": (21,)},
        {"degrees": ()},
        {"input_lags": (397,)},
    ],
)
def test_orders_that_cannot_be_compared_are_refused(options: dict[str, tuple[int, ...]]) -> None:
    X, y, labels = record(8, [1.0])
    with pytest.raises(InputError):
        select_order(X, y, labels, sample_period_s=PERIOD_S, **options)
