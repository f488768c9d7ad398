"""Free run of the lag and of an identified model, with a dead time of either sign.

And terms, nuisances, τ and starts fitted to the scored rows of free runs (variable projection).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sindy_surge.candidate_terms import CandidateTerms
from sindy_surge.linear_problem import Support, least_squares, unit_norms
from sindy_surge.segments import Segments, block_slices
from surge_core.lag import FirstOrderLag, Hold
from surge_core.types import FloatArray, IndexArray

_SHORTEST_SAMPLES = 0.1
# A lag three times the longest run looks like an integrator.
_LONGEST_RUNS = 3.0
_SCAN_POINTS = 32
# Of log τ: far below any standard error.
_CONVERGED = 1e-9
_DIFFERENCE = 1e-4
# Share of a column that the nuisances must leave.
_ALIAS = 1e-9


@dataclass(frozen=True)
class FreeRunFit:
    """One structure fitted to the scored rows."""

    parameters: FloatArray  # (n_support + 1,): β, and last τ in seconds
    nuisance: FloatArray  # (n_nuisances,): Coefficients of the columns that every structure has
    # (n_scored, n_support + n_nuisances + 1): Derivatives of the fitted values with respect to β,
    # the nuisances and τ; starts projected out
    joint: FloatArray
    residual: FloatArray  # (n_scored,): What is left, times the root of the weights


@dataclass(frozen=True)
class FreeRunEquations:
    """The scored rows of free runs τ x' + x = Σ β_i s_i + Σ γ_j n_j, with s_i and n_j as columns.

    What is not scored is simulated through. The start of each run is a parameter of its own,
    and projected out; all that enters linearly is solved for at each τ (variable projection,
    Golub & Pereyra 1973).
    """

    columns: FloatArray  # (n_rows, n_columns): The candidate terms s_i
    # (n_rows, n_nuisances): Columns that are in every structure; may have none
    nuisance: FloatArray
    output: FloatArray  # (n_rows,): ψ'
    # (n_rows,): Weight of each squared error; rows of weight 0 are simulated through
    weight: FloatArray
    runs: Segments  # The runs of rows
    sample_period_s: float  # Sample period in seconds
    hold: Hold  # {"first", "zero"}: How the columns run between two samples

    @property
    def longest_lag_s(self) -> float:
        """The longest τ tried, in seconds."""
        return _LONGEST_RUNS * float(self.runs.lengths.max()) * self.sample_period_s

    @cached_property
    def scored(self) -> IndexArray:
        """Rows that are scored."""
        return np.flatnonzero(self.weight > 0)

    @cached_property
    def run(self) -> IndexArray:
        """Number of the run of each scored row."""
        return np.repeat(np.arange(self.runs.starts.size), self.runs.lengths)[self.scored]

    def fit(self, support: Support) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Fit some terms and τ: β with τ last, the derivatives of the fitted values, the residual.

        Nuisances and starts are projected out of the derivatives, (n_scored, n_support + 1).
        """
        found = self.solve(support)
        between = np.s_[len(support) : len(support) + self.nuisance.shape[1]]
        own = np.delete(found.joint, between, axis=1)
        return found.parameters, _projected(own, found.joint[:, between]), found.residual

    def solve(self, support: Support) -> FreeRunFit:
        """Fit some terms and τ, and keep all that goes with it."""
        values = np.column_stack((self.columns[:, list(support)], self.nuisance))
        tau = self._end(values, self._scanned(support))
        solution, joint, residual = self._at(values, tau)
        n = len(support)
        return FreeRunFit(np.append(solution[:n], tau), solution[n:], joint, residual)

    def solve_all(self) -> FreeRunFit:
        """Fit all terms and τ."""
        return self.solve(tuple(range(self.columns.shape[1])))

    def coefficients(self, time_constant_s: float) -> FloatArray:
        """Return the coefficients of nuisances and all terms at one τ in seconds."""
        stacked = self._stacked(time_constant_s, self._all_values)
        return least_squares(stacked[:, :-1], stacked[:, -1])

    def left(self, time_constant_s: float) -> FloatArray:
        """Return what all terms leave of ψ' in the scored rows, for one τ in seconds."""
        stacked = self._stacked(time_constant_s, self._all_values)
        return _rest(stacked[:, :-1], stacked[:, -1])

    def simulated(self, time_constant_s: float) -> FloatArray:
        """Return what each candidate contributes to the scored rows, for one τ in seconds.

        Run through the lag, nuisances and starts projected out; zero where nuisances make up the
        whole column.
        """
        n = self.nuisance.shape[1]
        stacked = self._stacked(time_constant_s, self._all_values)
        left = _projected(stacked[:, n:-1], stacked[:, :n])
        own = np.linalg.norm(left, axis=0) > _ALIAS * np.linalg.norm(stacked[:, n:-1], axis=0)
        return np.where(own, left, 0.0)

    def profiled(self, support: Support) -> tuple[float, float, float]:
        """Return the least squared error over a grid of τ, and the last term's coefficient there.

        The error is that at the vertex of the parabola through the logarithms of the least three,
        for where it falls by ten from one τ to the next a parabola through them falls below zero.
        Last comes the inverse of the coefficient's variance for errors of variance one.
        """
        wanted, errors = self._errors(support)
        at = int(np.clip(np.argmin(errors), 1, errors.size - 2))
        below, error, above = np.log(np.maximum(errors[at - 1 : at + 2], 1e-300))
        bend = below + above - 2.0 * error
        if bend > 0.0 and error <= min(below, above):
            error -= (above - below) ** 2 / (8.0 * bend)
        best = self._scan[1][int(np.argmin(errors))]
        before = best[:, wanted[:-1]]
        last = _projected(best[:, [wanted[-1]]], before)[:, 0]
        information = max(float(last @ last), 1e-300)
        return float(np.exp(error)), float(last @ best[:, -1]) / information, information

    def blocks(self, cycles: IndexArray, time_constant_s: float) -> list[IndexArray]:
        """Return the scored rows of each cycle, counted among the scored, by its number a row.

        No cycle is cut into parts of fewer than two time constants.
        """
        numbers = self.run * (int(np.ptp(cycles)) + 1) + (cycles - cycles.min())[self.scored]
        within = Segments.from_labels(numbers, self.scored.size)
        shortest = round(2.0 * time_constant_s / self.sample_period_s)
        return [np.arange(b.start, b.stop) for b in block_slices(within, shortest)]

    @property
    def _all_values(self) -> FloatArray:
        return np.column_stack((self.nuisance, self.columns))

    def _lag(self, tau: float) -> FirstOrderLag:
        return FirstOrderLag(tau, self.sample_period_s, self.hold)

    def _decays(self, tau: float) -> FloatArray:
        """Return what a start of one in each run leaves at the scored rows, (n_scored, n_runs)."""
        decays = np.zeros((self.scored.size, self.runs.starts.size))
        offsets = self.runs.offsets()[self.scored].astype(float)
        decays[np.arange(self.scored.size), self.run] = self._lag(tau).a ** offsets
        return decays * np.sqrt(self.weight[self.scored])[:, None]

    def _stacked(self, tau: float, values: FloatArray) -> FloatArray:
        """Return the columns behind the lag, and last ψ', at the scored rows without starts."""
        every = np.column_stack((simulate(values, self.runs, self._lag(tau)), self.output))
        return self._without_starts(every, tau)[0]

    def _without_starts(self, columns: FloatArray, tau: float) -> tuple[FloatArray, FloatArray]:
        """Return the weighted scored rows of columns without starts, and these, (n_runs, n)."""
        weighted = columns[self.scored] * np.sqrt(self.weight[self.scored])[:, None]
        decays = self._decays(tau)
        # Runs do not overlap: each start is a regression of its own.
        starts = decays.T @ weighted / (unit_norms(decays) ** 2)[:, None]
        return weighted - decays @ starts, starts

    @cached_property
    def _scan(self) -> tuple[FloatArray, list[FloatArray]]:
        """Return a grid of τ with all columns and ψ' at each, compressed by QR."""
        shortest = _SHORTEST_SAMPLES * self.sample_period_s
        grid = np.geomspace(shortest, self.longest_lag_s, _SCAN_POINTS)
        stacks = [self._stacked(float(tau), self._all_values) for tau in grid]
        return grid, [np.asarray(np.linalg.qr(stack, mode="r")) for stack in stacks]

    def _errors(self, support: Support) -> tuple[list[int], FloatArray]:
        """Return the columns of nuisances and some terms, and their squared error at each τ."""
        n = self.nuisance.shape[1]
        wanted = [*range(n), *(n + i for i in support)]
        return wanted, np.array([_cost(each[:, wanted], each[:, -1]) for each in self._scan[1]])

    def _scanned(self, support: Support) -> tuple[float, float]:
        """Return the neighbours of the best τ of the grid."""
        grid, best = self._scan[0], int(np.argmin(self._errors(support)[1]))
        return float(grid[max(best - 1, 0)]), float(grid[min(best + 1, grid.size - 1)])

    def _end(self, values: FloatArray, within: tuple[float, float]) -> float:
        """Search log τ between two values."""
        from scipy.optimize import minimize_scalar

        def cost(log_tau: float) -> float:
            stacked = self._stacked(float(np.exp(log_tau)), values)
            return _cost(stacked[:, :-1], stacked[:, -1])

        low, high = within
        found = minimize_scalar(
            cost,
            bounds=(np.log(low), np.log(high)),
            method="bounded",
            options={"xatol": _CONVERGED},
        )
        return float(np.exp(found.x))

    def _at(self, values: FloatArray, tau: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return coefficients, derivatives with τ last, and the residual for one τ."""
        stacked = self._stacked(tau, values)
        solution = least_squares(stacked[:, :-1], stacked[:, -1])
        forcing = values @ solution
        rest = self.output - simulate(forcing, self.runs, self._lag(tau))
        initial = self._without_starts(rest[:, None], tau)[1][:, 0]
        step = _DIFFERENCE * tau
        above, below = (
            simulate(forcing, self.runs, self._lag(tau + sign * step), initial)
            for sign in (1.0, -1.0)
        )
        slope = self._without_starts((above - below)[:, None] / (2 * step), tau)[0]
        joint = np.column_stack((stacked[:, :-1], slope))
        return solution, joint, stacked[:, -1] - stacked[:, :-1] @ solution


def _rest(columns: FloatArray, target: FloatArray) -> FloatArray:
    return target - columns @ least_squares(columns, target)


def _cost(columns: FloatArray, target: FloatArray) -> float:
    rest = _rest(columns, target)
    return float(rest @ rest)


def _projected(columns: FloatArray, others: FloatArray) -> FloatArray:
    """Return columns without what other columns can stand in for."""
    norms = np.linalg.norm(others, axis=0)
    kept = others[:, norms > 0] / norms[norms > 0]
    if not kept.shape[1]:
        return columns
    basis, values, _ = np.linalg.svd(kept, full_matrices=False)
    basis = basis[:, values > 1e-12 * values[0]]
    result: FloatArray = columns - basis @ (basis.T @ columns)
    return result


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
        return self.terms(inputs, psi_p, self.selected.tolist())

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
