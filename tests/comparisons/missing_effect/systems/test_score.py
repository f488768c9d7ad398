"""What a score test promises, against what a fit then wins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import system_models as make
import system_truths as truth

from comparisons.missing_effect.systems.catalogue import SYSTEM_CATALOGUE
from comparisons.missing_effect.systems.fit import Fit, fit_runs
from comparisons.missing_effect.systems.metric import raw_metric
from comparisons.missing_effect.systems.open_terms import OPEN_TERMS
from comparisons.missing_effect.systems.places import Placed
from comparisons.missing_effect.systems.score import Probe, Prober, placed_effects
from comparisons.missing_effect.systems.shapes import Kind
from comparisons.missing_effect.systems.simulate import own_starts, path_of
from comparisons.missing_effect.systems.structure import Run, Structure

N = 1200
NOISE = 0.01
PARAMETERS = np.array([2.0, 1.5, 80.0, 0.0])
START = np.array([0.05, 0.0])


def body_run(seed: int) -> tuple[Structure, Run]:
    model = make.body()
    run = make.runs_on(model, [make.experiment("body", truth.body(seed, N, noise=0.0))])[0]
    return Structure(model, (), "cubic", 1e-8, offsets_free=False), run


def with_outputs(run: Run, outputs: np.ndarray, seed: int) -> Run:
    noise = np.random.default_rng(seed).standard_normal(outputs.shape)
    return replace(run, outputs=outputs + NOISE * np.std(outputs) * noise)


def placed_on(structure: Structure, run: Run) -> tuple[Fit, list[Probe]]:
    fit = make.fitted(structure, [run], PARAMETERS)
    effects, _ = placed_effects(fit, [run], [*SYSTEM_CATALOGUE, *OPEN_TERMS])
    return fit, Prober(fit, [run], effects).in_metric(raw_metric([run.outputs])).best()


@pytest.fixture(scope="module")
def bare() -> tuple[Structure, Run, list[Probe]]:
    """The body, its outputs without noise, and every effect at its place with its scales."""
    structure, run = body_run(5)
    path = path_of(structure, run, PARAMETERS, START, np.array([0.3, 1.5]))
    quiet = with_outputs(run, path.outputs, 5)
    return structure, replace(run, outputs=path.outputs), placed_on(structure, quiet)[1]


# Effects that are linear in an amplitude, and how much of it, in units of what the equation or the
# reading has.
CASES = (
    ("cubic_stiffness", -0.01),
    ("coulomb_friction", -0.01),
    ("softening_damping", -0.01),
    ("dead_zone", -0.02),
    ("hysteresis", -0.02),
    ("constant_bias", 0.01),
    ("parameter_drift", 0.01),
)


def made_with(structure: Structure, run: Run, probe: Probe, slots: tuple[float, ...]) -> Run:
    """The run of the body with an effect in it, noise added."""
    extended = structure.with_effect(probe.placed)
    theta = np.concatenate([PARAMETERS, extended.slots(slots)])
    start = own_starts(extended, run, START)
    scale = np.r_[0.3, 1.5, np.ones(start.size - 2)]
    path = path_of(extended, run, theta, start, scale)
    assert not path.failed
    return with_outputs(run, path.outputs, 7)


def nearly_largest(found: list[Probe], placed: Placed, share: float) -> Probe:
    """The probe of an effect, which has the largest gain or one that noise explains."""
    mine = next(p for p in found if p.placed.key == placed.key and p.placed.effect == placed.effect)
    told = (found[0].placed.name, found[0].gain, mine.gain)
    assert mine.gain > share * found[0].gain or found[0].gain - mine.gain < 5.0, told
    return mine


@pytest.mark.parametrize(("name", "amount"), CASES)
def test_the_gain_of_a_small_effect_is_what_a_fit_wins(
    name: str, amount: float, bare: tuple[Structure, Run, list[Probe]]
) -> None:
    """With the size of the errors fitted too, n/2 squared sizes less are −n/2 log(1 − 2 gain/n)."""
    structure, run, probes = bare
    places = [p for p in probes if p.placed.name == name and p.placed.effect.linear]
    assert places
    for known in places:
        made = made_with(structure, run, known, (amount, *known.start[1:]))
        fit, found = placed_on(structure, made)
        mine = nearly_largest(found, known.placed, 0.9)
        assert mine.amplitude == pytest.approx(amount, rel=0.25)
        # The shape is held where the search starts it, so that one number is won.
        first, *shape = mine.placed.effect.numbers
        held = zip(shape, mine.start[1:], strict=True)
        numbers = (first, *(replace(n, low=value, high=value) for n, value in held))
        one = replace(mine.placed, effect=replace(mine.placed.effect, numbers=numbers))
        bigger = fit.structure.with_effect(one)
        begun = np.concatenate([fit.theta, bigger.slots((0.0, *mine.start[1:]))])
        raw = raw_metric([made.outputs])
        won = fit.cost - fit_runs(bigger, [made], raw, begun, fit.starts).cost
        assert won == pytest.approx(-0.5 * N * np.log(1.0 - 2.0 * mine.gain / N), rel=0.05, abs=0.5)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("backlash", Kind.INPUT_PLAY),
        ("saturation", Kind.INPUT_MAP),
        ("saturation", Kind.OUTPUT_MAP),
        ("transport_delay", Kind.INPUT_DELAY),
        ("further_lag", Kind.OUTPUT_LAG),
    ],
)
def test_an_effect_without_an_amplitude_is_promised_whole(
    name: str, kind: Kind, bare: tuple[Structure, Run, list[Probe]]
) -> None:
    """Made at the mildest start of its search, the errors ask for about once what is laid along."""
    structure, run, probes = bare
    places = [p for p in probes if p.placed.name == name and p.placed.effect.kind == kind]
    assert places
    for known in places:
        mildest = known.placed.starts[0]
        _, found = placed_on(structure, made_with(structure, run, known, mildest))
        mine = nearly_largest(found, known.placed, 0.7)
        if mine.start == pytest.approx(mildest, rel=0.1):
            assert mine.amplitude == pytest.approx(1.0, abs=0.8), known.placed.name


def test_noise_alone_promises_what_chance_does(bare: tuple[Structure, Run, list[Probe]]) -> None:
    """Gains of effects with one number are half of χ² with one degree of freedom."""
    structure, run, _ = bare
    path = path_of(structure, run, PARAMETERS, START, np.array([0.3, 1.5]))
    gains = []
    for seed in range(6):
        _, found = placed_on(structure, with_outputs(run, path.outputs, 100 + seed))
        gains += [p.gain for p in found if p.placed.effect.linear and len(p.placed.starts) == 1]
    assert len(gains) > 80
    assert 0.25 < np.mean(gains) < 0.75
    assert np.mean(np.array(gains) > 0.5 * 3.84) < 0.15


def test_what_is_fitted_already_promises_nothing(bare: tuple[Structure, Run, list[Probe]]) -> None:
    """A spring and a damper are parameters: as open terms they say nothing, whatever is missing."""
    structure, run, probes = bare
    cubic = next(p for p in probes if p.placed.name == "cubic_stiffness")
    made = made_with(structure, run, cubic, (-0.05,))
    fit, found = placed_on(structure, made)
    terms = [p for p in found if p.placed.name == "open_linear" and p.placed.place.at == 1]
    assert all(p.gain < 0.05 * found[0].gain / 10.0 for p in terms)
    extended = structure.with_effect(cubic.placed)
    complete = make.fitted(extended, [made], np.concatenate([PARAMETERS, [-0.05, 0, 0, 0]]))
    effects, _ = placed_effects(complete, [made], SYSTEM_CATALOGUE)
    assert cubic.placed.key not in {e.key for e in effects}
    left = Prober(complete, [made], effects).in_metric(raw_metric([made.outputs])).best()
    assert left[0].gain < 12.0 < found[0].gain
    assert fit.cost > complete.cost
