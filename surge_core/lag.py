"""The first-order lag in discrete time, for both ways of reading the input between samples."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from surge_core.types import FloatArray

Hold = Literal["zero", "first"]


@dataclass(frozen=True)
class FirstOrderLag:
    """τ dx/dt + x = f sampled with period h: ``x[k] = a x[k-1] + Σ_i taps[i] f[k-m-i]``.

    a = exp(-h/τ) (paper, Eq 10). Without dead time two samples act. Zero hold: f[k] by 0, f[k-1]
    by 1 - a (Eq 11). First hold, with r = (1 - a) τ/h: f[k] by 1 - r, f[k-1] by r - a, the exact
    response to a ramp. With a dead time of m + δ samples, 0 <= δ < 1, f[k-m], f[k-m-1] and
    f[k-m-2] act. Derivatives are with respect to log τ, in which a fit works, and to the dead time
    in samples.
    """

    tau_s: float
    sample_period_s: float
    # "zero": f[k] acts from k to k+1 (paper, Eq 9-11 to the letter). "first": f is a continuous
    # signal, joined by straight lines between its samples
    hold: Hold
    dead_time_s: float = 0.0  # How much later f acts; any fraction of a sample

    @cached_property
    def ratio(self) -> float:
        """Sample period over time constant, h/τ."""
        return self.sample_period_s / self.tau_s

    @cached_property
    def a(self) -> float:
        """Pole of the discrete lag (paper, Eq 10)."""
        return float(np.exp(-self.ratio))

    @property
    def d_a(self) -> float:
        """Derivative of the pole with respect to log τ."""
        return self.a * self.ratio

    @property
    def gain_now(self) -> float:
        """Weight of f[k] in x[k]; without dead time."""
        return float(self.taps[0, 0])

    @property
    def gain_before(self) -> float:
        """Weight of f[k-1] in x[k]; without dead time."""
        return float(self.taps[0, 1])

    @property
    def whole_samples(self) -> int:
        """Whole samples m of the dead time."""
        return int(np.floor(self.dead_time_s / self.sample_period_s + 1e-9))

    @cached_property
    def taps(self) -> FloatArray:
        """Weights of f[k-m], f[k-m-1], f[k-m-2] in x[k], of shape (3, 3).

        The rows are the weights and their derivatives with respect to log τ and to the dead time
        in samples: the exact response to steps (or straight lines) that begin δ late.
        """
        late = max(self.dead_time_s / self.sample_period_s - self.whole_samples, 0.0)
        r, a, rest = self.ratio, self.a, 1.0 - late
        e = float(np.exp(-r * rest))
        # expm1 keeps the digits that 1 - a loses when τ is much longer than h.
        begun = -float(np.expm1(-r * rest))
        ended = e * float(np.expm1(-r * late))
        if self.hold == "zero":
            return np.array(
                [
                    [0.0, begun, -ended],
                    [0.0, -r * rest * e, r * (rest * e - a)],
                    [0.0, -r * e, r * e],
                ]
            )
        now = rest - begun / r
        old = -ended / r - late * a
        d_now = rest * e - begun / r
        d_old = rest * e - a - ended / r - r * late * a
        return np.array(
            [
                [now, -float(np.expm1(-r)) - now - old, old],
                [d_now, -r * a - d_now - d_old, d_old],
                [e - 1.0, 1.0 - 2.0 * e + a, e - a],
            ]
        )

    def drive(self, quasi_steady: FloatArray, derivative: int = 0) -> FloatArray:
        """Return ``Σ_i taps[i] f[k-i]`` for k = 1 … n-1, f of shape (n,) or (n, p), not late.

        With ``derivative`` 1, its derivative with respect to log τ for the f that is given. Only of
        a lag without dead time, whose input two samples before has no part in it.
        """
        assert self.dead_time_s == 0.0
        taps = self.taps[derivative]
        before = taps[1] * quasi_steady[:-1]
        both = before if self.hold == "zero" else before + taps[0] * quasi_steady[1:]
        return np.asarray(both)

    def respond(self, quasi_steady: FloatArray, start: FloatArray | float) -> FloatArray:
        """Return the state x for the input f of shape (n,) or (n, p), from its start, in O(n)."""
        return self.accumulate(self.drive(quasi_steady), start)

    def d_respond(self, quasi_steady: FloatArray, state: FloatArray) -> FloatArray:
        """Return ∂x/∂(log τ) of the state x that :meth:`respond` gave, its start held fixed."""
        forcing = self.drive(quasi_steady, 1) + self.d_a * state[:-1]
        return self.accumulate(forcing, np.zeros_like(state[0]))

    def accumulate(self, drive: FloatArray, start: FloatArray | float) -> FloatArray:
        """Run ``x[k] = a x[k-1] + drive[k-1]`` from a start."""
        from scipy.signal import lfilter

        x = np.empty((drive.shape[0] + 1, *drive.shape[1:]))
        x[0] = start
        if drive.shape[0] > 0:
            # lfilter's state is what is added to the next output: a times the state before it.
            x[1:], _ = lfilter([1.0], [1.0, -self.a], drive, axis=0, zi=self.a * x[:1])
        return x

    def decay(self, n_samples: int) -> FloatArray:
        """Return a^k for k = 0 … n-1: what a start that is off by one adds."""
        return np.asarray(np.exp(-self.ratio * np.arange(n_samples)))
