"""The lag in the weak form, as a regression on any of the terms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sindy_surge.lag_problem import LagProblem
from sindy_surge.linear_problem import LinearProblem, least_squares, without_nuisances
from sindy_surge.segments import block_slices
from sindy_surge.sparse_paths import Support
from sindy_surge.weak_form import weak_centres, weak_lag, weak_rows
from surge_core.types import FloatArray, IndexArray

__all__ = ["WeakEquations", "blocks_for"]


@dataclass(frozen=True)
class WeakEquations:
    """Weak equations ψ' = -τ dψ'/dt + Σ β_i s_i of one width of the test function.

    Parameters
    ----------
    derivative, signal : ndarray of shape (n_weak,)
        Weak dψ'/dt (1/s) and ψ'.
    columns : ndarray of shape (n_weak, n_columns)
        Weak usable terms.
    centres : ndarray of int of shape (n_weak,)
        Row at the middle of each test function.
    half_width : int
        Half width in samples.
    """

    derivative: FloatArray
    signal: FloatArray
    columns: FloatArray
    centres: IndexArray
    half_width: int

    @classmethod
    def of(cls, problem: LagProblem, half_width: int | None = None) -> WeakEquations | None:
        """Set up the equations.

        Parameters
        ----------
        problem : LagProblem
            The data.
        half_width : int or None
            Half width in samples; None takes two time constants.

        Returns
        -------
        WeakEquations or None
            None if the segments are too short for a test function, or no lag shows.
        """
        # Terms with ψ' need a simulated ψ', of which the weak form has none.
        without = problem.columns[: problem.n_without_state].tolist()
        values = problem.late(problem.terms(problem.inputs, wanted=without))
        segments, period = problem.segments, problem.sample_period_s
        if half_width is None:
            # The first terms of a library are its simplest; with all of them τ drifts up.
            found = weak_lag(problem.output, values[:, :3], segments, period)
            if found is None:
                return None
            half_width = round(found.half_width_s / period)
        change, signal, columns = weak_rows(problem.output, values, segments, half_width, period)
        return cls(change, signal, columns, weak_centres(segments, half_width), half_width)

    def fit(self, support: Support) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Regress ψ' on dψ'/dt and some terms.

        dψ'/dt stands on the right, so that what is left is an error of ψ'. Put the other way
        round, τ came out 5 to 20 ms too high on records of the simulated rig.

        Parameters
        ----------
        support : tuple of int
            Positions of the terms.

        Returns
        -------
        parameters : ndarray of shape (n_support + 1,)
            β, and last τ in seconds.
        design : ndarray of shape (n_weak, n_support + 1)
            Derivatives of the fitted values.
        residual : ndarray of shape (n_weak,)
            What is left.
        """
        design = np.column_stack((self.columns[:, list(support)], -self.derivative))
        parameters = least_squares(design, self.signal)
        return parameters, design, self.signal - design @ parameters

    def fit_forward(self, support: Support) -> FloatArray | None:
        """Return (β, τ) from regressing dψ'/dt; None if τ is not positive."""
        design = np.column_stack((self.columns[:, list(support)], -self.signal))
        solution = least_squares(design, self.derivative)
        if not solution[-1] > 0:
            return None
        parameters: FloatArray = np.append(solution[:-1], 1.0) / solution[-1]
        return parameters

    def linear(self) -> LinearProblem:
        """Return the regression on all terms, τ projected out, for the optimizers."""
        return without_nuisances(self.derivative[:, None], self.columns, self.signal)


def blocks_for(problem: LagProblem, weak: WeakEquations) -> list[tuple[slice, IndexArray]]:
    """Return the blocks of rows to leave out, each with the weak equations centred in it.

    Parameters
    ----------
    problem : LagProblem
        The data.
    weak : WeakEquations
        The equations.

    Returns
    -------
    list of (slice, ndarray of int)
        Short segments whole, long ones in parts longer than a test function; those without an
        equation are left out.
    """
    blocks = []
    for block in block_slices(problem.segments, 2 * weak.half_width + 1):
        inside = (weak.centres >= block.start) & (weak.centres < block.stop)
        if inside.any():
            blocks.append((block, np.flatnonzero(inside)))
    return blocks
