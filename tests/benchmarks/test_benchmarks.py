"""The benchmarks run, and what they measure with is right."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType
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
    and path.stem != "all"
]


@pytest.mark.parametrize("script", QUICK, ids=lambda path: path.stem)
def test_benchmark_runs(script: Path, tmp_path: Path) -> None:
    assert rows_of(script, tmp_path)


def test_peers_run_without_peers(tmp_path: Path) -> None:
    rows = rows_of(
        BENCHMARKS / "peers" / "run.py", tmp_path, "--peer", "LagRegressor", "--c", "-0.6"
    )
    assert [row["n_fits"] for row in rows] == [3]


def test_everything_in_one_table(tmp_path: Path) -> None:
    # The other two blocks take the longer part of half a minute.
    rows = rows_of(BENCHMARKS / "all.py", tmp_path, "--only", "sparse,reduction")
    first = {str(row["block"]): str(row["what"]) for row in reversed(rows)}
    assert [name.split(",")[0] for name in first.values()][::-1] == [
        "SparseLagRegressor",
        "reduce_record",
    ]
    for row in rows:
        # Ours and at least one peer in each block; what is no number says why.
        assert sum(other["block"] == row["block"] for other in rows) > 1
        why = row["why_not"]
        assert isinstance(why, dict)
        assert all(why.get(key) for key, value in row.items() if value is None)
        if first[str(row["block"])] == row["what"]:
            assert row["times_own"] == pytest.approx(1.0)
    script = [row for row in rows if "script" in str(row["what"])]
    assert script
    # Of the range of φ and ψ'; the script inverts Eq 3 by a table.
    assert all(0.0 < float(str(row["differs"])) < 1e-6 for row in script)
    sparse = [row for row in rows if row["block"] == "sparse"]
    assert sparse[0]["right_percent"] == 100.0
    # Unbiased, no estimate is better than the bound by more than chance.
    assert all(float(str(row["efficiency"])) < 1.1 for row in sparse)


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


@pytest.fixture
def gathered(peers: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(BENCHMARKS))


N_BOUND, NOISE_BOUND = 80, 0.03


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
def made(gathered: None) -> Any:
    from surge_truths import TAU_S, Record, Simulated

    phi = 0.2 + 0.25 * np.sin(2 * np.pi * 6.0 * 1e-3 * np.arange(N_BOUND))
    psi_p = flow_and_response(TAU_S, BETA_BOUND, phi, 0.5)
    return Simulated(Record(phi, psi_p), phi, psi_p)


BETA_BOUND = np.array([0.35, 1.2, -1.9])
TERMS_BOUND = dict(zip(("1", "phi", "phi^2"), BETA_BOUND, strict=True))


def test_bound_with_noise_on_the_flow_is_that_of_all_unknowns(made: Any) -> None:
    from gathered.noisy_flow_bound import tau_bound
    from surge_truths import TAU_S

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
    from gathered.noisy_flow_bound import tau_bound
    from surge_truths import Record

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


def test_a_number_that_is_not_there_has_its_reason(gathered: None) -> None:
    from gathered.table import COLUMNS, Line, Notes, absent, printed

    cells = absent("no such thing") | {"floats": float("nan"), "efficiency": (0.5, float("nan"))}
    line, notes = Line("ml", "somebody", 0, cells), Notes()
    text = printed(line, notes)
    assert text.split().count("-") == len(COLUMNS)
    assert "no such thing" in notes.text()
    assert "too few records" in notes.text()
    row = line.numbers()
    assert row["floats"] is None
    assert row["efficiency"] == 0.5
    with pytest.raises(KeyError):
        printed(Line("ml", "somebody", 1, {}), Notes())


def test_a_peer_that_is_not_installed_is_a_line_of_the_table(
    gathered: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import environments
    from gathered import ml

    monkeypatch.setattr(environments, "VENVS", tmp_path / "none")
    peers = tuple(peer for peer in ml.PEERS if peer.environment in (None, "sippy"))
    monkeypatch.setattr(ml, "PEERS", peers)
    monkeypatch.setattr(ml, "QUICK", (ml.Setting(200, 1, 2, 2.0),))
    lines = {line.what: line for line in ml.lines(True, None)}
    assert "not installed" in str(lines["SIPPY ILLS, N = 200"].cells["times_own"])
    for name in ("LagRegressor, N = 200", "scipy least_squares, N = 200"):
        assert lines[name].n == 2
    # Both minimise the same sum of squares.
    values = [line.cells["error_over_bound"] for line in lines.values() if line.n]
    assert values[0] == pytest.approx(values[1], rel=0.1)
