from __future__ import annotations

import numpy as np
import pytest

from sindy_surge import InputError
from sindy_surge.free_run import driven, run_lag, simulate
from sindy_surge.segments import Segments
from surge_core.lag import FirstOrderLag

PERIOD_S = 1e-3


def test_segments_run_alone() -> None:
    forcing = np.random.default_rng(1).standard_normal(60)
    runs = Segments.from_labels(np.repeat([4, 2, 4], [10, 1, 49]), 60)
    lag = FirstOrderLag(0.01, PERIOD_S, "first")
    start = np.array([1.0, 2.0, 3.0])
    joint = simulate(forcing, runs, lag, start)
    for number, rows in enumerate(runs.slices()):
        whole = Segments.from_labels(None, rows.stop - rows.start)
        alone = simulate(forcing[rows], whole, lag, start[number : number + 1])
        np.testing.assert_allclose(joint[rows], alone, rtol=1e-14)
    assert runs.lengths.tolist() == [10, 1, 49]
    assert set(range(60)) - set(runs.later.tolist()) == {0, 10, 11}


@pytest.mark.parametrize(
    "labels", [np.zeros(4), np.zeros((5, 1)), np.full(5, 0.5), np.full(5, np.nan), ["a"] * 5]
)
def test_bad_labels_are_refused(labels: object) -> None:
    with pytest.raises(InputError, match="segments"):
        Segments.from_labels(labels, 5)  # type: ignore[arg-type]


@pytest.mark.parametrize("hold", ["first", "zero"])
@pytest.mark.parametrize("samples", [-2.5, -1.0, -0.3, 0.0, 0.4, 1.0, 2.75])
def test_dead_time_equals_a_shifted_input(hold: str, samples: float) -> None:
    tau, fine = 0.018, 400
    forcing = np.random.default_rng(2).standard_normal(60)
    # The held input on a fine grid, shifted there, run with tiny steps.
    at = np.arange(59 * fine + 1) / fine
    held = np.interp(at, np.arange(60), forcing) if hold == "first" else forcing[at.astype(int)]
    shifted = np.roll(held, round(samples * fine))
    decay = np.exp(-PERIOD_S / fine / tau)
    state, path = 0.0, [0.0]
    for k in range(10 * fine, 50 * fine):
        mean = 0.5 * (shifted[k] + shifted[k + 1]) if hold == "first" else shifted[k]
        state = decay * state + (1 - decay) * mean
        path.append(state)
    lag = FirstOrderLag(tau, PERIOD_S, hold, samples * PERIOD_S)  # type: ignore[arg-type]
    drive = driven(lag, forcing, np.arange(10, 51))
    mine = run_lag(drive, Segments(np.array([0]), np.array([41])), lag.a)
    np.testing.assert_allclose(mine, path[::fine], atol=2e-5 if hold == "first" else 1e-9)
    assert lag.taps[0].sum() == pytest.approx(1 - lag.a)


@pytest.mark.parametrize("hold", ["first", "zero"])
@pytest.mark.parametrize("samples", [-1.3, 0.03, 0.9])
def test_sensitivities_are_the_derivatives(hold: str, samples: float) -> None:
    forcing, rows = np.random.default_rng(3).standard_normal(40), np.arange(10, 30)

    def drive(tau: float, dead: float, by: int = 0) -> np.ndarray:
        lag = FirstOrderLag(tau, PERIOD_S, hold, dead * PERIOD_S)  # type: ignore[arg-type]
        return driven(lag, forcing, rows, by)

    for by, step in ((1, (1e-6, 0.0)), (2, (0.0, 1e-4))):
        above = drive(0.018 * np.exp(step[0]), samples + step[1])
        below = drive(0.018 * np.exp(-step[0]), samples - step[1])
        slope = (above - below) / (2 * sum(step))
        np.testing.assert_allclose(drive(0.018, samples, by), slope, rtol=1e-3, atol=1e-6)
