"""The free run over whole cycles that had no part in the fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sindy_surge.covariance import leave_out_moves
from sindy_surge.lag_equations import Point, free_run
from sindy_surge.lag_fit import StructureFit, moved_point
from sindy_surge.lag_problem import LagProblem
from surge_core.errors import InputError
from surge_core.types import FloatArray, IndexArray

__all__ = ["HeldOutRun", "held_out_rms", "paired_difference"]


@dataclass(frozen=True)
class HeldOutRun:
    """Errors of the free run on blocks left out of the fit.

    Parameters
    ----------
    rms : float
        Root mean square error of all blocks, in units of ψ'; nan if there is nothing to leave out.
    per_block : ndarray of shape (n_blocks,)
        Mean square error of each block; 0 where a block has no degree of freedom.
    freedom : ndarray of shape (n_blocks,)
        Degrees of freedom behind each: its rows less one for its initial state.
    """

    rms: float
    per_block: FloatArray
    freedom: IndexArray


def held_out_rms(
    problem: LagProblem,
    fit: StructureFit,
    blocks: Sequence[slice],
    folds: int = 5,
) -> HeldOutRun:
    """Predict every block from measured φ with a fit that has not seen its fold.

    Block i is in fold i mod `folds`. The parameters without a fold follow from the whitened
    sensitivities by one step (exact for a linear regression), with the prior kept and τ within
    its bounds. Each block then runs freely from measured φ; of its ψ' only the initial state
    is taken, by least squares.

    The noise of φ passes through the characteristic and the lag and is in the error of every
    structure: (1 - a)/(1 + a) of σ_φ² times the mean square slope, beside σ_ψ².

    Parameters
    ----------
    problem : LagProblem
        The data.
    fit : StructureFit
        The structure, fitted to all of it.
    blocks : sequence of slice
        Rows of the record, none across two segments, e.g. from `cycles.cycle_blocks`.
    folds : int
        Number of fits, or the number of blocks if that is less; as many folds as blocks leave
        them out one by one.

    Returns
    -------
    HeldOutRun
        The errors, block by block in the order given.

    Raises
    ------
    InputError
        If fewer than two folds are asked for.
    """
    if folds < 2:
        raise InputError("folds", expected="at least 2", found=str(folds))
    usable = problem.usable
    edges = [np.searchsorted(usable.rows, (block.start, block.stop)) for block in blocks]
    held = [np.arange(low, high) for low, high in edges]
    freedom = np.array([max(rows.size - 1, 0) for rows in held], dtype=np.intp)
    if len(blocks) < 2 or not freedom.any():
        return HeldOutRun(float("nan"), np.full(len(blocks), np.nan), freedom)
    fold_of = np.arange(len(blocks)) % min(folds, len(blocks))
    measured = problem.output[usable.rows]
    # At the measured inputs: nobody who predicts has others.
    silent = np.zeros_like(problem.inputs)
    squares = np.zeros(len(blocks))
    for fold, point in enumerate(_without_folds(problem, fit, blocks, fold_of)):
        there = replace(point, input_noise=silent, blur=np.zeros(silent.shape[1]))
        rest = measured - free_run(problem, fit.support, there)
        pole = problem.taps_at(point.time_constant_s, point.dead_time_s).pole
        for i in np.flatnonzero((fold_of == fold) & (freedom > 0)).tolist():
            decay = pole ** np.arange(held[i].size, dtype=np.float64)
            own = rest[held[i]]
            own = own - decay * float(decay @ own) / float(decay @ decay)
            squares[i] = float(own @ own)
    per_block = squares / np.maximum(freedom, 1)
    return HeldOutRun(float(np.sqrt(squares.sum() / freedom.sum())), per_block, freedom)


def paired_difference(a: HeldOutRun, b: HeldOutRun) -> tuple[float, float]:
    """Return the difference of two mean square errors on the same blocks, and its standard error.

    The differences of the blocks are weighted by their degrees of freedom, so that their mean is
    a.rms² - b.rms².

    Parameters
    ----------
    a, b : HeldOutRun
        Of two structures, with the same blocks.

    Returns
    -------
    mean : float
        Positive if `b` predicts better; in units of ψ'².
    stderr : float
        From the scatter over blocks; nan with fewer than two.

    Raises
    ------
    InputError
        If the blocks are not the same.
    """
    if not np.array_equal(a.freedom, b.freedom):
        raise InputError(
            "b",
            expected=f"the same {a.freedom.size} blocks as in a",
            found=f"{b.freedom.size} blocks of other lengths",
        )
    used = a.freedom > 0
    if not used.any():
        return float("nan"), float("nan")
    weights = a.freedom[used] / a.freedom[used].sum()
    difference = (a.per_block - b.per_block)[used]
    mean = float(weights @ difference)
    n = difference.size
    if n < 2:
        return mean, float("nan")
    scatter = weights**2 @ (difference - mean) ** 2
    return mean, float(np.sqrt(n / (n - 1) * scatter))


def _without_folds(
    problem: LagProblem, fit: StructureFit, blocks: Sequence[slice], fold_of: IndexArray
) -> list[Point]:
    """Return the parameters fitted without each fold."""
    fold_of_row = np.full(problem.output.size, -1)
    for block, fold in zip(blocks, fold_of, strict=True):
        fold_of_row[block] = fold
    home = fold_of_row[fit.rows]
    left_out = [np.flatnonzero(home == fold) for fold in range(int(fold_of.max()) + 1)]
    # The prior is information that no fold takes away; its own residual is in no block.
    columns = np.vstack((fit.sensitivity, np.diag(np.sqrt(fit.prior))))
    return [
        moved_point(problem, fit.point, move)
        for move in leave_out_moves(columns, fit.residual, left_out)
    ]
