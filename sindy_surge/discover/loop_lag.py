"""The lag of a compressor with one branch or two: free run, levels, terms of each branch.

τ dψ'/dt + ψ' = f_m(φ), with m = stalled or unstalled. At a given τ and given levels the free run
is linear in the coefficients; τ and the levels are profiled.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import njit

from sindy_surge.discover.loop_balance import best_terms, sandwich
from sindy_surge.discover.loop_signals import smoothed
from surge_core.lag import FirstOrderLag
from surge_core.types import FloatArray, IntArray

# Degree of the richest single branch, of a branch while the levels are searched, and the largest
# power among the candidate terms of a branch.
_RICHEST, _SEARCHED, _HIGHEST = 7, 3, 5
_GRID, _STARTS = 26, 8
_TWINS = 3
_TAUS_S = np.geomspace(2e-3, 80e-3, 12)


@dataclass(frozen=True)
class Branch:
    """One branch of the characteristic: f(φ) = Σ β_i s_i(φ).

    Parameters
    ----------
    name : str
        ``"stalled"``, ``"unstalled"`` or ``"single"``.
    powers : tuple of int
        Powers of φ; -1 and -2 stand for relu(φ - knot) and its square.
    coefficients, stderr : ndarray of shape (n_terms,)
        β_i and their standard errors.
    covariance : ndarray of shape (n_terms, n_terms)
        Covariance of the β_i.
    knot : float
        Where relu(φ - knot) begins; nan without one.
    """

    name: str
    powers: tuple[int, ...]
    coefficients: FloatArray
    covariance: FloatArray
    knot: float

    @property
    def stderr(self) -> FloatArray:
        """Standard errors of the coefficients."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the terms."""
        return tuple(
            f"relu(phi-{self.knot:.4g})" + "^2" * (p == -2)
            if p < 0
            else ("1", "phi")[p]
            if p < 2
            else f"phi^{p}"
            for p in self.powers
        )

    def __call__(self, phi: FloatArray) -> FloatArray:
        """Return f(φ), of the shape of φ."""
        return np.asarray(self.coefficients @ _candidates(phi, self.powers, self.knot))


@dataclass(frozen=True)
class LagRows:
    """The rows that the lag is fitted to.

    Parameters
    ----------
    phi : ndarray of shape (n_rows,)
        Smoothed φ of all records, one behind the other.
    psi_p : ndarray of shape (n_rows,)
        Measured ψ'.
    starts : ndarray of int of shape (n_records,)
        First row of each record.
    sample_period_s : float
        Sample period in seconds.
    rearm : float
        By how much φ must have been beyond a level before it can cross it, against noise.
    period_samples : int
        Rows of a surge cycle.
    noise : float
        White noise of φ before it was smoothed.
    """

    phi: FloatArray
    psi_p: FloatArray
    starts: IntArray
    sample_period_s: float
    rearm: float
    period_samples: int
    noise: float

    @property
    def blocks(self) -> IntArray:
        """Number of the cycle that each row belongs to."""
        return np.arange(self.phi.size) // self.period_samples

    def twin(self, psi_p: FloatArray, rng: np.random.Generator) -> LagRows:
        """Return the record measured again: φ with new noise and smoothed, ψ' as given."""
        noisy = self.phi + self.noise * rng.standard_normal(self.phi.size)
        pieces = np.split(noisy, self.starts[1:])
        return replace(self, phi=np.concatenate([smoothed(x)[0] for x in pieces]), psi_p=psi_p)


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
    n_parameters : int
        Coefficients, τ, levels and knot.
    independent_rows : float
        Rows over the length of the correlation of what is left.
    """

    time_constant_s: float
    time_constant_stderr_s: float
    branches: tuple[Branch, ...]
    levels: tuple[float, ...]
    levels_stderr: tuple[float, ...]
    rest: float
    n_parameters: int
    independent_rows: float

    def better_than(self, other: LagFit) -> bool:
        """Whether the Bayesian information criterion prefers this fit."""
        n = min(self.independent_rows, other.independent_rows)
        gain = 2 * n * np.log(other.rest / self.rest)
        return bool(gain > (self.n_parameters - other.n_parameters) * np.log(n))


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


@njit(cache=True)
def _responses(
    columns: FloatArray, share: FloatArray, gains: FloatArray, starts: IntArray
) -> FloatArray:
    """Free run of x[k] = a x[k-1] + share[k] (now s[k] + before s[k-1]) for each column s."""
    out = np.zeros(columns.shape)
    a, now, before = gains
    for i in range(columns.shape[0]):
        first = 0
        for k in range(columns.shape[1]):
            if first < starts.size and k == starts[first]:
                first += 1
                continue
            drive = now * columns[i, k] + before * columns[i, k - 1]
            out[i, k] = a * out[i, k - 1] + share[k] * drive
    return out


def _candidates(phi: FloatArray, powers: tuple[int, ...], knot: float) -> FloatArray:
    return np.stack([np.maximum(phi - knot, 0.0) ** -p if p < 0 else phi**p for p in powers])


def _free_run(
    rows: LagRows, columns: FloatArray, tau_s: float, levels: tuple[float, ...] = ()
) -> FloatArray:
    """Return the free run of every column: stalled, unstalled, then the start of each record."""
    lag = FirstOrderLag(tau_s, rows.sample_period_s, "first")

    def respond(share: FloatArray) -> FloatArray:
        gains = np.array([lag.a, lag.gain_now, lag.gain_before])
        return np.asarray(_responses(columns, share, gains, rows.starts))

    stops = np.append(rows.starts[1:], rows.phi.size)
    decay = np.zeros((rows.starts.size, rows.phi.size))
    for row, begin, end in zip(decay, rows.starts, stops, strict=True):
        row[begin:end] = lag.a ** np.arange(end - begin)
    if not levels:
        return np.vstack((respond(np.ones(rows.phi.size)), decay))
    recover, stall = levels
    share = _stalled_share(rows.phi, rows.starts, recover, stall, rows.rearm)
    return np.vstack((respond(share), respond(1 - share), decay))


def _rest(design: FloatArray, psi_p: FloatArray) -> float:
    """Return the root mean square that the columns of the free run leave of ψ'."""
    if np.any(np.all(design == 0, axis=1)):
        return np.inf
    gram = design @ design.T
    gram[np.diag_indices_from(gram)] += 1e-10 * np.trace(gram) / len(gram)
    beta = np.linalg.solve(gram, design @ psi_p)
    return float(np.sqrt(np.mean((psi_p - beta @ design) ** 2)))


def _chebyshev(phi: FloatArray, degree: int) -> FloatArray:
    low, high = float(phi.min()), float(phi.max())
    z = (2 * phi - low - high) / (high - low)
    return np.ascontiguousarray(np.polynomial.chebyshev.chebvander(z, degree).T)


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


def fit_one_branch(rows: LagRows) -> tuple[LagFit, float]:
    """Fit one branch: powers of φ, and a kink where it earns its place.

    Parameters
    ----------
    rows : LagRows
        The record.

    Returns
    -------
    fit : LagFit
        The fit with the terms of least score.
    richest : float
        What the richest single branch (degree 7, and other cubics beyond a kink) leaves of ψ'.
    """
    smooth = _chebyshev(rows.phi, _RICHEST)

    def rest(tau_s: float, knot: float) -> float:
        columns = smooth
        if np.isfinite(knot):
            columns = np.vstack((smooth, _candidates(rows.phi, (-1, -2, -3), knot)))
        return _rest(_free_run(rows, columns, tau_s), rows.psi_p)

    span = float(np.ptp(rows.phi))
    knots = np.linspace(rows.phi.min(), rows.phi.max(), 22)[1:-1]
    _, tau, knot = min((rest(t, at), t, at) for t in _TAUS_S for at in knots)
    at = _descend(
        lambda v: rest(float(np.exp(v[0])), v[1]),
        np.array([np.log(tau), knot]),
        np.array([0.2, 0.03 * span]),
    )
    tau, knot = float(np.exp(at[0])), float(at[1])
    richest = min(rest(tau, knot), rest(tau, np.nan))
    plain, kinked = tuple(range(_HIGHEST + 1)), (-2, -1, *range(_HIGHEST + 1))
    without = _settled(rows, tau, (), plain, np.nan)
    with_kink = _settled(rows, tau, (), kinked, knot)
    return with_kink if with_kink.better_than(without) else without, richest


def fit_two_branches(rows: LagRows, tau_s: float) -> LagFit:
    """Fit two branches: search both levels on a grid, refine them with τ, choose the terms.

    Parameters
    ----------
    rows : LagRows
        The record.
    tau_s : float
        First value of τ: one branch forced on two reads some 15 % low.

    Returns
    -------
    LagFit
        The fit with the terms of least score.
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
        return _rest(design[:, thin], rows.psi_p[thin])

    taus = tau_s * np.array([0.7, 1.0, 1.5])
    ranked = sorted((rest(t, r, s), t, r, s) for t in taus for r in grid for s in grid)
    best, least = np.array([np.log(tau_s), grid[0], grid[-1]]), np.inf
    for _, tau, recover, stall in _apart(ranked, 1.5 * step):
        at = _descend(
            lambda v: rest(float(np.exp(v[0])), v[1], v[2]),
            np.array([np.log(tau), recover, stall]),
            np.array([0.1, 0.5 * step, 0.5 * step]),
        )
        value = rest(float(np.exp(at[0])), at[1], at[2])
        if value < least:
            best, least = at, value
    levels = (float(best[1]), float(best[2]))
    powers = tuple(range(_HIGHEST + 1))
    return _settled(rows, float(np.exp(best[0])), levels, powers, np.nan)


def _apart(ranked: Sequence[tuple[float, ...]], distance: float) -> list[tuple[float, ...]]:
    """Return the best places of the grid that are not neighbours of a better one."""
    found: list[tuple[float, ...]] = []
    for place in ranked:
        if all(max(abs(place[2] - f[2]), abs(place[3] - f[3])) > distance for f in found):
            found.append(place)
        if len(found) == _STARTS:
            break
    return found


def _twin_rest(
    design: Callable[[FloatArray, LagRows], FloatArray], twin: LagRows
) -> Callable[[FloatArray], float]:
    return lambda at: _rest(design(at, twin), twin.psi_p)


def _settled(
    rows: LagRows, tau_s: float, levels: tuple[float, ...], powers: tuple[int, ...], knot: float
) -> LagFit:
    """Choose the terms, refine τ, levels and knot with them, choose again, and state errors.

    What smoothing left of the noise of φ biases all of them. Twins of the record show by how
    much: the smoothed φ is taken for the true one, the fitted free run for ψ', and both are
    measured and fitted again.
    """
    n_branches = 2 if levels else 1
    n_terms = n_branches * len(powers)
    kept = np.arange(n_terms)
    n_nonlinear = 1 + len(levels) + int(np.isfinite(knot))

    def design(at: FloatArray, rows: LagRows = rows) -> FloatArray:
        here = float(at[-1]) if np.isfinite(knot) else np.nan
        columns = _candidates(rows.phi, powers, here)
        full = _free_run(rows, columns, float(np.exp(at[0])), tuple(at[1 : 1 + len(levels)]))
        return np.vstack((full[kept], full[n_terms:]))

    at = np.array([np.log(tau_s), *levels, *([knot] if np.isfinite(knot) else [])])
    for _ in range(2):
        kept = np.arange(n_terms)
        chosen, independent = best_terms(design(at), rows.psi_p, n_terms)
        kept = chosen
        at = _descend(lambda v: _rest(design(v), rows.psi_p), at, np.full(at.size, 0.01))
    columns = design(at)
    beta = np.linalg.lstsq(columns.T, rows.psi_p, rcond=None)[0]
    left = rows.psi_p - beta @ columns
    moves = []
    for i in range(n_nonlinear):
        move = np.zeros(at.size)
        move[i] = 2e-3
        moves.append(beta @ (design(at + move) - design(at - move)) / 4e-3)
    spread = sandwich(np.vstack((columns, *moves)), left, rows.blocks)
    errors = np.sqrt(np.maximum(np.diag(spread), 0.0))[columns.shape[0] :]
    rng = np.random.default_rng(0)
    again = []
    for _ in range(_TWINS):
        twin = rows.twin(beta @ columns, rng)
        found = _descend(_twin_rest(design, twin), at, np.full(at.size, 0.01))
        linear = np.linalg.lstsq(design(found, twin).T, twin.psi_p, rcond=None)[0]
        again.append(np.concatenate((found, linear)))
    moved = 2 * np.concatenate((at, beta)) - np.mean(again, axis=0)
    at, beta = moved[: at.size], moved[at.size :]
    tau = float(np.exp(at[0]))
    here = float(at[-1]) if np.isfinite(knot) else np.nan
    names = ("stalled", "unstalled") if levels else ("single",)
    branches = []
    for i, name in enumerate(names):
        own = np.flatnonzero(kept // len(powers) == i)
        chosen_powers = tuple(powers[j % len(powers)] for j in kept[own])
        branches.append(Branch(name, chosen_powers, beta[own], spread[np.ix_(own, own)], here))
    return LagFit(
        tau,
        tau * float(errors[0]),
        tuple(
            branches
            if min(branches[0].powers, default=0) < 0
            else (replace(b, knot=np.nan) for b in branches)
        ),
        tuple(at[1 : 1 + len(levels)].tolist()),
        tuple(errors[1 : 1 + len(levels)].tolist()),
        float(np.sqrt(np.mean(left**2))),
        kept.size + n_nonlinear,
        independent,
    )
