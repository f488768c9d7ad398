"""Duct and plenum in integral form, and the choice of terms by exhaustive search.

x(t) = x(t₀) + Σ c_j ∫ s_j dt with a free x(t₀) in every cycle: nothing is differentiated, and the
noise of the terms is averaged by the integral.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np

from surge_core.types import FloatArray, IntArray

FACTORS = ("phi", "psi_p", "plenum", "sqrt(plenum)")
# Linear and quadratic terms of the three states, and the flow through a throttle.
_EXPONENTS = np.array(
    [
        (0, 0, 0, 0),
        *np.eye(4, dtype=int).tolist(),
        (2, 0, 0, 0),
        (0, 2, 0, 0),
        (0, 0, 2, 0),
        (1, 1, 0, 0),
        (1, 0, 1, 0),
        (0, 1, 1, 0),
    ],
    dtype=np.int64,
)
# What is left is smooth over about as many rows as its autocorrelation stays above this.
_UNCORRELATED = 0.1


@dataclass(frozen=True)
class Balance:
    """The equation dx/dt = Σ c_j s_j(φ, ψ', Ψ) of one state.

    Parameters
    ----------
    exponents : ndarray of int of shape (n_terms, 4)
        Powers of φ, ψ', Ψ and sign(Ψ) √|Ψ| in each term.
    coefficients : ndarray of shape (n_terms,)
        c_j, per second.
    covariance : ndarray of shape (n_terms, n_terms)
        Their covariance.
    """

    exponents: IntArray
    coefficients: FloatArray
    covariance: FloatArray

    @property
    def stderr(self) -> FloatArray:
        """Standard errors of the coefficients, per second."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the terms."""
        named = (
            " ".join(
                name + (f"^{power}" if power > 1 else "")
                for name, power in zip(FACTORS, row, strict=True)
                if power
            )
            for row in self.exponents.tolist()
        )
        return tuple(name or "1" for name in named)

    def rate(self, states: FloatArray) -> FloatArray:
        """Return dx/dt at states (n_rows, 3), per second."""
        return np.asarray(self.coefficients @ term_values(states, self.exponents))


def term_values(states: FloatArray, exponents: IntArray) -> FloatArray:
    """Evaluate terms: states (n_rows, 3) to values (n_terms, n_rows)."""
    phi, psi_p, plenum = states.T
    root = np.copysign(np.sqrt(np.abs(plenum)), plenum)
    factors = np.stack((phi, psi_p, plenum, root))
    return np.asarray(np.prod(factors[None] ** exponents[:, :, None], axis=1))


def sandwich(columns: FloatArray, left: FloatArray, blocks: IntArray) -> FloatArray:
    """Return the covariance of least squares whose residual is correlated within blocks.

    Parameters
    ----------
    columns : ndarray of shape (n_columns, n_rows)
        The regressors.
    left : ndarray of shape (n_rows,)
        The residual.
    blocks : ndarray of int of shape (n_rows,)
        Number of the block of each row.
    """
    size = np.linalg.norm(columns, axis=1)
    size[size == 0] = 1.0
    scaled = columns / size[:, None]
    bread = np.linalg.pinv(scaled @ scaled.T, rcond=1e-12)
    scores = np.stack([np.bincount(blocks, c * left) for c in scaled])
    n = scores.shape[1]
    meat = scores @ scores.T * n / max(n - 1, 1)
    return np.asarray(bread @ meat @ bread / np.outer(size, size))


def best_terms(columns: FloatArray, goal: FloatArray, n_terms: int) -> tuple[IntArray, float]:
    """Choose among the first `n_terms` columns by the extended BIC, over all their subsets.

    n log(rest²) + k (log n + 2 log p) with n the number of independent rows: the residual of all
    columns says over how many rows it is correlated.

    Parameters
    ----------
    columns : ndarray of shape (n_columns, n_rows)
        Candidates, then columns that always stay.
    goal : ndarray of shape (n_rows,)
        What they are to explain.
    n_terms : int
        Number of candidates.

    Returns
    -------
    chosen : ndarray of int
        The candidates that stay.
    independent : float
        Number of independent rows.
    """
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=1), 1e-300)[:, None]
    q, r = np.linalg.qr(np.vstack((scaled, goal)).T)
    r, target = r[:, :-1], r[:, -1]
    left = q[:, -1] * target[-1]
    independent = goal.size / correlation_rows(left)
    penalty = np.log(independent) + 2 * np.log(n_terms)
    always = tuple(range(n_terms, len(columns)))

    def score(subset: tuple[int, ...]) -> float:
        own = r[:, subset + always]
        rest = target - own @ np.linalg.lstsq(own, target, rcond=1e-12)[0]
        return float(independent * np.log(rest @ rest / goal.size) + penalty * len(subset))

    candidates = range(n_terms)
    subsets = (s for size in range(n_terms + 1) for s in combinations(candidates, size))
    return np.array(min(subsets, key=score), dtype=np.int64), independent


def correlation_rows(left: FloatArray) -> float:
    """Return over how many rows a residual is correlated: 1 + 2 Σ ρ_j up to the first small ρ."""
    spectrum = np.abs(np.fft.rfft(left - left.mean(), 2 * left.size)) ** 2
    rho = np.fft.irfft(spectrum)[: left.size // 4]
    rho /= rho[0]
    end = int(np.argmax(rho < _UNCORRELATED))
    return float(1 + 2 * rho[1:end].sum()) if end else 1.0


def fit_balance(
    channel: FloatArray,
    states: FloatArray,
    starts: IntArray,
    period_samples: int,
    sample_period_s: float,
) -> Balance:
    """Fit dx/dt = Σ c_j s_j in integral form, its terms chosen by the extended BIC.

    Parameters
    ----------
    channel : ndarray of shape (n_rows,)
        Measured x.
    states : ndarray of shape (n_rows, 3)
        φ, ψ' and Ψ, smoothed.
    starts : ndarray of int of shape (n_records,)
        First row of each record.
    period_samples : int
        Rows of a cycle; x starts freely in each.
    sample_period_s : float
        Sample period in seconds.

    Returns
    -------
    Balance
        The equation.
    """
    from scipy.integrate import cumulative_simpson

    values = term_values(states, _EXPONENTS)
    edges = []
    for begin, end in zip(starts, np.append(starts[1:], len(states)), strict=True):
        n_windows = max((end - begin) // period_samples, 1)
        edges.append(np.linspace(begin, end, n_windows + 1).astype(int))
    columns, blocks = np.zeros_like(values), np.zeros(len(states), dtype=np.int64)
    goal = channel.copy()
    number = 0
    for cut in edges:
        for begin, end in pairwise(cut):
            own = cumulative_simpson(values[:, begin:end], dx=sample_period_s, initial=0)
            columns[:, begin:end] = own - own.mean(axis=1, keepdims=True)
            goal[begin:end] -= goal[begin:end].mean()
            blocks[begin:end] = number
            number += 1
    chosen, _ = best_terms(columns, goal, len(columns))
    own = columns[chosen]
    coefficients = np.asarray(np.linalg.lstsq(own.T, goal, rcond=None)[0], dtype=np.float64)
    spread = sandwich(own, goal - coefficients @ own, blocks)
    return Balance(_EXPONENTS[chosen], coefficients, spread)
