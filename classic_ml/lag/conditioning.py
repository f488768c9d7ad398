"""Terms of a characteristic made nearly orthogonal, so that inner products keep their digits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from classic_ml.lag.compiled import compiled
from surge_core.types import FloatArray

__all__ = ["Conditioned", "condition"]

# Up to here the eigenvectors of the Gram matrix keep half of all digits; beyond, QR is called.
MILD = 1e-8
ROWS_AT_A_TIME = 65_536
# What is left of 1 after the terms have been taken out of it.
IS_CONSTANT = 1e-7


@dataclass(frozen=True)
class Conditioned:
    """Combinations of the terms, each of mean square one, no two alike.

    Parameters
    ----------
    rows : ndarray of shape (r, n)
        The combinations, ``terms @ back`` transposed.
    back : ndarray of shape (q, r)
        What turns their coefficients into those of the terms.
    constant : ndarray of shape (q,), optional
        Coefficients with which the terms make 1, where that was taken out of ``rows``.
    deficient : bool
        Some terms are copies of others within rounding.
    """

    rows: FloatArray
    back: FloatArray
    constant: FloatArray | None
    deficient: bool


def condition(terms: FloatArray, without_constant: bool) -> Conditioned:
    """Return nearly orthogonal combinations of the terms that span the same curves.

    Parameters
    ----------
    terms : ndarray of shape (n, q)
        The s_i(φ) at each sample.
    without_constant : bool
        Leave the constant out where the terms can make it (a drift then carries it).
    """
    n = terms.shape[0]
    terms = np.require(terms, requirements=["C", "W"])
    gram, sums = _products(terms)
    scale = np.sqrt(np.diag(gram))
    scale[scale == 0.0] = 1.0
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    if values[0] < MILD * max(values[-1], 1e-300):
        triangle = _triangle(terms, scale)
        _, singular, right = np.linalg.svd(triangle)
        limit = max(n, 1000) * np.finfo(np.float64).eps * singular[0]
        kept = singular > max(limit, 1e-300)
        vectors, values = right[: singular.size].T, singular**2
    else:
        kept = np.ones(values.size, dtype=np.bool_)
    back = vectors[:, kept] / np.sqrt(values[kept]) / scale[:, None] * np.sqrt(n)
    deficient = bool(np.count_nonzero(kept) < terms.shape[1])
    constant = None
    if without_constant and back.shape[1] > 0:
        share = back.T @ sums / n
        if _has_constant_column(terms) or _is_one(terms @ (back @ share)):
            constant = back @ share
            full, _ = np.linalg.qr(share[:, None], mode="complete")
            back = back @ full[:, 1:]
    rows = np.empty((back.shape[1], n))
    _combine(terms, np.ascontiguousarray(back), rows)
    return Conditioned(rows, back, constant, deficient)


def _has_constant_column(terms: FloatArray) -> bool:
    first = terms[0]
    same = (first != 0.0) & (terms[-1] == first)
    return any(bool(np.all(terms[:, j] == first[j])) for j in np.flatnonzero(same))


def _is_one(values: FloatArray) -> bool:
    return bool(np.max(np.abs(values - 1.0)) < IS_CONSTANT)


@compiled
def _products(terms: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Sum the products of all pairs of columns, and the columns."""
    n, q = terms.shape
    gram, sums = np.zeros((q, q)), np.zeros(q)
    part = np.zeros((q, 256))
    for low in range(0, n, 256):
        m = min(256, n - low)
        for j in range(q):
            for k in range(m):
                part[j, k] = terms[low + k, j]
        for i in range(q):
            one = part[i]
            for k in range(m):
                sums[i] += one[k]
            for j in range(i + 1):
                other = part[j]
                total = 0.0
                for k in range(m):
                    total += one[k] * other[k]
                gram[i, j] += total
    for i in range(q):
        for j in range(i):
            gram[j, i] = gram[i, j]
    return gram, sums


@compiled
def _combine(terms: FloatArray, back: FloatArray, rows: FloatArray) -> None:
    """Fill ``terms @ back``, a row for each combination."""
    n, q = terms.shape
    part = np.zeros((q, 256))
    for low in range(0, n, 256):
        m = min(256, n - low)
        for j in range(q):
            for k in range(m):
                part[j, k] = terms[low + k, j]
        for i in range(back.shape[1]):
            out = rows[i, low : low + m]
            for k in range(m):
                out[k] = 0.0
            for j in range(q):
                factor, one = back[j, i], part[j]
                for k in range(m):
                    out[k] += factor * one[k]


def _triangle(terms: FloatArray, scale: FloatArray) -> FloatArray:
    triangle = np.zeros((0, terms.shape[1]))
    for at in range(0, terms.shape[0], ROWS_AT_A_TIME):
        part = terms[at : at + ROWS_AT_A_TIME] / scale
        triangle = np.asarray(np.linalg.qr(np.concatenate([triangle, part]), mode="r"))
    return triangle
