"""Simulated runs against closed forms and scipy; hard right-hand sides; inputs between samples."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from comparisons.missing_effect.systems.experiments import Experiment, input_pieces
from comparisons.missing_effect.systems.model import Model, P
from comparisons.missing_effect.systems.simulate import Path, path_of
from comparisons.missing_effect.systems.structure import Run, Structure

TIGHT = 1e-9


def model_of(
    rhs: Callable[..., Any], states: int = 1, inputs: tuple[str, ...] = (), **params: float
) -> Model:
    """A model whose outputs are all its states."""
    names = ["a", "b", "c"][:states]
    outputs: Callable[..., Any] = (
        (lambda t, x, u, p: x.a) if states == 1 else (lambda t, x, u, p: (x.a, x.b))
    )
    return Model(
        dict.fromkeys(names, "1"),
        dict.fromkeys(inputs, "1"),
        {f"{name}_m": "1" for name in names},
        {name: P(v, v - 1 - abs(v), v + 1 + abs(v)) for name, v in params.items()},
        rhs,
        outputs,
    )


def simulated(
    model: Model,
    start: list[float],
    n: int = 200,
    period_s: float = 0.05,
    inputs: dict[str, np.ndarray] | None = None,
    *,
    tolerance: float = TIGHT,
    between: str = "cubic",
    theta: list[float] | None = None,
    scale: list[float] | None = None,
) -> Path:
    n_x = len(model.states)
    channels = {name: np.arange(n, dtype=float) for name in model.output_names}
    experiment = Experiment("run", period_s, {**channels, **(inputs or {})}).of(model)
    blank = (np.zeros(n_x), np.full(n_x, np.inf))
    run = Run.of(model, experiment, between, (0.0, n * period_s), blank)
    structure = Structure(model, (), between, tolerance)
    given = structure.start() if theta is None else np.array(theta)
    size = np.array(scale or [1.0] * n_x)
    return path_of(structure, run, given, np.array(start), size)


def oscillator() -> Model:
    return model_of(lambda t, x, u, p: (x.b, -p.k * x.a - p.c * x.b), states=2, k=40.0, c=0.4)


@pytest.mark.parametrize(("tolerance", "off"), [(1e-5, 2e-2), (1e-6, 2e-3), (1e-9, 1e-5)])
def test_a_damped_oscillator_keeps_amplitude_and_phase(tolerance: float, off: float) -> None:
    """Sixteen periods at twenty samples a period."""
    path = simulated(oscillator(), [1.0, 0.0], n=320, tolerance=tolerance, scale=[0.5, 3.0])
    t = 0.05 * np.arange(320)
    w = math.sqrt(40.0 - 0.04)
    wanted = np.exp(-0.2 * t) * (np.cos(w * t) + 0.2 / w * np.sin(w * t))
    assert np.max(np.abs(path.outputs[:, 0] - wanted)) < off


def test_a_forced_lag_follows_its_closed_form() -> None:
    """da/dt = (u − a)/τ under u = sin ωt."""
    tau, w, n, h = 0.5, 2.0, 400, 0.05
    t = h * np.arange(n)
    model = model_of(lambda t, x, u, p: (u.w - x.a) / p.tau, inputs=("w",), tau=tau)
    start = -w * tau / (1 + (w * tau) ** 2)
    path = simulated(model, [start], n, h, {"w": np.sin(w * t)}, between="cubic")
    wanted = (np.sin(w * t) - w * tau * np.cos(w * t)) / (1 + (w * tau) ** 2)
    assert np.max(np.abs(path.outputs[:, 0] - wanted)) < 2e-6


def test_friction_with_a_narrow_tanh_brings_to_rest() -> None:
    model = model_of(lambda t, x, u, p: -p.f * math.tanh(x.a / 1e-6), f=0.8)
    path = simulated(model, [3.0], n=120, tolerance=1e-5)
    wanted = np.maximum(3.0 - 0.8 * 0.05 * np.arange(120), 0.0)
    assert np.max(np.abs(path.outputs[:, 0] - wanted)) < 1e-3


@pytest.mark.parametrize(
    "rhs",
    [
        lambda t, x, u, p: p.k * x.a * x.a,
        lambda t, x, u, p: math.sqrt(1.0 - t) + x.a,
        lambda t, x, u, p: np.inf if t > 3.0 else -x.a,
    ],
    ids=["a²", "root of less than nothing", "infinite"],
)
def test_what_runs_away_fails_and_does_not_raise(rhs: Callable[..., Any]) -> None:
    path = simulated(model_of(rhs, k=1.0), [1.0])
    assert path.failed
    assert np.all(np.isnan(path.outputs))


@pytest.mark.parametrize("between", ["held", "linear", "cubic", "band"])
def test_a_pulse_after_a_quiet_stretch_is_not_stepped_over(between: str) -> None:
    """One sample of input after 900 of silence, into a store that keeps it."""
    n, h = 1200, 0.05
    model = model_of(lambda t, x, u, p: p.k * u.w, inputs=("w",), k=1.0)
    for when in range(896, 906):
        drive = np.zeros(n)
        drive[when] = 1.0
        path = simulated(model, [0.0], n, h, {"w": drive}, tolerance=1e-5, between=between)
        assert path.outputs[-1, 0] == pytest.approx(h, rel=0.02), when


@pytest.mark.parametrize("tau_samples", [1e-6, 1e-4, 1e-2])
def test_a_lag_that_vanishes_follows_its_input(tau_samples: float) -> None:
    n, h = 300, 0.05
    t = h * np.arange(n)
    tau = tau_samples * h
    model = model_of(lambda t, x, u, p: (u.w - x.a) / p.tau, inputs=("w",), tau=tau)
    path = simulated(model, [0.0], n, h, {"w": np.sin(2 * t)}, theta=[tau, 0.0], tolerance=1e-6)
    assert not path.failed
    assert np.max(np.abs(path.outputs[2:, 0] - np.sin(2 * (t - tau))[2:])) < 1e-4


def at(pieces: np.ndarray, per_sample: int, when: np.ndarray) -> np.ndarray:
    """An input at times in samples, from its pieces."""
    place = when * per_sample
    i = np.clip(np.floor(place).astype(int), 0, pieces.shape[0] - 1)
    s = place - i
    c = pieces[i]
    return c[:, 0] + s * (c[:, 1] + s * (c[:, 2] + s * c[:, 3]))


@pytest.mark.parametrize(("how", "off"), [("band", 0.02), ("cubic", 0.4), ("linear", 0.9)])
def test_a_band_limited_input_follows_a_fast_sine(how: str, off: float) -> None:
    """At 0.35 of the sample rate only the band-limited way keeps a sine: others miss by a half."""
    n, f = 400, 0.35
    values = np.sin(2 * np.pi * f * np.arange(n))
    pieces, per_sample = input_pieces(values, how), 4 if how == "band" else 1
    when = np.arange(60.0, 340.0, 0.01)
    error = np.max(np.abs(at(pieces, per_sample, when) - np.sin(2 * np.pi * f * when)))
    assert error < off
    if how != "band":
        assert error > 0.1
