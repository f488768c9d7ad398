"""Compressor, duct and plenum drawn at random; shares no code with what recovers them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

STEP_S = 1e-3
Curve = Callable[[float], float]


@dataclass(frozen=True)
class SurgeMachine:
    duct: float
    plenum: float
    throttle: float
    tau_s: float
    levels: tuple[float, float]
    curves: tuple[Curve, Curve]
    loss: Curve = lambda _: 0.0

    def run(self, n: int, fine: int = 5) -> tuple[np.ndarray, np.ndarray]:
        """Integrate; return n states after the first second, and whether stalled."""
        dt = STEP_S / fine
        skip = 1000
        x = np.array([self.levels[0], self.curves[0](0.1), self.curves[0](0.1)])
        stalled = True
        states, modes = np.empty((n, 3)), np.empty(n, dtype=bool)
        for k in range((n + skip) * fine):
            if k % fine == 0 and k >= skip * fine:
                states[k // fine - skip], modes[k // fine - skip] = x, stalled
            curve = self.curves[0 if stalled else 1]
            k1 = self.rate(x, curve)
            k2 = self.rate(x + dt / 2 * k1, curve)
            k3 = self.rate(x + dt / 2 * k2, curve)
            k4 = self.rate(x + dt * k3, curve)
            new = x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            if not abs(new[0]) < 3:
                return np.full((n, 3), np.nan), modes
            if stalled and x[0] < self.levels[0] <= new[0]:
                stalled = False
            elif not stalled and x[0] > self.levels[1] >= new[0]:
                stalled = True
            x = new
        return states, modes

    def rate(self, x: np.ndarray, curve: Curve) -> np.ndarray:
        through = self.throttle * np.sign(x[2]) * abs(x[2]) ** 0.5
        return np.array(
            [
                self.duct * (x[1] - x[2]) - self.loss(x[0]),
                (curve(x[0]) - x[1]) / self.tau_s,
                self.plenum * (x[0] - through),
            ]
        )


def _two(rng: np.random.Generator) -> tuple[tuple[float, float], tuple[Curve, Curve]]:
    base, slope, bend = rng.uniform(0.15, 0.3), rng.uniform(-0.2, 0.3), rng.uniform(2, 5)
    top, peak, fall = rng.uniform(0.7, 0.9), rng.uniform(0.3, 0.4), rng.uniform(3, 6)
    levels = (rng.uniform(0.14, 0.26), rng.uniform(0.18, 0.28))
    return levels, (
        lambda phi: base + slope * phi + bend * phi**2,
        lambda phi: top - fall * (phi - peak) ** 2,
    )


def _one(rng: np.random.Generator, kinked: bool) -> tuple[tuple[float, float], tuple[Curve, Curve]]:
    if kinked:
        base, bend, knot = rng.uniform(0.2, 0.3), rng.uniform(3, 5), rng.uniform(0.25, 0.35)
        fall = 2 * bend * knot + rng.uniform(0.5, 2)

        def curve(phi: float) -> float:
            return (
                base
                + bend * phi**2 * (phi < knot)
                + (phi >= knot) * (bend * knot**2 + (2 * bend * knot - fall) * (phi - knot))
            )
    else:
        base, height, width = rng.uniform(0.2, 0.4), rng.uniform(0.15, 0.25), rng.uniform(0.2, 0.3)

        def curve(phi: float) -> float:
            z = phi / width - 1
            return base + height * (1 + 1.5 * z - 0.5 * z**3)

    return (0.2, 0.2), (curve, curve)


def draw(seed: int, kind: str) -> tuple[SurgeMachine, np.ndarray, np.ndarray]:
    """Draw machines until one surges through both sides; kind: two, one or kinked."""
    rng = np.random.default_rng([seed, len(kind)])
    while True:
        levels, curves = _two(rng) if kind == "two" else _one(rng, kind == "kinked")
        machine = SurgeMachine(
            rng.uniform(80, 160), rng.uniform(4, 20), rng.uniform(0.15, 0.5),
            rng.uniform(0.010, 0.025), levels, curves,
        )  # fmt: skip
        states, _ = machine.run(4000, fine=1)
        late = states[-1000:, 0]
        if not np.all(np.isfinite(states)) or late.max() < 0.35 or late.min() > 0.1:
            continue
        if np.count_nonzero(np.diff((late > 0.2).astype(int)) > 0) >= 3:
            return machine, *machine.run(4000)


def measured(states: np.ndarray, share: float, seed: int) -> np.ndarray:
    noise = np.random.default_rng([seed, 99]).standard_normal(states.shape)
    return states + share * states.std(axis=0) * noise
