"""Reconstruction of a record by a model that was fitted to another: validation runs."""

from __future__ import annotations

import numpy as np

from classic_ml.series import CoefficientSeries
from comparisons.harness.fit_quality import score_fit
from comparisons.harness.rows import stack_rows
from comparisons.results import LagModel, Reconstruction

__all__ = ["reconstruct_record"]


def reconstruct_record(model: LagModel, record: CoefficientSeries) -> Reconstruction:
    """Run a fitted model over another record, with nothing refitted.

    Parameters
    ----------
    model : LagModel
        Fitted elsewhere, with effects or without.
    record : CoefficientSeries
        Measured φ drives it; the measured coefficient serves for each segment's start and for
        the score. Its sample rate need not be that of the fit.

    Raises
    ------
    InputError
        When the record lacks the coefficient that the model gives, or a channel that it needs.
    """
    rows = stack_rows([record], model.target)
    reconstructed = model.free_run_over(rows, [record])
    low, high = model.valid_phi
    outside = float(np.mean((rows.phi < low) | (rows.phi > high)))
    score = score_fit(rows.measured, reconstructed)
    return Reconstruction(model, record, rows, reconstructed, score, outside)
