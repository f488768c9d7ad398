"""Discover a surge loop from noisy φ, ψ' and plenum pressure, and move its throttle.

A compressor with a stalled and an unstalled branch feeds a plenum through a duct, and the plenum
empties through a throttle (Greitzer's model with a lag). All three channels have 2 % noise.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from sindy_surge import SurgeLoop, discover_loop

STEP_S = 1e-3


def surge_test(seed: int, n_rows: int = 4000, parts: int = 10) -> np.ndarray:
    """Measure φ, ψ' and Ψ: branches with hysteresis at φ = 0.22 and 0.25, τ = 18 ms."""
    x, stalled, rows = np.array([0.1, 0.3, 0.3]), True, []
    for k in range((n_rows + 500) * parts):
        if k % parts == 0:
            rows.append(x)
        phi, psi_p, plenum = x
        curve = 0.22 + 3.5 * phi**2 if stalled else 0.8 - 4 * (phi - 0.35) ** 2
        outflow = 0.3 * np.copysign(np.sqrt(abs(plenum)), plenum)
        rate = [120 * (psi_p - plenum), (curve - psi_p) / 0.018, 10 * (phi - outflow)]
        x = x + STEP_S / parts * np.array(rate)
        stalled = x[0] < 0.25 if stalled else x[0] <= 0.22
    clean = np.array(rows[500:])
    return clean + 0.02 * clean.std(axis=0) * np.random.default_rng(seed).normal(size=clean.shape)


def draw(record: np.ndarray, loop: SurgeLoop, path: Path) -> None:
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.plot(record[:, 0], record[:, 1], ".", color="0.7", ms=2, label="measured, 2 % noise")
    simulated = loop.simulate()[2 * round(loop.period_s / STEP_S) :]
    left.plot(simulated[:, 0], simulated[:, 1], color="C0", lw=1, label="discovered, simulated")
    for branch, colour in zip(loop.lag.branches, ("C3", "C2"), strict=True):
        recover, stall = loop.lag.levels
        stalled = branch.name == "stalled"
        phi = np.linspace(*((-0.3, recover) if stalled else (stall, 0.8)), 100)
        left.plot(phi, branch(phi), "--", color=colour, label=f"{branch.name} branch")
    left.set(xlabel="φ", ylabel="ψ'", title="The loop, and the curves behind it")
    left.legend(frameon=False, fontsize=8)

    limit, at = loop.surge_line()
    openings = np.geomspace(0.8 * limit, 1.6 * limit, 25)
    points = [loop.operating_point(opening) for opening in openings]
    flows = np.array([state[0] for state, _ in points])
    swing = []
    for opening, (state, _) in zip(openings, points, strict=True):
        start = state + np.array([0.01, 0.0, 0.0])
        late = loop.simulate(start, np.arange(0.0, 3.0, STEP_S), throttle=opening)[-1500:, 0]
        swing.append((late.min(), late.max()))
    right.fill_between(openings, *np.array(swing).T, color="C0", alpha=0.2, label="swing of φ")
    right.plot(openings, flows, color="C2", label="steady flow")
    right.axvline(limit, color="C3", ls="--", label=f"surge line: φ = {at[0]:.3f}")
    right.axvline(1.0, color="0.5", ls=":", label="throttle of the record")
    right.set(xlabel="throttle opening over that of the record", ylabel="φ")
    right.set_title("The throttle moved")
    right.legend(frameon=False, fontsize=8)
    figure.savefig(path, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plot", type=Path, default="discover_surge.png", metavar="FILE")
    arguments = parser.parse_args()
    record = surge_test(seed=0)
    loop = discover_loop(*record.T, STEP_S)
    print("\n".join(loop.equations()))
    tau, error = loop.lag.time_constant_s, loop.lag.time_constant_stderr_s
    print(f"τ = {1e3 * tau:.2f} ± {1e3 * error:.2f} ms (18 ms)")
    for name, level, sigma in zip(
        ("up through", "down through"), loop.lag.levels, loop.lag.levels_stderr, strict=False
    ):
        print(f"{name} φ = {level:.4f} ± {sigma:.4f}")
    print(f"period {loop.period_s:.4f} s, measured {loop.measured_cycles.period_s:.4f} s")
    print(f"{loop.state}: {loop.state.advice}")
    limit, at = loop.surge_line()
    print(f"surge line: opening {limit:.3f} of the record's, φ = {at[0]:.3f}, ψ' = {at[1]:.3f}")
    draw(record, loop, arguments.plot)


if __name__ == "__main__":
    main()
