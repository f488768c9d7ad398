"""The sparse fit beside plain pysindy, on the records of `structure_recovery.py`."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np
from efficiency import efficiency
from plain_pysindy import DERIVATIVES, fit_once, make_model, plain_pysindy
from resident import Cost, cost
from structure_recovery import LEVELS, MAIN_TRUTHS, same_structure, warm_up
from surge_truths import PERIOD_S, TAU_S, TRUTHS, Record, simulate_record

from gathered.noisy_flow_bound import TauBound, tau_bound
from gathered.table import Cell, Line, absent, costs, root_mean_square
from sindy_surge import SparseLagRegressor

FIRST_SEED, SEEDS = 300, 6
OWN = "SparseLagRegressor"
LONG_NAMES = {"FD": "pysindy, finite difference", "SFD": "pysindy, smoothed difference"}
NO_FALSE = "not a question of this block: every record has a structure to be found"
NO_DIFFERENCE = "not a question of this block: the methods do not compute the same thing"


@dataclass(frozen=True)
class _Trial:
    """One method on one record."""

    right: bool
    tau_error_s: float
    bound: TauBound
    spent: Cost
    settings: tuple[str, ...] = ()


def lines(quick: bool, seeds: int | None) -> list[Line]:
    """Return a line for ours and one for each derivative of pysindy.

    Parameters
    ----------
    quick : bool
        For its working alone.
    seeds : int, optional
        Records of each truth and noise.
    """
    warm_up()
    count = seeds or (1 if quick else SEEDS)
    cases = [(truth, noise) for truth in MAIN_TRUTHS for noise in LEVELS]
    if quick:
        cases = [("quadratic", 0.02), ("reverse", 0.02)]
    trials: dict[str, list[_Trial]] = {name: [] for name in (OWN, *DERIVATIVES)}
    kinds: list[str] = []
    for truth, noise in cases:
        for seed in range(FIRST_SEED, FIRST_SEED + count):
            for name, trial in _one_record(truth, noise, seed).items():
                trials[name].append(trial)
            kinds.append(f"{truth} {noise}")
    n_samples = simulate_record(*cases[0], FIRST_SEED).phi.size
    return [_line(name, trials[name], trials[OWN], kinds, n_samples) for name in trials]


def _one_record(truth: str, noise: float, seed: int) -> dict[str, _Trial]:
    made = simulate_record(truth, noise, seed)
    record, terms = made.measured, TRUTHS[truth]
    bound = tau_bound(terms, made, noise)
    spent = cost(lambda: _own_fit(record))
    found = {OWN: _trial(spent.result, terms, bound, spent)}
    # Their one fit each, in turn with ours; what they find at every threshold is had apart.
    fits = {name: _pysindy_cost(record, name) for name in DERIVATIVES}
    told = plain_pysindy(record, terms, crowded=False)
    for name in DERIVATIVES:
        settings = tuple(told[name]["right"])
        off_s = told[name]["tau_s"] - TAU_S
        found[name] = _Trial(bool(settings), off_s, bound, fits[name], settings)
    return found


def _own_fit(record: Record) -> SparseLagRegressor | None:
    try:
        return SparseLagRegressor(PERIOD_S).fit(record.phi[:, None], record.psi_p)
    except Exception:
        # A record that breaks the fit is a record not found.
        return None


def _trial(model: Any, terms: dict[str, float], bound: TauBound, spent: Cost) -> _Trial:
    if model is None:
        return _Trial(False, np.nan, bound, spent)
    off_s = float(model.time_constant_s_) - TAU_S
    return _Trial(same_structure(model.terms_, terms), off_s, bound, spent)


def _pysindy_cost(record: Record, derivative: str) -> Cost:
    model, _ = make_model(derivative, False)
    return cost(lambda: fit_once(model, record))


def _line(
    name: str, trials: list[_Trial], own: list[_Trial], kinds: list[str], n_samples: int
) -> Line:
    seconds = np.array([t.spent.seconds for t in trials])
    off_s = np.array([t.tau_error_s for t in trials])
    bound_s = np.array([t.bound.stderr_s for t in trials])
    one_step_s = np.array([t.bound.one_step_s for t in trials])
    lags = np.isfinite(off_s)
    cells: dict[str, Cell] = {
        **absent(NO_FALSE, "false_percent"),
        **absent(NO_DIFFERENCE, "differs"),
        "right_percent": 100.0 * float(np.mean([t.right for t in trials])),
        "tau_error_percent": 100.0 * root_mean_square(off_s) / TAU_S,
        "error_over_bound": root_mean_square(off_s / bound_s),
        "efficiency": efficiency((off_s / bound_s)[lags], (one_step_s / bound_s)[lags]),
        **costs(
            seconds,
            np.array([t.spent.seconds for t in own]),
            np.array([t.spent.peak_bytes for t in trials if t.spent.peak_bytes is not None]),
            np.full(seconds.size, n_samples),
            PERIOD_S,
        ),
    }
    return Line(
        "sparse", LONG_NAMES.get(name, name), len(trials), cells, _note(name, trials, kinds)
    )


def _note(name: str, trials: list[_Trial], kinds: list[str]) -> str:
    if name == OWN:
        failed = sum(not np.isfinite(t.tau_error_s) for t in trials)
        return f"{failed} fits without a lag, left out of the error" if failed else ""
    one = 0
    for kind in dict.fromkeys(kinds):
        mine = [t for t, other in zip(trials, kinds, strict=True) if other == kind]
        one += max(Counter(s for t in mine for s in t.settings).values(), default=0)
    return (
        "right where any of its thresholds is, told by the truth (with one for all records of a "
        f"case: {100.0 * one / len(trials):.1f} %); tau from the regression on the true terms; "
        "time and memory of one fit at one threshold"
    )
