"""What a model and its records may be, and what its states are to each other."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
import system_models as make
from scipy.integrate import solve_ivp
from scipy.signal import lsim

from comparisons.missing_effect.systems.experiments import Experiment
from comparisons.missing_effect.systems.model import Model, P
from comparisons.missing_effect.systems.records import Records, runs_of
from comparisons.missing_effect.systems.roles import (
    displacements,
    free_equations,
    measured_as,
    physical,
    rates,
    rates_of,
)
from comparisons.missing_effect.systems.simulate import path_of
from comparisons.missing_effect.systems.structure import Structure
from surge_core.errors import InputError

GOOD: Mapping[str, Any] = {
    "states": {"q": "m", "v": "m/s"},
    "inputs": {"F": "N"},
    "outputs": {"y": "m"},
    "params": {"M": P(1.0, 0.1, 9.0, "kg"), "c": P(0.5, 0.0, 9.0)},
    "rhs": lambda t, x, u, p: (x.v, (u.F - p.c * x.v - x.q) / p.M),
    "output": lambda t, x, u, p: x.q,
    "exact": ("q",),
}

BAD_MODELS: dict[str, tuple[dict[str, Any], str]] = {
    "no states": ({"states": {}}, "model: states: expected at least one, found none"),
    "name with a space": ({"inputs": {"my force": "N"}}, "model: inputs: .*'my force'"),
    "input named as a state": ({"inputs": {"q": "N"}}, "model: inputs: .*'q' twice"),
    "no unit": ({"outputs": {"y": ""}}, "model: outputs: y: expected a unit"),
    "parameter that is a number": ({"params": {"M": 1.0}}, r"model: params: M: .*P\(start.*1.0"),
    "start beyond its bounds": (
        {"params": {"M": P(3.0, 0.0, 2.0)}},
        "model: params: M: .*low <= start <= high.*start 3",
    ),
    "exact state that is none": ({"exact": ("w",)}, "model: exact: .*q, v, found 'w'"),
    "unknown way between samples": (
        {"input_between_samples": "spline"},
        "model: input_between_samples: .*held.*'spline'",
    ),
    "start that is neither": ({"x0": {"q": "last"}}, "model: x0: q: .*'first'.*'last'"),
    "balance of a state that is none": (
        {"balance": {"w": ("M", "N")}},
        "model: balance: .*found 'w'",
    ),
    "right-hand side that is one short": (
        {"rhs": lambda t, x, u, p: x.v},
        r"model: rhs: expected 2 numbers \(q, v\), found 1",
    ),
    "a name that the model lacks": (
        {"rhs": lambda t, x, u, p: (x.v, u.G)},
        "model: rhs and output: .*AttributeError.*'G'",
    ),
}


def one_sentence(error: InputError) -> None:
    """A message names part, expected and found, on one line."""
    assert re.fullmatch(r".*: expected .*, found .*", str(error))


@pytest.mark.parametrize("case", BAD_MODELS)
def test_a_bad_model_is_refused_in_one_sentence(case: str) -> None:
    change, told = BAD_MODELS[case]
    with pytest.raises(InputError, match=told) as caught:
        Model(**{**GOOD, **change})
    one_sentence(caught.value)


def channels(n: int = 60) -> dict[str, Any]:
    t = np.arange(n, dtype=float)
    return {"F": np.sin(t), "y": np.cos(t)}


BAD_RECORDS: dict[str, tuple[Callable[[], object], str]] = {
    "no period": (lambda: Experiment("a", channels(), 0.1), "a: sample period: .*positive.*dict"),
    "a gap in an input": (
        lambda: Experiment("a", 1.0, {**channels(), "F": np.r_[0.0, np.nan, np.arange(58.0)]}).of(
            Model(**GOOD)
        ),
        "a: F: expected finite values, found nan in row 2",
    ),
    "a reading that is infinite": (
        lambda: Experiment("a", 1.0, {**channels(), "y": np.r_[0.0, np.inf, np.arange(58.0)]}),
        "a: y: expected finite values, found inf in row 2",
    ),
    "an output that is hardly read": (
        lambda: Experiment(
            "a", 1.0, {**channels(), "y": np.r_[np.arange(9.0), np.full(51, np.nan)]}
        ).of(Model(**GOOD)),
        "a: y: expected at least 10 readings, found 9",
    ),
    "an output that is not read at the end": (
        lambda: Records.of(
            Model(**GOOD),
            [
                Experiment(
                    "a", 1.0, {**channels(150), "y": np.r_[np.arange(100.0), np.full(50, np.nan)]}
                )
            ],
        ),
        "a: y: expected at least 10 readings in the last third of the record, found 0",
    ),
    "channels of two lengths": (
        lambda: Experiment("a", 1.0, {**channels(), "y": np.arange(61.0)}),
        r"a: channels: expected one length, found lengths \[60, 61\]",
    ),
    "too few rows": (
        lambda: Experiment("a", 1.0, channels(39)),
        "a: rows: expected at least 40, found 39",
    ),
    "an input that is missing": (
        lambda: Experiment("a", 1.0, {"y": channels()["y"]}).of(Model(**GOOD)),
        "a: F: expected channels F, y, found y",
    ),
    "an output that never changes": (
        lambda: Experiment("a", 1.0, {**channels(), "y": np.ones(60)}).of(Model(**GOOD)),
        "a: y: expected an output that changes, found a constant",
    ),
    "no records": (lambda: Records.of(Model(**GOOD), []), "fit: expected at least one experiment"),
    "records of two rates": (
        lambda: Records.of(
            Model(**GOOD), [Experiment("a", 1.0, channels()), Experiment("b", 2.0, channels())]
        ),
        "fit: expected one sample rate, found periods from 1 to 2 s",
    ),
}


@pytest.mark.parametrize("case", BAD_RECORDS)
def test_a_bad_record_is_refused_in_one_sentence(case: str) -> None:
    make, told = BAD_RECORDS[case]
    with pytest.raises(InputError, match=told) as caught:
        make()
    one_sentence(caught.value)


def test_displacements_and_rates_follow_from_exact_equations() -> None:
    """Without those every state is either."""
    model, free = Model(**GOOD), Model(**{**GOOD, "exact": ()})
    assert (rates_of(model), rates_of(free), measured_as(model)) == ({0: (1, 1.0)}, {}, {0: "y"})
    assert (displacements(model), rates(model), free_equations(model)) == ((0,), (1,), (1,))
    assert displacements(free) == rates(free) == free_equations(free) == (0, 1)


def test_an_exact_state_that_is_no_displacement_is_no_part_of_the_plant() -> None:
    """A controller's filter dw/dt = (q − w)/T is a definition: nothing in the plant feels it."""
    model = Model(
        **{
            **GOOD,
            "states": {"q": "m", "v": "m/s", "w": "m"},
            "rhs": lambda t, x, u, p: (x.v, (u.F - p.c * x.v - x.w) / p.M, (x.q - x.w) / 0.3),
            "exact": ("q", "w"),
        }
    )
    assert physical(model) == (0, 1)
    assert displacements(model) == (0,)
    assert rates(model) == (1,)


def test_a_scaled_or_shifted_reading_does_not_measure_a_state() -> None:
    """An offset that starts at zero hides at the starts of the parameters, and not elsewhere."""
    shifted = Model(
        **{
            **GOOD,
            "outputs": {"y": "m", "z": "m/s"},
            "params": {**GOOD["params"], "b": P(0.0, -1.0, 2.0)},
            "output": lambda t, x, u, p: (x.q + p.b, x.v),
        }
    )
    assert measured_as(shifted) == {1: "z"}
    scaled = Model(**{**GOOD, "output": lambda t, x, u, p: 1000.0 * x.q})
    assert measured_as(scaled) == {}


CELLS, WIDTH = 20, 0.05
HEAT = np.array([250.0, 300.0, 350.0, 400.0])
CONDUCTED = np.array([4e-3, 5e-3, 5.5e-3, 5.8e-3])


def rod(**changes: Any) -> Model:
    """A rod whose first cell is heated, beside a lump at its end."""

    def rhs(t: float, x: Any, u: Any, p: Any) -> Any:
        flow = p.k * (x.T[1:] - x.T[:-1]) / WIDTH
        dT = np.zeros(CELLS)
        dT[0] = (u.q + flow[0]) / WIDTH
        dT[1:-1] = (flow[1:] - flow[:-1]) / WIDTH
        dT[-1] = (p.g * (x.lump - x.T[-1]) - flow[-1]) / WIDTH
        return dT, p.g * (x.T[-1] - x.lump)

    given: dict[str, Any] = {
        "states": {"T": ("K", CELLS), "lump": "K"},
        "inputs": {"q": "K m/s"},
        "outputs": {"T_mid": "K", "T_end": "K"},
        "params": {"k": P(2e-3, 1e-4, 0.1, "m²/s"), "g": P(0.01, 1e-4, 1.0, "m/s")},
        "rhs": rhs,
        "output": lambda t, x, u, p: (x.T[10], x.lump),
        "x0": {"T": (0.0, 0.01), "lump": (0.0, 0.01)},
        "name": "rod",
    }
    return Model(**{**given, **changes})


def rod_record(n: int = 300) -> Experiment:
    """By scipy, from other equations: the matrix exponential of the whole rod."""
    k, g, h = 4e-3, 0.02, 0.5
    A = np.zeros((CELLS + 1, CELLS + 1))
    for i in range(CELLS - 1):
        for a, b in ((i, i + 1), (i + 1, i)):
            A[a, a] -= k / WIDTH**2
            A[a, b] += k / WIDTH**2
    A[CELLS - 1, CELLS - 1] -= g / WIDTH
    A[CELLS - 1, CELLS] += g / WIDTH
    A[CELLS, CELLS - 1], A[CELLS, CELLS] = g, -g
    B = np.zeros((CELLS + 1, 1))
    B[0] = 1.0 / WIDTH
    rng = np.random.default_rng(2)
    q = 0.05 * np.repeat(rng.random(n // 20), 20)
    C = np.zeros((2, CELLS + 1))
    C[0, 10] = C[1, CELLS] = 1.0
    y = lsim((A, B, C, np.zeros((2, 1))), q, h * np.arange(n), interp=False)[1]
    y = y + 0.002 * np.std(y, axis=0) * rng.standard_normal(y.shape)
    return Experiment("rod", h, {"q": q, "T_mid": y[:, 0], "T_end": y[:, 1]})


def test_a_state_may_be_a_vector() -> None:
    """Twenty cells and a lump: parameters of the truth, and no effect on a single cell."""
    model = rod(input_between_samples="held")
    assert model.state_names == (*(f"T_{i}" for i in range(CELLS)), "lump")
    assert (free_equations(model), physical(model)) == ((CELLS,), (CELLS,))
    assert measured_as(model) == {10: "T_mid", CELLS: "T_end"}
    records = Records.of(model, [rod_record()])
    run = runs_of(records, records.whole, "held", begun=True)[0]
    fit = make.fitted(Structure(model, (), "held", 1e-6, offsets_free=False), [run])
    assert fit.theta[:2] == pytest.approx([4e-3, 0.02], rel=0.01)
    assert np.std(fit.errors[0] / np.std(run.outputs, axis=0)) < 1.2 * 0.002


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"states": {"T": ("K", 0), "lump": "K"}}, r"states: T: expected a unit, or \(unit"),
        ({"x0": {"T": [0.0] * 19}}, "x0: T: expected 20 values, found 19"),
        ({"states": {"T": ("K", 19), "lump": "K"}}, "rhs"),
    ],
)
def test_a_bad_vector_is_refused(change: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=f"model: {words}") as caught:
        rod(**change)
    one_sentence(caught.value)


def test_an_exact_vector_and_a_start_of_each_cell() -> None:
    model = rod(x0={"T": [*np.arange(19.0), (19.0, 0.1)]}, exact=("T",))
    assert (model.exact[0], len(model.exact)) == ("T_0", 20)
    assert (model.x0["T_7"], model.x0["T_19"], free_equations(model)) == (7.0, (19.0, 0.1), (20,))


def conducted(kelvin: float) -> float:
    """What `conducted` gives is not known below freezing."""
    return float(np.interp(kelvin, HEAT, CONDUCTED)) + 0.0 * math.sqrt(kelvin - 273.15)


def test_a_table_in_a_function_of_the_users_is_compiled() -> None:
    """A conductivity that is read from a table, as a function of the temperature."""
    model = rod(
        states={"lump": "K"},
        inputs={"q": "K/s"},
        outputs={"T_end": "K"},
        params={"g": P(1.0, 0.1, 9.0)},
        rhs=lambda t, x, u, p: u.q - p.g * conducted(x.lump) * (x.lump - 280.0),
        output=lambda t, x, u, p: x.lump,
        x0={},
    )
    n, h = 200, 1.0
    experiment = Experiment("run", h, {"q": np.full(n, 0.5), "T_end": 280.0 + np.arange(n)})
    run = make.runs_on(model, [experiment])[0]
    structure = Structure(model, (), "held", 1e-8)
    path = path_of(structure, run, np.array([1.0, 0.0]), np.array([280.0]), np.array([100.0]))
    reference = solve_ivp(
        lambda t, x: 0.5 - np.interp(x, HEAT, CONDUCTED) * (x - 280.0),
        (0.0, h * (n - 1)),
        [280.0],
        t_eval=h * np.arange(n),
        rtol=1e-9,
        atol=1e-9,
    )
    assert np.max(np.abs(path.outputs[:, 0] - reference.y[0])) < 1e-4
