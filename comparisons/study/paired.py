"""Cells of a study that differ in nothing but the method, and differences over them.

Cells of one record are not independent: errors are a jackknife that leaves out one whole record
at a time (Tukey 1958; for clusters of unequal size as in Bell & McCaffrey, Survey Methodology 28,
2002).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
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
    "finite",
    "group_cells",
    "jackknife",
    "losses",
    "paired",
    "plain_values",
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
        of the score. NaN where a pair holds an infinite score; the error is NaN with one record.
    median : float
        Median of the differences of the pairs.
    wins : float
        Share of the pairs with the smaller loss; a tie counts half.
    heaviest : float
        Share of the summed absolute differences that a single record carries.
    n_infinite : int
        Pairs with an infinite score.
    """

    n_pairs: int = 0
    n_records: int = 0
    difference: float = math.nan
    stderr: float = math.nan
    median: float = math.nan
    wins: float = math.nan
    heaviest: float = math.nan
    n_infinite: int = 0

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
    """Return what is lost in each cell: smaller is better, an infinite score loses infinitely.

    Parameters
    ----------
    score : Score
        Which way is better.
    values : ndarray
        Scores.
    """
    worth = {
        "smaller": values,
        "larger": -values,
        "zero": np.abs(values),
        "target": np.abs(values - score.target),
    }[score.better]
    return np.where(np.isinf(values), np.inf, worth)


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
    for name in (*NEEDED, score.name, *by):
        if name not in table.columns:
            raise InputError("results", expected=f"the column '{name}'", found="none of that name")
    columns = {name: plain_values(table[name]) for name in (*by, *axes_in(table))}
    rows: dict[tuple[Any, ...], list[int]] = {}
    for i, group in enumerate(zip(*(columns[name] for name in by), strict=True)):
        rows.setdefault(group, []).append(i)
    if not by and len(table):
        rows[()] = list(range(len(table)))
    whole = _parts(table, score, columns)
    # Records that were drawn together (one seed at several settings) are not independent.
    unit = "draw" if "draw" in table.columns else "record"
    drawn = dict(zip(map(str, table["record"]), map(str, table[unit]), strict=True))
    ordered = sorted(rows, key=lambda group: [_order(value) for value in group])
    return [(tuple(zip(by, g, strict=True)), _wide(whole, rows[g], drawn)) for g in ordered]


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
    n_infinite = int(np.any(np.isinf(lost), axis=1).sum())
    same = lost[:, 0] == lost[:, 1]
    with np.errstate(invalid="ignore", over="ignore"):
        change = np.where(same, 0.0, lost[:, 0] - lost[:, 1])
        median = float(np.median(change))
    counts = (int(both.sum()), int(np.unique(record).size))
    target = score.target if score.better == "target" else None
    difference = stderr = heaviest = math.nan
    if n_infinite == 0:
        difference, stderr = jackknife(change if target is None else values, record, target)
        heaviest = _heaviest(change, record)
    if target is not None:
        # Of a single cell the distance to a share means nothing: only of the mean of many.
        return Paired(*counts, difference, stderr, n_infinite=n_infinite)
    wins = float(np.mean((lost[:, 0] < lost[:, 1]) + 0.5 * same))
    return Paired(*counts, difference, stderr, median, wins, heaviest, n_infinite)


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
        NaN where a value is infinite; the error is NaN with one record.
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

    with np.errstate(over="ignore", invalid="ignore"):
        whole = float(measured(sums.sum(axis=0), counts.sum()))
        if counts.size < 2 or not math.isfinite(whole):
            return whole if math.isfinite(whole) else math.nan, math.nan
        # About the whole's value rather than the mean of the parts: a little wider, never smaller.
        spread = measured(sums.sum(axis=0) - sums, counts.sum() - counts) - whole
        # Scaled, so that squares of scores beyond 1e154 do not overflow.
        largest = float(np.max(np.abs(spread))) or 1.0
        share = (counts.size - 1) / counts.size
        error = largest * math.sqrt(share * float(np.sum((spread / largest) ** 2)))
    size = float(np.max(np.abs(columns), initial=0.0))
    return whole, error if error > SAME * size else 0.0


def axes_in(table: pd.DataFrame) -> tuple[str, ...]:
    """Return the names of the varied axes, which are the columns with a dot in their names."""
    return tuple(str(name) for name in table.columns if "." in str(name))


def finite(values: FloatArray) -> FloatArray:
    """Return the values that are finite."""
    return values[np.isfinite(values)]


def _parts(
    table: pd.DataFrame, score: Score, columns: Mapping[str, list[Any]]
) -> list[tuple[tuple[Any, ...], str, str, float]]:
    """Return key, method, state and score of each row; a failed cell has no score."""
    import pandas as pd

    try:
        numbers = pd.to_numeric(table[score.name]).to_numpy(dtype=np.float64, na_value=np.nan)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"results, column '{score.name}'", expected="numbers", found=str(error)
        ) from error
    names = ("record", "reduction")
    shared = zip(
        *([str(v) for v in table[n]] for n in names), *(columns[n] for n in columns), strict=True
    )
    states = [str(state) for state in table["state"]]
    methods = [str(method) for method in table["method"]]
    values = [math.nan if s == FAILED else float(v) for s, v in zip(states, numbers, strict=True)]
    return list(zip(shared, methods, states, values, strict=True))


def _wide(
    whole: list[tuple[tuple[Any, ...], str, str, float]], rows: list[int], drawn: dict[str, str]
) -> Cells:
    parts = [whole[i] for i in rows]
    # Sorted, so that sums do not depend on the order of the rows.
    keys = sorted({part[0] for part in parts}, key=lambda key: [_order(value) for value in key])
    methods = tuple(sorted({part[1] for part in parts}))
    draws = [drawn[str(key[0])] for key in keys]
    records = {name: g for g, name in enumerate(sorted(set(draws)))}
    place, column = ({name: i for i, name in enumerate(names)} for names in (keys, methods))
    shape = (len(keys), len(methods))
    values = np.full(shape, np.nan)
    ran, failed, bad = np.zeros(shape, bool), np.zeros(shape, bool), np.zeros(shape, bool)
    for key, method, state, value in parts:
        at = place[key], column[method]
        if ran[at]:
            raise InputError(
                "results",
                expected="one row for each record, reduction, setting and method",
                found=f"two of method '{method}' on record '{key[0]}', reduction '{key[1]}'",
            )
        ran[at], failed[at], values[at] = True, state == FAILED, value
        bad[at] = state not in (FAILED, *ENDED_WELL)
    record = np.array([records[name] for name in draws], dtype=np.intp)
    return Cells(methods, record, values, ran, failed, bad)


def plain_values(column: pd.Series[Any]) -> list[Any]:
    """Return values as Python's own, with None for all that is missing."""
    import pandas as pd

    missing = pd.isna(column).to_numpy()
    return [None if gone else value for value, gone in zip(column.tolist(), missing, strict=True)]


def _order(value: Any) -> tuple[int, float, str]:
    if value is None:
        return (2, 0.0, "")
    if isinstance(value, int | float) and not isinstance(value, bool):
        return (0, float(value), "")
    return (1, 0.0, str(value))


def _heaviest(change: FloatArray, record: NDArray[np.intp]) -> float:
    by_record = np.abs(np.bincount(record, weights=change))
    total = float(by_record.sum())
    return float(by_record.max() / total) if total > 0.0 else math.nan
