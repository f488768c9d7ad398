"""Duct and plenum in integral form, and the choice of their terms.

x(t) = x(t₀) + Σ c_j ∫ s_j dt with a free x(t₀) in every cycle: nothing is differentiated, and the
noise of the terms is averaged by the integral.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Self

import numpy as np

from sindy_surge.candidate_terms import independent_columns
from sindy_surge.discover.levels import pays
from sindy_surge.library import monomial_name, monomials
from sindy_surge.linear_problem import Support, least_squares, without_nuisances
from sindy_surge.search import beam_search
from sindy_surge.segments import Segments
from surge_core.leave_out import leave_out, scatter
from surge_core.types import FloatArray, IntArray

FACTORS = ("phi", "psi_p", "plenum", "sqrt(plenum)", "abs(phi)")
# Linear and quadratic terms of the three states, the flow through a throttle, and the loss of a
# duct in which the flow turns round.
_EXPONENTS = np.array(
    [
        (0, 0, 0, 0, 0),
        *np.eye(4, 5, dtype=int).tolist(),
        (2, 0, 0, 0, 0),
        (0, 2, 0, 0, 0),
        (0, 0, 2, 0, 0),
        (1, 1, 0, 0, 0),
        (1, 0, 1, 0, 0),
        (0, 1, 1, 0, 0),
        (1, 0, 0, 0, 1),
    ],
    dtype=np.int64,
)
# What is left is smooth over about as many rows as its autocorrelation stays above this.
_UNCORRELATED = 0.1


@dataclass(frozen=True)
class FittedSum:
    """A fitted sum of terms.

    Parameters
    ----------
    coefficients : ndarray of shape (n_terms,)
        Of each term.
    covariance : ndarray of shape (n_terms, n_terms)
        Their covariance.
    """

    coefficients: FloatArray
    covariance: FloatArray

    @property
    def stderr(self) -> FloatArray:
        """Standard errors of the coefficients."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def one_error_off(self) -> list[Self]:
        """Return it moved by a standard error along each axis of its covariance."""
        size, axes = np.linalg.eigh(self.covariance)
        moves = (axes * np.sqrt(np.maximum(size, 0.0))).T
        return [replace(self, coefficients=self.coefficients + move) for move in moves]


@dataclass(frozen=True)
class Balance(FittedSum):
    """The equation dx/dt = Σ c_j s_j(φ, ψ', Ψ) of one state, c_j per second.

    Parameters
    ----------
    exponents : ndarray of int of shape (n_terms, 5)
        Powers of φ, ψ', Ψ, sign(Ψ) √|Ψ| and the size of φ in each term.
    beyond : tuple of str
        Terms beyond the library that would explain more than they cost.
    """

    exponents: IntArray
    beyond: tuple[str, ...] = ()

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the terms."""
        return tuple(monomial_name(FACTORS, powers) for powers in self.exponents.tolist())

    def rate(self, states: FloatArray) -> FloatArray:
        """Return dx/dt at states (n_rows, 3), per second."""
        return term_values(states, self.exponents) @ self.coefficients


def term_values(states: FloatArray, exponents: IntArray) -> FloatArray:
    """Evaluate terms: states (n_rows, 3) to values (n_rows, n_terms)."""
    plenum = states[:, 2]
    root = np.copysign(np.sqrt(np.abs(plenum)), plenum)
    return monomials(np.column_stack((states, root, abs(states[:, 0]))), exponents)


def best_terms(
    columns: FloatArray, goal: FloatArray, n_terms: int, independent: float | None = None
) -> tuple[IntArray, float]:
    """Choose among the first `n_terms` columns, and return them and the number of independent rows.

    By the extended BIC n log(rest²) + k (log n + 2 log p) with n the independent rows: the residual
    of all columns says over how many rows it is correlated, where n is not given. The columns
    behind the first always stay.
    """
    if independent is None:
        left = goal - columns @ least_squares(columns, goal)
        independent = goal.size / correlation_rows(left)
    linear = without_nuisances(columns[:, n_terms:], columns[:, :n_terms], goal)
    best = [(linear.chi2(()), ()), *(each[0] for each in beam_search(linear, n_terms).values())]

    def score(trial: tuple[float, Support]) -> float:
        cost = price(independent, n_terms) * len(trial[1])
        return float(independent * np.log(trial[0] / goal.size) + cost)

    return np.array(min(best, key=score)[1], dtype=np.int64), independent


def price(independent: float, n_terms: int) -> float:
    """Return what one of so many candidate terms costs on so many independent rows."""
    return float(np.log(independent) + 2 * np.log(n_terms))


def correlation_rows(left: FloatArray) -> float:
    """Return over how many rows a residual is correlated: 1 + 2 Σ ρ_j up to the first small ρ."""
    spectrum = np.abs(np.fft.rfft(left - left.mean(), 2 * left.size)) ** 2
    rho = np.fft.irfft(spectrum)[: left.size // 4]
    rho /= rho[0]
    end = int(np.argmax(rho < _UNCORRELATED))
    return float(1 + 2 * rho[1:end].sum()) if end else 1.0


def covariance_of_cycles(
    jacobian: FloatArray, left: FloatArray, cycles: Sequence[slice]
) -> FloatArray:
    """Return the covariance by leaving out cycles, as much wider as few of them ask for.

    Of five or six it is itself known badly: two standard errors hold as much as of Student's t.
    """
    from scipy.stats import norm, t

    wider = t.isf(norm.sf(2.0), len(cycles) - 1) / 2.0
    return np.asarray(wider**2 * scatter(leave_out(jacobian, left, cycles)[0]))


def fit_balance(
    channel: FloatArray,
    states: FloatArray,
    runs: Segments,
    period_samples: int,
    sample_period_s: float,
) -> Balance:
    """Fit dx/dt = Σ c_j s_j in integral form, its terms chosen by the extended BIC.

    The channel is measured x (n_rows,), the states are φ, ψ' and Ψ (n_rows, 3), smoothed; x starts
    freely in each cycle of ``period_samples`` rows.
    """
    from scipy.integrate import cumulative_simpson

    # φ² is φ |φ| where the flow does not turn round.
    more = (_EXPONENTS[:, None] + np.eye(3, 5, dtype=np.int64)).reshape(-1, 5)
    wide = np.vstack((_EXPONENTS, more))
    there = independent_columns(term_values(states, wide))
    wide, n = wide[there], int(np.count_nonzero(there < len(_EXPONENTS)))
    columns, goal = term_values(states, wide), channel.copy()
    blocks = []
    for run in runs.slices():
        n_windows = max((run.stop - run.start) // period_samples, 1)
        edges = np.linspace(run.start, run.stop, n_windows + 1).astype(int)
        blocks += [slice(begin, end) for begin, end in pairwise(edges.tolist())]
    for block in blocks:
        own = cumulative_simpson(columns[block], dx=sample_period_s, initial=0, axis=0)
        columns[block] = own - own.mean(axis=0)
        goal[block] -= goal[block].mean()

    def held(chosen: IntArray, price: float) -> tuple[IntArray, FloatArray, FloatArray]:
        """Drop terms: what differs between cycles says less of one than the rows do."""
        while True:
            own = columns[:, chosen]
            coefficients = least_squares(own, goal)
            covariance = covariance_of_cycles(-own, goal - own @ coefficients, blocks)
            worth = coefficients**2 / np.diag(covariance)
            if chosen.size < 2 or worth.min() > price:
                return chosen, coefficients, covariance
            chosen = np.delete(chosen, np.argmin(worth))

    chosen, independent = best_terms(columns[:, :n], goal, n)
    chosen, coefficients, covariance = held(chosen, price(independent, n))
    left = goal - columns[:, chosen] @ coefficients
    # So that χ² counts independent rows.
    unit = np.linalg.norm(left) / np.sqrt(independent)
    linear = without_nuisances(columns[:, :0], columns / unit, goal / unit)
    every, cost = tuple(range(len(wide))), price(independent, len(wide))
    found = np.array(
        pays(linear, [(0, (i,)) for i in every[n:]], tuple(chosen.tolist()), cost, [every])
    )
    beyond = wide[[i for i in held(found, cost)[0] if i >= n]].tolist()
    names = tuple(monomial_name(FACTORS, each) for each in beyond)
    return Balance(coefficients, covariance, wide[chosen], names)
