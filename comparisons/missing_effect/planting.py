"""Planting an effect of a given size into a user's own records, and noise like theirs beside it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from comparisons.missing_effect.candidates import over_rows
from comparisons.missing_effect.catalogue.workings import ripple_waves, shape_columns
from comparisons.missing_effect.effect import Effect
from comparisons.missing_effect.fit import Fit
from comparisons.missing_effect.lag_data import LagData
from comparisons.missing_effect.lag_result import LagDiagnosis
from comparisons.missing_effect.noise import Metric, NoiseModel
from comparisons.missing_effect.open_terms import with_own_state
from comparisons.missing_effect.ports import n_powers
from comparisons.missing_effect.probes import Prober
from surge_core.types import FloatArray

# A bump in the middle of the range of φ, of this width as a share of it, on so many intervals.
BUMP_WIDTH, BUMP_INTERVALS = 0.15, 7
# A ripple at a frequency that is no simple share of the sample rate.
RIPPLE_SHARE = 0.171
# What the noise model does not know of the order of the errors is kept over so many rows.
BLOCK_ROWS = 20
BURN_IN_ROWS = 200
LARGEST_ROOT = 0.995


@dataclass(frozen=True)
class Planter:
    """A fitted model of a user's records, into which effects are planted, and its noise.

    The fit is to all rows, and what it holds stays in; ``white`` is what is new in each of its
    errors, in units of the coefficient.
    """

    fit: Fit
    data: LagData
    noise: NoiseModel
    white: FloatArray

    @classmethod
    def of(cls, diagnosis: LagDiagnosis) -> Planter:
        """Return the planter of a diagnosis: its model after, its rows, its noise."""
        fit = diagnosis.after
        data = with_own_state(diagnosis.data, fit)
        noise = over_rows(diagnosis.noise, fit, data)
        metric = noise.metric()
        white = metric.whitened(fit.errors(data, Metric()), data) * noise.innovation
        kept = white[metric.rows(data) > 0.0]
        return cls(fit, data, noise, kept - kept.mean())

    def shape(self, effect: Effect) -> FloatArray:
        """Return where an effect is planted: its searched parameters beside the amplitude."""
        if effect.name == "characteristic_shape":
            return np.array([float(BUMP_INTERVALS), *self.data.references.phi_range])
        if effect.episodes:
            frequency_hz = RIPPLE_SHARE / self.data.sample_period_s
            phi = self.data.sampled(self.data["phi"])[self.data.scored()]
            return np.array([frequency_hz, float(np.median(phi))])
        starts = effect.starts(self.data)
        held = any(p.kind == "held" for p in effect.nonlinear)
        # Of values held at one of a few the first is the plain case; of a search, the middle.
        start = starts[0 if held else starts.shape[0] // 2]
        return np.asarray(start if effect.linear else start[1:])

    def coefficients(self, effect: Effect, size: float, rng: np.random.Generator) -> FloatArray:
        """Return the coefficients of the columns of an effect; the phases of a ripple vary."""
        if not effect.linear:
            return np.zeros(0)
        if effect.episodes:
            return ripple_waves(self.data, float(self.shape(effect)[1]), size, rng)
        if effect.name == "characteristic_shape":
            return size * self._bump
        return np.array([size])

    def planted(self, effect: Effect, size: float, rng: np.random.Generator) -> FloatArray:
        """Return the coefficient at every sample, without noise, with one more effect."""
        shape = self.shape(effect)
        own = shape if effect.linear else np.concatenate([[size], shape])
        groups = {**self.fit.groups(self.data), effect.name: self.coefficients(effect, size, rng)}
        structure = self.fit.structure.with_effect(effect)
        nonlinear = np.concatenate([self.fit.nonlinear, own])
        return Fit.assembled(structure, self.data, nonlinear, groups).output(self.data)

    @cached_property
    def bare(self) -> FloatArray:
        """The coefficient at every sample, without noise and with nothing planted."""
        return self.fit.output(self.data)

    def measured(self, clean: FloatArray, rng: np.random.Generator) -> LagData:
        """Return the rows with a coefficient that was measured with noise."""
        return self.data.with_measured(clean + self.draw(rng))

    def draw(self, rng: np.random.Generator) -> FloatArray:
        """Return noise on the coefficient at every sample, of shape (n,).

        What is new in each error is drawn in blocks from the fit's own, so that its tails and its
        bursts are those of the record; then it is given the colour of the noise model.
        """
        from scipy.signal import lfilter

        new, flow = self._resampled(rng, self.data.n_samples), self.noise.flow
        out = np.empty_like(new)
        if flow is not None:
            # What noise on φ leaves behind the lag.
            driven = flow.slope * self.noise.flow_sigma * rng.standard_normal(new.size)
            for run in self.data.slices:
                out[run] = lfilter([flow.now, flow.before], [1.0, -flow.a], driven[run])
            return new + out
        if not self.noise.ar:
            return new
        feedback = np.concatenate([[1.0], -_stable(np.array(self.noise.ar))])
        for run in self.data.slices:
            ahead = self._resampled(rng, BURN_IN_ROWS)
            coloured = lfilter([1.0], feedback, np.concatenate([ahead, new[run]]))
            out[run] = coloured[BURN_IN_ROWS:]
        return out

    def _resampled(self, rng: np.random.Generator, n: int) -> FloatArray:
        size = min(BLOCK_ROWS, self.white.size)
        first = rng.integers(0, self.white.size - size + 1, -(-n // size))
        rows = (first[:, None] + np.arange(size)).ravel()[:n]
        return np.asarray(self.white[rows])

    def promise(self, clean: FloatArray) -> tuple[float, float]:
        """Return what an effect as planted leaves once the model without it is fitted again.

        Returns
        -------
        gain : float
            Log-units that it would win on the fitted rows, in the metric of the noise.
        excess_sigma : float
            Rms of it there, in standard deviations of the noise.
        """
        added = (clean - self.bare)[self.data.train_rows]
        coloured = self._left(added, self._probers[0])
        plain = self._left(added, self._probers[1])
        n = max(int(np.count_nonzero(self.data.train.weight)), 1)
        return 0.5 * float(coloured @ coloured), float(np.sqrt(plain @ plain / n))

    def _left(self, added: FloatArray, prober: Prober) -> FloatArray:
        seen = prober.metric.seen(added, prober.solution.decay, prober.data)
        return np.asarray(seen - prober.basis @ (prober.basis.T @ seen))

    @cached_property
    def _probers(self) -> tuple[Prober, Prober]:
        """Score tests in the metric of the noise, and in units of its standard deviation."""
        train, rows = self.data.train, self.data.train_rows
        plain = Metric(self.noise.sigma)
        return Prober(self.fit, train, self.noise.metric().on(rows)), Prober(self.fit, train, plain)

    @cached_property
    def _bump(self) -> FloatArray:
        """Coefficients of the splines for a bump in the middle of the range, of height 1."""
        low, high = self.data.references.phi_range
        grid = np.linspace(low, high, 400)
        bump = np.exp(-0.5 * ((grid - 0.5 * (low + high)) / (BUMP_WIDTH * (high - low))) ** 2)
        n_base = n_powers(self.fit.structure.terms)
        columns = shape_columns(grid, self.data.references.phi_range, BUMP_INTERVALS, n_base)
        found = np.linalg.lstsq(columns, bump, rcond=None)[0]
        return np.asarray(found / np.max(np.abs(columns @ found)))


def _stable(ar: NDArray[np.float64]) -> FloatArray:
    """Return an autoregression whose memory dies away."""
    largest = float(np.max(np.abs(np.roots(np.concatenate([[1.0], -ar]))), initial=0.0))
    shrink = min(1.0, LARGEST_ROOT / max(largest, 1e-12))
    return np.asarray(ar * shrink ** np.arange(1, ar.size + 1))
