"""Reconstruction of a record by a model that was fitted to another: validation runs."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from classic_ml.records import FloatArray
from classic_ml.series import CoefficientSeries
from comparisons.fit_quality import FitScore, score_fit
from comparisons.fit_rows import FitRows, stack_rows
from comparisons.lag_value import FittedLag

__all__ = [
    "RECONSTRUCT_SCHEMA",
    "Reconstruction",
    "reconstruct_record",
    "reconstruction_csv",
    "reconstruction_document",
]

RECONSTRUCT_SCHEMA = "sindy-surge/reconstruct/1"


@dataclass(frozen=True)
class Reconstruction:
    """The deterministic free run of a model over a record (paper, Fig 27).

    Parameters
    ----------
    model : FittedLag
        The model, as it was fitted elsewhere.
    record : CoefficientSeries
        The record it is run on.
    rows : FitRows
        The rows in the record's segments.
    reconstructed : ndarray of shape (n,)
        Free run from measured φ and each segment's measured start.
    score : FitScore
        How well it matches.
    outside : float
        Share of the rows whose φ lies outside the model's range of trust.
    """

    model: FittedLag
    record: CoefficientSeries
    rows: FitRows
    reconstructed: FloatArray
    score: FitScore
    outside: float


def reconstruct_record(model: FittedLag, record: CoefficientSeries) -> Reconstruction:
    """Run a fitted model over another record, with nothing refitted.

    Parameters
    ----------
    model : FittedLag
        Fitted elsewhere.
    record : CoefficientSeries
        Measured φ drives it; the measured coefficient serves for each segment's start and for
        the score. Its sample rate need not be that of the fit.

    Raises
    ------
    InputError
        When the record lacks the coefficient that the model gives.
    """
    rows = stack_rows([record], model.target)
    reconstructed = model.free_run(rows.phi, rows.sample_period_s, rows.labels, start=rows.measured)
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
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["time_s", "segment", "phi", target, f"{target}_reconstructed"])
    for values in zip(
        rows.time_s.tolist(),
        rows.labels.tolist(),
        rows.phi.tolist(),
        rows.measured.tolist(),
        reconstruction.reconstructed.tolist(),
        strict=True,
    ):
        writer.writerow(values)
    return stream.getvalue()


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
