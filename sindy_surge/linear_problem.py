"""A regression on all terms, small enough for an optimizer of any kind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from surge_core.types import FloatArray

Support = tuple[int, ...]


def unit_norms(columns: FloatArray) -> FloatArray:
    """Return the norms of columns, 1 for columns of zeros."""
    norms: FloatArray = np.linalg.norm(columns, axis=0)
    norms[norms == 0] = 1.0
    return norms


@dataclass(frozen=True)
class LinearProblem:
    """The regression about one fit, compressed by QR to as many rows as columns."""

    # (n_rows, n_columns): Every usable term, whitened, τ projected out, scaled to unit norm
    columns: FloatArray
    target: FloatArray  # (n_rows,): What the terms have to explain
    norms: FloatArray  # (n_columns,): Norms taken out of the columns
    outside: float  # The part of χ² that no term can explain
    n_equations: int  # Number of whitened equations behind it

    @property
    def variance(self) -> float:
        """Variance of the whitened residual when every term is in.

        Not below 1: it is 1 by construction, and next to nothing on exact data, where
        rounding and interpolation would otherwise decide.
        """
        freedom = max(self.n_equations - self.columns.shape[1] - 1, 1)
        return float(max(self.outside / freedom, 1.0))

    def chi2(self, support: Support) -> float:
        """Return χ² of the regression on some terms, with the part that no term explains."""
        total = float(self.target @ self.target)
        if support:
            basis, _ = np.linalg.qr(self.columns[:, list(support)])
            total -= float(np.sum((basis.T @ self.target) ** 2))
        return max(total, 0.0) + self.outside

    def score(self, support: Support, penalty: float) -> float:
        """Return χ² in units of the variance that all terms leave, and what the terms cost."""
        return self.chi2(support) / self.variance + penalty * len(support)

    def beside(self, kept: Sequence[int], others: Sequence[int]) -> LinearProblem:
        """Return the regression on other terms where some are in every structure."""
        chosen = list(others)
        rest = without_nuisances(
            self.columns[:, list(kept)], self.columns[:, chosen], self.target, self.n_equations
        )
        return replace(
            rest, norms=rest.norms * self.norms[chosen], outside=rest.outside + self.outside
        )

    def coefficients(self, support: Support) -> FloatArray:
        """Return the coefficients of some terms, in units of the columns before scaling."""
        chosen = list(support)
        solution = np.linalg.lstsq(self.columns[:, chosen], self.target, rcond=1e-12)[0]
        return np.asarray(solution / self.norms[chosen])


def without_nuisances(
    nuisances: FloatArray, columns: FloatArray, target: FloatArray, n_equations: int | None = None
) -> LinearProblem:
    """Project out columns that are in every structure, and compress by QR.

    The rows, of every usable term and of what they have to explain, stand for so many equations:
    one each if that is not given.
    """
    n = nuisances.shape[1]
    stacked = np.column_stack((nuisances, columns, target))
    norms = unit_norms(stacked)
    triangle: FloatArray = np.asarray(np.linalg.qr(stacked / norms, mode="r"))
    terms, goal = triangle[n:, n:-1], triangle[n:, -1] * norms[-1]
    rank = min(terms.shape)
    # Projecting τ out shortens a column that a change of τ can stand in for.
    left = np.linalg.norm(terms, axis=0)
    left[left < 1e-12] = 1.0
    outside = float(goal[rank:] @ goal[rank:])
    count = target.size if n_equations is None else n_equations
    return LinearProblem(terms[:rank] / left, goal[:rank], norms[n:-1] * left, outside, count)


def least_squares(design: FloatArray, target: FloatArray) -> FloatArray:
    """Solve a regression on columns of unlike size; of least norm where they are dependent."""
    norms = unit_norms(design)
    solution: FloatArray = np.linalg.lstsq(design / norms, target, rcond=1e-12)[0] / norms
    return solution
