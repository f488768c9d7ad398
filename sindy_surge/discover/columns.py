"""Columns of a user's arrays and their names, or why they are refused."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.fft import dct
from scipy.stats import beta

from sindy_surge.candidate_terms import independent_columns
from sindy_surge.discover.trajectories import LEAST_NOISE
from surge_core.errors import InputError, require
from surge_core.types import BoolArray, FloatArray, IndexArray

# What the last digit leaves, as a share of a column's spread: a fifth of the least noise assumed.
_ROUNDED = 0.2 * LEAST_NOISE
# How rarely white noise about a constant may seem to move.
_BY_CHANCE = 1e-4


def apart(columns: FloatArray, names: Sequence[str]) -> None:
    """Refuse a column that does not move, or that others give without error."""
    moving(columns, names)
    scaled = (columns - columns.mean(axis=0)) / np.std(columns, axis=0)
    # Two measurements of one quantity differ by their noise; the same one twice, by its digits.
    same = np.abs(np.corrcoef(scaled, rowvar=False)) if len(names) > 1 else np.zeros((1, 1))
    expected = "a column of its own"
    for i, j in np.argwhere(np.triu(same > 1.0 - _ROUNDED**2, 1)).tolist():
        found = f"a straight line of {names[i]}, but for its last digits"
        remedy = "leave one of the two out: it is the same measurement twice"
        raise InputError(names[j], expected=expected, found=found, remedy=remedy)
    for j in np.setdiff1d(np.arange(len(names)), independent_columns(scaled)).tolist():
        found = "what the columns before it give without error"
        remedy = "leave it out: no record can part what it does from what they do"
        raise InputError(names[j], expected=expected, found=found, remedy=remedy)


def moving(columns: FloatArray, names: Sequence[str]) -> None:
    """Refuse a column that does not move."""
    still = np.ptp(columns, axis=0) <= 1e-12 * np.abs(columns).max(axis=0)
    remedy = "leave it out: what it does is the term 1"
    for name, is_so in zip(names, still, strict=True):
        require(not is_so, name, "a column that moves", "a constant", remedy)


def idle(y: FloatArray, u: FloatArray, starts: IndexArray) -> BoolArray:
    """Return which columns of y are not distinguished from a constant with white noise.

    Of white noise any m of n cosine coefficients hold a share of the energy that is distributed as
    Beta(m/2, (n - m)/2), and a sum of rows one as m = 1. Bands of 1, 2, 4, … coefficients are
    looked at, for a drift or a swing; sums of the first 2, 4, … rows of each run, for what decays
    at once; and the correlation with inputs of a row and the one before, which a fast lag behind
    noise has. Of 66 400 constants with noise of four shapes 18 moved; of 50 decays over five rows
    from five standard deviations all did.
    """
    z, w, n = _unit(y), _unit(u), len(y) - 1
    energy = dct(z, axis=0, norm="ortho")[1:] ** 2
    sums = np.pad(np.cumsum(z, axis=0), ((1, 0), (0, 0)))
    shares = [(1, energy), (1, np.vstack((w.T @ z, w[:-1].T @ z[1:])) ** 2)]
    for m in (2**k for k in range(1, n.bit_length() - 1)):
        first = (sums[np.minimum(starts + m, n)] - sums[starts]) ** 2 / (m * (1 - m / (n + 1)))
        shares += [(m, np.add.reduceat(energy, np.arange(0, n, m))), (1, first)]
    few = _BY_CHANCE / sum(len(share) for _, share in shares)
    likely = [beta.sf(np.max(each, axis=0, initial=0.0), m / 2, (n - m) / 2) for m, each in shares]
    return np.asarray(np.min(likely, axis=0) > few)


def _unit(columns: FloatArray) -> FloatArray:
    about = columns - columns.mean(axis=0)
    return np.asarray(about / np.linalg.norm(about, axis=0))


def idle_words(names: Sequence[str]) -> list[str]:
    """Say which states are idle, if any are."""
    words = "not distinguished from a constant; an effect on the others is in their coefficients"
    return [f"idle: {', '.join(names)} ({words})"] if names else []


def as_fitted(name: str, found: int, names: Sequence[str]) -> None:
    """Refuse another number of columns than was fitted."""
    wanted = f"{len(names)} columns, as fitted" + f": {', '.join(names)}" * bool(names)
    require(found == len(names), name, wanted, str(found))


def check_names(names: Sequence[str], wanted: int) -> None:
    """Refuse names of states and inputs that are doubled, too few, or those of terms."""
    texts = [name for name in names if isinstance(name, str)]
    # "x y" beside x and y is the name of a term too.
    factors = {n: {factor.partition("^")[0] for factor in n.split()} for n in texts}
    terms = [n for n in texts if n == "1" or factors[n] <= {"1", *texts} - {n}]
    good = not terms and len(set(texts)) == wanted == len(names)
    expected = f"{wanted} different names of states and inputs, as text, none that of a term"
    found = ", ".join(map(str, names)) or "none"
    found += "".join(f"; {name!r} reads as a term" for name in terms)
    require(good, "feature_names, hidden", expected, found)
