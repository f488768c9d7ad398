"""Beyond the catalogue: terms without a name, nothing where nothing is, measured systems."""

from __future__ import annotations

import csv
import runpy
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lfilter, lsim
from shared_data import MEASURED, SHARED, needs_measured

from comparisons.missing_effect import Experiment, Model, P, diagnose_model, nulls
from comparisons.missing_effect.systems import structure
from comparisons.missing_effect.systems.bench import Bench
from comparisons.missing_effect.systems.catalogue import SYSTEM_CATALOGUE
from comparisons.missing_effect.systems.doubts import leftover_of, proves
from comparisons.missing_effect.systems.records import Records
from comparisons.missing_effect.systems.results import SystemDiagnosis

ROOT = Path(__file__).parents[4]
EXAMPLES = ROOT / "examples" / "measured"
SYSTEMS = runpy.run_path(str(ROOT / "benchmarks" / "measured_systems.py"))["SYSTEMS"]
PERIOD_S = 0.1


def slow_signal(rng: np.random.Generator, n: int) -> np.ndarray:
    """Noise below the rate of the system, of unit rms."""
    made = np.convolve(rng.standard_normal(n + 50), np.hanning(25), "same")[25:-25]
    return np.asarray(made / np.std(made))


def oscillator(
    seed: int, n: int, hidden: float, slow: bool = False, slew: float = np.inf, rub: Any = (0, 1)
) -> Experiment:
    """x'' = u − 0.3 x' − x + hidden·x²·x' − rub ± abs(x')ⁿ, read with 1 % of noise."""
    rng = np.random.default_rng(seed)
    asked = 1.5 * slow_signal(rng, n)
    u = asked.copy()
    for k in range(1, n):
        u[k] = u[k - 1] + np.clip(asked[k] - u[k - 1], -slew * PERIOD_S, slew * PERIOD_S)
    state, x = np.zeros(2), np.empty(n)
    for k in range(n):
        x[k] = state[0]
        for part in range(10):
            at = [u[k] + (u[min(k + 1, n - 1)] - u[k]) * (part + s) / 10.0 for s in (0.0, 0.5, 1.0)]

            def rate(y: np.ndarray, push: float) -> np.ndarray:
                push += hidden * y[0] ** 2 * y[1] - rub[0] * np.sign(y[1]) * abs(y[1]) ** rub[1]
                return np.array([y[1], push - 0.3 * y[1] - y[0]])

            h = PERIOD_S / 10.0
            slopes = [rate(state, at[0])]
            for share, push in ((0.5, at[1]), (0.5, at[1]), (1.0, at[2])):
                slopes.append(rate(state + share * h * slopes[-1], push))
            state = state + h / 6.0 * np.dot([1.0, 2.0, 2.0, 1.0], slopes)
    noise = slow_signal(rng, n) if slow else rng.standard_normal(n)
    return Experiment(f"run {seed}", PERIOD_S, {"u": asked, "y": x + 0.01 * np.std(x) * noise})


LINEAR = Model(
    name="oscillator",
    states={"x": "m", "v": "m/s"},
    inputs={"u": "N"},
    outputs={"y": "m"},
    params={
        "b": P(1.0, 0.1, 5.0, "1/kg"),
        "c": P(0.5, 0.0, 5.0, "1/s"),
        "k": P(1.2, 0.1, 5.0, "1/s^2"),
    },
    rhs=lambda t, x, u, p: (x.v, p.b * u.u - p.c * x.v - p.k * x.x),
    output=lambda t, x, u, p: x.x,
    exact=("x",),
)


def test_a_product_that_no_name_holds_is_given_as_an_equation() -> None:
    """The term is x²·v, within 1 %; it goes where a check record runs as the model without it."""
    fit, check = oscillator(41, 1200, -0.4), oscillator(91, 600, -0.4)
    found = diagnose_model(LINEAR, fit, check)
    check = replace(check, channels={**check.channels, "y": found.checks[0].before[:, 0]})
    other = diagnose_model(LINEAR, fit, check)
    assert (other.verdict, other.missing) == ("unexplained_structure", ())
    assert "with it the error on every check record grows" in other.remarks[0]
    assert found.verdict == "unnamed_term"
    (item,) = found.missing
    assert "x²·v" in item.label
    assert item.parameters[0].value == pytest.approx(-0.4, rel=0.01)
    assert found.checks[0].after_rms < 0.1 * found.checks[0].before_rms


def test_a_spring_that_was_forgotten_is_a_term_in_proportion() -> None:
    """A dead zone without a gap fits as well."""
    params = {name: LINEAR.params[name] for name in ("b", "c")}
    free = replace(LINEAR, params=params, rhs=lambda t, x, u, p: (x.v, p.b * u.u - p.c * x.v))
    (item,) = diagnose_model(free, oscillator(47, 1200, 0.0)).missing
    assert item.label == "open_linear(x) in dv/dt"
    assert abs(item.parameters[0].value + 1.0) < 4.0 * item.parameters[0].stderr < 0.05


def test_noise_as_slow_as_the_system_itself_gets_no_name() -> None:
    assert diagnose_model(LINEAR, oscillator(43, 1200, 0.0, slow=True)).missing == ()


def under_noise(share: float, size: float = 0.5) -> Experiment:
    record, noise = oscillator(43, 600, 0.0), np.random.default_rng(5).standard_normal(600)
    y = share * record.channels["y"] + lfilter([size], [1.0, -0.78], noise)
    return replace(record, channels={**record.channels, "y": y})


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_an_input_without_a_visible_effect_is_said_to_have_none(share: float) -> None:
    found = diagnose_model(LINEAR, under_noise(share), most_effects=0)
    said = "no visible effect on it" in " ".join(found.remarks)
    assert (found.verdict == "unexplained_structure", said) == (share == 0.0,) * 2


@pytest.mark.parametrize("share", [0.1, 1.0])
def test_an_error_beyond_the_swing_of_a_check_record_leaves_the_answer_open(share: float) -> None:
    found = diagnose_model(LINEAR, under_noise(1.0), under_noise(share, 0.01), most_effects=0)
    assert (found.verdict == "unexplained_structure") == (share < 1.0)


def test_a_bound_in_the_way_is_no_missing_effect() -> None:
    """The model is complete, but the true stiffness is beyond the user's bound."""
    tight = {**LINEAR.params, "k": P(0.5, 0.1, 0.9, "1/s^2")}
    found = diagnose_model(replace(LINEAR, params=tight), oscillator(44, 1200, 0.0))
    assert (firm(found), found.verdict) == ([], "unexplained_structure")
    assert "k above its bound of 0.9" in " ".join(found.remarks)


def test_a_drive_that_slews_is_no_firm_lag() -> None:
    """No name of the catalogue is a limit of a rate, and what comes nearest stays in doubt."""
    runs = (oscillator(seed, n, 0.0, slew=0.8) for seed, n in ((45, 1200), (95, 600)))
    found = diagnose_model(LINEAR, *runs)
    assert (firm(found), found.verdict == "nothing_missing") == ([], False)


def test_a_friction_by_another_power_has_no_false_name() -> None:
    """By √v it is not Coulomb's; by v³ no softening damping of the wrong sign, but that term."""
    found = [
        diagnose_model(LINEAR, *(oscillator(s, n, 0.0, rub=rub) for s, n in runs))
        for rub, runs in (
            ((0.5, 0.5), ((46, 1500), (96, 800))),
            ((0.1, 3), ((48, 1500), (98, 800))),
        )
    ]
    assert not [label for label in firm(found[0]) if "coulomb" in label]
    (item,) = found[1].missing
    assert (item.label, item.provisional) == ("open_cube(v³) in dv/dt", False)
    (c,) = item.parameters
    assert abs(c.value + 0.1) < 3.0 * c.stderr < 0.01


MOTOR = Model(
    name="motor",
    states={"i": "A", "w": "rad/s"},
    inputs={"V": "V"},
    outputs={"y": "rad/s"},
    params={
        "Te": P(0.02, 0.002, 0.2, "s"),
        "Tm": P(0.1, 0.01, 1.0, "s"),
        "K": P(5.0, 0.5, 50.0, "rad/s/V"),
    },
    rhs=lambda t, x, u, p: ((p.K * u.V - x.i) / p.Te, (x.i - x.w) / p.Tm),
    output=lambda t, x, u, p: x.w,
)


def motor(seed: int, n: int, wanted: list[float], rows: int, late: float, every: int) -> Experiment:
    """10 ms of a drive held at one of two levels; delayed by some rows, read every few."""
    te, tm, gain = wanted
    rng = np.random.default_rng(seed)
    drive = np.repeat(rng.choice([-2.0, 2.0], n // rows + 1), rows)[:n]
    fine = np.r_[np.zeros(round(20 * late)), np.repeat(drive, 20)][: 20 * n]
    system = [[-1.0 / te, 0.0], [1.0 / tm, -1.0 / tm]], [[gain / te], [0.0]], [[0.0, 1.0]], [[0.0]]
    w = lsim(system, fine, np.arange(20 * n) * 0.0005, interp=False)[1][::20]
    read = w + 0.005 * np.std(w) * rng.standard_normal(n)
    return Experiment(f"run {seed}", 0.01, {"V": drive, "y": np.repeat(read[::every], every)[:n]})


HELD = {"complete": (0.009, 0.03, 2, 0.0, 1), "late": (0.08, 0.012, 4, 1.6, 1)}
HELD["read every fourth row"] = (0.05, 0.25, 10, 0.0, 4)


@pytest.mark.parametrize("case", HELD)
def test_what_is_held_between_rows_is_no_lag(case: str) -> None:
    """A held drive is no cubic half a sample late, a delay of it its own, a held reading no lag."""
    te, tm, *how = HELD[case]
    wanted = [te, tm, 6.0]
    found = diagnose_model(
        MOTOR, *(motor(seed, n, wanted, *how) for seed, n in ((1, 1500), (2, 800)))
    )
    assert [item.label for item in found.missing] == ["transport_delay(V) in V"] * (case == "late")
    assert ("held for 4 rows" in " ".join(found.remarks)) == (how[-1] == 4)
    for row, truth in zip(found.parameters, wanted, strict=True):
        assert abs(row.after - truth) < 4.0 * row.after_stderr < 0.05 * truth
    for delay in (n for item in found.missing for n in item.parameters):
        assert abs(delay.value - 0.016) < 4.0 * delay.stderr < 0.0016


def test_a_delay_beyond_what_an_offset_says_is_named() -> None:
    """Two rows: an offset of one and a term without a name were said in its place."""

    def smooth(seed: int, n: int) -> Experiment:
        rng = np.random.default_rng(seed)
        drive = 40.0 * gaussian_filter1d(rng.standard_normal(20 * n + 40), 40)
        system = [3e4], np.polymul([1.0, 50.0], [1.0, 100.0])
        w = lsim(system, drive[: 20 * n], np.arange(20 * n) * 0.0005)[1][::20]
        w += 0.03 * np.std(w) * rng.standard_normal(n)
        return Experiment(f"run {seed}", 0.01, {"V": drive[40::20], "y": w})

    (item,) = diagnose_model(MOTOR, smooth(1, 300), smooth(2, 150)).missing
    assert (item.label, item.provisional) == ("transport_delay(V) in V", False)
    assert abs(item.parameters[0].value - 0.02) < 3.0 * item.parameters[0].stderr < 0.015


def test_a_servo_of_second_order_is_no_firm_delay() -> None:
    """Of 9 rad/s and ζ 0.5, in front of the oscillator; the nearest name is a delay of 0.12 s."""

    def behind_servo(seed: int, n: int) -> Experiment:
        rng = np.random.default_rng(seed)
        asked = np.repeat(rng.uniform(-1.0, 1.0, n // 30), 30)
        system = [324.0], np.polymul([1.0, 9.0, 81.0], [1.0, 0.8, 4.0])
        y = lsim(system, np.repeat(asked, 10), np.arange(10 * n) * 0.002, interp=False)[1][::10]
        y += 0.01 * np.std(y) * rng.standard_normal(n)
        return Experiment(f"run {seed}", 0.02, {"u": asked, "y": y})

    found = diagnose_model(LINEAR, *(behind_servo(seed, 1500) for seed in (1, 2)))
    assert (firm(found), found.verdict == "nothing_missing") == ([], False)


def plate(seed: int, n: int) -> Experiment:
    """400 T' = P − 0.25 T^1.3 every 5 s, in steps of 0.25 s; T is that above the room's."""
    rng = np.random.default_rng(seed)
    heat, warm = np.repeat(rng.uniform(5.0, 150.0, n // 80), 80), np.full(n, 60.0)
    for k in range(1, n):
        now = warm[k - 1]
        for _ in range(20):
            now += 0.25 * (heat[k - 1] - 0.25 * now**1.3) / 400.0
        warm[k] = now
    read = warm + 0.3 * rng.standard_normal(n)
    return Experiment(f"run {seed}", 5.0, {"P": heat, "T": read})


def test_pieces_of_one_law_are_not_firm() -> None:
    """T² and T³ of what is never below zero are one curve, and neither is the law."""
    model = Model(
        states={"T": "K"},
        inputs={"P": "W"},
        outputs={"T": "K"},
        params={"C": P(500.0, 50.0, 5000.0, "J/K"), "h": P(1.5, 0.1, 20.0, "W/K")},
        rhs=lambda t, x, u, p: ((u.P - p.h * x.T) / p.C,),
        output=lambda t, x, u, p: x.T,
    )
    found = diagnose_model(model, plate(1, 1200), plate(2, 800))
    assert (firm(found), bool(found.missing)) == ([], True)


@pytest.mark.parametrize("periodic", [False, True])
def test_chance_of_what_is_foretold_is_chance(periodic: bool) -> None:
    """Errors that have nothing to do with the signals are called foretold as often as stated."""
    cycle = np.sin(2.0 * np.pi * np.arange(600)[:, None] / 97.0 + [0.0, 1.2, 2.0])
    p, newly, late = [], [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        slow = np.column_stack([slow_signal(rng, 600) for _ in range(3)])
        given = np.exp(cycle) if periodic else slow
        error = slow_signal(rng, 600)
        p.append(nulls.foretold([error], [given], ("a", "b", "c"), rng)[0])
        newly.append(nulls.newly_foretold([error], [given]))
        late.append(nulls.foretold_late([error], [given], rng))
    # 60 uniform numbers: 6 are expected below 0.1, sd 2.3, and 0.06 below 0.001.
    for chances in (p, newly, late):
        assert np.count_nonzero(np.array(chances) < 0.1) <= 13
        assert np.count_nonzero(np.array(chances) < 0.001) <= 1


def test_errors_that_follow_a_product_are_foretold() -> None:
    rng = np.random.default_rng(5)
    signals = np.column_stack([slow_signal(rng, 600) for _ in range(2)])
    error = 0.5 * signals[:, 0] * signals[:, 1] + 0.5 * rng.standard_normal(600)
    p, share, follows = nulls.foretold([error], [signals], ("a", "b"), rng)
    assert p < 0.01
    assert share > 0.3
    assert follows == "a·b"
    assert nulls.Leftover(p, p, share, 1.0).structured


def test_errors_of_a_mode_that_is_missing_are_foretold_and_those_in_a_loop_are_not() -> None:
    rng = np.random.default_rng(6)
    u, noise = slow_signal(rng, 2000), rng.standard_normal(2000)
    mode = lfilter([0.0, 0.02], [1.0, -1.9, 0.93], u)
    error = mode + np.std(mode) * noise
    # The second run has five readings, too few to say anything.
    seldom = np.where(np.arange(2000) % 400, np.nan, error)
    assert nulls.foretold_late([error, seldom], [u[:, None]] * 2, rng) < nulls.LEAST_P
    # Spikes alone once made these three chances 1e-33 to 4e-6.
    for seed in (23, 72, 40):
        gen = np.random.default_rng(seed)
        given, spiked = slow_signal(gen, 600)[:, None], gen.standard_normal(600)
        spiked[gen.random(600) < 0.01] *= 30.0
        assert nulls.foretold_late([spiked], [given], gen) > nulls.LEAST_P
    slow = lfilter([1.0], [1.0, -0.9], noise)
    answer = u - 0.5 * np.roll(slow, 1)
    assert nulls.foretold_late([slow], [answer[:, None]], rng) > nulls.LEAST_P


def test_an_input_that_answers_the_error_of_its_own_row_is_no_cause_of_it() -> None:
    rng, x, rows = np.random.default_rng(7), 0.0, []
    for target in np.repeat(rng.uniform(-1.0, 1.0, 40), 30):
        read = x + 0.1 * rng.standard_normal()
        rows.append((2.0 * (target - read), read))
        x = np.exp(-0.1) * x - np.expm1(-0.1) * rows[-1][0]
    model = Model(
        states={"x": "V"},
        inputs={"u": "V"},
        outputs={"y": "V"},
        params={"tau": P(2.0, 0.1, 10.0, "s")},
        rhs=lambda t, x, u, p: (u.u - x.x) / p.tau,
        output=lambda t, x, u, p: x.x,
        input_between_samples="held",
    )
    loop = Experiment("loop", 0.1, dict(zip("uy", np.array(rows).T, strict=True)))
    bench = Bench.of(Records.of(model, [loop]))
    assert not leftover_of(bench, SYSTEM_CATALOGUE, ()).structured


def test_a_smooth_input_that_is_late_is_not_held() -> None:
    """By 1.3 samples: one held is late by half a sample itself, and reached as far alone."""
    made, rows = oscillator(47, 1200, 0.0), np.arange(1200.0)
    early = np.interp(rows + 1.3, rows, made.channels["u"])
    run = replace(made, channels={"u": early, "y": made.channels["y"]})
    assert Bench.of(Records.of(LINEAR, [run])).fit.structure.ways != ("held",)


def test_a_timing_offset_is_where_the_errors_are_least() -> None:
    """Of a sharp resonance: one step from errors that are the offset's own stopped at 0.960."""
    rng, n = np.random.default_rng(1), 700
    u = np.convolve(rng.standard_normal(n + 10), np.hanning(7)[1:-1], "same")[5:-5]
    fine = np.arange(-10.0, n, 0.05)
    pushed = CubicSpline(np.arange(n), u)(np.clip(fine - 0.93, 0.0, n - 1.0))
    system = [[0.0, 1.0], [-0.6, -0.007]], [[0.0], [0.3]], [[-0.6, -0.007]], [[-0.2]]
    y = lsim(system, pushed, fine + 10.0)[1][200::20]
    y += 0.05 * np.std(y) * rng.standard_normal(n)
    model = Model(
        states={"q": "rad", "w": "rad/s"},
        inputs={"u": "N m"},
        outputs={"y": "rad/s^2"},
        params={"k": P(0.57, 0.1, 3.0), "d": P(0.02, 0, 1)} | dict.fromkeys("be", P(0.1, -5, 5)),
        rhs=lambda t, x, u, p: (x.w, p.b * u.u - p.d * x.w - p.k * x.q),
        output=lambda t, x, u, p: -p.d * x.w - p.k * x.q + p.e * u.u,
        exact=("q",),
    )
    fit = Bench.of(Records.of(model, [Experiment("arm", 1.0, {"u": u, "y": y})])).fit
    assert fit.theta[fit.structure.offsets] == pytest.approx(0.93, abs=0.01)


def test_a_check_record_proves_nothing_where_its_own_parameters_are_others() -> None:
    runs: Any = [
        SimpleNamespace(after_rms=np.ones(1), refitted_rms=np.ones(1) * left)
        for left in (0.1, 0.9, np.nan)
    ]
    assert [proves([run]) for run in runs] == [False, True, True]


def measured(folder: str, name: str) -> Experiment:
    with (MEASURED / folder / f"{name}.csv").open() as file:
        header, *rows = csv.reader(file)
    columns = dict(zip(header, np.array(rows, dtype=float).T, strict=True))
    time_s = columns.pop("time_s")
    return Experiment(name, round(float(np.median(np.diff(time_s))), 9), columns)


def diagnosed(name: str) -> SystemDiagnosis:
    return diagnose_model(SYSTEMS[name][0], measured(name, "train"), measured(name, "test"))


def firm(found: SystemDiagnosis) -> list[str]:
    return [item.label for item in found.missing if not item.provisional and not item.unnamed]


@needs_measured
@pytest.mark.parametrize("step", [1e-5, 8e-6])
def test_the_tanks_overflow(step: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """The upper tank spills into the lower one, firm, whatever the rounding: no sensor does it."""
    monkeypatch.setattr(structure, "RELATIVE_STEP", step)
    found = diagnosed("tanks")
    assert firm(found)[0] == "overflow(h1) in h1 into h2"
    assert not [label for label in firm(found) if "of y" in label]
    assert found.checks[0].after_rms < 0.30


@needs_measured
def test_the_ball_on_its_beam_gets_no_name() -> None:
    """An integrating plant in 700 rows: nothing can be named, and the model stays as it was."""
    found = diagnosed("ball_and_beam")
    assert firm(found) == []
    assert found.verdict == "unexplained_structure"
    assert found.checks[0].after_rms <= 1.01 * found.checks[0].before_rms


@needs_measured
def test_the_spring_of_the_silverbox_is_cubic(monkeypatch: pytest.MonkeyPatch) -> None:
    """From the linear model of the example: its name, its place, and the error on unseen rows."""
    monkeypatch.setenv("SINDY_SURGE_BENCHMARKS", str(SHARED))
    monkeypatch.syspath_prepend(EXAMPLES)
    made = runpy.run_path(str(EXAMPLES / "silverbox.py"))
    train = made["rows"]("training", 40650, 40650 + 3600)
    tests = [made["rows"]("multisine", 105712, 108712)]
    d = diagnose_model(made["model"], train, tests, most_effects=1)
    found = d.missing[0]
    assert found.alias_set == ("cubic_stiffness",)
    assert (found.place["equation"], found.place["signal"]) == ("dv/dt", "x")
    check = d.checks[0]
    assert 6e-3 < check.before_rms[0] < 8e-3
    assert check.after_rms[0] < 0.15 * check.before_rms[0]
