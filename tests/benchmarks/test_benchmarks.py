"""The benchmarks run, and what they measure with is right."""

from __future__ import annotations

import inspect
import itertools
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
# The others take their time and have no short setting.
QUICK = [
    path
    for path in sorted(BENCHMARKS.glob("*.py"))
    if all(option in path.read_text("utf-8") for option in ("--quick", "--json"))
]


@pytest.fixture
def benchmarks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(BENCHMARKS))


@pytest.mark.parametrize("script", QUICK, ids=lambda path: path.stem)
def test_benchmark_runs(script: Path, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, str(script), "--quick", "--json", "rows.json"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr
    rows: list[dict[str, Any]] = json.loads((tmp_path / "rows.json").read_text("utf-8"))
    assert rows
    if script.stem == "peers":
        script_rows = [row for row in rows if "script" in row["what"]]
        # Of the range of φ and ψ'; the script inverts Eq 3 by a table.
        assert script_rows
        assert all(0.0 < row["differs"] < 1e-6 for row in script_rows)


def test_the_systems_can_hide_what_the_benchmark_hides_in_them(benchmarks: None) -> None:
    import hidden_in_systems
    import system_truths

    for name, (kind, hidden, _) in hidden_in_systems.CASES.items():
        known = inspect.signature(getattr(system_truths, kind)).parameters
        assert set(hidden) <= set(known), name


@pytest.mark.parametrize("c", [-0.6, 0.0, 0.5])
def test_one_step_estimate_attains_the_bound(benchmarks: None, c: float) -> None:
    from lag_problem import simulate

    # The score, made from the errors themselves, has the information as its covariance only if
    # the bound's closed form for what the errors add to the information is right.
    n_records = 400
    ratios = []
    for seed in range(n_records):
        bound, one_step = simulate(1500, seed, c).bound()
        ratios.append(one_step / bound)
    squares = np.square(ratios)
    se = squares.std(axis=0, ddof=1) / np.sqrt(n_records)
    assert np.all(np.abs(squares.mean(axis=0) - 1.0) < 4.0 * se)


def test_paired_control_keeps_the_mean_and_cuts_its_error(benchmarks: None) -> None:
    from peers import efficiency

    rng = np.random.default_rng(0)
    control = rng.standard_normal(2000)
    error = control + 0.5 * rng.standard_normal(2000)
    value, se = efficiency(error, control)
    plain, plain_se = efficiency(error)
    assert abs(value - 0.8) < 4.0 * se
    assert abs(plain - 0.8) < 4.0 * plain_se
    assert se < 0.8 * plain_se


N_BOUND, NOISE_BOUND = 80, 0.03
BETA_BOUND = np.array([0.35, 1.2, -1.9])
TERMS_BOUND = dict(zip(("1", "phi", "phi^2"), BETA_BOUND, strict=True))


def flow_and_response(tau_s: float, beta: FloatArray, phi: FloatArray, start: float) -> FloatArray:
    """ψ' of a parabola, φ joined by straight lines, by the formula of one step."""
    x = 1e-3 / tau_s
    p, curve = np.exp(-x), np.polynomial.polynomial.polyval(phi, beta)
    psi_p = [start]
    for f, g in itertools.pairwise(curve):
        # g + (g - f)(t/h - 1) - (g - f) τ/h is a solution of the equation on this line.
        psi_p.append(g - (g - f) / x + p * (psi_p[-1] - f + (g - f) / x))
    return np.array(psi_p)


@pytest.fixture
def made(benchmarks: None) -> Any:
    from surge_truths import TAU_S, Record, Simulated

    phi = 0.2 + 0.25 * np.sin(2 * np.pi * 6.0 * 1e-3 * np.arange(N_BOUND))
    psi_p = flow_and_response(TAU_S, BETA_BOUND, phi, 0.5)
    return Simulated(Record(phi, psi_p), phi, psi_p)


def test_bound_with_noise_on_the_flow_is_that_of_all_unknowns(made: Any) -> None:
    from surge_truths import TAU_S, tau_bound

    # The whole problem, nothing eliminated: τ, β, the start and every true φ are unknown.
    def measured(unknown: FloatArray) -> FloatArray:
        phi = unknown[5:]
        return np.concatenate((flow_and_response(unknown[0], unknown[1:4], phi, unknown[4]), phi))

    truth = np.concatenate(([TAU_S], BETA_BOUND, [0.5], made.phi))
    steps = np.where(np.arange(truth.size) == 0, 1e-7, 1e-5)
    slopes = np.column_stack(
        [(measured(truth + d) - measured(truth - d)) / (2.0 * d.sum()) for d in np.diag(steps)]
    )
    sigma = NOISE_BOUND * np.repeat([made.psi_p.std(), made.phi.std()], N_BOUND)
    weighed = slopes / sigma[:, None]
    scale = np.linalg.norm(weighed, axis=0)
    covariance = np.linalg.inv((weighed / scale).T @ (weighed / scale))
    expected = np.sqrt(covariance[0, 0]) / scale[0]
    assert tau_bound(TERMS_BOUND, made, NOISE_BOUND).stderr_s == pytest.approx(expected, rel=1e-4)


def test_one_step_estimate_attains_the_bound_with_noise_on_the_flow(made: Any) -> None:
    from surge_truths import Record, tau_bound

    rng = np.random.default_rng(3)
    n_records = 600
    squares = []
    for _ in range(n_records):
        off = NOISE_BOUND * rng.standard_normal((2, N_BOUND))
        noisy = Record(made.phi + made.phi.std() * off[0], made.psi_p + made.psi_p.std() * off[1])
        bound = tau_bound(TERMS_BOUND, replace(made, measured=noisy), NOISE_BOUND)
        squares.append((bound.one_step_s / bound.stderr_s) ** 2)
    se = np.std(squares, ddof=1) / np.sqrt(n_records)
    assert abs(np.mean(squares) - 1.0) < 4.0 * se
