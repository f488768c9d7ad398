"""Reconstruction of a record by a model that was fitted to another: validation runs."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from classic_ml.series import CoefficientSeries
from comparisons.harness.fit_quality import FitScore, score_fit
from comparisons.harness.lag_value import FittedLag, load_models
from comparisons.harness.rows import FitRows, stack_rows
from surge_core.types import FloatArray

if TYPE_CHECKING:
    from comparisons.missing_effect.extended_lag import ExtendedLag

__all__ = [
    "RECONSTRUCT_SCHEMA",
    "AnyLag",
    "Reconstruction",
    "free_run_over",
    "load_any_models",
    "reconstruct_record",
    "reconstruction_csv",
    "reconstruction_document",
]

RECONSTRUCT_SCHEMA = "sindy-surge/reconstruct/1"

AnyLag: TypeAlias = "FittedLag | ExtendedLag"


@dataclass(frozen=True)
class Reconstruction:
    """The deterministic free run of a model over a record (paper, Fig 27).

    Parameters
    ----------
    model : FittedLag or ExtendedLag
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

    model: AnyLag
    record: CoefficientSeries
    rows: FitRows
    reconstructed: FloatArray
    score: FitScore
    outside: float


def reconstruct_record(model: AnyLag, record: CoefficientSeries) -> Reconstruction:
    """Run a fitted model over another record, with nothing refitted.

    Parameters
    ----------
    model : FittedLag or ExtendedLag
        Fitted elsewhere.
    record : CoefficientSeries
        Measured φ drives it; the measured coefficient serves for each segment's start and for
        the score. Its sample rate need not be that of the fit.

    Raises
    ------
    InputError
        When the record lacks the coefficient that the model gives, or a channel that it needs.
    """
    rows = stack_rows([record], model.target)
    reconstructed = free_run_over(model, rows, [record])
    low, high = model.valid_phi
    outside = float(np.mean((rows.phi < low) | (rows.phi > high)))
    score = score_fit(rows.measured, reconstructed)
    return Reconstruction(model, record, rows, reconstructed, score, outside)


def free_run_over(
    model: AnyLag,
    rows: FitRows,
    records: Sequence[CoefficientSeries],
    labels: NDArray[np.int64] | None = None,
) -> FloatArray:
    """Return the free run of a model over rows, each segment from its measured start.

    Parameters
    ----------
    model : FittedLag or ExtendedLag
        The model.
    rows : FitRows
        The rows.
    records : sequence of CoefficientSeries
        The records they come from: effects may need more of them than φ.
    labels : ndarray of int, shape (n,), optional
        In place of the rows' own segments.
    """
    if isinstance(model, FittedLag):
        marks = rows.labels if labels is None else labels
        return model.free_run(rows.phi, rows.sample_period_s, marks, start=rows.measured)
    return model.free_run_over(rows, records, labels)


def load_any_models(path: str | Path) -> dict[str, AnyLag]:
    """Read lag models, or lag models with effects: whichever the file says that it holds.

    Parameters
    ----------
    path : str or path
        Written by ``compare --save`` or ``diagnose --save``.

    Raises
    ------
    InputError
        When it is missing or is neither.
    """
    from comparisons.missing_effect.extended_file import is_extended_file, load_extended

    if not is_extended_file(path):
        return {**load_models(path)}
    # The name in the file is the one that tables show and that --estimator takes.
    return {name: replace(m, estimator=name) for name, m in load_extended(path).items()}


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
