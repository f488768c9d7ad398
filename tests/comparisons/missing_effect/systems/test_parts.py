"""What effects are: their signs, shapes and places; terms without a name; units."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import system_models as make
import system_truths as truth
from made_systems import STATES, fit_of, machine, placed_at

from comparisons.missing_effect.systems.catalogue import SYSTEM_CATALOGUE
from comparisons.missing_effect.systems.fit import Fit
from comparisons.missing_effect.systems.metric import raw_metric
from comparisons.missing_effect.systems.model import Model, P
from comparisons.missing_effect.systems.open_terms import OPEN_TERMS, open_effect
from comparisons.missing_effect.systems.places import Place, Placed
from comparisons.missing_effect.systems.quantities import covariance, numbers_of
from comparisons.missing_effect.systems.roles import against_storing, displacements, rates, rates_of
from comparisons.missing_effect.systems.score import Probe, Prober, placed_effects
from comparisons.missing_effect.systems.shapes import Kind, Map
from comparisons.missing_effect.systems.structure import Run, Structure
from comparisons.missing_effect.systems.system import is_exceeded
from comparisons.missing_effect.systems.units import product_of_units
from surge_core.errors import InputError

BODY = [truth.BODY[name] for name in ("M", "c", "k")]


def body_with(force: object, n: int = 800, noise: float = 0.01) -> tuple[Model, Run]:
    model = make.body()
    made = truth.body(5, n, force=force, noise=noise)  # type: ignore[arg-type]
    return model, make.runs_on(model, [make.experiment("body", made)])[0]


def bare_fit(model: Model, run: Run, theta: list[float] | None = None) -> Fit:
    structure = Structure(model, (), "cubic", 1e-6, offsets_free=False)
    return make.fitted(structure, [run], theta and [*theta, 0.0])


def probed(fit: Fit, run: Run, effects: object) -> list[Probe]:
    placed, _ = placed_effects(fit, [run], list(effects))  # type: ignore[call-overload]
    return Prober(fit, [run], placed).in_metric(raw_metric([run.outputs])).best()


def fitted_with(fit: Fit, run: Run, effect: Placed, slots: tuple[float, ...]) -> Fit:
    structure = fit.structure.with_effect(effect)
    return make.fitted(structure, [run], [*fit.theta, *structure.slots(slots)])


@pytest.mark.parametrize("drag", [0.1, -0.1])
def test_what_drives_is_no_resistance(drag: float) -> None:
    """A drag that pushes is no drag: neither friction nor a drag fits it, an open term does."""
    model, run = body_with(lambda t, q, v: -drag * v * abs(v))
    found = probed(bare_fit(model, run), run, [*SYSTEM_CATALOGUE, *OPEN_TERMS])
    gains = {p.placed.name: p.gain for p in reversed(found)}
    assert (gains["quadratic_drag"] > 0.0) == (drag > 0.0)
    if drag < 0.0:
        # Friction that is stronger than it was is what a fit without the drag leaves of it.
        assert gains["open_cube"] > 20.0
        fit = bare_fit(model, run)
        effect = next(p.placed for p in found if p.placed.name == "quadratic_drag")
        assert fitted_with(fit, run, effect, (-0.01,)).theta[-4] == 0.0


def test_a_contact_pushes_back_on_what_moves_it() -> None:
    """Between two bodies, on the distance d: dd/dt = v₁ − v₂; a contact slows 1 and drives 2."""
    model = make.body(
        states={"d": "m", "v_1": "m/s", "v_2": "m/s"},
        outputs={"q": "m"},
        rhs=lambda t, x, u, p: (x.v_1 - x.v_2, (u.F - p.c * x.v_1) / p.M, -p.k * x.v_2),
        output=lambda t, x, u, p: x.d,
        exact=("d",),
        balance={},
    )
    assert (displacements(model), rates(model)) == ((0, 1, 2), (1, 2))
    places = {(p.at, p.signal): p.sign for p in against_storing(model) if p.signal == 0}
    assert places == {(1, 0): 1, (2, 0): -1}
    contact = next(e for e in SYSTEM_CATALOGUE if (e.name, e.kind) == ("dead_zone", Kind.TERM))
    flipped = Placed(contact, Place(2, 0, sign=-1), (2.0, 0.5, 1.0), ())
    assert flipped.floats == (-2.0, 0.5, 1.0, 0.0, 0.0)
    assert contact.numbers[0].high == 0.0
    # Heat flows both ways between two stores: no place for what pushes back.
    assert {(p.at, p.signal) for p in against_storing(make.thermal())} == {(0, 0), (1, 1)}


def bouc_wen(n: int, ratio: float, seed: int = 5) -> dict[str, np.ndarray]:
    """The body with F_h = 6 N on a reach of 0.3 m, and a loop of any shape."""
    rng = np.random.default_rng(seed)
    force = truth.tones(rng, 20.0, 2.0)
    p = truth.BODY

    def slopes(t: float, x: list[float]) -> list[float]:
        q, v, z = x
        dz = (v - 0.5 * abs(v) * z - 0.5 * ratio * v * abs(z)) / 0.3
        return [v, (force(t) - p["c"] * v - p["k"] * q - 6.0 * z) / p["M"], dz]

    states = truth.integrated(slopes, [0.05, 0.0, 0.0], n, truth.BODY_PERIOD_S, substeps=16)
    return {
        "F": truth.sampled(force, n, truth.BODY_PERIOD_S),
        "q": truth.noisy(states[:, 0], 0.002, rng),
    }


@pytest.mark.parametrize("ratio", [1.0, -1.375])
def test_a_loop_of_any_shape_is_found(ratio: float) -> None:
    model = make.body()
    run = make.runs_on(model, [make.experiment("body", bouc_wen(1500, ratio))])[0]
    fit = bare_fit(model, run)
    placed, _ = placed_effects(fit, [run], [e for e in SYSTEM_CATALOGUE if e.name == "hysteresis"])
    assert [one.place for one in placed] == [Place(1, 1)]
    whole = min(
        (fitted_with(fit, run, placed[0], (-0.1, *start[1:])) for start in placed[0].starts),
        key=lambda one: one.cost,
    )
    cov = covariance(whole, [run], raw_metric([run.outputs]))
    numbers = {n.name: n for n in numbers_of(whole, placed[0], cov, run.clock)}
    for name, wanted in (("F_h", 6.0), ("reach", 0.3), ("ratio", ratio)):
        number = numbers[name]
        assert abs(number.value - wanted) < max(4.0 * number.stderr, 0.02 * abs(wanted)), number
    assert np.std(whole.errors[0]) < 1.1 * 0.002 * np.std(run.outputs)


@pytest.mark.parametrize("clipped", [True, False])
def test_readings_beyond_a_limit_of_the_sensor_rule_it_out(clipped: bool) -> None:
    made = truth.body(5, 800, noise=0.0)
    limit = 0.6 * float(np.max(made["q"]))
    read = np.minimum(made["q"], limit if clipped else np.inf)
    read += 0.01 * limit * np.random.default_rng(2).standard_normal(800)
    kind, scales = Kind.OUTPUT_MAP, (1.0, limit, 1.0)
    placed = make.placed("saturation", kind, 0, scales=scales, code=Map.UPPER)
    structure = Structure(make.body(), (placed,), "cubic", 1e-6, offsets_free=False)
    run = make.runs_on(make.body(), [make.experiment("body", {**made, "q": read})])[0]
    theta = np.array([*BODY, 0.0, 1.0, 0.0, 0.0, 0.0])
    fit = replace(make.fitted(structure, [run], theta), theta=theta)
    assert is_exceeded(fit, placed, [run]) is not clipped


def test_the_exponent_of_a_sensor_that_is_blind_to_the_sign_is_found() -> None:
    model = make.body(
        params={**make.body().params, "gain": P(1.0, 0.01, 100.0, "1")},
        output=lambda t, x, u, p: p.gain * x.at,
    )
    made = truth.body(5, 800, sensor=lambda q: np.abs(3.0 * q) ** 1.7, noise=0.01)
    run = make.runs_on(model, [make.experiment("body", made)])[0]
    sensor = next(e for e in SYSTEM_CATALOGUE if e.name == "absolute_value_sensor")
    scale = float(np.sqrt(np.mean(run.outputs**2)))
    effect = Placed(sensor, Place(0), (1.0, scale, 1.0), ((1.0,), (1.8,)))
    structure = Structure(model, (effect,), "cubic", 1e-6, offsets_free=False)
    fit = make.fitted(structure, [run], [*BODY, 1.0, 0.0, 1.8, 0.0, 0.0, 0.0])
    cov = covariance(fit, [run], raw_metric([run.outputs]))
    number = numbers_of(fit, effect, cov, run.clock)[0]
    assert (number.name, number.unit) == ("exponent", "1")
    assert abs(number.value - 1.7) < 4.0 * number.stderr < 0.08


def test_a_sensor_may_be_blind_only_to_a_sign_that_the_model_changes() -> None:
    """A level is never negative: nothing can be said of what its sensor would show there."""
    model = make.tanks()
    run = make.runs_on(model, [make.experiment("tanks", truth.tanks(1, 600))])[0]
    names = ("absolute_value_sensor", "rectifying_sensor")
    blind = [e for e in SYSTEM_CATALOGUE if e.name in names]
    placed, refused = placed_effects(bare_fit(model, run), [run], blind)
    assert placed == []
    assert all(words.startswith("needs an output that changes sign") for words in refused.values())
    model, run = body_with(lambda t, q, v: 0.0)
    half = replace(run, outputs=np.abs(run.outputs))
    fit = bare_fit(model, run, BODY)
    assert {one.name for one in placed_effects(fit, [half], blind)[0]} == set(names)
    assert placed_effects(fit, [run], blind)[0] == []


@pytest.mark.parametrize(
    ("power", "label", "unit", "written"),
    [
        (1, "open_product(at·speed) in dspeed/dt", "N·s/m²", "at·speed"),
        (2, "open_square_product(at²·speed) in dspeed/dt", "N·s/m³", "at^2 speed"),
    ],
)
def test_a_product_is_found_with_its_coefficient(
    power: int, label: str, unit: str, written: str
) -> None:
    """As one of the terms without a name, and as a term of one's own."""
    amount = 4.0
    model, run = body_with(lambda t, q, v: -amount * q**power * v, n=1500)
    fit = bare_fit(model, run)
    best = probed(fit, run, OPEN_TERMS)[0].placed
    assert best.label(model) == label
    own, _ = placed_effects(fit, [run], [open_effect(written)])
    assert [one.label(model) for one in own] == [f"open_{written} of dspeed/dt"]
    for effect in (best, own[0]):
        whole = fitted_with(fit, run, effect, (0.0,))
        cov = covariance(whole, [run], raw_metric([run.outputs]))
        number = numbers_of(whole, effect, cov, run.clock)[0]
        assert number.unit == unit
        assert abs(number.value + amount) < 4.0 * number.stderr < 0.3 * amount


def test_products_of_what_keeps_its_sign_are_tried_about_its_mean_as_well() -> None:
    model = make.tanks()
    run = make.runs_on(model, [make.experiment("tanks", truth.tanks(1, 400))])[0]
    fit = bare_fit(model, run)
    found = {p.label(model): p for p in placed_effects(fit, [run], OPEN_TERMS)[0]}
    plain = found["open_product(upper·q) in dupper/dt"]
    centred = found["open_centred_product(upper·q) in dupper/dt"]
    assert plain.centres == (0.0, 0.0)
    mean = float(np.mean(fit.paths[0].states[::4, 0]))
    assert centred.centres == pytest.approx((mean, np.mean(run.experiment.channels["q"])))
    assert centred.equation(model).startswith(f"+ c (upper − {mean:.4g})·(q − ")
    assert "open_square_product(q²·upper) in dlower/dt" in found
    model, run = body_with(lambda t, q, v: 0.0)
    swinging = placed_effects(bare_fit(model, run), [run], OPEN_TERMS)[0]
    assert not [one for one in swinging if one.effect.centred]


def test_a_term_of_ones_own_may_be_a_function_of_anything() -> None:
    model, run = body_with(lambda t, q, v: -3.0 * np.sin(8.0 * q), n=1000)
    fit = bare_fit(model, run)
    for term in (
        open_effect("sin(8·at)"),
        open_effect("sine of place", lambda t, x, u, p: np.sin(8.0 * x.at)),
    ):
        placed, _ = placed_effects(fit, [run], [term])
        whole = fitted_with(fit, run, placed[0], (0.0,))
        cov = covariance(whole, [run], raw_metric([run.outputs]))
        number = numbers_of(whole, placed[0], cov, run.clock)[0]
        assert abs(number.value + 3.0) < 4.0 * number.stderr < 1.5
        assert number.unit == "N"
    assert placed_effects(fit, [run], [open_effect("sway", lambda t, x, u, p: np.sin(t))])[0]


@pytest.mark.parametrize(
    "written", ["at +", "import os", "at.speed", "open('x')", "at if 1 else 2"]
)
def test_what_is_no_term_is_refused(written: str) -> None:
    with pytest.raises(InputError, match=r"library: .*what is no such term"):
        open_effect(written)
    model, run = body_with(lambda t, q, v: 0.0, n=200)
    with pytest.raises(InputError, match="expected at, speed, F, M, c, k, found 'w'"):
        placed_effects(bare_fit(model, run), [run], [open_effect("at w")])


def test_a_definition_may_be_scaled() -> None:
    """dq/dt = 0.25 w and dr/dt = (M/2) w: w is the rate of both; q²/dt is no definition of one."""
    model = make.body(
        states={"q": "m", "r": "m", "s": "m", "w": "rad/s"},
        rhs=lambda t, x, u, p: (0.25 * x.w, 0.5 * p.M * x.w, x.w * x.q, u.F - p.c * x.w - x.r),
        output=lambda t, x, u, p: x.q,
        exact=("q", "r", "s"),
        balance={},
    )
    found = rates_of(model)
    assert {i: j for i, (j, _) in found.items()} == {0: 3, 1: 3}
    assert found[0][1] == pytest.approx(0.25)
    assert np.isnan(found[1][1])


@pytest.mark.parametrize(
    ("factors", "wanted"),
    [
        ((("ticks/s^2", 1), ("s", -1), ("ticks/s", -2)), "1/(ticks·s)"),
        ((("N s/m", 1), ("m/s", 1)), "N"),
        ((("kPa s²/dm³", 1), ("dm³/s", 2)), "kPa·dm³"),
        ((("m^0.5/s", 1), ("cm^(1/2)/N", -1), ("m^1.5", 1)), "m²·N/(s·cm^(1/2))"),
        ((("N.s/m", 1), ("m/s2", 1)), "N/s"),
        ((("-", 1), ("1", 1), ("s", -1)), "1/s"),
        ((("J/(kg·K)", 1), ("kg", 1), ("K", 1)), "J"),
        ((("%, full scale", 1),), "%, full scale"),
        ((("(V", 1), ("s", -1)), "(V/s"),
    ],
)
def test_units_cancel(factors: tuple[tuple[str, float], ...], wanted: str) -> None:
    assert product_of_units(*factors) == wanted


@pytest.mark.parametrize(
    ("speed", "reach"),
    [("m/s", "m"), ("rad/s", "rad"), ("1/s", "1"), ("m/s²", "m/s"), ("1", "s"), ("A", "A·s")],
)
def test_what_a_rate_sums_up_to_has_the_unit_of_the_sum(speed: str, reach: str) -> None:
    model = machine()
    model = replace(model, states={**STATES, "v": speed})
    effect = placed_at(model, "hysteresis")
    fit = fit_of(model, (effect,), ())
    clock = np.array([0.0, 0.02, 0.0, 1.0])
    _, second, _ = numbers_of(fit, effect, np.eye(fit.theta.size), clock)
    assert (second.name, second.unit) == ("reach", reach)
