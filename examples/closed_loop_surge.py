"""Discover a surge model that runs by itself from a few noisy cycles, and let it run.

A compressor behind a lag feeds a plenum through a duct, and the plenum empties through a throttle
(Greitzer's model with the characteristic of Moore and Greitzer). Flow, compressor pressure and
plenum pressure are measured with 1.5 % noise; once more, the plenum pressure is not.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from sindy_surge.closed_loop import SurgeModel, discover_surge_model

PERIOD_S = 1e-3
DUCT_PER_S, PLENUM_PER_S, THROTTLE, TAU_S = 125.0, 21.7, 0.4, 0.018


def characteristic(phi: float) -> float:
    z = phi / 0.25 - 1
    return 0.3 + 0.18 * (1 + 1.5 * z - 0.5 * z**3)


def surge(_: float, state: np.ndarray) -> list[float]:
    phi, psi_p, plenum = state
    through = THROTTLE * np.copysign(np.sqrt(abs(plenum)), plenum)
    return [
        DUCT_PER_S * (psi_p - plenum),
        (characteristic(phi) - psi_p) / TAU_S,
        PLENUM_PER_S * (phi - through),
    ]


def measure(seed: int, n_samples: int = 2500) -> np.ndarray:
    times = 0.7 + np.arange(n_samples) * PERIOD_S
    clean = solve_ivp(surge, (0, times[-1]), [0.4, 0.5, 0.6], t_eval=times, rtol=1e-9, atol=1e-9)
    noise = np.random.default_rng(seed).standard_normal(clean.y.shape)
    return (clean.y + 0.015 * clean.y.std(axis=1, keepdims=True) * noise).T


def show(title: str, model: SurgeModel) -> None:
    print(title)
    for equation in model.equations():
        print("   ", equation)
    print(f"    {model.state}: {model.state.advice}")
    print(f"    {'quantity':<18} {'measured':>9} {'simulated':>10} {'difference':>11}")
    for row in model.cycle_rows():
        print(
            f"    {row.quantity:<18} {row.measured:9.4f} {row.simulated:10.4f}"
            f" {100 * row.difference:9.2f} %"
        )


def plot(record: np.ndarray, model: SurgeModel, path: Path) -> None:
    from matplotlib.figure import Figure

    n_samples = int(10 * model.period_s / PERIOD_S)
    simulated = model.simulate(n_samples=n_samples)
    times = np.arange(n_samples) * PERIOD_S
    figure = Figure(figsize=(11, 5), layout="constrained")
    panels = figure.subplot_mosaic(
        [["loop", name] for name in ("φ", "ψ'", "Ψ")], width_ratios=(2, 3)
    )
    loop = panels["loop"]
    loop.plot(record[:, 0], record[:, 1], ".", color="0.65", ms=3, label="measured")
    loop.plot(simulated[:, 0], simulated[:, 1], color="C0", lw=1, label="simulated, ten cycles")
    loop.set(xlabel="φ", ylabel="ψ'")
    for column, name in enumerate(("φ", "ψ'", "Ψ")):
        axes = panels[name]
        axes.plot(times, record[:n_samples, column], ".", color="0.65", ms=3)
        axes.plot(times, simulated[:, column], color="C0", lw=1)
        axes.set_ylabel(name)
        axes.tick_params(labelbottom=name == "Ψ")
    panels["Ψ"].set_xlabel("time, s")
    figure.align_ylabels([panels[name] for name in ("φ", "ψ'", "Ψ")])
    figure.legend(*loop.get_legend_handles_labels(), loc="outside upper center", ncols=2)
    figure.savefig(path, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw loop and traces")
    arguments = parser.parse_args()
    record = measure(seed=0)
    phi, psi_p, plenum = record.T
    model = discover_surge_model(phi, psi_p, plenum, PERIOD_S)
    show("Plenum pressure measured:", model)
    hidden = discover_surge_model(phi, psi_p, None, PERIOD_S)
    show("φ and ψ' alone, the plenum a hidden state:", hidden)
    if arguments.plot:
        plot(record, model, arguments.plot)


if __name__ == "__main__":
    main()
