"""Exact equations of surge loops and other systems from noisy states, over seeds.

Three trajectories of 2 000 rows, or one N-th of these N steps apart, from random starts;
noise as a share of each state's rms. A cell counts the seeds on which the support of every
equation is exact, gives the median error of the coefficients, the time, and beside it pysindy with
the best of its optimizers and thresholds, picked with the truth at hand. On a miss it says what
lacked: "search" where the true support scores better than what was found, "data" where it does
not.

`lorenz_odr_bindy` is the Lorenz case of ODR-BINDy (Fung 2025, arXiv 2507.23426, Lorenz_heatmap.m):
one trajectory of 1 000 rows, terms to degree 2, noise as a share of the standard deviation of all
states together.

    python benchmarks/discovery.py [--systems NAME…] [--noise 0.01 0.02 0.05] [--seeds 20]
        [--first-seed N] [--every N] [--jobs N] [--no-pysindy] [--json FILE]
"""

from __future__ import annotations

import argparse
import itertools
import json
import time
import warnings
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pysindy as ps
import sympy
from scipy.integrate import solve_ivp

from sindy_surge import SparseDynamics

N_TRAJECTORIES, N_ROWS = 3, 2000
# Thresholds that pysindy is tried with.
THRESHOLDS = np.geomspace(1e-3, 3.0, 25)


@dataclass(frozen=True)
class System:
    """A system whose equations are known."""

    states: tuple[str, ...]
    rate: Callable[..., Any]  # dx/dt at (t, x, u)
    truth: dict[str, dict[str, float]]  # Coefficients of each equation by term
    low: tuple[float, ...]  # Range of the starts
    high: tuple[float, ...]
    step_s: float
    # Makes the candidate terms.
    library: Callable[[], Any] = lambda: ps.PolynomialLibrary(degree=3)
    force: Callable[[Any], Any] | None = None  # The input u at a time
    # A state that is not measured, with the equation of the first state known; may be empty.
    hidden: str = ""
    n_runs: int = N_TRAJECTORIES
    n_rows: int = N_ROWS
    # Whether noise is a share of the standard deviation of all states together.
    pooled: bool = False


def _root() -> Any:
    """Return the root of each state."""
    return ps.CustomLibrary([lambda x: np.sqrt(np.abs(x))], function_names=[lambda x: f"sqrt({x})"])


def _with_root(state: int, n_states: int) -> Any:
    """Return polynomials to degree 3 and the root of one state."""
    parts = [ps.PolynomialLibrary(degree=3), _root()]
    return ps.GeneralizedLibrary(parts, inputs_per_library=[list(range(n_states)), [state]])


def _of(truth: dict[str, dict[str, float]], states: tuple[str, ...]) -> Callable[..., Any]:
    """Return dx/dt for equations of polynomial terms, sqrt(·), sin(·) and the input u."""
    symbols = {name: sympy.Symbol(name) for name in (*states, "u")}
    known = symbols | {"sqrt": lambda x: sympy.sqrt(sympy.Abs(x))}
    rates = [
        sum(c * sympy.sympify(n.replace("^", "**").replace(" ", "*"), known) for n, c in terms)
        for terms in (truth[state].items() for state in states)
    ]
    compiled = sympy.lambdify(list(symbols.values()), rates)
    return lambda t, x, u: compiled(*x, u)


def _system(states: tuple[str, ...], truth: dict[str, dict[str, float]], **kind: Any) -> System:
    return System(states, _of(truth, states), truth, **kind)


GREITZER = {
    "phi": {"1": 1.2, "phi": 1.2, "phi^3": -1.0, "psi": -1.0},
    "psi": {"1": 0.3, "phi": 0.45, "sqrt(psi)": -0.42},
}
GREITZER_LAG = _system(
    ("phi", "psi", "psi_c"),
    {
        "phi": {"psi_c": 1.8, "psi": -1.8},
        "psi": {"phi": 0.55, "sqrt(psi)": -0.36},
        "psi_c": {"1": 1.2, "phi^2": 6.0, "phi^3": -4.0, "psi_c": -4.0},
    },
    low=(0.2, 0.3, 0.3),
    high=(1.2, 0.9, 0.9),
    step_s=0.02,
    library=partial(_with_root, 1, 3),
)
MOORE_GREITZER = {
    "phi": {"1": 0.6, "psi": -2.0, "phi^2": 3.0, "phi^3": -1.0, "J": 1.5, "phi J": -1.5},
    "psi": {"phi": 0.5, "sqrt(psi)": -0.62},
    "J": {"phi J": 4.0, "phi^2 J": -2.0, "J^2": -0.5},
}
SYSTEMS = {
    "van_der_pol": _system(
        ("x", "y"),
        {"x": {"y": 1.0}, "y": {"x": -1.0, "y": 2.0, "x^2 y": -2.0}},
        low=(-2, -2),
        high=(2, 2),
        step_s=0.01,
    ),
    "duffing": _system(
        ("x", "v"),
        {"x": {"v": 1.0}, "v": {"x": 1.0, "v": -0.3, "x^3": -1.0, "u": 1.0}},
        low=(-1.5, -1.5),
        high=(1.5, 1.5),
        step_s=0.02,
        force=lambda t: 0.5 * np.cos(1.2 * t),
    ),
    "greitzer": _system(
        ("phi", "psi"),
        GREITZER,
        low=(-0.5, 0.6),
        high=(1.0, 1.6),
        step_s=0.02,
        library=partial(_with_root, 1, 2),
    ),
    "greitzer_lag": GREITZER_LAG,
    "greitzer_lag_hidden": replace(GREITZER_LAG, hidden="psi_c"),
    "moore_greitzer": _system(
        ("phi", "psi", "J"),
        MOORE_GREITZER,
        low=(0.4, 0.8, 0.1),
        high=(1.6, 2.0, 1.0),
        step_s=0.02,
        library=partial(_with_root, 1, 3),
    ),
    # Not developed on.
    "lorenz": _system(
        ("x", "y", "z"),
        {
            "x": {"x": -10.0, "y": 10.0},
            "y": {"x": 28.0, "y": -1.0, "x z": -1.0},
            "z": {"z": -8.0 / 3.0, "x y": 1.0},
        },
        low=(-10, -10, 15),
        high=(10, 10, 35),
        step_s=0.01,
    ),
    "rossler": _system(
        ("x", "y", "z"),
        {
            "x": {"y": -1.0, "z": -1.0},
            "y": {"x": 1.0, "y": 0.2},
            "z": {"1": 0.2, "x z": 1.0, "z": -5.7},
        },
        low=(-5, -5, 0),
        high=(5, 5, 1),
        step_s=0.02,
    ),
    "lotka_volterra": _system(
        ("x", "y"),
        {"x": {"x": 1.0, "x y": -0.8}, "y": {"y": -1.2, "x y": 0.9}},
        low=(0.5, 0.5),
        high=(3, 3),
        step_s=0.02,
    ),
    "tanks": _system(
        ("a", "b", "c"),
        {
            "a": {"u": 1.0, "sqrt(a)": -0.8},
            "b": {"sqrt(a)": 0.8, "sqrt(b)": -0.7},
            "c": {"sqrt(b)": 0.7, "sqrt(c)": -0.6},
        },
        low=(0.5, 0.5, 0.5),
        high=(2, 2, 2),
        step_s=0.02,
        library=lambda: ps.PolynomialLibrary(degree=2) + _root(),
        force=lambda t: 0.8 + 0.4 * np.sin(0.7 * t),
    ),
    "pendulum": _system(
        ("q", "w"),
        {"q": {"w": 1.0}, "w": {"sin(q)": -2.0, "w": -0.1}},
        low=(-2.5, -1),
        high=(2.5, 1),
        step_s=0.02,
        library=lambda: (
            ps.PolynomialLibrary(degree=3)
            + ps.CustomLibrary([lambda q: np.sin(1.0 * q)], function_names=[lambda x: f"sin({x})"])
        ),
    ),
}
PUBLISHED_START = (-8.0, 8.0, 27.0)
SYSTEMS["lorenz_odr_bindy"] = replace(
    SYSTEMS["lorenz"],
    low=PUBLISHED_START,
    high=PUBLISHED_START,
    library=lambda: ps.PolynomialLibrary(degree=2),
    n_runs=1,
    n_rows=1000,
    pooled=True,
)


def measured(system: System, noise: float, seed: int) -> tuple[Any, ...]:
    """Return noisy trajectories, times and inputs."""
    rng = np.random.default_rng([seed, 10])
    times = np.arange(system.n_rows) * system.step_s
    force = system.force

    def rate(t: float, x: Any) -> Any:
        return system.rate(t, x, 0.0 if force is None else force(t))

    runs = []
    while len(runs) < system.n_runs:
        start = rng.uniform(system.low, system.high)
        run = solve_ivp(rate, (0.0, times[-1]), start, t_eval=times, rtol=1e-9, atol=1e-11)
        if run.success and np.abs(run.y).max() < 1e3:
            runs.append(run.y.T)
    every = np.concatenate(runs)
    rms = np.std(every) if system.pooled else np.sqrt(np.mean(every**2, axis=0))
    noisy = [run + noise * rms * rng.standard_normal(run.shape) for run in runs]
    inputs = None if force is None else [force(times)[:, None] for _ in runs]
    return noisy, times, inputs


def cell(name: str, noise: float, with_pysindy: bool, seed: int, every: int = 1) -> dict[str, Any]:
    """Discover one system once, and compare with its truth."""
    warnings.simplefilter("ignore")  # pysindy warns at every threshold that leaves no term
    system = SYSTEMS[name]
    system = replace(system, step_s=system.step_s * every, n_rows=system.n_rows // every)
    x, t, u = measured(system, noise, seed)
    options: dict[str, Any] = {}
    states = list(system.states)
    if system.hidden:
        first = states[0]
        options = {"hidden": (system.hidden,), "known": {first: system.truth[first]}}
        kept = [i for i, s in enumerate(states) if s != system.hidden]
        x, states = [each[:, kept] for each in x], [states[i] for i in kept]
    began = time.process_time()
    model = SparseDynamics(library=system.library(), **options)
    model.fit(x, t, u, feature_names=[*states, *(["u"] if u else [])])
    seconds = time.process_time() - began
    wanted = [set(system.truth[s]) for s in model.state_names_]
    exact = [set(terms) for terms in model.terms_] == wanted
    errors = [
        abs(term.coefficient / system.truth[s][term.name] - 1.0)
        for s, terms in zip(model.state_names_, model.equation_terms_, strict=True)
        for term in terms
        if exact and term.stderr > 0.0
    ]
    row = {"system": name, "noise": noise, "seed": seed, "exact": exact, "seconds": seconds}
    row |= {"error": float(np.median(errors)) if errors else None, "state": model.state_.code}
    if not exact:
        row["lacked"] = _lacked(model, wanted)
        row["found"] = model.equations()
    if with_pysindy and not system.hidden:
        row["pysindy"] = _pysindy(system, x, t, u)
    return row


def _lacked(model: SparseDynamics, wanted: list[set[str]]) -> str:
    n = len(model.candidate_terms_)
    support = [
        s * n + i
        for s, terms in enumerate(wanted)
        if model.state_names_[s] not in (model.known or {})
        for i, name in enumerate(model.candidate_terms_)
        if name in terms
    ]
    true = model.search_.try_support(support, model.best_.fit, "truth")
    return "search" if true.score < model.best_.score else "data"


def _pysindy(system: System, x: Any, t: Any, u: Any) -> bool:
    """Return whether any optimizer and threshold of pysindy gives the exact support."""
    wanted = [set(system.truth[s]) for s in system.states]
    library = system.library()
    for window in (11, 41):
        smooth = ps.SmoothedFiniteDifference(smoother_kws={"window_length": window})
        fitted = ps.SINDy(
            optimizer=ps.STLSQ(threshold=0.0, alpha=1e-9),
            feature_library=library,
            differentiation_method=smooth,
        )
        fitted.fit(x, t, u=u, feature_names=[*system.states, *(["u"] if u else [])])
        names = fitted.get_feature_names()
        theta = np.vstack(
            [
                np.asarray(fitted.feature_library.transform(np.column_stack((a, b)) if u else a))
                for a, b in zip(x, u or x, strict=True)
            ]
        )
        rates = np.vstack([np.asarray(smooth(a, t)) for a in x])
        for threshold in THRESHOLDS:
            for normalise in (True, False):
                optimizer = ps.STLSQ(threshold=threshold, alpha=1e-9, normalize_columns=normalise)
                optimizer.fit(theta, rates)
                found = [
                    {n for n, c in zip(names, row, strict=True) if c != 0.0}
                    for row in np.atleast_2d(optimizer.coef_)
                ]
                if found == wanted:
                    return True
    return False


def table(found: list[dict[str, Any]]) -> str:
    """Return the table of the cells: exact supports, errors, seconds, and what lacked where."""
    names = ["system", "noise", "seed", "exact", "error", "seconds", "pysindy", "lacked"]
    rows = pd.DataFrame(found).reindex(columns=names)
    rows["lacked"] = [f"{row['seed']}: {row['lacked']}" if "lacked" in row else "" for row in found]
    groups = rows.groupby(["system", "noise"], sort=False)
    shown = groups[["exact", "pysindy"]].sum(min_count=1)
    shown.insert(1, "of", groups.size())
    shown = shown.join(groups[["error", "seconds"]].median())
    shown = shown.join(groups["lacked"].agg(lambda words: " ".join(filter(None, words))))
    return shown.to_string(na_rep="-", float_format="%.3g")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--systems", nargs="+", choices=SYSTEMS, default=list(SYSTEMS))
    parser.add_argument("--noise", nargs="+", type=float, default=[0.01, 0.02, 0.05])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--no-pysindy", action="store_true")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    seeds = range(given.first_seed, given.first_seed + given.seeds)
    cells = itertools.product(
        given.systems, given.noise, [not given.no_pysindy], seeds, [given.every]
    )
    with ProcessPoolExecutor(given.jobs) as pool:
        found = list(pool.map(cell, *zip(*cells, strict=True)))
    print(table(found))
    if given.json:
        given.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
