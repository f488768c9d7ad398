"""The closed loop against Greitzer's model, integrated here by a Runge-Kutta method of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

from sindy_surge.closed_loop import LoopState, SurgeModel, discover_surge_model
from sindy_surge.closed_loop.record import half_width_samples, hidden_plenum, measure_cycles
from sindy_surge.closed_loop.terms import surge_library
from surge_core.errors import InputError

PERIOD_S = 1e-3
DUCT_PER_S = 125.0


def _cubic(phi: np.ndarray) -> np.ndarray:
    """Moore and Greitzer's characteristic, ψ_c0 = 0.3, H = 0.18, W = 0.25."""
    z = phi / 0.25 - 1
    return 0.3 + 0.18 * (1 + 1.5 * z - 0.5 * z**3)


def _branches(phi: np.ndarray) -> np.ndarray:
    """In-stall parabola that falls off beyond its peak, and a reverse-flow branch."""
    return 0.25 + 0.2 * phi + 4 * phi**2 - 5.5 * phi**3 + 10 * np.minimum(phi, 0) ** 2


@dataclass(frozen=True)
class Machine:
    greitzer_b: float
    throttle: float
    tau_s: float
    curve: Callable[[np.ndarray], np.ndarray]
    lag: tuple[tuple[str, float], ...]

    @property
    def plenum_per_s(self) -> float:
        return DUCT_PER_S / (4 * self.greitzer_b**2)

    @property
    def coefficients(self) -> tuple[dict[str, float], dict[str, float], dict[str, float]]:
        lag = {name: beta / self.tau_s for name, beta in self.lag}
        b = self.plenum_per_s
        return (
            {"psi_p": DUCT_PER_S, "plenum": -DUCT_PER_S},
            {**lag, "psi_p": -1 / self.tau_s},
            {"phi": b, "sqrt(plenum)": -b * self.throttle},
        )

    def rate(self, x: np.ndarray) -> np.ndarray:
        phi, psi_p, plenum = x
        outflow = self.throttle * np.sign(plenum) * np.sqrt(np.abs(plenum))
        return np.stack(
            [
                DUCT_PER_S * (psi_p - plenum),
                (self.curve(phi) - psi_p) / self.tau_s,
                self.plenum_per_s * (phi - outflow),
            ]
        )


CUBIC = (("1", 0.3), ("phi^2", 4.32), ("phi^3", -5.76))
PIECES = (("1", 0.25), ("phi", 0.2), ("phi^2", 4.0), ("phi^3", -5.5), ("phi^2[phi<0]", 10.0))
MACHINES = {
    "moderate": Machine(1.2, 0.4, 0.018, _cubic, CUBIC),
    "deep": Machine(2.0, 0.4, 0.008, _cubic, CUBIC),
    "branches": Machine(1.2, 0.4, 0.012, _branches, PIECES),
}


def _integrate(machine: Machine, start: np.ndarray, n_samples: int) -> np.ndarray:
    """Classical Runge-Kutta, four steps a sample; (n_samples, 3, …)."""
    step, x, states = PERIOD_S / 4, start, []
    for row in range(4 * n_samples):
        if row % 4 == 0:
            states.append(x)
        k1 = machine.rate(x)
        k2 = machine.rate(x + step / 2 * k1)
        k3 = machine.rate(x + step / 2 * k2)
        k4 = machine.rate(x + step * k3)
        x = x + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return np.array(states)


@cache
def _settled(name: str) -> np.ndarray:
    """Cycles of a machine once its transient has gone."""
    return _integrate(MACHINES[name], np.array([0.4, 0.5, 0.6]), 5000)[1000:]


def _record(name: str, noise: float, seed: int, n: int = 2000) -> tuple[np.ndarray, np.ndarray]:
    """Return clean and noisy states; the record begins anywhere in the cycle."""
    rng = np.random.default_rng(seed)
    begin = int(rng.integers(0, 400))
    clean = _settled(name)[begin : begin + n]
    return clean, clean + noise * clean.std(axis=0) * rng.standard_normal(clean.shape)


@cache
def _model(name: str, noise: float, seed: int, hidden: bool) -> SurgeModel:
    phi, psi_p, plenum = _record(name, noise, seed)[1].T
    return discover_surge_model(phi, psi_p, None if hidden else plenum, PERIOD_S)


def _true_period_s(phi: np.ndarray) -> float:
    level = (phi.max() + phi.min()) / 2
    rows = np.flatnonzero((phi[:-1] <= level) & (phi[1:] > level))
    exact = rows + (level - phi[rows]) / (phi[rows + 1] - phi[rows])
    return float((exact[-1] - exact[0]) / (exact.size - 1)) * PERIOD_S


CASES = [
    ("moderate", 0.01, 0, False),
    ("moderate", 0.02, 1, False),
    ("moderate", 0.02, 4, True),
    ("deep", 0.02, 6, False),
    ("branches", 0.01, 8, True),
]


@pytest.mark.parametrize(("name", "noise", "seed", "hidden"), CASES)
def test_terms_are_the_true_ones_and_ten_free_cycles_repeat(
    name: str, noise: float, seed: int, hidden: bool
) -> None:
    model = _model(name, noise, seed, hidden)
    assert model.state is LoopState.OK
    for terms, truth in zip(model.terms, MACHINES[name].coefficients, strict=True):
        assert set(terms.names) == set(truth)
    clean = _settled(name)
    period = _true_period_s(clean[:, 0])
    free = model.simulate(n_samples=int(10 * period / PERIOD_S))
    # Asked for are 5 %; the worst of 120 records was off by 0.2 %.
    assert _true_period_s(free[:, 0]) == pytest.approx(period, rel=0.005)
    np.testing.assert_allclose(np.ptp(free, axis=0), np.ptp(clean, axis=0), rtol=0.01)


def test_truth_lies_within_the_standard_errors() -> None:
    distances = []
    for name, noise, seed, hidden in CASES:
        model = _model(name, noise, seed, hidden)
        for k, truth in enumerate(MACHINES[name].coefficients):
            for term, value, error in zip(
                model.terms[k].names, model.coefficients[k], model.standard_errors[k], strict=True
            ):
                distances.append((value - truth[term]) / error)
        tau = (model.time_constant_s - MACHINES[name].tau_s) / model.time_constant_stderr_s
        distances.append(tau)
    spread = np.sqrt(np.mean(np.square(distances)))
    assert np.max(np.abs(distances)) < 4.5
    assert 0.5 < spread < 1.6


def test_simulation_follows_the_rate() -> None:
    model = _model("moderate", 0.02, 1, False)
    states = model.simulate(n_samples=201)
    middle = (states[2:] - states[:-2]) / (2 * PERIOD_S)
    np.testing.assert_allclose(model.rate(states[1:-1]), middle, atol=1e-2 * np.ptp(middle))


def test_equations_are_written_with_their_errors() -> None:
    flow, pressure, plenum = _model("moderate", 0.01, 0, False).equations()
    assert flow.startswith("dφ/dt = 12")
    assert pressure.startswith("dψ'/dt = 16.")
    assert "√Ψ" in plenum


def test_a_hidden_plenum_has_the_unit_of_psi_p() -> None:
    model = _model("moderate", 0.02, 4, True)
    assert model.noise.size == 2
    assert dict(zip(model.terms[0].names, model.coefficients[0], strict=True)) == pytest.approx(
        {"psi_p": model.coefficients[0][0], "plenum": -model.coefficients[0][0]}
    )
    clean, noisy = _record("moderate", 0.02, 4)
    half_width = half_width_samples(noisy[:, 0], 147.0)
    estimate, gain = hidden_plenum(noisy[:, :2], PERIOD_S, half_width)
    assert gain == pytest.approx(DUCT_PER_S, rel=0.03)
    inner = slice(30, -30)
    assert np.std((estimate - clean[:, 2])[inner]) < 0.1 * clean[:, 2].std()


def test_a_stable_machine_is_said_not_to_cycle() -> None:
    # A small plenum and a throttle just too far open for surge: the cycles die away.
    damped = Machine(0.8, 0.56, 0.018, _cubic, CUBIC)
    clean = _integrate(damped, np.array([0.2, 0.55, 0.5]), 1500)
    noise = np.random.default_rng(0).standard_normal(clean.shape)
    phi, psi_p, plenum = (clean + 0.002 * clean.std(axis=0) * noise).T
    model = discover_surge_model(phi, psi_p, plenum, PERIOD_S)
    assert model.state is LoopState.DOES_NOT_CYCLE
    assert "settles" in model.state.advice


def test_library_holds_the_products_and_the_special_terms() -> None:
    library = surge_library()
    assert len(set(library.names)) == len(library) == 15
    phi, psi_p, plenum = states = np.random.default_rng(0).normal(size=(3, 4, 10))
    values = dict(zip(library.names, library.values(states.T).T, strict=True))
    np.testing.assert_allclose(values["phi psi_p"], phi * psi_p)
    np.testing.assert_allclose(values["phi^5"], phi**5)
    np.testing.assert_allclose(values["phi^2[phi<0]"], np.minimum(phi, 0) ** 2)
    np.testing.assert_allclose(values["sqrt(plenum)"], np.sign(plenum) * np.sqrt(np.abs(plenum)))


@pytest.mark.parametrize("noise", [0.0, 0.02, 0.05])
def test_cycles_of_a_sine_are_measured(noise: float) -> None:
    rng = np.random.default_rng(3)
    angle = 2 * np.pi * np.arange(2000) / 137.3
    states = np.column_stack((0.2 + 0.3 * np.sin(angle), 1 + 0.5 * np.cos(angle)))
    states += noise * states.std(axis=0) * rng.standard_normal(states.shape)
    cycles = measure_cycles(states, PERIOD_S)
    assert cycles.n_cycles in (13, 14)
    assert cycles.period_s == pytest.approx(0.1373, rel=1e-3)
    # The extremes of fourteen averaged cycles still lie some noise beyond the true ones.
    np.testing.assert_allclose(cycles.amplitude, (0.3, 0.5), rtol=0.001 + noise / 2)


def _sine(n: int = 1000) -> np.ndarray:
    return 0.3 + 0.2 * np.sin(2 * np.pi * np.arange(n) / 100)


def _bad(row: int, value: float) -> np.ndarray:
    signal = _sine()
    signal[row] = value
    return signal


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"phi": np.full(1000, 0.3)}, "changes"),
        ({"phi": _bad(17, np.nan)}, "finite"),
        ({"psi_p": _sine(999)}, "999"),
        (dict.fromkeys(("phi", "psi_p", "plenum"), _sine(450)), "3 in 450"),
        ({"phi": np.sin(np.arange(1000) / 2)}, "30 samples"),
        ({"sample_period_s": 0.0}, "positive"),
    ],
)
def test_input_that_cannot_be_used_is_refused_in_a_sentence(
    change: dict[str, object], words: str
) -> None:
    good: dict[str, object] = {
        **dict.fromkeys(("phi", "psi_p", "plenum"), _sine()),
        "sample_period_s": PERIOD_S,
    }
    with pytest.raises(InputError, match=words):
        discover_surge_model(**{**good, **change})  # type: ignore[arg-type]


def test_a_channel_late_by_a_sample_is_not_called_well() -> None:
    phi, psi_p, plenum = _record("moderate", 0.01, 2)[1].T
    model = discover_surge_model(phi[1:], psi_p[:-1], plenum[1:], PERIOD_S)
    assert model.state is not LoopState.OK
