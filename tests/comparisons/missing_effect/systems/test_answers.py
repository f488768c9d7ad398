"""How a run answers to every kind of number, against central differences of runs made again."""

from __future__ import annotations

import numpy as np
import pytest
import system_models as make
import system_truths as truth

from comparisons.missing_effect.systems.fit import scales_of
from comparisons.missing_effect.systems.linearised import Linearised
from comparisons.missing_effect.systems.model import Model
from comparisons.missing_effect.systems.places import Placed
from comparisons.missing_effect.systems.shapes import Kind, Map, Term
from comparisons.missing_effect.systems.simulate import own_starts, path_of
from comparisons.missing_effect.systems.structure import Run, Structure

TIGHT = 1e-9
N = 300
# Of the central differences: well above what the integrator rounds.
STEP = 2e-3
# Scales of the body's run: of dv/dt, of what a term acts on, of a second signal or a time.
SPEED, AT, FORCE = (5.0, 1.5, 0.3), (5.0, 0.3, 0.3), (1.0, 20.0, 1.0)

# Effect, slots, and how far a column may be off, over its norm: smooth ones to the order of the
# propagators; those with a kink as far as four points a sample resolve the moment of the kink.
SMOOTH, KINKED = 2e-3, 3e-2
EFFECTS: dict[str, tuple[Placed, list[float], float]] = {
    "cubic_stiffness": (make.placed("cubic_stiffness", Kind.TERM, 1, 0, scales=AT), [-0.4], SMOOTH),
    "coulomb_friction": (
        make.placed("coulomb_friction", Kind.TERM, 1, 1, scales=SPEED),
        [-0.1, 0.2],
        SMOOTH,
    ),
    "stribeck_friction": (
        make.placed("stribeck_friction", Kind.TERM, 1, 1, scales=SPEED),
        [-0.1, 0.2, 0.5],
        # The excess acts within a tenth of the rms speed: hardly a sample wide.
        0.1,
    ),
    "contact": (
        make.placed("dead_zone", Kind.TERM, 1, 0, scales=AT, code=Term.GAP),
        [-0.5, 0.6],
        KINKED,
    ),
    "gravity": (make.placed("gravity", Kind.TERM, 1, scales=AT, code=Term.CONSTANT), [0.3], SMOOTH),
    "dead_zone": (make.placed("dead_zone", Kind.INPUT_MAP, 0, 2, scales=FORCE), [0.15], KINKED),
    "saturation of the input": (
        make.placed("saturation", Kind.INPUT_MAP, 0, 2, scales=FORCE, code=Map.BOTH),
        [0.9],
        KINKED,
    ),
    "saturation of the state": (
        make.placed("saturation", Kind.STATE_LIMIT, 0, 0, scales=(1.0, 0.3, 1.0), code=Map.BOTH),
        [1.8],
        KINKED,
    ),
    "saturation of the sensor": (
        make.placed("saturation", Kind.OUTPUT_MAP, 0, scales=(1.0, 0.3, 1.0), code=Map.UPPER),
        [0.9],
        SMOOTH,
    ),
    "delay": (make.placed("transport_delay", Kind.INPUT_DELAY, 0, 2), [3.3], SMOOTH),
    "lag of the input": (make.placed("further_lag", Kind.INPUT_LAG, 0, 2), [4.0], SMOOTH),
    "lag of the sensor": (make.placed("further_lag", Kind.OUTPUT_LAG, 0), [5.0], SMOOTH),
    "backlash": (make.placed("backlash", Kind.INPUT_PLAY, 0, 2, scales=FORCE), [0.15], KINKED),
    "hysteresis": (
        make.placed("hysteresis", Kind.HYSTERESIS, 1, 1, scales=(5.0, 1.5, 0.2)),
        [-0.3, 0.8, -0.7],
        KINKED,
    ),
    "drift": (
        make.placed("parameter_drift", Kind.DRIFT, 2, scales=(80.0, 1.0, 1.0)),
        [0.1],
        SMOOTH,
    ),
}


def run_of(model: Model, between: str = "cubic") -> Run:
    record = make.experiment("body", truth.body(3, N, noise=0.0))
    return make.runs_on(model, [record], between)[0]


def worst(structure: Structure, theta: np.ndarray, run: Run, begun: np.ndarray) -> dict[str, float]:
    """How far each column is off, over its norm, by the name of its number."""
    start = own_starts(structure, run, begun)
    first = path_of(structure, run, theta, start, np.ones(start.size))
    assert not first.failed
    scale = scales_of(structure, [first])
    path = path_of(structure, run, theta, start, scale)
    which = structure.free
    columns = Linearised(structure, run, theta, path, scale).to_numbers(which)

    def outputs(moved: np.ndarray, at: np.ndarray) -> np.ndarray:
        return path_of(structure, run, moved, at, scale).outputs

    off = {}
    names = [f"θ{i}" for i in which] + [f"x{i}" for i in structure.started]
    for c, name in enumerate(names):
        theta_moved, start_moved = np.zeros(theta.size), np.zeros(start.size)
        if c < which.size:
            theta_moved[which[c]] = STEP * max(abs(theta[which[c]]), 1.0)
        else:
            own = structure.started[c - which.size]
            start_moved[own] = STEP * scale[own]
        above = outputs(theta + theta_moved, start + start_moved)
        below = outputs(theta - theta_moved, start - start_moved)
        wanted = (above - below) / (2.0 * (theta_moved.sum() + start_moved.sum()))
        size = float(np.linalg.norm(wanted))
        own = float(np.linalg.norm(columns[:, :, c] - wanted))
        off[name] = own / size if size > 0.0 else own
    return off


@pytest.mark.parametrize("between", ["cubic", "linear", "band"])
def test_parameters_offset_and_starts(between: str) -> None:
    """A linear way has kinks at the samples, where an offset's derivative jumps."""
    model = make.body()
    structure = Structure(model, (), between, TIGHT)
    theta = np.array([2.0, 1.5, 80.0, 0.3])
    off = worst(structure, theta, run_of(model, between), np.array([0.05, 0.2]))
    assert max(off.values()) < (KINKED if between == "linear" else SMOOTH), off


@pytest.mark.parametrize("name", EFFECTS)
def test_effects(name: str) -> None:
    effect, slots, allowed = EFFECTS[name]
    model = make.body()
    structure = Structure(model, (effect,), "cubic", TIGHT)
    theta = np.concatenate([[2.0, 1.5, 80.0, 0.2], structure.slots(tuple(slots))])
    off = worst(structure, theta, run_of(model), np.array([0.05, 0.2]))
    assert max(off.values()) < allowed, off


def test_a_nonlinear_model_with_two_effects_and_two_outputs() -> None:
    """Derivatives through one effect into the other, and of both outputs."""
    model = make.body(
        outputs={"q": "m", "w": "m/s"},
        rhs=lambda t, x, u, p: (
            x.speed,
            (u.F - p.c * x.speed * abs(x.speed) - p.k * x.at**3 * 4.0) / p.M,
        ),
        output=lambda t, x, u, p: (x.at + 0.1 * x.at**2, x.speed),
    )
    record = truth.body(3, N, noise=0.0, with_speed=True)
    record["w"] = record.pop("v")
    run = make.runs_on(model, [make.experiment("body", record)])[0]
    lag = make.placed("further_lag", Kind.INPUT_LAG, 0, 2)
    drag = make.placed("coulomb_friction", Kind.TERM, 1, 1, scales=SPEED)
    structure = Structure(model, (lag, drag), "cubic", TIGHT)
    theta = np.concatenate(
        [[2.0, 1.5, 80.0, 0.2], structure.slots((3.0,)), structure.slots((-0.1, 0.25))]
    )
    off = worst(structure, theta, run, np.array([0.05, 0.2]))
    assert max(off.values()) < SMOOTH, off


def test_the_recording_filter() -> None:
    """In a nonlinear model, since a linear one commutes with it: its columns are all but zero."""
    model = make.body(
        rhs=lambda t, x, u, p: (x.speed, (u.F - p.c * x.speed - p.k * x.at - 600.0 * x.at**3) / p.M)
    )
    filter_ = make.placed("recording_filter", Kind.RECORDING, -1)
    structure = Structure(model, (filter_,), "cubic", TIGHT)
    theta = np.concatenate([[2.0, 1.5, 80.0, 0.2], structure.slots((0.6, 0.15))])
    off = worst(structure, theta, run_of(model), np.array([0.05, 0.2]))
    assert max(off.values()) < KINKED, off
