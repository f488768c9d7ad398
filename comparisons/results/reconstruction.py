"""The free run of a saved model over another record, and the fields of its table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from classic_ml.series import CoefficientSeries
from comparisons.results.lag import LagModel
from comparisons.results.rows import FitRows, FitScore
from comparisons.results.tables import SYMBOLS, TableField, estimator_label
from surge_core.rounding import significant
from surge_core.types import FloatArray

__all__ = ["RECONSTRUCTION_FIELDS", "Reconstruction", "reconstruction_cells"]


@dataclass(frozen=True)
class Reconstruction:
    """The deterministic free run of a model over a record (paper, Fig 27).

    Parameters
    ----------
    model : LagModel
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

    model: LagModel
    record: CoefficientSeries
    rows: FitRows
    reconstructed: FloatArray
    score: FitScore
    outside: float


RECONSTRUCTION_FIELDS: tuple[TableField, ...] = (
    TableField("record", "what the model was run on", lambda run: run.record.source, False),
    TableField(
        "model",
        "the estimator that found it",
        lambda run: estimator_label(run.model.estimator),
        False,
    ),
    TableField("of", "the coefficient", lambda run: SYMBOLS[run.model.target], False),
    TableField("rms", "of measured minus reconstructed", lambda run: significant(run.score.rms, 3)),
    TableField(
        "fit [%]",
        "100 (1 - error / spread of the measurement)",
        lambda run: f"{run.score.fit_percent:.1f}",
    ),
    TableField("rows", "rows that were scored", lambda run: str(run.score.n_rows)),
    TableField(
        "outside [%]",
        "share of the rows whose φ lies beyond where it dwelt in the fit (5th to 95th percentile)",
        lambda run: f"{100.0 * run.outside:.0f}",
    ),
)


def reconstruction_cells(runs: Sequence[Reconstruction]) -> list[list[str]]:
    """Return the text of every cell, one list a run.

    Parameters
    ----------
    runs : sequence of Reconstruction
        Models and the records they were run on.
    """
    return [[field.text(run) for field in RECONSTRUCTION_FIELDS] for run in runs]
