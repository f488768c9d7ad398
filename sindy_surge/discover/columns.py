"""Columns of a user's arrays and their names, or why they are refused."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sindy_surge.candidate_terms import independent_columns
from sindy_surge.discover.trajectories import LEAST_NOISE
from surge_core.errors import InputError
from surge_core.types import FloatArray

# What the last digit leaves, as a share of a column's spread: a fifth of the least noise assumed.
_ROUNDED = 0.2 * LEAST_NOISE


def apart(columns: FloatArray, names: Sequence[str]) -> None:
    """Refuse a column that does not move, or that others give without error."""
    moving(columns, names)
    scaled = (columns - columns.mean(axis=0)) / np.std(columns, axis=0)
    # Two measurements of one quantity differ by their noise; the same one twice, by its digits.
    same = np.abs(np.corrcoef(scaled, rowvar=False)) if len(names) > 1 else np.zeros((1, 1))
    for i, j in np.argwhere(np.triu(same > 1.0 - _ROUNDED**2, 1)).tolist():
        raise InputError(
            names[j],
            expected="a column of its own",
            found=f"a straight line of {names[i]}, but for its last digits",
            remedy="leave one of the two out: it is the same measurement twice",
        )
    for j in np.setdiff1d(np.arange(len(names)), independent_columns(scaled)).tolist():
        raise InputError(
            names[j],
            expected="a column of its own",
            found="what the columns before it give without error",
            remedy="leave it out: no record can part what it does from what they do",
        )


def moving(columns: FloatArray, names: Sequence[str]) -> None:
    """Refuse a column that does not move."""
    still = np.ptp(columns, axis=0) <= 1e-12 * np.abs(columns).max(axis=0)
    for j in np.flatnonzero(still).tolist():
        raise InputError(
            names[j],
            expected="a column that moves",
            found="a constant",
            remedy="leave it out: what it does is the term 1",
        )


def as_fitted(name: str, found: int, names: Sequence[str]) -> None:
    """Refuse another number of columns than was fitted."""
    if found != len(names):
        raise InputError(
            name,
            expected=f"{len(names)} columns, as fitted" + (f": {', '.join(names)}" * bool(names)),
            found=str(found),
        )


def check_names(names: Sequence[str], wanted: int) -> None:
    """Refuse names of states and inputs that are doubled, too few, or those of terms."""
    texts = [name for name in names if isinstance(name, str)]
    # "x y" beside x and y is the name of a term too.
    factors = {n: {factor.partition("^")[0] for factor in n.split()} for n in texts}
    terms = [n for n in texts if n == "1" or factors[n] <= {"1", *texts} - {n}]
    if terms or not len(set(texts)) == wanted == len(names):
        raise InputError(
            "feature_names, hidden",
            expected=f"{wanted} different names of states and inputs, as text, none that of a term",
            found=(", ".join(map(str, names)) or "none")
            + "".join(f"; {name!r} reads as a term" for name in terms[:1]),
        )
