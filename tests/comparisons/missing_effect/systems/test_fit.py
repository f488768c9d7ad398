"""Fits: the truth over seeds, honest intervals, bounds, several runs, what is known of starts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import system_models as make
import system_truths as truth
from scipy.integrate import solve_ivp

from comparisons.missing_effect import Experiment, diagnose_model
from comparisons.missing_effect.systems import quantities
from comparisons.missing_effect.systems.bench import Bench
from comparisons.missing_effect.systems.fit import fit_runs, settled
from comparisons.missing_effect.systems.metric import metric_of, raw_metric
from comparisons.missing_effect.systems.model import Model, P
from comparisons.missing_effect.systems.quantities import asked_beyond, covariance, numbers_of
from comparisons.missing_effect.systems.records import Records
from comparisons.missing_effect.systems.shapes import Kind
from comparisons.missing_effect.systems.structure import Run, Structure

TRUE = np.array([truth.BODY[name] for name in ("M", "c", "k")])
N = 600
SEEDS = 40
COVERED_ROWS = 1500
NOISE = 0.02


PREY = Model(
    states={"a": "1", "b": "1"},
    inputs={},
    outputs={"hunter": "1", "hunted": "1"},
    params={name: P(1.0, 0.05, 5.0, "1/s") for name in ("gain", "death", "birth", "loss")},
    rhs=lambda t, x, u, p: (x.a * (p.gain * x.b - p.death), x.b * (p.birth - p.loss * x.a)),
    output=lambda t, x, u, p: (x.a, x.b),
)


def ar1(n: int, a: float, rng: np.random.Generator) -> np.ndarray:
    """Coloured noise of unit variance."""
    out = np.empty(n)
    out[0] = rng.standard_normal()
    for k in range(1, n):
        out[k] = a * out[k - 1] + np.sqrt(1 - a * a) * rng.standard_normal()
    return out


@pytest.fixture(scope="module")
def quiet() -> tuple[Structure, Run]:
    model = make.body()
    run = make.runs_on(model, [make.experiment("body", truth.body(5, COVERED_ROWS, noise=0.0))])[0]
    return Structure(model, (), "cubic", 1e-6), run


def z_scores(structure: Structure, run: Run, a: float) -> np.ndarray:
    """Errors of the parameters over their standard errors, one row a seed."""
    out = []
    size = NOISE * float(np.std(run.outputs))
    for seed in range(SEEDS):
        noise = size * ar1(COVERED_ROWS, a, np.random.default_rng(1000 + seed))[:, None]
        noisy = replace(run, outputs=run.outputs + noise)
        fit = make.fitted(structure, [noisy], [*TRUE, 0.0])
        raw = raw_metric([noisy.outputs])
        stderr = np.sqrt(np.diag(covariance(fit, [noisy], raw))[:3])
        out.append((fit.theta[:3] - TRUE) / stderr)
    return np.array(out)


def test_a_bound_that_is_in_the_way_is_reported(quiet: tuple[Structure, Run]) -> None:
    """Bounds a tenth below, at and above the truth; one at the truth is pressed by noise alone."""
    structure, run = quiet
    (name, p), size = next(iter(structure.model.params.items())), NOISE * np.std(run.outputs)
    for seed, share in enumerate([0.9, 1.0, 1.0, 1.0, 1.1]):
        noise = size * np.random.default_rng(seed).standard_normal(run.outputs.shape)
        own = replace(p, start=p.low, high=share * TRUE[0])
        model = replace(structure.model, params={**structure.model.params, name: own})
        noisy = replace(run, outputs=run.outputs + noise)
        fit = make.fitted(replace(structure, model=model), [noisy], [p.low, *TRUE[1:], 0.0])
        asked = asked_beyond(fit, [noisy], raw_metric([noisy.outputs]))
        assert [name in each for each in asked] == [True] * (share < 1.0)


@pytest.mark.parametrize(("a", "spread"), [(0.0, (0.75, 1.35)), (0.8, (0.75, 1.45))])
def test_the_truth_is_found_and_intervals_cover_it(
    a: float, spread: tuple[float, float], quiet: tuple[Structure, Run]
) -> None:
    """Forty records with white or coloured noise: z has mean zero and spread one."""
    z = z_scores(*quiet, a)
    assert np.all(np.abs(np.mean(z, axis=0)) < 3.5 * spread[1] / np.sqrt(SEEDS)), np.mean(z, axis=0)
    sizes = np.sqrt(np.mean(z**2, axis=0))
    assert np.all((sizes > spread[0]) & (sizes < spread[1])), sizes
    assert np.mean(np.abs(z) < 1.96) > 0.85


def test_the_number_of_an_effect_and_its_error_are_right() -> None:
    """A drag of 0.4 N/(m/s)² over seeds of the input and the noise."""
    model = make.body()
    effect = make.placed("quadratic_drag", Kind.TERM, 1, 1, scales=(10.0, 1.5, 1.0))
    structure = Structure(model, (effect,), "cubic", 1e-6, offsets_free=False)
    z = []
    for seed in range(12):
        made = truth.body(seed, N, force=lambda t, q, v: -0.4 * v * abs(v), noise=NOISE)
        run = make.runs_on(model, [make.experiment("body", made)])[0]
        fit = make.fitted(structure, [run], [*TRUE, 0.0, 0.0, 0.0, 0.0, 0.0])
        cov = covariance(fit, [run], raw_metric([run.outputs]))
        number = numbers_of(fit, effect, cov, run.clock)[0]
        assert number.unit == "N·s²/m²"
        assert number.stderr < 0.08
        assert [quantities.is_nothing(fit, effect, k * cov) for k in (1, 1e4)] == [False, True]
        z.append((abs(number.value) - 0.4) / number.stderr)
    assert np.all(np.abs(z) < 4.0), z
    assert 0.4 < np.sqrt(np.mean(np.square(z))) < 1.8


@pytest.mark.parametrize("start", [(2.0, 0.1, 8.0), (10.0, 0.1, 20.0)])
def test_a_model_from_afar_comes_home(start: tuple[float, ...]) -> None:
    """A resonance that starts at a fifth of its frequency: one fit alone ends at 50 kg."""
    searched = zip("Mck", start, (0.1, 0.0, 1.0), (50.0, 50.0, 1000.0), strict=True)
    model = make.body(params={name: P(*numbers) for name, *numbers in searched})
    records = Records.of(model, [make.experiment("body", truth.body(1, N, noise=0.01))])
    assert np.allclose(Bench.of(records).fit.theta[:3], TRUE, rtol=5e-3)


def prey(seed: int, n: int, crowding: float) -> Experiment:
    """A predator and its prey for n tenths of a second, read with an error of 0.06."""
    rng = np.random.default_rng(seed)
    t = 0.1 * np.arange(n)
    x = solve_ivp(
        lambda t, x: (x[0] * (0.9 * x[1] - 1.1), x[1] * (1.1 - 0.9 * x[0] - crowding * x[1])),
        (0.0, t[-1]), rng.uniform(0.5, 2.5, 2), t_eval=t, rtol=1e-8,
    ).y  # fmt: skip
    hunter, hunted = x + 0.06 * rng.standard_normal(x.shape)
    return Experiment(f"prey {seed}", 0.1, {"hunter": hunter, "hunted": hunted})


@pytest.mark.parametrize(("seed", "n"), [(0, 800), (1, 1500), (2, 1500), (3, 400), (5, 800)])
def test_what_swings_freely_is_fitted_over_many_periods(seed: int, n: int) -> None:
    """Up to 25 periods: from any start alone half of the fits end in another optimum."""
    theta = Bench.of(Records.of(PREY, [prey(seed, n, 0.0)])).fit.theta
    assert np.allclose(theta[:4], [0.9, 1.1, 1.1, 0.9], rtol=0.03)


@pytest.mark.parametrize("seed", [1, 5, 9])
def test_a_record_that_dies_out_is_not_called_complete(seed: int) -> None:
    assert diagnose_model(PREY, prey(seed, 140, 0.2)).verdict != "nothing_missing"


def test_bounds_hold_and_the_rest_is_fitted_beside_them() -> None:
    """A spring that may not be as stiff as it is ends at its bound; opened, it leaves it."""
    record = make.experiment("body", truth.body(5, N, noise=0.005))
    tight = make.body(params={**make.body().params, "k": P(60.0, 5.0, 70.0)})
    structure = Structure(tight, (), "cubic", 1e-6, offsets_free=False)
    run = make.runs_on(tight, [record])[0]
    fit = make.fitted(structure, [run])
    assert fit.theta[2] == 70.0
    assert fit.theta[2] / fit.theta[0] == pytest.approx(40.0, rel=0.1)


def test_two_runs_of_unequal_length_and_their_order() -> None:
    """Each run has a start of its own; the sums do not know which came first."""
    model = make.body()
    records = [
        make.experiment("body", truth.body(5, 700, noise=NOISE), "long"),
        make.experiment("body", truth.body(6, 250, noise=NOISE), "short", 100.0),
    ]
    structure = Structure(model, (), "cubic", 1e-6, offsets_free=False)
    runs = make.runs_on(model, records)
    both = make.fitted(structure, runs)
    turned = make.fitted(structure, runs[::-1])
    raw = raw_metric([run.outputs for run in runs])
    stderr = np.sqrt(np.diag(covariance(both, runs, raw))[:3])
    assert np.all(np.abs(both.theta[:3] - TRUE) < 4.0 * stderr)
    assert np.all(np.abs(both.theta[:3] - turned.theta[:3]) < 0.2 * stderr)
    assert both.cost == pytest.approx(turned.cost, abs=0.1)
    assert both.starts[0] == pytest.approx(turned.starts[1], abs=1e-2)


def test_what_is_known_of_a_start_pulls_as_its_error_says() -> None:
    """A start known to be 0.3 m/s off: a wide error leaves it to the data, a narrow one rules."""
    model = make.body()
    record = make.experiment("body", truth.body(5, N, noise=NOISE))
    structure = Structure(model, (), "cubic", 1e-6, offsets_free=False)
    speeds = []
    for sd in (np.inf, 10.0, 1e-4):
        known = ([0.05, 0.3], [np.inf, sd])
        runs = make.runs_on(model, [record], known=known)
        speeds.append(make.fitted(structure, runs).starts[0][1])
    free, wide, narrow = speeds
    assert free == pytest.approx(0.0, abs=0.1)
    assert wide == pytest.approx(free, abs=2e-3)
    assert narrow == pytest.approx(0.3, abs=1e-3)
    # Forty rows weigh against what is known with the noise of all of them.
    fit = make.fitted(structure, runs := make.runs_on(model, [record]))
    raw = raw_metric([runs[0].outputs]).with_size_of(fit.errors)
    off = make.runs_on(model, [record], known=([0.05, 0.3], [np.inf, 0.02]))
    assert settled(fit, off, raw, rows=40).starts[0][1] == pytest.approx(free, abs=0.15)


def test_two_outputs_of_unlike_size_weigh_as_their_errors_ask() -> None:
    """Position in mm, with little noise, beside a speed that is mostly noise."""
    model = make.body(
        outputs={"q": "mm", "w": "m/s"}, output=lambda t, x, u, p: (1000.0 * x.at, x.speed)
    )
    made = truth.body(5, N, noise=0.005, with_speed=True)
    made["w"] = made.pop("v") + 3.0 * np.random.default_rng(9).standard_normal(N)
    made["q"] = 1000.0 * made["q"]
    run = make.runs_on(model, [make.experiment("body", made)])[0]
    fit = make.fitted(Structure(model, (), "cubic", 1e-6, offsets_free=False), [run])
    stderr = np.sqrt(np.diag(covariance(fit, [run], raw_metric([run.outputs])))[:3])
    assert np.all(np.abs(fit.theta[:3] - TRUE) < 4.0 * stderr)
    assert np.all(stderr < [0.02, 0.02, 0.6])


def test_the_colour_of_errors_is_found_and_helps() -> None:
    """Errors of an autoregression 0.9: whitened, they are white and the truth is nearer."""
    model = make.body()
    quiet = make.runs_on(model, [make.experiment("body", truth.body(5, N, noise=0.0))])[0]
    structure = Structure(model, (), "cubic", 1e-6, offsets_free=False)
    off = {"raw": [], "white": []}
    size = 0.05 * float(np.std(quiet.outputs))
    for seed in range(8):
        noise = size * ar1(N, 0.9, np.random.default_rng(seed))[:, None]
        run = replace(quiet, outputs=quiet.outputs + noise)
        raw = make.fitted(structure, [run], [*TRUE, 0.0])
        metric = metric_of(raw.errors)
        white = fit_runs(structure, [run], metric, raw.theta, raw.starts, raw.scale)
        left = metric.whitened(white.errors[0])[metric.lost :, 0]
        assert abs(np.corrcoef(left[1:], left[:-1])[0, 1]) < 0.12
        assert np.std(left) == pytest.approx(1.0, abs=0.1)
        off["raw"].append(raw.theta[:3] / TRUE - 1.0)
        off["white"].append(white.theta[:3] / TRUE - 1.0)
    spread = {key: np.sqrt(np.mean(np.square(value), axis=0)) for key, value in off.items()}
    assert np.all(spread["white"][[0, 2]] < spread["raw"][[0, 2]])


def test_errors_of_parameters_hold_while_the_offset_is_held() -> None:
    """An offset that was estimated and then held: the resistance moves with it, by ten errors."""
    model = make.circuit()
    record = make.experiment("circuit", truth.circuit(11, 1500))
    run = make.runs_on(model, [record])[0]
    begun = [truth.CIRCUIT[name] for name in "LRC"] + [0.0]
    raw = raw_metric([run.outputs])
    errors = []
    for free in (True, False):
        structure = Structure(model, (), "cubic", 1e-6, offsets_free=free)
        fit = make.fitted(structure, [run], begun)
        errors.append(np.sqrt(np.diag(covariance(fit, [run], raw))[:3]))
    assert errors[1][1] > 0.7 * errors[0][1]


def test_parameters_that_only_show_as_a_product_have_no_small_error() -> None:
    """A gain and its unit: b·g is found, b and g are anybody's guess."""
    model = make.body(
        params={**make.body().params, "b": P(1.0, 0.1, 10.0), "g": P(1.3, 0.1, 10.0)},
        rhs=lambda t, x, u, p: (x.speed, (p.b * p.g * u.F - p.c * x.speed - p.k * x.at) / 2.0),
    )
    run = make.runs_on(model, [make.experiment("body", truth.body(5, N))])[0]
    fit = make.fitted(Structure(model, (), "cubic", 1e-6, offsets_free=False), [run])
    stderr = np.sqrt(np.diag(covariance(fit, [run], raw_metric([run.outputs]))))
    assert fit.theta[3] * fit.theta[4] == pytest.approx(1.0, abs=0.01)
    assert stderr[3] > 0.3


def test_a_number_without_a_slope_stays_and_the_others_are_fitted() -> None:
    """A damped frequency whose ζ begins at 1: beyond it the root is no number."""
    model = make.body(
        params={"zeta": P(1.0, 0.1, 2.0), **make.body().params},
        rhs=lambda t, x, u, p: (
            x.speed,
            (u.F - p.c * x.speed - p.k * x.at) / p.M + np.sqrt(1.0 - p.zeta**2),
        ),
    )
    record = make.experiment("body", truth.body(5, N))
    run = make.runs_on(model, [record])[0]
    fit = make.fitted(Structure(model, (), "cubic", 1e-6, offsets_free=False), [run])
    stderr = np.sqrt(np.diag(covariance(fit, [run], raw_metric([run.outputs]))))
    assert (fit.theta[0], stderr[0]) == (1.0, np.inf)
    assert np.all(np.abs(fit.theta[1:4] - TRUE) < 4.0 * stderr[1:4])
    diagnosis = diagnose_model(model, [record, make.experiment("body", truth.body(6, N))])
    assert (diagnosis.after.theta[0], diagnosis.names) == (1.0, ())
