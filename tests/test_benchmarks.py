"""The benchmarks run, and what they measure with is right."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
# The others take their time and have no short setting.
QUICK = [
    path
    for path in sorted(BENCHMARKS.glob("*.py"))
    if all(option in path.read_text("utf-8") for option in ("--quick", "--json"))
]


@pytest.mark.parametrize("script", QUICK, ids=lambda path: path.stem)
def test_benchmark_runs(script: Path, tmp_path: Path) -> None:
    assert rows_of(script, tmp_path)


def test_peers_run_without_peers(tmp_path: Path) -> None:
    rows = rows_of(
        BENCHMARKS / "peers" / "run.py", tmp_path, "--peer", "LagRegressor", "--c", "-0.6"
    )
    assert [row["n_fits"] for row in rows] == [3]


def rows_of(script: Path, folder: Path, *options: str) -> list[dict[str, object]]:
    done = subprocess.run(
        [sys.executable, "-W", "error", str(script), "--quick", "--json", "rows.json", *options],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()
    rows: list[dict[str, object]] = json.loads((folder / "rows.json").read_text("utf-8"))
    return rows


@pytest.fixture
def peers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(BENCHMARKS / "peers"))


@pytest.fixture
def run(peers: None) -> ModuleType:
    import run

    return run


@pytest.mark.parametrize(
    ("error", "c"), [("armax", -0.6), ("armax", 0.5), ("arx", 0.0), ("output-error", 0.0)]
)
def test_one_step_estimate_attains_the_bound(peers: None, error: str, c: float) -> None:
    from lag_problem import Problem

    # The score, made from the errors themselves, has the information as its covariance only if
    # the bound's closed form for what the errors add to the information is right.
    n_records = 400
    ratios = []
    for seed in range(n_records):
        bound, one_step = Problem(error, c).record(1500, seed).bound()  # type: ignore[arg-type]
        ratios.append(one_step / bound)
    squares = np.square(ratios)
    se = squares.std(axis=0, ddof=1) / np.sqrt(n_records)
    assert np.all(np.abs(squares.mean(axis=0) - 1.0) < 4.0 * se)


def test_record_obeys_its_equation(peers: None) -> None:
    from lag_problem import BETA, Problem

    problem = Problem("armax", -0.6)
    record = problem.record(300, seed=3)
    curve = np.polynomial.polynomial.polyval(record.phi, BETA)
    for k in range(299):
        expected = problem.a * record.y[k] + (1.0 - problem.a) * curve[k]
        expected += record.e[k + 1] - 0.6 * record.e[k]
        assert record.y[k + 1] == pytest.approx(expected, abs=1e-12)


def test_paired_control_keeps_the_mean_and_cuts_its_error(peers: None) -> None:
    from efficiency import coverage, efficiency

    rng = np.random.default_rng(0)
    control = rng.standard_normal(2000)
    error = control + 0.5 * rng.standard_normal(2000)
    value, se = efficiency(error, control)
    plain, plain_se = efficiency(error)
    assert abs(value - 0.8) < 4.0 * se
    assert abs(plain - 0.8) < 4.0 * plain_se
    assert se < 0.8 * plain_se
    holds = (np.abs(error) < 1.959964 * np.sqrt(1.25)).astype(np.float64)
    share, share_se = coverage(holds, control)
    assert abs(share - 0.95) < 4.0 * share_se
    assert share_se < 0.9 * holds.std() / np.sqrt(2000)


def test_a_peer_that_fails_is_a_row_with_its_reason(
    run: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import environments

    monkeypatch.setattr(environments, "VENVS", tmp_path / "none")
    records = run.Records.simulate(0.0, 60, 2)
    file = tmp_path / "records.npz"
    np.savez(file, phi=records.phi, y=records.y)
    broken = tmp_path / "broken.py"
    broken.write_text("raise RuntimeError('no such backend')\n")
    for peer, reason in (
        (run.Peer("absent", "fit_sippy_opt.py", "sippy"), "not installed"),
        (run.Peer("broken", str(broken), None), "RuntimeError: no such backend"),
    ):
        got = run.run_peer(peer, file, 2, cap_s=5.0)
        row = run.compare(peer, records, got, got)
        assert reason in row.note
        assert row.n_fits == 0
        assert reason in run.line(row)


def test_a_fit_that_leaves_the_process_costs_its_own_record_alone(
    run: ModuleType, tmp_path: Path
) -> None:
    records = run.Records.simulate(0.0, 60, 3)
    file = tmp_path / "records.npz"
    np.savez(file, phi=records.phi, y=records.y)
    script = tmp_path / "leaves.py"
    script.write_text(
        f"import sys\nsys.path.insert(0, {str(BENCHMARKS / 'peers')!r})\n"
        "from worker import serve\n"
        f"second = {float(records.y[1, 0])!r}\n"
        "def fit(phi, y):\n"
        "    if y[0] == second:\n"
        "        sys.exit('bad argument')\n"
        "    return [0.02, 0.3, 1.2, -1.5]\n"
        "serve(fit)\n"
    )
    got = run.run_peer(run.Peer("leaves", str(script), None), file, 3, cap_s=5.0)
    assert np.isfinite(got.parameters[:, 0]).tolist() == [True, False, True]
    assert got.cpu_s.size == 2
    assert "1 of 3 fits failed: SystemExit: bad argument" in got.note
