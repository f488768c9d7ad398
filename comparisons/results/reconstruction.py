"""The free run of a saved model over another record, and its table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd

from classic_ml.series import CoefficientSeries
from comparisons.results.lag import LagModel
from comparisons.results.names import SYMBOLS, estimator_label
from comparisons.results.rows import FitRows, FitScore
from surge_core.display import Grid
from surge_core.rounding import significant
from surge_core.types import FloatArray

__all__ = ["RECONSTRUCTION_COLUMNS", "Reconstruction", "reconstruction_grid"]


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

    def to_csv(self) -> str:
        """Return the reconstruction as a CSV table, beside what was measured."""
        rows, target = self.rows, self.model.target
        columns = {
            "time_s": rows.time_s,
            "segment": rows.labels,
            "phi": rows.phi,
            target: rows.measured,
            f"{target}_reconstructed": self.reconstructed,
        }
        return str(pd.DataFrame(columns).to_csv(index=False, lineterminator="\n"))

    def to_json(self) -> dict[str, Any]:
        """Return what ``reconstruct --json`` says of it."""
        return {
            "record": self.record.source,
            "estimator": self.model.estimator,
            "target": self.model.target,
            "time_constant_s": self.model.time_constant_s,
            "rows": self.score.n_rows,
            "segments": self.rows.n_segments,
            "free_run": self.score.to_json(),
            "outside_valid_phi": self.outside,
        }


# Heading of each column of the table, and what it says.
RECONSTRUCTION_COLUMNS = {
    "record": "what the model was run on",
    "model": "the estimator that found it",
    "of": "the coefficient",
    "rms": "of measured minus reconstructed",
    "fit [%]": "100 (1 - error / spread of the measurement)",
    "rows": "rows that were scored",
    "outside [%]": "share of the rows whose φ lies beyond where it dwelt in the fit (5th to 95th "
    "percentile)",
}


def reconstruction_grid(runs: Sequence[Reconstruction]) -> Grid:
    """Return the table of reconstructions, a column for each heading.

    Parameters
    ----------
    runs : sequence of Reconstruction
        Models and the records they were run on.
    """
    rows = tuple(
        (
            run.record.source,
            estimator_label(run.model.estimator),
            SYMBOLS[run.model.target],
            significant(run.score.rms, 3),
            f"{run.score.fit_percent:.1f}",
            str(run.score.n_rows),
            f"{100.0 * run.outside:.0f}",
        )
        for run in runs
    )
    return Grid("Reconstructions", tuple(RECONSTRUCTION_COLUMNS), rows, frozenset({0, 1, 2}))
