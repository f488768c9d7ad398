"""What a model and its records may be, and what its states are to each other."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest

from comparisons.missing_effect.systems.compiled import compiled
from comparisons.missing_effect.systems.experiments import Experiment
from comparisons.missing_effect.systems.model import Model, P
from comparisons.missing_effect.systems.records import Records
from comparisons.missing_effect.systems.roles import (
    displacements,
    free_equations,
    measured_as,
    physical,
    rate_of,
    rates,
)
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
    "balance of a state that is none": ({"balance": {"w": ("M", "N")}}, "model: balance: w"),
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
    text = str(error)
    assert "\n" not in text
    assert ", found " in text
    assert ": expected " in text


@pytest.mark.parametrize("case", BAD_MODELS)
def test_a_bad_model_is_refused_in_one_sentence(case: str) -> None:
    change, told = BAD_MODELS[case]
    with pytest.raises(InputError, match=told) as caught:
        Model(**{**GOOD, **change})
    one_sentence(caught.value)


def test_what_cannot_be_compiled_is_refused_in_one_sentence() -> None:
    model = Model(**{**GOOD, "rhs": lambda t, x, u, p: (x.v, [0.0] if t > 1e9 else u.F)})
    with pytest.raises(InputError, match="model: rhs: expected arithmetic") as caught:
        compiled(model)
    one_sentence(caught.value)


def channels(n: int = 60) -> dict[str, Any]:
    t = np.arange(n, dtype=float)
    return {"F": np.sin(t), "y": np.cos(t)}


BAD_RECORDS: dict[str, tuple[Callable[[], object], str]] = {
    "no period": (lambda: Experiment("a", 0.0, channels()), "a: sample period: .*positive.*0.0"),
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
                    "a",
                    1.0,
                    {**channels(150), "y": np.r_[np.arange(100.0), np.full(50, np.nan)]},
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
    model = Model(**GOOD)
    assert free_equations(model) == (1,)
    assert rate_of(model) == {0: 1}
    assert displacements(model) == (0,)
    assert rates(model) == (1,)
    assert measured_as(model) == {0: "y"}


def test_without_exact_equations_every_state_is_either() -> None:
    model = Model(**{**GOOD, "exact": ()})
    assert rate_of(model) == {}
    assert displacements(model) == rates(model) == free_equations(model) == (0, 1)


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
