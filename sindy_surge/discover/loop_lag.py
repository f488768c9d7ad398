"""The lag of a compressor with one branch or two: free run, levels, terms of each branch.

τ dψ'/dt + ψ' = f_m(φ), with m = stalled or unstalled. At a given τ and given levels the free run
is linear in the coefficients; τ and the levels are profiled.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from scipy.interpolate import make_interp_spline

from sindy_surge.discover.loop_balance import FittedSum, best_terms, covariance_of_cycles, price
from sindy_surge.free_run import run_lag
from sindy_surge.library import hinge_name, monomial_name
from sindy_surge.linear_problem import least_squares
from sindy_surge.noise import smoothed
from sindy_surge.segments import Segments
from surge_core.lag import FirstOrderLag
from surge_core.types import FloatArray, IntArray

# Degree of the richest single branch, of a branch while the levels are searched, and the largest
# power among the candidate terms of a branch.
_RICHEST, _SEARCHED, _HIGHEST = 7, 3, 5
_GRID, _STARTS, _KNOTS = 26, 8, 40
# Of a step between rows. From 6 on the smoothing of φ, over rows, misses more.
_MOST_PARTS = 8
_PAIRS = 3
# Errors of a kink that counts. Where φ turns, one explains what smoothing did: on three records of
# a smooth curve by 4 errors at most, a true one by 200 and more.
_SURE = 5.0
# Two branches must leave less than this share of the variance that the richest single one leaves.
_SHARE = 0.7
# White noise taken out of both, as a share of the variance that differences show: they scatter by
# some 5 %, and noise shared by both would make any two fits alike.
_NOISE = 0.8
_TAUS_S = np.geomspace(2e-3, 80e-3, 12)


@dataclass(frozen=True)
class Branch(FittedSum):
    """One branch of the characteristic: f(φ) = Σ β_i s_i(φ).

    Parameters
    ----------
    name : str
        ``"stalled"``, ``"unstalled"`` or ``"single"``.
    powers : tuple of int
        Powers of φ; -1 and -2 stand for relu(φ - knot) and its square.
    knot : float
        Where relu(φ - knot) begins; nan without one.
    knot_stderr : float
        Its standard error.
    """

    name: str
    powers: tuple[int, ...]
    knot: float
    knot_stderr: float

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the terms."""
        kink = hinge_name("phi", float(f"{self.knot:.4g}"))
        named = ((kink, -p) if p < 0 else ("phi", p) for p in self.powers)
        return tuple(monomial_name([name], [power]) for name, power in named)

    def __call__(self, phi: FloatArray) -> FloatArray:
        """Return f(φ), of the shape of φ."""
        return _candidates(phi, self.powers, self.knot) @ self.coefficients


@dataclass(frozen=True)
class LagRows:
    """The rows that the lag is fitted to."""

    # (n_rows * parts,): Smoothed φ of all records, one behind the other, by splines between rows
    phi: FloatArray
    psi_p: FloatArray  # (n_rows,): Measured ψ'
    runs: Segments  # The rows of each record
    sample_period_s: float  # Sample period in seconds
    period_samples: int  # Rows of a surge cycle
    noise: float  # White noise of φ before it was smoothed
    parts: int = 1  # Of each step between rows, on which φ runs straight

    def refined(self) -> LagRows:
        """Return them with steps cut so that straight lines miss φ by less than its noise.

        In the mean over the record. On 97 rows a cycle they missed it by 28 times that: τ was 7
        errors low, and a parabola had powers up to the fifth.
        """
        bends = np.concatenate([np.diff(self.phi[rows], 2) for rows in self.runs.slices()])
        # Between rows a parabola is a twelfth of its second difference off, in the mean.
        missed = np.sqrt(np.mean(bends**2) * self.phi.size) / (12.0 * max(self.noise, 1e-300))
        parts = int(np.clip(round(np.sqrt(missed)), 1, _MOST_PARTS))
        return replace(self, phi=_between(self.phi, self.runs, parts), parts=parts)

    @property
    def cycles(self) -> list[slice]:
        """The rows of each cycle."""
        starts = range(0, self.psi_p.size, self.period_samples)
        return [slice(start, start + self.period_samples) for start in starts]

    def twin(self, psi_p: FloatArray, noise: FloatArray) -> LagRows:
        """Return the record measured again: φ with new noise and smoothed, ψ' as given."""
        noisy = self.phi[:: self.parts] + noise
        smooth = [smoothed(noisy[rows], self.noise) for rows in self.runs.slices()]
        phi = _between(np.concatenate(smooth), self.runs, self.parts)
        return replace(self, phi=phi, psi_p=psi_p)


@dataclass(frozen=True)
class LagFit:
    """A fitted lag.

    Parameters
    ----------
    time_constant_s, time_constant_stderr_s : float
        τ and its standard error.
    branches : tuple of Branch
        One, or the stalled and the unstalled.
    levels, levels_stderr : tuple of float
        φ_rec and φ_s with their standard errors; empty for one branch.
    rest : float
        Root mean square of what the free run leaves of ψ'.
    """

    time_constant_s: float
    time_constant_stderr_s: float
    branches: tuple[Branch, ...]
    levels: tuple[float, ...]
    levels_stderr: tuple[float, ...]
    rest: float

    def one_error_off(self) -> list[LagFit]:
        """Return it with τ, each level and each branch moved by a standard error."""
        moved = [replace(self, time_constant_s=self.time_constant_s + self.time_constant_stderr_s)]
        for i, error in enumerate(self.levels_stderr):
            levels = (*self.levels[:i], self.levels[i] + error, *self.levels[i + 1 :])
            moved.append(replace(self, levels=levels))
        for i, own in enumerate(self.branches):
            for each in own.one_error_off():
                branches = (*self.branches[:i], each, *self.branches[i + 1 :])
                moved.append(replace(self, branches=branches))
        return moved


def _between(phi: FloatArray, runs: Segments, parts: int) -> FloatArray:
    """Return φ at so many times a row; behind the last row of a run that row's."""
    fine = []
    for rows in runs.slices():
        at = np.arange(rows.stop - rows.start)
        spline = make_interp_spline(at, phi[rows])
        fine.append(spline(np.minimum(np.arange(at.size * parts) / parts, at[-1])))
    return np.concatenate(fine) if parts > 1 else phi


@njit(cache=True)
def _stalled_share(
    phi: FloatArray, starts: IntArray, recover: float, stall: float, rearm: float
) -> FloatArray:
    """Share of the interval before each row that was spent in stall."""
    share = np.zeros(phi.size)
    first = 0
    stalled, armed = False, False
    for k in range(phi.size):
        if first < starts.size and k == starts[first]:
            first += 1
            stalled = phi[k] < 0.5 * (recover + stall)
            armed = phi[k] < recover - rearm if stalled else phi[k] > stall + rearm
            share[k] = 1.0 if stalled else 0.0
            continue
        share[k] = 1.0 if stalled else 0.0
        if stalled:
            if armed and phi[k] >= recover:
                share[k] = min(max((recover - phi[k - 1]) / (phi[k] - phi[k - 1]), 0.0), 1.0)
                stalled, armed = False, phi[k] > stall + rearm
            elif phi[k] < recover - rearm:
                armed = True
        elif armed and phi[k] <= stall:
            share[k] = 1.0 - min(max((stall - phi[k - 1]) / (phi[k] - phi[k - 1]), 0.0), 1.0)
            stalled, armed = True, phi[k] < recover - rearm
        elif phi[k] > stall + rearm:
            armed = True
    return share


def _candidates(phi: FloatArray, powers: tuple[int, ...], knot: float) -> FloatArray:
    columns = [np.maximum(phi - knot, 0.0) ** -p if p < 0 else phi**p for p in powers]
    return np.column_stack(columns)


def _free_run(
    rows: LagRows, columns: FloatArray, tau_s: float, levels: tuple[float, ...] = ()
) -> FloatArray:
    """Return the free run of every column: stalled, unstalled, then the start of each record."""
    lag = FirstOrderLag(tau_s, rows.sample_period_s / rows.parts, "first")
    drive = lag.gain_now * columns
    drive[1:] += lag.gain_before * columns[:-1]
    runs = Segments(rows.runs.starts * rows.parts, rows.runs.stops * rows.parts)
    starts = runs.starts
    decay = np.zeros((rows.phi.size, starts.size))
    which = np.repeat(np.arange(starts.size), runs.lengths)
    decay[np.arange(rows.phi.size), which] = lag.a ** runs.offsets().astype(float)
    if not levels:
        return np.column_stack((run_lag(drive, runs, lag.a), decay))[:: rows.parts]
    # By how much φ must have been beyond a level before it can cross it, against noise.
    stalled = _stalled_share(rows.phi, starts, levels[0], levels[1], 2.0 * rows.noise)[:, None]
    both = np.column_stack((stalled * drive, (1.0 - stalled) * drive))
    return np.column_stack((run_lag(both, runs, lag.a), decay))[:: rows.parts]


def _rest(design: FloatArray, psi_p: FloatArray) -> float:
    """Return the root mean square that the columns of the free run leave of ψ'."""
    if np.any(np.all(design == 0, axis=0)):
        return np.inf
    gram = design.T @ design
    gram[np.diag_indices_from(gram)] += 1e-10 * np.trace(gram) / len(gram)
    beta = np.linalg.solve(gram, design.T @ psi_p)
    return float(np.sqrt(np.mean((psi_p - design @ beta) ** 2)))


def _chebyshev(phi: FloatArray, degree: int) -> FloatArray:
    z = np.interp(phi, (phi.min(), phi.max()), (-1.0, 1.0))
    return np.asarray(np.polynomial.chebyshev.chebvander(z, degree), dtype=np.float64)


def _descend(
    objective: Callable[[FloatArray], float], start: FloatArray, steps: FloatArray
) -> FloatArray:
    from scipy.optimize import minimize

    simplex = np.vstack((start, start + np.diag(steps)))
    found = minimize(
        objective,
        start,
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "xatol": 1e-5, "fatol": 1e-7, "maxiter": 150},
    )
    return np.asarray(found.x)


def fit_lag(rows: LagRows, noise: float) -> LagFit:
    """Fit τ and one branch or two, by the rule of `discover_loop`; the white noise is of ψ'."""
    one, plain, richest = _one_branch(rows)
    two = _two_branches(rows, float(np.exp(one.at[0])))
    white = _NOISE * noise**2
    kept = (two.rest**2 - white) / max(min(richest, one.rest) ** 2 - white, 1e-300)
    if kept < _SHARE and replace(two, independent=one.independent).score < one.score:
        return _stated(two)
    fit = _stated(one)
    branch = fit.branches[0]
    sure = abs(branch.coefficients) > _SURE * branch.stderr
    kink = np.any(sure[np.array(branch.powers) < 0])
    return fit if kink or one is plain else _stated(plain)


def _one_branch(rows: LagRows) -> tuple[_Trial, _Trial, float]:
    """Return the likeliest single branch, with a kink or without, that without, and a rest of ψ'.

    It is what the richest single branch (degree 7, and other cubics beyond a kink) leaves.
    """
    smooth = _chebyshev(rows.phi, _RICHEST)

    def rest(tau_s: float, knot: float) -> float:
        columns = np.column_stack((smooth, _candidates(rows.phi, (-1, -2, -3), knot)))
        return _rest(_free_run(rows, columns, tau_s), rows.psi_p)

    span = float(np.ptp(rows.phi))
    knots = np.linspace(rows.phi.min(), rows.phi.max(), _KNOTS + 2)[1:-1]
    _, tau, knot = min((rest(t, at), t, at) for t in _TAUS_S for at in knots[::2])
    log_tau, knot = _descend(
        lambda v: rest(float(np.exp(v[0])), v[1]),
        np.array([np.log(tau), knot]),
        np.array([0.2, 0.03 * span]),
    ).tolist()
    plain = _Trial(rows, tuple(range(_HIGHEST + 1)), np.array([log_tau])).settled()
    # A kink in the wrong place, with other powers beside it, can be a lesser optimum.
    kinked = replace(plain, powers=(-2, -1, *plain.powers))
    trials = [replace(kinked, at=np.array([log_tau, each])).chosen() for each in knots]
    scores = np.array([t.score if min(t.kept or (2,)) < 2 else np.inf for t in trials])
    settled = [trials[i].settled() for (i,) in _lowest(scores)]
    best = min([plain, *settled], key=lambda trial: trial.score)
    return best, plain, rest(float(np.exp(log_tau)), knot)


def _two_branches(rows: LagRows, tau_s: float) -> _Trial:
    """Fit two branches: search both levels on a grid, refine them with τ, choose the terms.

    The first τ may be that of one branch, which forced on two reads some 15 % low.
    """
    columns = _chebyshev(rows.phi, _SEARCHED)
    low, high = np.quantile(rows.phi, (0.02, 0.98))
    grid = np.linspace(low, high, _GRID + 2)[1:-1]
    step = float(grid[1] - grid[0])
    thin = slice(None, None, 3)

    def rest(tau: float, recover: float, stall: float) -> float:
        if not (low < recover < high and low < stall < high):
            return np.inf
        design = _free_run(rows, columns, tau, (recover, stall))
        return _rest(design[thin], rows.psi_p[thin])

    taus = tau_s * np.array([0.7, 1.0, 1.5])
    values = np.array([[[rest(t, r, s) for s in grid] for r in grid] for t in taus])
    best, least = np.array([np.log(tau_s), grid[0], grid[-1]]), np.inf
    for i, j in _lowest(values.min(axis=0)):
        tau, recover, stall = taus[values[:, i, j].argmin()], grid[i], grid[j]
        at = _descend(
            lambda v: rest(float(np.exp(v[0])), v[1], v[2]),
            np.array([np.log(tau), recover, stall]),
            np.array([0.1, 0.5 * step, 0.5 * step]),
        )
        value = rest(float(np.exp(at[0])), at[1], at[2])
        if value < least:
            best, least = at, value
    return _Trial(rows, tuple(range(_HIGHEST + 1)), best, n_levels=2).settled()


def _lowest(values: FloatArray) -> list[tuple[int, ...]]:
    """Return the places of a grid with no better neighbour, best first."""
    from scipy.ndimage import minimum_filter

    places = np.argwhere((minimum_filter(values, 3) == values) & np.isfinite(values)).tolist()
    return sorted(map(tuple, places), key=values.__getitem__)[:_STARTS]


@dataclass(frozen=True)
class _Trial:
    """A structure: some terms of each branch, and log τ, levels and knot, which are not linear."""

    rows: LagRows
    powers: tuple[int, ...]  # As of a branch; with negative ones a knot is the last parameter
    at: FloatArray
    n_levels: int = 0
    kept: tuple[int, ...] | None = None  # Which of the powers of all branches; None: all
    rest: float = np.inf  # Root mean square of what it leaves of ψ'
    independent: float = 0.0  # Rows over the length of the correlation of what is left; 0: unknown

    @property
    def score(self) -> float:
        """Extended BIC; of τ, levels and knot, which are not chosen, as many as there are."""
        n, terms = self.independent, len(self.powers) * (2 if self.n_levels else 1)
        cost = price(n, terms) * len(self.kept or ()) + np.log(n) * self.at.size
        return float(2 * n * np.log(self.rest) + cost)

    def design(self, at: FloatArray, rows: LagRows) -> FloatArray:
        """Return the free run of every term kept, and of the starts."""
        columns = _candidates(rows.phi, self.powers, float(at[-1]))
        full = _free_run(rows, columns, float(np.exp(at[0])), tuple(at[1 : 1 + self.n_levels]))
        n = full.shape[1] - rows.runs.starts.size
        return full[:, [*(range(n) if self.kept is None else self.kept), *range(n, full.shape[1])]]

    def refined(self, rows: LagRows) -> FloatArray:
        """Return what is not linear where least is left of ψ'."""
        return _descend(
            lambda at: _rest(self.design(at, rows), rows.psi_p),
            self.at,
            np.full(self.at.size, 0.01),
        )

    def chosen(self) -> _Trial:
        """Choose the terms where all that is not linear is given."""
        columns = replace(self, kept=None).design(self.at, self.rows)
        n_terms = columns.shape[1] - self.rows.runs.starts.size
        kept, n = best_terms(columns, self.rows.psi_p, n_terms, self.independent or None)
        rest = _rest(columns[:, [*kept, *range(n_terms, columns.shape[1])]], self.rows.psi_p)
        return replace(self, kept=tuple(kept.tolist()), rest=rest, independent=n)

    def settled(self) -> _Trial:
        """Choose the terms, refine all that is not linear with them, and choose again."""
        once = self.chosen()
        return replace(once, at=once.refined(self.rows)).chosen()


def _stated(trial: _Trial) -> LagFit:
    """Refine a trial, drop what its terms do not hold, and state errors.

    What smoothing left of the noise of φ biases all of them, and asks for terms. Twins of the
    record show by how much: the smoothed φ is taken for the true one, the fitted free run for ψ',
    and both are measured and fitted again, in pairs with the same noise of either sign. The mean of
    a pair shows the bias, of which the median counts: in one a level may jump. Half its difference
    is a scatter that adds to that of the cycles, which are few. Without the bias the terms are
    chosen once more among those at hand; then none stays that its stated error does not hold, for
    what cycles and twins scatter by is up to three times what the rows show.
    """
    rows, powers, kept = trial.rows, trial.powers, np.array(trial.kept)
    names = ("stalled", "unstalled") if trial.n_levels else ("single",)
    trial = replace(trial, at=trial.refined(rows))
    at, columns = trial.at, trial.design(trial.at, rows)
    beta = least_squares(columns, rows.psi_p)
    fitted = columns @ beta
    left = rows.psi_p - fitted
    moves = []
    for move in 2e-3 * np.eye(at.size):
        moves.append((trial.design(at + move, rows) - trial.design(at - move, rows)) @ beta / 4e-3)
    tangent = np.column_stack((columns, *moves))
    rng = np.random.default_rng(0)
    again = []
    for _ in range(_PAIRS):
        noise = rows.noise * rng.standard_normal(rows.psi_p.size)
        for twin in (rows.twin(fitted, noise), rows.twin(fitted, -noise)):
            found = trial.refined(twin)
            again.append(np.append(least_squares(trial.design(found, twin), twin.psi_p), found))
    half, middle = (0.5 * op(again[::2], again[1::2]) for op in (np.subtract, np.add))
    found = 2 * np.append(beta, at) - np.median(middle, axis=0)
    spread = covariance_of_cycles(-tangent, left, rows.cycles) + half.T @ half / _PAIRS
    held, n = best_terms(tangent, tangent @ found + left, kept.size, trial.independent)
    worth = (found**2 / np.diag(spread))[: kept.size]
    if held.size == kept.size and worth.min() < price(n, len(powers) * len(names)):
        held = np.delete(held, np.argmin(worth))
    if 0 < held.size < kept.size:
        return _stated(replace(trial, kept=tuple(kept[held].tolist())))
    errors = np.sqrt(np.diag(spread))[beta.size :].tolist()
    beta, at = np.split(found, [beta.size])
    tau = float(np.exp(at[0]))
    branches = []
    for i, name in enumerate(names):
        own = np.flatnonzero(kept // len(powers) == i)
        chosen = tuple(powers[j % len(powers)] for j in kept[own])
        knot = (float(at[-1]), errors[-1]) if min(chosen, default=0) < 0 else (np.nan, np.nan)
        branches.append(Branch(beta[own], spread[np.ix_(own, own)], name, chosen, *knot))
    levels = slice(1, 1 + trial.n_levels)
    return LagFit(
        tau,
        tau * errors[0],
        tuple(branches),
        tuple(at[levels].tolist()),
        tuple(errors[levels]),
        float(np.sqrt(np.mean(left**2))),
    )
