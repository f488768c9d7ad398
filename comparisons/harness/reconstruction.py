"""Reconstruction of a record by a model that was fitted to another: validation runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from classic_ml.series import CoefficientSeries
from comparisons.harness.fit_quality import score_fit
from comparisons.harness.rows import stack_rows
from comparisons.results import LagModel, Reconstruction

__all__ = [
    "RECONSTRUCT_SCHEMA",
    "reconstruct_record",
    "reconstruction_csv",
    "reconstruction_document",
]

RECONSTRUCT_SCHEMA = "sindy-surge/reconstruct/1"


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


def reconstruction_csv(reconstruction: Reconstruction) -> str:
    """Return the reconstruction as a CSV table.

    Parameters
    ----------
    reconstruction : Reconstruction
        What :func:`reconstruct_record` gave.
    """
    rows, target = reconstruction.rows, reconstruction.model.target
    columns = {
        "time_s": rows.time_s,
        "segment": rows.labels,
        "phi": rows.phi,
        target: rows.measured,
        f"{target}_reconstructed": reconstruction.reconstructed,
    }
    return str(pd.DataFrame(columns).to_csv(index=False, lineterminator="\n"))


def reconstruction_document(runs: Sequence[Reconstruction]) -> dict[str, Any]:
    """Return the document of ``reconstruct --json``.

    Parameters
    ----------
    runs : sequence of Reconstruction
        One for each model and record.
    """
    return {
        "schema": RECONSTRUCT_SCHEMA,
        "reconstructions": [
            {
                "record": run.record.source,
                "estimator": run.model.estimator,
                "target": run.model.target,
                "time_constant_s": run.model.time_constant_s,
                "rows": run.score.n_rows,
                "segments": run.rows.n_segments,
                "free_run": run.score.to_json(),
                "outside_valid_phi": run.outside,
            }
            for run in runs
        ],
    }
