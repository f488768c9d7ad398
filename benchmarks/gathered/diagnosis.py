"""The diagnosis beside the published recipe, on the tests of `effect_study.py`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from effect_study import STRENGTHS, Case, asked_pysindy, diagnosed, warm_up
from effect_study_pysindy import RIGHT_TERMS
from effect_study_tables import false_names, outcome, tau_error_after, tau_error_before
from resident import Cost, cost

from comparisons.rig.coefficient_tests import EFFECTS, NOISES
from gathered.table import Cell, Line, absent, costs, root_mean_square

FIRST_SEED, SEEDS, NULLS_A_SEED = 1000, 2, 5
INSIDE = ("unique", "set", "extra", "prov. right")
NO_DIFFERENCE = "not a question of this block: the methods do not compute the same thing"
NO_BOUND = (
    "the Cramer-Rao bound of tau depends on which effects are fitted beside it, and the forms of "
    "the simulator's effects are not the catalogue's: none is at hand"
)
NO_TAU = "the recipe adds terms to a rate of change; what is tau then is not said"


@dataclass(frozen=True)
class _Test:
    """One test, put to both."""

    case: Case
    n_samples: int
    period_s: float
    own_row: dict[str, Any]
    own: Cost
    recipe_row: dict[str, Any]
    recipe: Cost


def lines(quick: bool, seeds: int | None) -> list[Line]:
    """Return a line for ours and one for the recipe.

    Parameters
    ----------
    quick : bool
        For its working alone.
    seeds : int, optional
        Tests of each effect at each strength; of each noise with nothing missing, five times it.
    """
    warm_up()
    tests = [_put(case) for case in _cases(quick, seeds)]
    return [_own_line(tests), _recipe_line(tests)]


def _cases(quick: bool, seeds: int | None) -> list[Case]:
    effects, strengths, noises = EFFECTS, STRENGTHS, NOISES
    nulls = NULLS_A_SEED
    if quick:
        effects, strengths, noises, nulls = EFFECTS[:2], STRENGTHS[1:2], NOISES[:2], 1
    count = seeds or SEEDS
    found = [
        Case("effect", (effect,), strength, FIRST_SEED + seed)
        for effect in effects for strength in strengths for seed in range(count)
    ]  # fmt: skip
    return found + [
        Case("null", (), 0.0, FIRST_SEED + seed, noise)
        for noise in noises for seed in range(nulls * count)
    ]  # fmt: skip


def _put(case: Case) -> _Test:
    test = case.simulate()
    known = {
        "planted": list(case.planted),
        "noise": case.noise,
        "tau_true_s": test.tau_s,
        "error": "",
    }
    own = cost(lambda: _own_answer(test))
    recipe = cost(lambda: asked_pysindy(case, test))
    clock = test.records[0].time_s
    return _Test(
        case,
        sum(one.phi.size for one in test.records),
        float(clock[1] - clock[0]),
        {**known, **own.result},
        own,
        recipe.result,
        recipe,
    )


def _own_answer(test: Any) -> dict[str, Any]:
    try:
        return diagnosed(test)
    except Exception as error:
        # One test that breaks the diagnosis is a test lost.
        return {"verdict": "", "missing": [], "error": f"{type(error).__name__}: {error}"}


def _shared(tests: list[_Test], mine: list[Cost]) -> dict[str, Cell]:
    return {
        **absent(NO_DIFFERENCE, "differs"),
        **absent(NO_BOUND, "error_over_bound", "efficiency"),
        **costs(
            np.array([c.seconds for c in mine]),
            np.array([t.own.seconds for t in tests]),
            np.array([c.peak_bytes for c in mine if c.peak_bytes is not None]),
            np.array([t.n_samples for t in tests]),
            tests[0].period_s,
        ),
    }


def _own_line(tests: list[_Test]) -> Line:
    effects = [t.own_row for t in tests if t.case.kind == "effect"]
    nulls = [t.own_row for t in tests if t.case.kind == "null"]
    answered = [row for row in effects if not row["error"]]
    outcomes = [outcome(row) for row in effects]
    after = np.array([tau_error_after(row) for row in answered])
    before = np.array([tau_error_before(row) for row in answered])
    cells: dict[str, Cell] = {
        **_shared(tests, [t.own for t in tests]),
        "right_percent": _percent([one in INSIDE for one in outcomes]),
        "false_percent": _percent([bool(false_names(row)) for row in nulls]),
        "tau_error_percent": root_mean_square(after),
    }
    note = (
        f"{len(effects)} tests with an effect, {len(nulls)} with none, where firm names "
        "count as false; alone and rightly named in "
        f"{_percent([one == 'unique' for one in outcomes]):.1f} %, wrongly in "
        f"{_percent([one == 'WRONG' for one in outcomes]):.1f} %; tau with what was named added "
        f"(median error {np.median(after):.3f} %), rms {root_mean_square(before):.2f} % before "
        f"(median {np.median(before):.3f} %)"
    )
    return Line("diagnosis", "diagnose", len(tests), cells, note)


def _recipe_line(tests: list[_Test]) -> Line:
    hits, sayable, sizes = [], [], []
    for t in tests:
        if t.case.kind == "effect":
            right = RIGHT_TERMS[t.case.planted[0]]
            hits.append(right is not None and bool(set(right) & set(t.recipe_row["terms"])))
            sayable.append(right is not None)
            sizes.append(len(t.recipe_row["terms"]))
    false = [bool(t.recipe_row["terms"]) for t in tests if t.case.kind == "null"]
    first = [t.recipe_row["right"] is True for t in tests if t.case.kind == "effect"]
    cells: dict[str, Cell] = {
        **_shared(tests, [t.recipe for t in tests]),
        **absent(NO_TAU, "tau_error_percent"),
        "right_percent": _percent(hits),
        "false_percent": _percent(false),
    }
    note = (
        "any term counts as false; a right term anywhere among those returned (median "
        f"{np.median(sizes):g} terms); as the first of them {_percent(first):.1f} %; of the "
        f"{sum(sayable)} tests whose effect has a term in its library "
        f"{100.0 * sum(hits) / max(sum(sayable), 1):.1f} %"
    )
    return Line("diagnosis", "published recipe (pysindy STLSQ)", len(tests), cells, note)


def _percent(holds: list[bool]) -> float:
    return 100.0 * float(np.mean(holds)) if holds else float("nan")
