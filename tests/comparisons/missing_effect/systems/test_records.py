"""Records: parameters of each record; readings that are missing."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import system_models as make
import system_truths as truth
from scipy.signal import lfilter

from comparisons.missing_effect.systems.bench import Bench
from comparisons.missing_effect.systems.diagnosis import diagnose_model
from comparisons.missing_effect.systems.experiments import Experiment, all_pass, held_rows, is_held
from comparisons.missing_effect.systems.fit import settled
from comparisons.missing_effect.systems.metric import metric_of, raw_metric
from comparisons.missing_effect.systems.model import Model, P
from comparisons.missing_effect.systems.quantities import covariance
from comparisons.missing_effect.systems.records import Records, check_run
from comparisons.missing_effect.systems.structure import Structure, laid


def biased_body(**changes: Any) -> Model:
    """The body with a force whose zero was set anew for each record."""
    given = {
        "params": {**make.body().params, "zero": P(0.0, -50.0, 50.0, "N", per_record=True)},
        "rhs": lambda t, x, u, p: (x.speed, (u.F + p.zero - p.c * x.speed - p.k * x.at) / p.M),
    }
    return make.body(**{**given, **changes})


def record(name: str, seed: int, zero: float, n: int = 600) -> Experiment:
    made = truth.body(seed, n, force=lambda t, q, v: zero, noise=0.01)
    return make.experiment("body", made, name)


ZEROS = {"one": 6.0, "two": -9.0}


def test_each_record_has_a_value_of_its_own() -> None:
    """Two records and a check with zeros of 6, −9 and 2 N; the check's from its first rows."""
    model = biased_body()
    assert "zero (of each record)" in str(model)
    given = [record(name, seed, zero) for seed, (name, zero) in enumerate(ZEROS.items())]
    check = replace(record("check", 7, 2.0), settle=100)
    found = diagnose_model(model, given, check, most_effects=0)
    rows = {row.name: row for row in found.parameters}
    assert list(rows) == ["M", "c", "k", "zero of one", "zero of two"]
    for name, zero in ZEROS.items():
        row = rows[f"zero of {name}"]
        assert row.unit == "N"
        assert abs(row.after - zero) < 4.0 * row.after_stderr < 2.0
    for name, wanted in truth.BODY.items():
        assert abs(rows[name].after - wanted) < 4.0 * rows[name].after_stderr
    run = found.checks[0]
    assert run.after_rms[0] < 1.3 * 0.01 * np.std(run.measured)


def test_a_value_of_a_record_keeps_its_bounds() -> None:
    zero = P(0.0, -5.0, 5.0, "N", per_record=True)
    model = biased_body(params={**make.body().params, "zero": zero})
    bench = Bench.of(Records.of(model, [record("one", 1, 6.0)]))
    assert bench.fit.starts[0][2] == 5.0


def test_a_check_begins_from_the_values_of_the_training_records() -> None:
    """With no row of its own a check has their mean, as far as they scatter."""
    records = Records.of(biased_body(), [record(n, i, z) for i, (n, z) in enumerate(ZEROS.items())])
    fit = Bench.of(records).fit
    run = check_run(records, record("check", 7, 2.0).of(records.model), fit)
    assert run.x0_mean[2] == pytest.approx(-1.5, abs=0.5)
    # The errors are white: what is known weighs as much as one row in one.
    assert run.x0_sd[2] == pytest.approx(np.std([6.0, -9.0], ddof=1), rel=0.2)
    slow = replace(fit, errors=tuple(np.repeat(e[::50], 50, axis=0) for e in fit.errors))
    held = check_run(records, record("check", 7, 2.0).of(records.model), slow)
    assert held.x0_sd[2] == pytest.approx(run.x0_sd[2] / np.sqrt(50.0), rel=0.4)
    there = settled(fit, [run], raw_metric([run.outputs]).with_size_of(fit.errors), rows=100)
    assert there.starts[0][2] == pytest.approx(2.0, abs=0.5)
    cov = covariance(fit, Bench.of(records).train, raw_metric([run.outputs]))
    assert cov.shape == (fit.theta.size + 2,) * 2


def test_a_check_takes_the_rows_that_fix_its_start() -> None:
    """The height of a drone with a slow thrust: 15 rows went wrong by four times the noise."""
    rng, h, runs = np.random.default_rng(0), 0.05, []
    for name in ("one", "two"):
        x, rows = np.array([0.0, 0.3, 0.5]), []
        for c in 0.8 * np.repeat(rng.choice([-1.0, 1.0], 30), 20):
            rows.append([c, x[0] + 0.02 * rng.standard_normal()])
            for _ in range(50):
                x = x + h / 50 * np.array([x[1], x[2] - 0.4 * x[1], (c - x[2]) / 0.15])
        runs.append(Experiment(name, h, dict(zip("cz", np.array(rows).T, strict=True))))
    model = Model(
        {"s": "m", "w": "m/s", "f": "m/s^2"},
        {"c": "m/s^2"},
        {"z": "m"},
        {"d": P(0.2, 0.01, 5.0, "1/s"), "T": P(0.1, 0.01, 1.0, "s")},
        lambda t, x, u, p: (x.w, x.f - p.d * x.w, (u.c - x.f) / p.T),
        lambda t, x, u, p: x.s,
    )
    found = diagnose_model(model, runs[0], runs[1], most_effects=0)
    assert found.verdict == "nothing_missing"
    assert found.checks[0].after_rms < 0.03
    assert found.checks[0].settle > 15
    assert "x0=" in " ".join(found.remarks)


def test_a_start_that_nothing_is_known_of_begins_where_the_fitted_rows_end() -> None:
    """A charge read by a table: from nothing the search stays beyond the end of it."""
    at, volts = np.linspace(0.2, 1.0, 6), np.array([3.0, 3.4, 3.5, 3.6, 3.8, 4.2])
    drawn = np.repeat(np.random.default_rng(1).choice([0.2, -0.1, 1.0], 40), 10)
    charge = 0.9 - np.r_[0.0, np.cumsum(drawn)[:-1]] / 400.0
    noise = 1e-3 * np.random.default_rng(2).standard_normal(400)
    run = Experiment("cell", 1.0, {"I": drawn, "U": np.interp(charge, at, volts) + noise})
    model = Model(
        {"q": "1"},
        {"I": "A"},
        {"U": "V"},
        {"Q": P(300.0, 50.0, 3000.0, "A s")},
        lambda t, x, u, p: -u.I / p.Q,
        lambda t, x, u, p: np.interp(x.q, at, volts),
        x0={"q": (0.9, 0.01)},
    )
    bench = Bench.of(Records.of(model, [run]))
    blind = replace(bench.later[0], x0_mean=np.zeros(1))
    assert settled(bench.fit, [blind], bench.raw).rms < 2e-3


def test_each_input_runs_between_samples_as_its_own_rows_show() -> None:
    """A force that is switched and one that is not: each goes through its rows."""
    model = make.body(inputs={"F": "N", "G": "N"})
    both = np.column_stack([np.repeat([0, 5, 1], 100), np.sin(np.arange(300) / 15.0)])
    run = Experiment("run", 1.0, dict(zip("FGq", [*both.T, both[:, 1]], strict=True)))
    still = replace(run, channels={**run.channels, "F": np.zeros(300)})
    assert Records.of(model, [run]).between == ("held", "auto")
    assert Records.of(model, [still]).between == ("auto", "auto")
    for way, pieces in (("cubic", 300), ("linear", 300), ("band", 1200)):
        made = laid(both, ("held", way))[:, :: pieces // 300, 0]
        assert np.allclose(made.T, both, atol=5e-3)


GAPS = {
    "an outage": lambda n, rng: (np.arange(n) < 200) | (np.arange(n) >= 330),
    "a sensor of a fifth of the rate": lambda n, rng: np.arange(n) % 5 == 2,
    "irregular times": lambda n, rng: rng.random(n) < 0.3,
}


def coloured(n: int, rng: np.random.Generator) -> np.ndarray:
    """Errors of an autoregression 0.9, of unit variance."""
    return np.asarray(lfilter([np.sqrt(1 - 0.81)], [1.0, -0.9], rng.standard_normal(n)))


@pytest.mark.parametrize("case", GAPS)
def test_readings_that_are_missing_are_not_scored(case: str) -> None:
    """The truth is found with honest errors, whatever stands in the rows without a reading."""
    n, model, z = 900, make.body(), []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        made = truth.body(5, n, noise=0.0)
        there = GAPS[case](n, rng)
        made["q"] = np.where(there, made["q"] + 0.01 * coloured(n, rng), np.nan)
        run = make.runs_on(model, [make.experiment("body", made)])[0]
        assert np.array_equal(run.valid[:, 0], there)
        fit = make.fitted(Structure(model, (), "cubic", 1e-6, offsets_free=False), [run])
        assert np.array_equal(np.isnan(fit.errors[0][:, 0]), ~there)
        assert np.all(np.isfinite(fit.paths[0].outputs))
        stderr = np.sqrt(np.diag(covariance(fit, [run], raw_metric([run.outputs])))[:3])
        z.append((fit.theta[:3] - list(truth.BODY.values())) / stderr)
    sizes = np.sqrt(np.mean(np.square(z), axis=0))
    assert np.all((sizes > 0.4) & (sizes < 1.8)), sizes


def test_no_whitened_error_looks_across_a_gap() -> None:
    """Errors of an autoregression 0.9: white within each piece, nothing at its first rows."""
    errors = coloured(4000, np.random.default_rng(3))[:, None]
    errors[1000:1040] = np.nan
    metric = metric_of([errors])
    assert metric.ar[0][0] == pytest.approx(0.9, abs=0.03)
    assert metric.strides == (1,)
    order = metric.ar[0].size
    scored = metric.scored(errors)[:, 0]
    assert not np.any(scored[[*range(order), *range(1000, 1040 + order)]])
    assert np.count_nonzero(scored) == 4000 - 40 - 2 * order
    white = metric.whitened(errors)[:, 0]
    assert np.all(white[~scored] == 0.0)
    assert np.std(white[scored]) == pytest.approx(1.0, abs=0.01)
    slow = np.full((4000, 1), np.nan)
    slow[3::4] = coloured(1000, np.random.default_rng(4))[:, None]
    slower = metric_of([slow])
    assert slower.strides == (4,)
    assert slower.ar[0][0] == pytest.approx(0.9, abs=0.05)
    left = slower.whitened(slow)[slower.scored(slow)]
    assert abs(np.corrcoef(left[1:], left[:-1])[0, 1]) < 0.1
    uneven = np.where(np.random.default_rng(5).random((250, 1)) < 0.5, np.nan, errors[:250])
    late = np.concatenate([errors[:400], uneven])
    assert metric_of([uneven]).strides == metric_of([late]).strides == (0,)
    assert metric_of([uneven]).sigma[0] == pytest.approx(np.sqrt(0.32), rel=0.15)


def test_a_slower_output_and_an_outage_leave_the_name() -> None:
    """A drag in a pipe whose flow is read every third row, with an outage, is named as it is."""
    made = truth.pipe(1, 900, drag=0.3, noise=0.01)
    rows = np.arange(900)
    made["Q"] = np.where((rows % 3 == 0) & ((rows < 500) | (rows > 560)), made["Q"], np.nan)
    found = diagnose_model(make.pipe(), make.experiment("pipe", made), most_effects=1)
    assert found.missing[0].effect == "quadratic_drag"
    number = found.missing[0].parameters[0]
    assert abs(number.value - 0.3) < 4.0 * number.stderr < 0.06
    assert np.all(np.isfinite(found.training[0].after_rms))
    assert np.all(np.isfinite(found.training[0].after))


FILTERS = [(0.3, 0.05), (1.0, 0.4), (2.5, 1.5), (-0.8, 0.2)]
# Rows at either end that the prolongation of the record may disturb.
EDGE = 100


INPUTS = {
    "two levels": (lambda rng: np.repeat(rng.choice([-1.0, 1.0], 200), 5), True),
    "a level for two rows": (lambda rng: np.repeat(rng.standard_normal(401), 2)[:-1], True),
    "two levels, drawn in each row": (lambda rng: rng.choice([-1.0, 1.0], 801), True),
    "noise": (lambda rng: rng.standard_normal(800), False),
    "rounded pulses": (lambda _: np.tile(np.r_[np.hanning(12)[1:-1], np.zeros(60)], 12), False),
    "a sine of few bits": (lambda _: np.round(8.0 * np.sin(np.arange(800) / 40.0)), False),
}


@pytest.mark.parametrize("kind", INPUTS)
def test_an_input_is_held_where_it_jumps_and_stays(kind: str) -> None:
    made, wanted = INPUTS[kind]
    assert is_held(made(np.random.default_rng(0))) is wanted


def test_an_output_is_held_where_its_repeats_are_regular() -> None:
    rng = np.random.default_rng(1)
    read = np.repeat(rng.standard_normal(300), 4)
    gap = np.where(np.arange(read.size) == 500, np.nan, read)
    own, slow = np.repeat(read[::4], rng.integers(7, 10, 300)), np.round(0.13 * np.arange(2000))
    relay = np.repeat(np.tile([1.0, -1.0], 30), 20)
    bits = np.round(20.0 * np.sin(np.arange(900) / 9.0))

    def rows(*outputs: np.ndarray) -> int:
        runs = [Experiment("one", 1.0, {"y": y}) for y in outputs]
        return held_rows("y", runs[:1], runs[1:])

    assert [rows(y) for y in (read, gap, read[1:], own, slow, read[:100])] == [4, 4, 4, 8, 1, 1]
    assert [rows(read, read[:78]), rows(relay), rows(bits), rows(rng.random(900))] == [4, 1, 1, 1]


def smooth(n: int = 1500, seed: int = 0) -> np.ndarray:
    """Two channels of tones up to a quarter of the sample rate."""
    rng = np.random.default_rng(seed)
    k = np.arange(n)
    hz = rng.uniform(0.005, 0.25, (2, 8))
    phase = rng.uniform(0.0, 6.28, (2, 8))
    return np.sin(2 * np.pi * hz[:, :, None] * k + phase[:, :, None]).sum(axis=1).T


def phase_of(alpha: float, beta: float, omega: np.ndarray) -> np.ndarray:
    """Phase of (1 − αs + βs²)/(1 + αs + βs²) at s = iω, by complex division."""
    s = 1j * omega
    return np.unwrap(np.angle((1 - alpha * s + beta * s**2) / (1 + alpha * s + beta * s**2)))


@pytest.mark.parametrize(("alpha", "beta"), FILTERS)
def test_the_inverse_undoes_the_filter(alpha: float, beta: float) -> None:
    values = smooth()
    there_and_back = all_pass(all_pass(values, alpha, beta), alpha, beta, inverse=True)
    inner = slice(EDGE, -EDGE)
    assert np.max(np.abs(there_and_back - values)[inner]) < 2e-3 * np.std(values)


@pytest.mark.parametrize(("alpha", "beta"), FILTERS)
@pytest.mark.parametrize("hz", [0.01, 0.07, 0.2])
def test_a_tone_keeps_its_size_and_turns_by_the_phase(alpha: float, beta: float, hz: float) -> None:
    k = np.arange(2000)
    tone = np.cos(2 * np.pi * hz * k)
    turned = all_pass(tone[:, None], alpha, beta)[:, 0]
    phase = phase_of(alpha, beta, np.array([2 * np.pi * hz]))[0]
    wanted = np.cos(2 * np.pi * hz * k + phase)
    inner = slice(EDGE, -EDGE)
    assert np.max(np.abs(turned - wanted)[inner]) < 5e-3
