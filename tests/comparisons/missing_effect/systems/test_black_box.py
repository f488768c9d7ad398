"""A simulation that is a black box: what a user's own solver gives, and effects around it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import system_models as make
import system_truths as truth
from scipy.signal import lsim

from comparisons.missing_effect.systems.diagnosis import diagnose_model
from comparisons.missing_effect.systems.experiments import Experiment
from comparisons.missing_effect.systems.metric import raw_metric
from comparisons.missing_effect.systems.model import Model, P
from comparisons.missing_effect.systems.quantities import covariance
from comparisons.missing_effect.systems.shapes import Kind, Map
from comparisons.missing_effect.systems.simulate import path_of, reads_at_once
from comparisons.missing_effect.systems.structure import Structure
from surge_core.errors import InputError

RUNS, HELD = [], False


def circuit(t: np.ndarray, u: Any, p: Any) -> np.ndarray:
    """The circuit by another solver: lsim, inputs straight between samples."""
    RUNS.append(t.size)
    A = [[-p.R / p.L, -1.0 / p.L], [1.0 / p.C, 0.0]]
    system = (A, [[1.0 / p.L], [0.0]], [[1.0, 0.0]], [[0.0]])
    return np.asarray(lsim(system, u.v, t, interp=not HELD)[1])


def boxed(**options: Any) -> Model:
    own = make.circuit()
    given = {"inputs": own.inputs, "outputs": own.outputs, "params": own.params, **options}
    return Model.from_simulate(circuit, **given)


def test_a_delay_of_a_held_input_is_known_within_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    """By whole rows it was known to a hundredth of a row, and wrong by half of one."""
    monkeypatch.setitem(globals(), "HELD", True)
    late, made = make.placed("transport_delay", Kind.INPUT_DELAY, 0, 2), truth.circuit(3, 800)
    made["v"] = np.repeat(made["v"][::8], 8)
    inside = Structure(make.circuit(), (late,), "held", 1e-8, offsets_free=False)
    theta = np.array([*truth.CIRCUIT.values(), 0.0, 3.4, 0.0, 0.0, 0.0])
    run = make.runs_on(inside.model, [make.experiment("circuit", made)], "held")[0]
    clean = path_of(inside, run, theta, np.zeros(2), np.ones(2)).outputs[:, 0]
    made["i"] = truth.noisy(clean, 0.01, np.random.default_rng(0))
    structure = replace(inside, model=boxed())
    run = make.runs_on(structure.model, [make.experiment("circuit", made)], "held")[0]
    fit = make.fitted(structure, [run], [*theta[:-4], 5.0, 0.0, 0.0, 0.0])
    error = np.sqrt(covariance(fit, [run], raw_metric([run.outputs]))[4, 4])
    assert abs(fit.theta[4] - 3.4) < max(3.0 * error, 0.1) < 0.3
    for box, at_once in ((boxed(), False), (replace(boxed(), simulate=lambda t, u, p: u.v), True)):
        assert reads_at_once(replace(structure, model=box), run, fit.theta, 0) == at_once


def test_numbers_that_make_up_for_each_other_are_fitted_to_the_end() -> None:
    """One of them is of the record."""
    u, w, e = np.random.default_rng(1).normal(size=(3, 300))
    numbers = {"a": P(2.0, -500.0, 500.0, per_record=True), "b": P(0.0, -500.0, 500.0)}

    def simulate(t: np.ndarray, u: Any, p: Any) -> np.ndarray:
        return np.asarray(p.a * u.u + p.b * (u.u + 3e-4 * u.w))

    model = Model.from_simulate(simulate, {"u": "V", "w": "V"}, {"y": "V"}, numbers)
    model, y = model.with_record_parameters(), 2.0 * u + 0.03 * w + 0.1 * e
    record = Experiment("record", 0.1, {"u": u, "w": w, "y": y})
    run = make.runs_on(model, [record], "linear", ([2.0], [np.inf]))[0]
    fit = make.fitted(Structure(model, (), "linear", offsets_free=False), [run])
    best = np.linalg.lstsq(np.column_stack([u, u + 3e-4 * w]), y)[0]
    assert np.r_[fit.starts[0], fit.theta[:1]] == pytest.approx(best, abs=0.5)


def test_a_black_box_is_fitted_as_the_model_is() -> None:
    """The same parameters and errors as by the equations, up to the way between samples."""
    record = make.experiment("circuit", truth.circuit(3, 800))
    found = []
    for model in (boxed(), make.circuit()):
        run = make.runs_on(model, [record], "linear")[0]
        structure = Structure(model, (), "linear", 1e-7, offsets_free=False)
        fit = make.fitted(structure, [run])
        cov = covariance(fit, [run], raw_metric([run.outputs]))
        found.append((fit.theta[:3], np.sqrt(np.diag(cov)[:3])))
    (one, one_error), (other, other_error) = found
    assert np.all(np.abs(one - other) < 0.2 * other_error)
    assert one_error == pytest.approx(other_error, rel=0.15)


def test_a_stretch_of_a_black_box_begins_where_its_record_does() -> None:
    record = make.experiment("circuit", truth.circuit(3, 300))
    runs = make.runs_on(boxed(), [record, record.rows(200, 300)], "linear")
    how = Structure(boxed(), (), "linear"), np.array([0.05, 3.0, 2e-3, 0.2]), np.zeros(0)
    whole, late = (path_of(how[0], run, *how[1:], np.zeros(0)).outputs for run in runs)
    assert late == pytest.approx(whole[200:], abs=1e-9)


PLACES = {
    "delay": (Kind.INPUT_DELAY, "transport_delay", None, (3.4,)),
    "lag of the input": (Kind.INPUT_LAG, "further_lag", None, (4.0,)),
    "dead zone": (Kind.INPUT_MAP, "dead_zone", Map.DEAD_ZONE, (0.2,)),
    "play": (Kind.INPUT_PLAY, "backlash", None, (0.15,)),
    "limit of the sensor": (Kind.OUTPUT_MAP, "saturation", Map.UPPER, (0.9,)),
    "lag of the sensor": (Kind.OUTPUT_LAG, "further_lag", None, (5.0,)),
    "drift": (Kind.DRIFT, "parameter_drift", None, (0.1,)),
}


@pytest.mark.parametrize("case", PLACES)
def test_effects_around_a_black_box_are_those_in_the_equations(case: str) -> None:
    kind, name, code, numbers = PLACES[case]
    made = truth.circuit(3, 600, noise=0.0)
    outs = []
    for model in (boxed(), make.circuit()):
        run = make.runs_on(model, [make.experiment("circuit", made)], "linear")[0]
        scales = (3.0, 8.0 if kind in (Kind.INPUT_MAP, Kind.INPUT_PLAY) else 0.5, 1.0)
        at = 1 if kind == Kind.DRIFT else 0
        one = make.placed(
            name, kind, at, 2 if "INPUT" in kind.name else -1, scales=scales, code=code
        )
        structure = Structure(model, (one,), "linear", 1e-8)
        theta = np.array([*truth.CIRCUIT.values(), 0.3, *numbers, 0.0, 0.0, 0.0])
        start = np.zeros(structure.n_states)
        if kind in (Kind.INPUT_LAG, Kind.INPUT_PLAY) and start.size:
            start[2] = made["v"][0]
        path = path_of(structure, run, theta, start, np.ones(start.size))
        assert not path.failed
        outs.append(path.outputs[:, 0])
    box, inside = outs
    size = float(np.std(inside))
    kinked = kind in (Kind.INPUT_PLAY, Kind.INPUT_MAP)
    assert np.max(np.abs(box - inside)[60:]) < (0.08 if kinked else 0.03) * size


def test_what_is_missing_at_the_input_of_a_black_box_is_named() -> None:
    """A drive with a threshold of 1 V; what acts inside is said to be out of reach."""
    fit = make.experiment("circuit", truth.circuit(1, 600, drive_gap=1.0), "training")
    check = make.experiment("circuit", truth.circuit(51, 300, drive_gap=1.0), "check")
    RUNS.clear()
    found = diagnose_model(boxed(), fit, check, most_effects=1)
    first = found.missing[0]
    assert "dead_zone" in first.alias_set
    assert first.place["input"] == "v"
    assert abs(first.parameters[0].value - 1.0) < max(4.0 * first.parameters[0].stderr, 0.02)
    assert "out of reach" in found.unavailable["coulomb_friction"]
    assert "transport_delay" not in found.unavailable
    assert found.checks[0].after_rms[0] < 0.3 * found.checks[0].before_rms[0]
    assert len(RUNS) < 20_000


def test_a_black_box_that_fails_loses_and_one_of_another_shape_is_refused() -> None:
    def stuck(t: np.ndarray, u: Any, p: Any) -> np.ndarray:
        if p.R < 1.0:
            raise ZeroDivisionError
        return circuit(t, u, p)

    model = replace(boxed(), simulate=stuck)
    run = make.runs_on(model, [make.experiment("circuit", truth.circuit(3, 200))])[0]
    structure = Structure(model)
    theta = structure.start()
    theta[1] = 0.5
    assert path_of(structure, run, theta, np.zeros(0), np.zeros(0)).failed

    def refused(simulate: Any, words: str) -> None:
        model = replace(boxed(), simulate=simulate)
        with pytest.raises(InputError, match="model: simulate: expected " + words):
            diagnose_model(model, make.experiment("circuit", truth.circuit(3, 200)))

    refused(lambda t, u, p: t[:10], r"outputs of shape \(133, 1\)")
    refused(lambda t, u, p: u.w, "outputs for .*AttributeError: .* 'w'")
    refused(lambda t, u, p: t * np.nan, r"a simulation of record from the starts \(.*no finite")
    refused(lambda t, u, p: 1 // 0, "a simulation .* found ZeroDivisionError")


def test_a_model_that_explains_nothing_is_not_called_complete() -> None:
    """A static model of an oscillator, at few rows; its held input is no part of a row late."""
    made = truth.body(5, 150)
    rng = np.random.default_rng(0)
    made["F"] = np.repeat(rng.choice([-20.0, 20.0], 30), 5)
    made["q"] = np.where(rng.random(150) < 0.6, made["q"], np.nan)
    model = Model.from_simulate(
        lambda t, u, p: u.F / p.k,
        {"F": "N"},
        {"q": "m"},
        {"k": P(80.0, 1.0, 300.0), "idle": P(1.0, 0.0, 2.0)},
    )
    found = diagnose_model(model, make.experiment("body", made), most_effects=0)
    assert found.verdict == "unexplained_structure"
    assert any("do not fix idle" in words for words in found.remarks)
    assert [row[1] for row in found.parameter_grid().rows][1] == "not fixed"
    assert not any("clocks" in words for words in found.remarks)
