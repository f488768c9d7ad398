"""Sparse regression on free runs: a parabola, or what the runs speak for; τ and β with errors.

For columns that are ready-made, e.g. averaged after the terms were formed, and runs that are
scored only where the model holds. What such runs leave is coloured by the average and has an
error of the model in it: :mod:`sindy_surge.departure` says when terms may be added.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from sindy_surge.candidate_terms import independent_columns
from sindy_surge.departure import Departure, departure_from
from sindy_surge.free_run import simulate
from sindy_surge.held_out import Trials, polynomial_ladder, with_held_out
from sindy_surge.linear_problem import Support, least_squares, leave_out_moves, unit_norms
from sindy_surge.segments import Segments, block_slices
from sindy_surge.selection import PathRow
from surge_core.fit_state import FitState
from surge_core.lag import FirstOrderLag, Hold
from surge_core.leave_out import scatter
from surge_core.types import FloatArray, IndexArray

__all__ = ["FreeRunEquations", "FreeRunFit", "SparseRun", "select_on_free_run"]


# A cycle that alone reaches part of the range of φ cannot be foretold by the others: its error
# would decide the mean of twenty.
_MOST_LEVERAGE = 0.5
# The first terms of a library are its simplest: enough to find the basin of τ.
_SIMPLEST = 3
# Scored rows for each parameter; below it nothing is fitted.
_ROWS_A_PARAMETER = 2
_SHORTEST_SAMPLES = 0.1
# A lag three times the longest run looks like an integrator.
_LONGEST_RUNS = 3.0
_SCAN_POINTS = 32
_MOST_STEPS = 10
# Two digits bring Gauss-Newton into its basin; its end is then far below any standard error.
_BRACKETED, _CONVERGED = 1e-2, 1e-9
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

    Parameters
    ----------
    columns : ndarray of shape (n_rows, n_columns)
        The candidate terms s_i.
    nuisance : ndarray of shape (n_rows, n_nuisances)
        Columns that are in every structure; may have none.
    output : ndarray of shape (n_rows,)
        ψ'.
    weight : ndarray of shape (n_rows,)
        Weight of each squared error; rows of weight 0 are simulated through.
    runs : Segments
        The runs of rows.
    sample_period_s : float
        Sample period in seconds.
    hold : {"first", "zero"}
        How the columns run between two samples.
    """

    columns: FloatArray
    nuisance: FloatArray
    output: FloatArray
    weight: FloatArray
    runs: Segments
    sample_period_s: float
    hold: Hold

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
        """Fit some terms and τ.

        Returns
        -------
        parameters : ndarray of shape (n_support + 1,)
            β, and last τ in seconds.
        design : ndarray of shape (n_scored, n_support + 1)
            Derivatives of the fitted values, nuisances and starts projected out.
        residual : ndarray of shape (n_scored,)
            What is left.
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

    def simulated(self, time_constant_s: float) -> FloatArray:
        """Return what each candidate contributes to the scored rows, for one τ in seconds.

        Returns
        -------
        ndarray of shape (n_scored, n_columns)
            Run through the lag, nuisances and starts projected out; zero where nuisances make up
            the whole column.
        """
        n = self.nuisance.shape[1]
        stacked = self._stacked(time_constant_s, self._all_values)
        left = _projected(stacked[:, n:-1], stacked[:, :n])
        own = np.linalg.norm(left, axis=0) > _ALIAS * np.linalg.norm(stacked[:, n:-1], axis=0)
        return np.where(own, left, 0.0)

    def apart(self) -> list[FreeRunEquations]:
        """Return the equations of each run alone."""
        slices = self.runs.slices()
        return [self._of_run(rows) for rows in slices] if len(slices) > 1 else [self]

    def _of_run(self, rows: slice) -> FreeRunEquations:
        nuisance = self.nuisance[rows]
        return replace(
            self,
            columns=self.columns[rows],
            nuisance=nuisance[:, np.ptp(nuisance, axis=0) > 0.0],
            output=self.output[rows],
            weight=self.weight[rows],
            runs=Segments.from_labels(None, rows.stop - rows.start),
        )

    def profiled(self, support: Support) -> tuple[float, float, float]:
        """Return the least squared error over a grid of τ, and the last term's coefficient there.

        Returns
        -------
        error, coefficient, information : float
            The error at the vertex of the parabola through the least three; the inverse of the
            coefficient's variance for errors of variance one.
        """
        grid, triangles = self._scan
        n = self.nuisance.shape[1]
        wanted = [*range(n), *(n + i for i in support)]
        errors = np.array([_cost(each[:, wanted], each[:, -1]) for each in triangles])
        at = int(np.clip(np.argmin(errors), 1, grid.size - 2))
        below, error, above = errors[at - 1 : at + 2]
        bend = below + above - 2.0 * error
        if bend > 0.0 and error <= min(below, above):
            error -= (above - below) ** 2 / (8.0 * bend)
        best = triangles[int(np.argmin(errors))]
        before = best[:, wanted[:-1]]
        last = _projected(best[:, [wanted[-1]]], before)[:, 0]
        information = max(float(last @ last), 1e-300)
        return float(error), float(last @ best[:, -1]) / information, information

    def blocks(self, cycles: IndexArray, time_constant_s: float) -> list[IndexArray]:
        """Return the scored rows of each cycle, counted among the scored.

        Parameters
        ----------
        cycles : ndarray of int of shape (n_rows,)
            Number of the cycle of each row.
        time_constant_s : float
            τ in seconds: no cycle is cut into parts of fewer than two of it.
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

    def _scanned(self, support: Support) -> tuple[float, float]:
        """Return the neighbours of the best τ of the grid."""
        grid, triangles = self._scan
        n = self.nuisance.shape[1]
        wanted = [*range(n), *(n + i for i in support)]
        costs = [_cost(triangle[:, wanted], triangle[:, -1]) for triangle in triangles]
        best = int(np.argmin(costs))
        return float(grid[max(best - 1, 0)]), float(grid[min(best + 1, grid.size - 1)])

    def _end(self, values: FloatArray, within: tuple[float, float]) -> float:
        """Search log τ between two values, and end with Gauss-Newton steps."""
        from scipy.optimize import minimize_scalar

        def cost(log_tau: float) -> float:
            stacked = self._stacked(float(np.exp(log_tau)), values)
            return _cost(stacked[:, :-1], stacked[:, -1])

        low, high = within
        found = minimize_scalar(
            cost,
            bounds=(np.log(low), np.log(high)),
            method="bounded",
            options={"xatol": _BRACKETED},
        )
        tau, least = float(np.exp(found.x)), float(found.fun)
        for _ in range(_MOST_STEPS):
            _, joint, residual = self._at(values, tau)
            moved = float(np.clip(tau + least_squares(joint, residual)[-1], low, high))
            new = cost(float(np.log(moved)))
            if not new < least:
                break
            small = abs(moved - tau) < _CONVERGED * tau
            tau, least = moved, new
            if small:
                break
        return tau

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


def _cost(columns: FloatArray, target: FloatArray) -> float:
    rest = target - columns @ least_squares(columns, target)
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


@dataclass(frozen=True)
class SparseRun:
    """Terms, τ and β found on free runs; without terms where too few rows are scored.

    Parameters
    ----------
    support : tuple of int
        Columns of the terms that were chosen.
    terms : tuple of str
        Their names.
    time_constant_s : float
        τ in seconds.
    coefficients : ndarray of shape (n_terms,)
        β in physical units.
    covariance : ndarray of shape (n_terms + 1, n_terms + 1)
        Of β and, last, τ: a jackknife over cycles, what all cycles share and, where others stand
        beside it, what structures differ by that the data cannot separate from the chosen one.
    n_blocks : int
        Cycles behind the jackknife.
    departure : Departure or None
        What speaks against the parabola.
    path : tuple of PathRow
        Every structure tried, with its error on cycles left out.
    state : FitState
        What became of the fit.
    """

    support: Support = ()
    terms: tuple[str, ...] = ()
    time_constant_s: float = float("nan")
    coefficients: FloatArray = field(default_factory=lambda: np.zeros(0))
    covariance: FloatArray = field(default_factory=lambda: np.full((1, 1), np.nan))
    n_blocks: int = 0
    departure: Departure | None = None
    path: tuple[PathRow, ...] = ()
    state: FitState = FitState.TOO_FEW_ROWS

    @property
    def time_constant_stderr_s(self) -> float:
        """Standard error of τ in seconds."""
        return float(np.sqrt(self.covariance[-1, -1]))


def select_on_free_run(
    equations: FreeRunEquations,
    names: Sequence[str],
    degrees: Sequence[int | None],
    cycles: IndexArray,
    *,
    judged: FreeRunEquations | None = None,
    shows_shape: bool = True,
    max_terms: int = 6,
    common_tau_share: float = 0.0,
    common_curve_share: float = 0.0,
) -> SparseRun:
    """Choose a parabola, a cubic or a parabola with a kink, and fit it on free runs.

    The parabola is left only where that saves more of the error than a needless term does.

    Parameters
    ----------
    equations : FreeRunEquations
        The candidate terms, what is in every structure, ψ' and which rows are scored.
    names : sequence of str
        Names of the candidate terms.
    degrees : sequence of int or None
        Total degree of each; None for a term that is no polynomial.
    cycles : ndarray of int of shape (n_rows,)
        Number of the cycle of each row: what is left out together.
    judged : FreeRunEquations, optional
        The same columns with other rows scored, on which terms are chosen: more rows show more of
        the curve, where they would move τ.
    shows_shape : bool
        Whether the parabola may be left.
    max_terms : int
        Largest structure considered.
    common_tau_share, common_curve_share : float
        Standard errors that all cycles share, as shares of τ and of the mean of abs(ψ') over the
        scored rows: no jackknife over cycles sees them.

    Returns
    -------
    SparseRun
        The terms with τ, β and their covariance.
    """
    columns = equations.columns
    most = min(max_terms, columns.shape[1])
    unknowns = most + equations.nuisance.shape[1] + equations.runs.starts.size + 1
    if equations.scored.size < _ROWS_A_PARAMETER * unknowns:
        return SparseRun()
    # τ of the simplest terms shows what can be separated, and how long errors hang together.
    pilot_s = float(equations.solve(tuple(range(min(_SIMPLEST, most)))).parameters[-1])
    usable = independent_columns(equations.simulated(pilot_s))
    if not usable.size:
        return SparseRun()
    equations = replace(equations, columns=columns[:, usable])
    blocks = equations.blocks(cycles, pilot_s)
    trials = Trials(equations, [(rows, rows) for rows in blocks], _MOST_LEVERAGE)
    kept = [names[i] for i in usable]
    powers = [degrees[i] for i in usable]
    ladder = [*polynomial_ladder(powers, most), tuple(range(most))]
    parabola, cubic = ladder[min(1, len(ladder) - 2)], ladder[min(2, max(len(ladder) - 2, 0))]
    hinges = [i for i, name in enumerate(kept) if name.startswith("relu") and most > len(parabola)]
    judge = equations if judged is None else replace(judged, columns=judged.columns[:, usable])
    seconds = equations.scored.size * equations.sample_period_s / equations.runs.starts.size
    found = departure_from(judge, parabola, cubic, hinges, seconds if shows_shape else 0.0)
    chosen = found.structure
    for structure in found.tried:
        trials.error(structure)
    fit = equations.solve(chosen)
    # The nuisances are estimated again without each cycle as well.
    moves = leave_out_moves(fit.joint, fit.residual, blocks)
    n = len(chosen)
    covariance = scatter(np.delete(moves, np.s_[n : n + fit.nuisance.size], axis=1))
    covariance += _spread(equations, fit, chosen, found.rivals)
    covariance += _shared(equations, fit, chosen, common_tau_share, common_curve_share)
    tau, stderr = float(fit.parameters[-1]), float(np.sqrt(covariance[-1, -1]))
    if tau < equations.sample_period_s / 2:
        state = FitState.LAG_BELOW_RESOLUTION
    elif not stderr < tau or tau > 0.99 * equations.longest_lag_s:
        state = FitState.LAG_UNDETERMINED
    else:
        state = FitState.OK
    return SparseRun(
        tuple(int(usable[i]) for i in chosen),
        tuple(kept[i] for i in chosen),
        tau,
        fit.parameters[:-1],
        covariance,
        len(blocks),
        found,
        with_held_out((), trials, chosen, kept),
        state,
    )


def _spread(
    equations: FreeRunEquations, fit: FreeRunFit, chosen: Support, rivals: Sequence[Support]
) -> FloatArray:
    """Return what the choice among structures adds that the data cannot separate.

    The mean square of what the curve and τ of each differ by; the curves as far as the terms
    that were chosen can follow.
    """
    values = equations.columns[equations.scored]
    curve = values[:, list(chosen)] @ fit.parameters[:-1]
    result = np.zeros((fit.parameters.size, fit.parameters.size))
    for rival in rivals:
        other = equations.solve(rival).parameters
        apart = least_squares(values[:, list(chosen)], values[:, list(rival)] @ other[:-1] - curve)
        shift = np.append(apart, other[-1] - fit.parameters[-1])
        result += np.outer(shift, shift) / len(rivals)
    return result


def _shared(
    equations: FreeRunEquations,
    fit: FreeRunFit,
    chosen: Support,
    tau_share: float,
    curve_share: float,
) -> FloatArray:
    """Return the covariance of errors that all cycles share: of τ, and of the curve's level."""
    values = equations.columns[equations.scored][:, list(chosen)]
    # The level moves along whatever the terms make of a constant.
    level = least_squares(values, np.ones(len(values)))
    level = level * curve_share * float(np.mean(np.abs(equations.output[equations.scored])))
    result = np.zeros((len(chosen) + 1, len(chosen) + 1))
    result[:-1, :-1] = np.outer(level, level)
    result[-1, -1] = (tau_share * float(fit.parameters[-1])) ** 2
    return result
