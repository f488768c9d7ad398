"""Cells of a study that differ in nothing but the method, and differences over them.

Cells of one record are not independent: errors are a jackknife that leaves out one whole record
at a time (Tukey 1958; for clusters of unequal size as in Bell & McCaffrey, Survey Methodology 28,
2002).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from comparisons.study.scores import Score
from surge_core.errors import InputError
from surge_core.types import FloatArray

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "SAME",
    "Cells",
    "Paired",
    "axes_in",
    "group_cells",
    "jackknife",
    "losses",
    "paired",
]

# States of a cell: no numbers at all, and a fit that ended well; any other ended badly.
FAILED, ENDED_WELL = "failed", ("ok", "converged")
NEEDED = ("record", "reduction", "method", "state")
STANDARD_ERRORS = 2.0
# Losses closer than rounding in the last digits are the same loss.
SAME = 1e-12


@dataclass(frozen=True)
class Paired:
    """A method against another over the cells that both could score.

    Parameters
    ----------
    n_pairs, n_records : int
        Cells that both could score, and the independent records that they come from.
    difference, stderr : float
        Mean loss minus that of the other, and its standard error clustered by record, in the unit
        of the score; the error is NaN with one record.
    wins : float
        Share of the pairs with the smaller loss; a tie counts half.
    """

    n_pairs: int = 0
    n_records: int = 0
    difference: float = math.nan
    stderr: float = math.nan
    wins: float = math.nan

    @property
    def reach(self) -> float:
        """Half width of the 95 % interval: two standard errors, more with few records (t)."""
        from scipy.special import stdtrit

        if self.n_records < 2:
            return math.nan
        return max(STANDARD_ERRORS, float(stdtrit(self.n_records - 1, 0.975))) * self.stderr


@dataclass(frozen=True)
class Cells:
    """Cells of a group: a row a combination of record, reduction and axes, a column a method.

    Parameters
    ----------
    methods : tuple of str
        Names, in alphabetical order.
    record : ndarray of int, shape (n,)
        Number of the record of each row.
    values : ndarray of shape (n, n_methods)
        The score; NaN where there is none.
    ran, failed : ndarray of bool, shape (n, n_methods)
        Where a method was run, and where it failed.
    bad : ndarray of bool, shape (n, n_methods)
        Where a fit has numbers that it says itself are not to be used.
    """

    methods: tuple[str, ...]
    record: NDArray[np.intp]
    values: FloatArray
    ran: NDArray[np.bool_]
    failed: NDArray[np.bool_]
    bad: NDArray[np.bool_]

    @property
    def scored(self) -> NDArray[np.bool_]:
        """Where there is a score, of shape (n, n_methods)."""
        return ~np.isnan(self.values)


def losses(score: Score, values: FloatArray) -> FloatArray:
    """Return what is lost in each cell: smaller is better.

    Parameters
    ----------
    score : Score
        Which way is better.
    values : ndarray
        Scores.
    """
    return {
        "smaller": values,
        "larger": -values,
        "zero": np.abs(values),
        "target": np.abs(values - score.target),
    }[score.better]


def group_cells(
    table: pd.DataFrame, score: Score, by: Sequence[str]
) -> list[tuple[tuple[tuple[str, Any], ...], Cells]]:
    """Return the cells of each combination of values of some axes, in the order of the values.

    Parameters
    ----------
    table : DataFrame
        Results, one row a cell.
    score : Score
        Which score the cells hold.
    by : sequence of str
        Axes.

    Raises
    ------
    InputError
        When a column is missing, the score is no number, or two rows are the same cell.
    """
    import pandas as pd

    for name in (*NEEDED, score.name, *by):
        if name not in table.columns:
            raise InputError("results", expected=f"the column '{name}'", found="none of that name")
    try:
        values = pd.to_numeric(table[score.name]).astype(float)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"results, column '{score.name}'", expected="numbers", found=str(error)
        ) from error
    # A failed cell has no score, nor has a simulation that ran off to infinity.
    table = table.assign(_value=values.where((table["state"] != FAILED) & np.isfinite(values)))
    keys = ["record", "reduction", *axes_in(table)]
    twice = table[table.duplicated([*keys, "method"])]
    if len(twice):
        one = twice.iloc[0]
        raise InputError(
            "results",
            expected="one row for each record, reduction, setting and method",
            found=f"two of method '{one['method']}' on record '{one['record']}', reduction "
            f"'{one['reduction']}'",
        )
    if not len(table):
        return []
    groups = table.groupby(list(by), dropna=False) if by else [((), table)]
    return [
        (
            tuple((name, _plain(value)) for name, value in zip(by, where, strict=True)),
            _wide(part, keys),
        )
        for where, part in groups
    ]


def paired(cells: Cells, score: Score, i: int, j: int) -> Paired:
    """Return one method against another over the cells that both could score.

    Parameters
    ----------
    cells : Cells
        Cells of all methods.
    score : Score
        What they hold.
    i, j : int
        Columns of the method and of the other.
    """
    both = cells.scored[:, i] & cells.scored[:, j]
    if not both.any():
        return Paired()
    values, record = cells.values[both][:, [i, j]], cells.record[both]
    lost = losses(score, values)
    counts = (int(both.sum()), int(np.unique(record).size))
    if score.better == "target":
        # Of a single cell the distance to a share means nothing: only of the mean of many.
        return Paired(*counts, *jackknife(values, record, score.target))
    change = lost[:, 0] - lost[:, 1]
    wins = float(np.mean((change < 0.0) + 0.5 * (change == 0.0)))
    return Paired(*counts, *jackknife(change, record), wins)


def jackknife(
    values: FloatArray, record: NDArray[np.intp], target: float | None = None
) -> tuple[float, float]:
    """Return a mean and its standard error over records, each of which is left out once.

    Parameters
    ----------
    values : ndarray of shape (n,) or (n, 2)
        Values; with a target two columns.
    record : ndarray of int, shape (n,)
        Number of the record of each row.
    target : float, optional
        With it: how much further the mean of the first column lies from the target than that of
        the second.

    Returns
    -------
    mean, stderr : float
        The error is NaN with one record.
    """
    _, cluster = np.unique(record, return_inverse=True)
    counts = np.bincount(cluster).astype(np.float64)
    columns = values.reshape(values.shape[0], -1)
    sums = np.stack([np.bincount(cluster, weights=column) for column in columns.T], axis=1)

    def measured(total: FloatArray, count: FloatArray) -> FloatArray:
        means = total / count[..., None]
        if target is None:
            return means[..., 0]
        return np.abs(means[..., 0] - target) - np.abs(means[..., 1] - target)

    whole = float(measured(sums.sum(axis=0), counts.sum()))
    if counts.size < 2:
        return whole, math.nan
    # About the whole's value rather than the mean of the parts: a little wider, never smaller.
    spread = measured(sums.sum(axis=0) - sums, counts.sum() - counts) - whole
    error = math.sqrt((counts.size - 1) / counts.size * float(np.sum(spread**2)))
    size = float(np.max(np.abs(columns), initial=0.0))
    return whole, error if error > SAME * size else 0.0


def axes_in(table: pd.DataFrame) -> tuple[str, ...]:
    """Return the names of the varied axes, which are the columns with a dot in their names."""
    return tuple(str(name) for name in table.columns if "." in str(name))


def _wide(part: pd.DataFrame, keys: list[str]) -> Cells:
    """Return the cells of a group, sorted so that no sum depends on the order of the rows."""
    row = part.groupby(keys, dropna=False, sort=True).ngroup().to_numpy()
    methods, column = np.unique(part["method"].astype(str), return_inverse=True)
    # Records that were drawn together (one seed at several settings) are not independent.
    unit = part["draw" if "draw" in part.columns else "record"].astype(str)
    _, draw = np.unique(unit, return_inverse=True)
    shape = (int(row.max()) + 1, methods.size)
    values, record = np.full(shape, np.nan), np.zeros(shape[0], dtype=np.intp)
    ran, failed, bad = (np.zeros(shape, bool) for _ in range(3))
    state = part["state"].astype(str)
    values[row, column] = part["_value"]
    record[row] = draw
    ran[row, column] = True
    failed[row, column] = state == FAILED
    bad[row, column] = ~state.isin([FAILED, *ENDED_WELL])
    return Cells(tuple(map(str, methods)), record, values, ran, failed, bad)


def _plain(value: Any) -> Any:
    """Return the value of an axis as Python's own, with None for what is missing."""
    import pandas as pd

    return None if pd.isna(value) else getattr(value, "item", lambda: value)()
