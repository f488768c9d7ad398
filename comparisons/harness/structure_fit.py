"""The sparse regression of one or several records, on rows or on whole runs, as one value."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from classic_ml.series import CoefficientSeries
from classic_ml.whole_run_rows import has_whole_run
from comparisons.harness.cautions import tau_caution
from comparisons.harness.rows import stack_rows
from comparisons.harness.sparse_whole_run import fit_sparse_whole_runs
from sindy_surge import SparseLagRegressor
from sindy_surge.text import ModelSummary
from surge_core.display import Displayed, Field, Sheet
from surge_core.terms import pretty_term
from surge_core.types import FloatArray

CURVE_POINTS = 201
# One in a hundred resampled records is no evidence for a term.
LEAST_INCLUSION = 0.01
QUOTE = "that of `sindy-surge compare`, which sets other estimators beside this one"
SETTINGS: dict[str, Any] = {"hold": "first", "max_terms": 6}


@dataclass(frozen=True)
class FoundStructure(Displayed):
    """Terms, lag and errors found by the sparse regression alone.

    Parameters
    ----------
    fit : SparseLagRegressor or SparseWholeRunFit
        The fitted estimator: both have a summary, an equation and a characteristic.
    records : tuple of CoefficientSeries
        What was fitted.
    fitted_to : {"rows", "whole runs"}
        Rows of the segments, or one free run through each unfiltered record.
    reason : str
        How these rows were taken, and why not whole runs.
    phi, measured : ndarray of shape (n,)
        The rows that were scored.
    n_segments : int
        Segments or runs they come from.
    """

    fit: Any
    records: tuple[CoefficientSeries, ...]
    fitted_to: Literal["rows", "whole runs"]
    reason: str
    phi: FloatArray
    measured: FloatArray
    n_segments: int

    @property
    def refused(self) -> bool:
        """Whether whole runs hold no lag, or the rows do not bear the coefficients found."""
        if self.fitted_to == "whole runs":
            return math.isnan(self.fit.time_constant_s_)
        found = self.fit.summary().parts.stderr
        return self.state[0] != "ok" and not np.all(np.isfinite(found))

    @property
    def state(self) -> tuple[str, str]:
        """Code of how the fit ended, and the advice that goes with it."""
        return str(self.fit.fit_state_), self.fit.fit_state_.advice

    @property
    def inclusion(self) -> dict[str, float]:
        """Share of resampled records that hold a term; empty where none were drawn."""
        return dict(getattr(self.fit, "inclusion_probability_", {}))

    @property
    def summary(self) -> ModelSummary:
        """All fields and tables of the fit, with what its records make doubtful."""
        own: ModelSummary = self.fit.summary()
        histories = [record.history for record in self.records]
        filtered = tau_caution(histories) if self.fitted_to == "rows" else None
        return replace(
            own,
            name="Structure of ψ'_QS(φ)",
            cautions=(*own.cautions, *([filtered.text] if filtered else [])),
        )

    def equation(self) -> str:
        """Write the equation, rounded to its uncertainty."""
        return str(self.fit.equation())

    def curve(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return φ over the range of the data, ψ'_QS and its standard error there."""
        phi = np.linspace(self.phi.min(), self.phi.max(), CURVE_POINTS)
        return (phi, *self.fit.characteristic(phi))

    def _sheet(self) -> Sheet:
        return self.sheet()

    def sheet(self) -> Sheet:
        """Return all that is known: what was fitted, equation, state, terms and what came close."""
        names = ", ".join(Path(record.source).name for record in self.records)
        fitted = Field("fitted to", f"{self.phi.size} rows {self.reason}")
        code, advice = self.state
        if self.refused:
            title = f"ψ' of {names}: no structure ({code})"
            return Sheet(title, (fitted, Field("state", advice, "advice")))
        own = self.summary.sheet()
        others = Field("not chosen", self._left_out())
        fields = (fitted, *own.fields, others, Field("τ to quote", QUOTE))
        return replace(own, title=f"{own.title} of {names}", fields=fields)

    def _left_out(self) -> str:
        """Say how often terms that were not chosen came up, or why nothing is known of that."""
        known = self.inclusion
        if not known:
            why = f"records are not resampled where a fit ended as {self.state[0]}"
            if self.fitted_to == "whole runs":
                why = "the free run through whole records is not resampled"
            return f"no inclusion probabilities: {why}"
        others = sorted((-p, name) for name, p in known.items() if name not in self.fit.terms_)
        shown = [f"{pretty_term(name)} {-p:.2f}" for p, name in others if -p >= LEAST_INCLUSION]
        if not shown:
            return "no other term came up in a resampled record"
        return "in some resampled records: " + ", ".join(shown)


def find_structure(records: Sequence[CoefficientSeries]) -> FoundStructure:
    """Choose the terms of the lag model of ψ' by the sparse regression.

    Parameters
    ----------
    records : sequence of CoefficientSeries
        One or several records at one sample rate; whole unfiltered runs are fitted where all of
        them carry one, else the rows of their segments.

    Returns
    -------
    FoundStructure
        The structure, with why it was fitted to what.

    Raises
    ------
    InputError
        When the records do not go together, or there is nothing to fit.
    """
    carry = [has_whole_run(record) for record in records]
    if all(carry):
        whole = fit_sparse_whole_runs(records, **SETTINGS)
        inputs = whole.stacked()
        scored = inputs.phi[inputs.scored], inputs.psi_p[inputs.scored], len(whole.rows_)
        reason = "in one simulation through the unfiltered record"
        return FoundStructure(whole, tuple(records), "whole runs", reason, *scored)
    rows = stack_rows(records)
    fit = SparseLagRegressor(rows.sample_period_s, output_name="psi_p", **SETTINGS)
    fit.fit(rows.X, rows.measured, segments=rows.labels)
    why = ", since not every record carries a whole run" if any(carry) else ""
    scored = rows.phi, rows.measured, rows.n_segments
    reason = f"of the segments{why}"
    return FoundStructure(fit, tuple(records), "rows", reason, *scored)
