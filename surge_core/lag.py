"""The first-order lag in discrete time, for both ways of reading the input between samples."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from surge_core.types import FloatArray

__all__ = ["FirstOrderLag", "Hold"]

Hold = Literal["zero", "first"]


@dataclass(frozen=True)
class FirstOrderLag:
    """τ dx/dt + x = f sampled with period h: ``x[k] = a x[k-1] + now f[k] + before f[k-1]``.

    Parameters
    ----------
    tau_s : float
        Time constant, in seconds.
    sample_period_s : float
        Sample period h, in seconds.
    hold : {"zero", "first"}
        ``"zero"``: f[k] acts from k to k+1 (paper, Eq 9-11 to the letter). ``"first"``: f is a
        continuous signal, joined by straight lines between its samples.
    dead_time_s : float
        How much later f acts, in seconds; any fraction of a sample. Before the first sample f
        stood at it.

    Notes
    -----
    a = exp(-h/τ) (paper, Eq 10). Zero hold: ``now = 0``, ``before = 1 - a`` (Eq 11). First hold:
    with r = (1 - a) τ/h, ``now = 1 - r`` and ``before = r - a``, the exact response to a ramp.
    The derivatives are with respect to log τ, in which the fit works. With a dead time of
    m + δ samples, 0 <= δ < 1, three samples f[k-m], f[k-m-1], f[k-m-2] act in place of two.
    """

    tau_s: float
    sample_period_s: float
    hold: Hold
    dead_time_s: float = 0.0

    @property
    def ratio(self) -> float:
        """Sample period over time constant, h/τ."""
        return self.sample_period_s / self.tau_s

    @property
    def a(self) -> float:
        """Pole of the discrete lag (paper, Eq 10)."""
        return float(np.exp(-self.ratio))

    @property
    def gain_now(self) -> float:
        """Weight of f[k] in x[k]."""
        return 0.0 if self.hold == "zero" else 1.0 - self._ramp

    @property
    def gain_before(self) -> float:
        """Weight of f[k-1] in x[k]."""
        # expm1 keeps the digits that 1 - a loses when τ is much longer than h.
        return -float(np.expm1(-self.ratio)) if self.hold == "zero" else self._ramp - self.a

    @property
    def d_a(self) -> float:
        """Derivative of the pole with respect to log τ."""
        return self.a * self.ratio

    @property
    def d_gain_now(self) -> float:
        """Derivative of ``gain_now`` with respect to log τ."""
        return 0.0 if self.hold == "zero" else self.a - self._ramp

    @property
    def d_gain_before(self) -> float:
        """Derivative of ``gain_before`` with respect to log τ."""
        return -self.d_a if self.hold == "zero" else self._ramp - self.a - self.d_a

    @property
    def _ramp(self) -> float:
        return -float(np.expm1(-self.ratio)) / self.ratio

    def drive(self, quasi_steady: FloatArray) -> FloatArray:
        """Return ``now f[k] + before f[k-1]`` for k = 1 … n-1.

        Parameters
        ----------
        quasi_steady : ndarray of shape (n,) or (n, p)
            Samples of f.

        Returns
        -------
        ndarray of shape (n - 1,) or (n - 1, p)
        """
        if self.dead_time_s > 0.0:
            taps, n = self.taps[0], quasi_steady.shape[0]
            late = [
                quasi_steady[np.maximum(np.arange(1, n) - self.whole_samples - back, 0)]
                for back in range(3)
            ]
            return np.asarray(taps[0] * late[0] + taps[1] * late[1] + taps[2] * late[2])
        return self.gain_now * quasi_steady[1:] + self.gain_before * quasi_steady[:-1]

    @property
    def whole_samples(self) -> int:
        """Whole samples m of the dead time."""
        return int(np.floor(self.dead_time_s / self.sample_period_s + 1e-9))

    @property
    def taps(self) -> FloatArray:
        """Weights of f[k-m], f[k-m-1], f[k-m-2] in x[k], of shape (3, 3).

        The rows are the weights and their derivatives with respect to log τ and to the dead time
        in samples: the exact response to steps (or straight lines) that begin δ late.
        """
        late = max(self.dead_time_s / self.sample_period_s - self.whole_samples, 0.0)
        r, a, rest = self.ratio, self.a, 1.0 - late
        e = float(np.exp(-r * rest))
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

    def d_drive(self, quasi_steady: FloatArray) -> FloatArray:
        """Return the derivative of :meth:`drive` with respect to log τ."""
        return self.d_gain_now * quasi_steady[1:] + self.d_gain_before * quasi_steady[:-1]

    def respond(self, quasi_steady: FloatArray, start: FloatArray | float) -> FloatArray:
        """Return the state x for the input f, in O(n).

        Parameters
        ----------
        quasi_steady : ndarray of shape (n,) or (n, p)
            Samples of f.
        start : float or ndarray of shape (p,)
            State at the first sample.

        Returns
        -------
        ndarray of the shape of ``quasi_steady``
        """
        return self.accumulate(self.drive(quasi_steady), start)

    def d_respond(self, quasi_steady: FloatArray, state: FloatArray) -> FloatArray:
        """Return dx/d(log τ) for the state x that :meth:`respond` gave, its start held fixed."""
        forcing = self.d_a * state[:-1] + self.d_drive(quasi_steady)
        return self.accumulate(forcing, np.zeros_like(state[0]))

    def accumulate(self, drive: FloatArray, start: FloatArray | float) -> FloatArray:
        """Run ``x[k] = a x[k-1] + drive[k-1]`` from a start."""
        from scipy.signal import lfilter

        first = np.broadcast_to(np.asarray(start, dtype=np.float64), drive.shape[1:])[None]
        if drive.shape[0] == 0:
            return np.array(first)
        # lfilter's state is what is added to the next output: a times the state before it.
        rest, _ = lfilter([1.0], [1.0, -self.a], drive, axis=0, zi=self.a * first)
        return np.concatenate([first, rest])

    def decay(self, n_samples: int) -> FloatArray:
        """Return a^k for k = 0 … n-1: what a start that is off by one adds."""
        return np.asarray(np.exp(-self.ratio * np.arange(n_samples)))
