"""Standard errors and correlations of fitted numbers; bases of columns."""

from __future__ import annotations

import numpy as np

from surge_core.types import BoolArray, FloatArray

# Of the largest eigenvalue of the scaled normal matrix: below it lies rounding; and the share of a
# number in such directions from which on the rows do not tell it.
LEAST_INFORMATION, BLIND_SHARE = 1e-12, 1e-3


def sandwich(normal: FloatArray, scores: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return the covariance of m numbers where the errors of a block may depend on each other.

    ``normal`` is that of their slopes, ``scores`` (blocks, m) slopes times errors summed over each
    block. Beside it: which numbers the rows do not tell.
    """
    unit = np.sqrt(np.diag(normal))
    unit = np.where(unit > 0.0, 1.0 / np.where(unit > 0.0, unit, 1.0), 0.0)
    values, vectors = np.linalg.eigh(normal * np.outer(unit, unit))
    known = values > LEAST_INFORMATION * values[-1]
    inverse = (vectors[:, known] / values[known]) @ vectors[:, known].T * np.outer(unit, unit)
    n = scores.shape[0]
    spread = scores.T @ scores * (n / max(n - 1, 1))
    blind = np.sum(vectors[:, ~known] ** 2, axis=1) > BLIND_SHARE
    return np.asarray(inverse @ spread @ inverse), blind


def largest_correlation(covariance: FloatArray) -> float:
    """Return the largest correlation of two of several numbers; 0 where no two are known."""
    variance = np.diag(covariance)
    at = np.flatnonzero((variance > 0.0) & np.isfinite(variance))
    if at.size < 2:
        return 0.0
    size = np.sqrt(variance[at])
    apart = np.triu(covariance[np.ix_(at, at)] / np.outer(size, size), 1).ravel()
    return float(apart[np.argmax(np.abs(apart))])


def orthonormal(columns: FloatArray, least: float = 1e-6, smallest: float = 1e-12) -> FloatArray:
    """Return an orthonormal basis of columns, without those that the others already span.

    A direction below ``least`` of the largest is none of its own; a column up to ``smallest`` is
    rounding.
    """
    size = np.sqrt(np.einsum("ij,ij->j", columns, columns))
    kept = np.asarray(columns[:, size > smallest] / size[size > smallest])
    if kept.shape[1] == 0:
        return kept
    basis, triangle = np.linalg.qr(kept)
    if np.abs(np.diag(triangle)).min() > least:
        return np.asarray(basis)
    left, scale, _ = np.linalg.svd(kept, full_matrices=False)
    return np.asarray(left[:, scale > least * scale[0]])
