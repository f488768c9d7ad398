"""The errors of a fitted lag model and their derivatives, on rows like those of the fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from classic_ml.lag_data import LagData, Terms
from classic_ml.likelihood import jacobian, profile
from surge_core.segments import runs_of
from surge_core.types import FloatArray, IntArray


@dataclass(frozen=True)
class LinearisedFit:
    """The errors of a fit and their derivatives.

    Parameters
    ----------
    errors : ndarray of shape (n,)
        Prediction errors of the scored rows, times the root of their weights.
    jacobian : ndarray of shape (n, p)
        ∂e/∂θ, θ = (τ in seconds, coefficients of nearly orthogonal terms,
        drift, C).
    back : ndarray of shape (q, r)
        What turns those coefficients into β.
    rows : ndarray of int, shape (n,)
        Row of the data that each error belongs to.
    pieces : tuple of slice
        Stretches of ``errors`` that follow each other without a gap.
    segment : ndarray of int, shape (n,)
        Number of the segment, from 0, of each error.
    """

    errors: FloatArray
    jacobian: FloatArray
    back: FloatArray
    rows: IntArray
    pieces: tuple[slice, ...]
    segment: IntArray


def linearised(data: LagData, terms: Terms, shape: FloatArray, beta: FloatArray) -> LinearisedFit:
    """Linearise about given parameters; starts and drift are the best for these.

    Parameters
    ----------
    data : LagData
        Record and model.
    terms : Terms
        How its terms come from the user's.
    shape : ndarray
        log τ, ρ.
    beta : ndarray of shape (r,)
        Coefficients of the nearly orthogonal terms.
    """
    at = profile(data, shape, beta)
    both, n_shape = jacobian(data, at), int(data.free.sum())
    # ∂e/∂τ from ∂e/∂log τ; a held τ does not move.
    fitted = int(data.held_log_tau is None)
    tau = both[:, :1] / np.exp(shape[0]) if fitted else np.zeros((both.shape[0], 1))
    keep = data.scored
    rows = data.rows_of_errors[keep]
    lengths = [run.stop - run.start for run in data.runs]
    segment = np.repeat(np.arange(len(lengths)), lengths)[rows]
    # Rows that follow each other within a segment have one such label.
    pieces = runs_of(rows - np.arange(rows.size) + 2 * segment * data.y.size, rows.size)
    return LinearisedFit(
        at.errors[keep],
        np.column_stack([tau, both[:, n_shape:], both[:, fitted:n_shape]])[keep],
        terms.back,
        rows,
        tuple(pieces),
        segment,
    )
