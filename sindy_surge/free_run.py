"""Free run of the lag and of an identified model, with a dead time of either sign."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sindy_surge.candidate_terms import CandidateTerms
from sindy_surge.segments import Segments
from surge_core.lag import FirstOrderLag
from surge_core.types import FloatArray, IndexArray

_MOST_STEPS = 60
_STEP = 1e-6


def driven(lag: FirstOrderLag, values: FloatArray, rows: IndexArray, by: int = 0) -> FloatArray:
    """Return Σ_i taps[by, i] values[row - m - i] for rows of the record.

    The values are the forcing at the samples, (n_rows,) or (n_rows, n_columns); the inputs of the
    rows, the dead time of m samples and a fraction earlier, are in the record. ``by`` 1 or 2 is the
    derivative with respect to log τ or to the dead time in samples.
    """
    at = rows - lag.whole_samples
    taps = lag.taps[by]
    result: FloatArray = taps[0] * values[at] + taps[1] * values[at - 1]
    return result + taps[2] * values[at - 2] if taps[2] else result


def run_lag(
    drive: FloatArray, segments: Segments, pole: float, initial: FloatArray | None = None
) -> FloatArray:
    """Run x[k] = pole x[k-1] + drive[k] through every segment from its own initial state.

    The drive has a value or a row of columns a row; that of a segment's first row is not used.
    Without initial states, one a segment, every run starts at zero.
    """
    from scipy.signal import lfilter

    states = drive.copy()
    states[segments.starts] = 0.0
    if initial is not None:
        states[segments.starts] = np.reshape(initial, (-1, *(1,) * (drive.ndim - 1)))
    for rows in segments.slices():
        states[rows] = lfilter([1.0], [1.0, -pole], states[rows], axis=0)
    return states


def simulate(
    forcing: FloatArray, segments: Segments, lag: FirstOrderLag, initial: FloatArray | None = None
) -> FloatArray:
    """Run the lag without dead time over its forcing; see `run_lag`."""
    drive = lag.gain_now * forcing
    drive[1:] += lag.gain_before * forcing[:-1]
    return run_lag(drive, segments, lag.a, initial)


def solve_recursion(
    ahead: FloatArray, behind: FloatArray, target: FloatArray, segments: Segments
) -> FloatArray:
    """Solve ahead[k] x[k] - behind[k] x[k-1] = target[k]; each segment's first x is its target.

    ``ahead`` and ``behind`` are given at the rows `segments.later`, the target at all.
    """
    from scipy.linalg import solve_banded

    band = np.zeros((2, target.size))
    band[0] = 1.0
    band[0, segments.later] = ahead
    band[1, segments.later - 1] = -behind
    return np.asarray(solve_banded((1, 0), band, target))


@dataclass(frozen=True)
class FreeModel:
    """τ dψ'/dt + ψ' = Σ β_i s_i(φ(t - d), ψ') with its numbers."""

    terms: CandidateTerms  # The library
    selected: IndexArray  # (n_terms,): The terms of the model
    coefficients: FloatArray  # (n_terms,): β
    lag: FirstOrderLag  # τ, the dead time, the sample period and the hold
    # Least and greatest ψ' of the record. A model with terms in ψ' may run away far from its
    # record; it is stopped ten ranges outside
    seen: tuple[float, float]

    @property
    def holds_state(self) -> bool:
        """Whether a term holds ψ'."""
        return bool(np.any(self.selected >= self.terms.n_without_state))

    def values(self, inputs: FloatArray, psi_p: FloatArray) -> FloatArray:
        """Evaluate the terms: from (n, n_inputs) when they act and ψ' then to (n, n_terms)."""
        order = np.argsort(self.selected, kind="stable")
        rising = self.terms(inputs, psi_p, self.selected[order].tolist())
        values = np.empty_like(rising)
        values[:, order] = rising
        return values

    def forcing(self, inputs: FloatArray, psi_p: FloatArray) -> FloatArray:
        """Return Σ β_i s_i; see `values`."""
        result: FloatArray = self.values(inputs, psi_p) @ self.coefficients
        return result

    def gain(self, inputs: FloatArray, psi_p: FloatArray) -> FloatArray:
        """Return ∂(Σ β_i s_i)/∂ψ'; see `values`."""
        if not self.holds_state:
            return np.zeros(psi_p.size)
        step = _STEP * max(1.0, float(np.max(np.abs(psi_p), initial=0.0)))
        above, below = self.forcing(inputs, psi_p + step), self.forcing(inputs, psi_p - step)
        return (above - below) / (2 * step)

    def rate(self, psi_p: ArrayLike, *inputs: ArrayLike) -> Any:
        """Return dψ'/dt = (Σ β_i s_i(φ(t - d), ψ') - ψ')/τ in 1/s, of the inputs' common shape.

        ψ' is that of now; the inputs, in the order of the columns, are those of the dead time ago.
        """
        given = (np.asarray(values, dtype=np.float64) for values in (psi_p, *inputs))
        state, *columns = np.broadcast_arrays(*given)
        flat = state.ravel()
        forcing = self.forcing(np.column_stack([column.ravel() for column in columns]), flat)
        rates = (forcing - flat) / self.lag.tau_s
        return rates.reshape(state.shape) if state.ndim else float(rates[0])

    def at_rest(self, inputs: FloatArray) -> FloatArray:
        """Return the ψ' at which nothing changes, by Newton's method; nan where there is none."""
        state = self.forcing(inputs, np.zeros(inputs.shape[0]))
        if not self.holds_state:
            return state
        state = self._bounded(state)
        with np.errstate(all="ignore"):
            for _ in range(_MOST_STEPS):
                gap = self.forcing(inputs, state) - state
                state = self._bounded(state - gap / (self.gain(inputs, state) - 1.0))
            gap = self.forcing(inputs, state) - state
        return np.where(np.abs(gap) < 1e-9 * (1.0 + np.abs(state)), state, np.nan)

    def _bounded(self, state: FloatArray) -> FloatArray:
        low, high = self.seen
        reach = 10.0 * max(high - low, 1e-3 * max(abs(low), abs(high)), 1e-300)
        return np.clip(np.nan_to_num(state), low - reach, high + reach)

    def run(self, inputs: FloatArray, segments: Segments, initial: FloatArray) -> FloatArray:
        """Run the model freely, each segment from the ψ' given for its first row.

        Before a segment begins its inputs are taken to have been what they are at its first row
        (after its end, for a dead time below zero, at its last).
        """
        lag, later = self.lag, segments.later
        rows = np.arange(segments.n_rows)
        sources = [segments.within(rows - lag.whole_samples - i) for i in range(3)]

        def driven(forcing: FloatArray) -> FloatArray:
            pairs = zip(lag.taps[0], sources, strict=True)
            return np.asarray(sum(tap * forcing[source] for tap, source in pairs))

        state = np.repeat(initial, segments.lengths)
        if not self.holds_state:
            return run_lag(driven(self.forcing(inputs, state)), segments, lag.a, initial)
        samples = lag.dead_time_s / lag.sample_period_s
        ahead = int(np.floor(samples))
        near, far = segments.within(rows + ahead), segments.within(rows + ahead + 1)
        for _ in range(_MOST_STEPS):
            # ψ' at the times when the inputs of each row act.
            acting = (1 - samples + ahead) * state[near] + (samples - ahead) * state[far]
            gain = np.clip(self.gain(inputs, acting), -np.inf, 1.0)
            target = driven(self.forcing(inputs, acting)) - state
            target[1:] += lag.a * state[:-1]
            target[segments.starts] = initial - state[segments.starts]
            now = 1.0 - lag.gain_now * gain[later]
            before = lag.a + lag.gain_before * gain[later - 1]
            change = solve_recursion(now, before, target, segments)
            state = self._bounded(state + change)
            if float(np.max(np.abs(change))) < 1e-12 * (1.0 + float(np.max(np.abs(state)))):
                break
        return state
