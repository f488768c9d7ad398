"""The free run of a saved model over another record, with its band, and the tables of several."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from classic_ml.series import CoefficientSeries
from comparisons.results.comparison import difference_cells
from comparisons.results.lag import LagModel
from comparisons.results.names import SYMBOLS, estimator_label, named
from comparisons.results.rows import FitRows, FitScore
from surge_core.display import Grid
from surge_core.rounding import NOT_KNOWN, significant
from surge_core.types import BoolArray, FloatArray


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
        The rows that are scored: those in the record's segments, or for a model fitted to
        unfiltered signals the rows that a whole run is scored on.
    reconstructed : ndarray of shape (n,)
        Free run from measured φ and each segment's measured start.
    score : FitScore
        How well it matches.
    band, wide_band : ndarray of shape (n,)
        Half the width of the pointwise 95 % band: where the free run lies by the covariance of
        the fit, and where the measurement is to be expected, with the error of the free run over
        the model's own rows; NaN where that is not known.
    difference, paired_error, p_value : float
        Of its rms to the least one on the same rows, with its paired jackknife error and the
        p-value of Diebold and Mariano's test; 0 and NaN for the least one.
    seen : bool
        Whether the model was fitted to this very record.
    """

    model: LagModel
    record: CoefficientSeries
    rows: FitRows
    reconstructed: FloatArray
    score: FitScore
    band: FloatArray
    wide_band: FloatArray
    difference: float = 0.0
    paired_error: float = 0.0
    p_value: float = math.nan
    seen: bool = False

    @property
    def label(self) -> str:
        """What people call the estimator of the model."""
        name, on_rows = self.model.estimator, getattr(self.model, "rows", "") == "filtered"
        return "armax on the rows" if on_rows and name == "classic_ml" else estimator_label(name)

    @property
    def beyond(self) -> BoolArray:
        """Rows whose φ lies outside the model's range of trust, of shape (n,)."""
        low, high = self.model.valid_phi
        return np.asarray((self.rows.phi < low) | (self.rows.phi > high))

    @property
    def outside(self) -> float:
        """Share of these."""
        return float(np.mean(self.beyond))

    @property
    def title(self) -> str:
        """Coefficient, record and speed."""
        speed = f" at {_percent(self.speed, 1)} speed" if math.isfinite(self.speed) else ""
        seen = ", to which the models were fitted" if self.seen else ""
        return f"{SYMBOLS[self.model.target]} of {self.record.source}{speed}{seen}"

    @property
    def speed(self) -> float:
        """Corrected speed at the first row of the record, as a share of design; NaN unknown."""
        return math.nan if self.record.Nc_frac is None else float(self.record.Nc_frac[0])

    def inside(self, band: FloatArray) -> float:
        """Return the share of the rows whose measurement lies inside a band; NaN without one."""
        if np.any(np.isnan(band)):
            return math.nan
        return float(np.mean(np.abs(self.rows.measured - self.reconstructed) <= band))

    def to_csv(self) -> str:
        """Return the reconstruction as a CSV table, beside what was measured."""
        rows, target, band = self.rows, self.model.target, self.band
        columns = {
            "time_s": rows.time_s,
            "segment": rows.labels,
            "phi": rows.phi,
            target: rows.measured,
            f"{target}_reconstructed": self.reconstructed,
            f"{target}_low": self.reconstructed - band,
            f"{target}_high": self.reconstructed + band,
            "outside_valid_phi": self.beyond.astype(int),
        }
        known = {name: values for name, values in columns.items() if np.all(np.isfinite(values))}
        return str(pd.DataFrame(known).to_csv(index=False, lineterminator="\n"))

    def to_json(self) -> dict[str, Any]:
        """Return what ``reconstruct --json`` says of it."""
        return {
            "record": self.record.source,
            "speed": self.speed,
            "fitted_to_it": self.seen,
            "estimator": self.model.estimator,
            "target": self.model.target,
            "time_constant_s": self.model.time_constant_s,
            "rows": self.score.n_rows,
            "scored": self.rows.kind,
            "segments": self.rows.n_segments,
            "free_run": self.score.to_json(),
            "to_least": {
                "difference": self.difference,
                "paired_error": self.paired_error,
                "p_value": self.p_value,
            },
            "inside_band95": self.inside(self.band),
            "inside_band95_with_scatter": self.inside(self.wide_band),
            "outside_valid_phi": self.outside,
            "rows_outside_valid_phi": int(np.count_nonzero(self.beyond)),
        }


# Heading of each column of the table, and what it says.
RECONSTRUCTION_COLUMNS = {
    "model": "the estimator that found it",
    "scored": "rows: low-passed, as a series without a ledger gives them, or unfiltered and "
    "averaged over a period of the stall cells, as the model was fitted to",
    "rows": "how many",
    "rms": "of measured minus reconstructed",
    "fit [%]": "100 (1 - error / spread of the measurement)",
    "Δ to least": "difference of the rms to the least on the same rows ± paired jackknife error",
    "p": "of Diebold and Mariano's test of that difference",
    "in band": "share of the rows inside the pointwise 95 % band of the free run by the "
    "covariance of τ and the coefficients",
    "+ scatter": "the same with the error of the free run over the model's own rows added: "
    "near 95 where the model holds as well as in its fit",
    "beyond φ": "rows whose φ lies beyond where it dwelt in the fit (5th to 95th percentile)",
}


def reconstruction_grids(runs: Sequence[Reconstruction]) -> tuple[Grid, ...]:
    """Return a table for each record and coefficient, a column for each heading.

    Parameters
    ----------
    runs : sequence of Reconstruction
        Models and the records they were run on.
    """
    groups: dict[str, list[tuple[str, ...]]] = {}
    for run in runs:
        row = (
            named(run.label, run.model.estimator),
            run.rows.called,
            str(run.score.n_rows),
            significant(run.score.rms, 3),
            f"{run.score.fit_percent:.1f}",
            *difference_cells(run.difference, run.paired_error, run.p_value),
            _percent(run.inside(run.band)),
            _percent(run.inside(run.wide_band)),
            f"{np.count_nonzero(run.beyond)} ({_percent(run.outside)})",
        )
        groups.setdefault(run.title, []).append(row)
    about = frozenset({0, 1}), (), RECONSTRUCTION_COLUMNS
    heads = tuple(RECONSTRUCTION_COLUMNS)
    return tuple(Grid(title, heads, tuple(rows), *about) for title, rows in groups.items())


def _percent(share: float, digits: int = 0) -> str:
    return f"{100.0 * share:.{digits}f} %" if math.isfinite(share) else NOT_KNOWN
