"""The sparse regression of one or several records, on rows or on whole runs, as one value."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from classic_ml.series import CoefficientSeries
from classic_ml.whole_run import has_whole_run
from comparisons.harness.cautions import tau_caution
from comparisons.harness.rows import MINIMUM_SEGMENT_ROWS, stack_rows
from comparisons.harness.sparse_whole_run import fit_sparse_whole_runs
from comparisons.results import FitRows
from surge_core.display import Field, Sheet
from surge_core.errors import InputError

if TYPE_CHECKING:
    from sindy_surge.summary import ModelSummary
    from sindy_surge.text import EquationParts
    from surge_core.types import FloatArray

__all__ = ["FoundStructure", "find_structure"]

CURVE_POINTS = 201
# What the free run through whole records cannot take, by the name of the estimator's parameter.
ROWS_ONLY = {
    "degree": "--degree",
    "knots": "--knots",
    "constraints": "--constraint",
    "dead_time_s": "--dead-time",
    "n_bootstrap": "--bootstrap",
}
OPTIONS = ROWS_ONLY | {"max_terms": "--max-terms", "optimizer": "--optimizer"}


@dataclass(frozen=True)
class FoundStructure:
    """Terms, lag and errors found by the sparse regression alone.

    Parameters
    ----------
    fit : SparseLagRegressor or SparseWholeRunFit
        The fitted estimator.
    records : tuple of CoefficientSeries
        What was fitted.
    target : {"psi_p", "psi"}
        Which coefficient was modelled.
    fitted_to : {"rows", "whole runs"}
        Rows of the segments, or one free run through each unfiltered record.
    reason : str
        Why these, in a sentence.
    phi, measured : ndarray of shape (n,)
        The rows that were scored.
    n_segments : int
        Segments or runs they come from.
    settings : dict
        What was asked for.
    """

    fit: Any
    records: tuple[CoefficientSeries, ...]
    target: str
    fitted_to: Literal["rows", "whole runs"]
    reason: str
    phi: FloatArray
    measured: FloatArray
    n_segments: int
    settings: dict[str, Any]

    @property
    def refused(self) -> bool:
        """Whether the whole runs hold no lag, so that there is no equation either."""
        return self.fitted_to == "whole runs" and math.isnan(self.fit.time_constant_s_)

    @property
    def state(self) -> tuple[str, str]:
        """Code of how the fit ended, and the advice that goes with it."""
        state = self.fit.fit_state_
        return str(getattr(state, "code", state)), str(state.advice)

    @property
    def inclusion(self) -> dict[str, float]:
        """Share of resampled records that hold a term; empty where none were drawn."""
        return dict(getattr(self.fit, "inclusion_probability_", {}))

    @property
    def cautions(self) -> tuple[str, ...]:
        """What to know before the numbers are used, but for the advice of the state."""
        own = [c for c in getattr(self.fit, "cautions_", ()) if c != self.state[1]]
        histories = [record.history for record in self.records]
        filtered = tau_caution(histories, target=self.target) if self.fitted_to == "rows" else None
        return (*own, *([filtered.text] if filtered else []))

    @property
    def parts(self) -> EquationParts:
        """The equation with its errors; of a refused fit without terms."""
        from sindy_surge.text import EquationParts

        fit = self.fit
        dead_stderr = getattr(fit, "dead_time_stderr_s_", 0.0)
        terms = () if self.refused else fit.terms_
        return EquationParts(
            tuple(terms),
            tuple(fit.coef_[: len(terms)].tolist()),
            tuple(np.sqrt(np.diag(fit.covariance_))[: len(terms)].tolist()),
            float(fit.time_constant_s_),
            float(fit.time_constant_stderr_s_),
            dead_time_s=float(getattr(fit, "dead_time_s_", 0.0)),
            dead_time_stderr_s=float(dead_stderr) or math.nan,
            output_name=self.target,
        )

    @property
    def summary(self) -> ModelSummary:
        """All fields and tables of the fit."""
        from sindy_surge.summary import ModelSummary
        from surge_core.fit_state import FitState
        from surge_core.terms import pretty_term

        fit, known = self.fit, self.inclusion
        rows = self.fitted_to == "rows"
        noise = getattr(fit, "noise_", None)
        # Where the error of the model dominates only degrees of a polynomial were on trial.
        searched = rows and bool(fit.path_) and fit.fit_state_ != FitState.MODEL_ERROR_DOMINATES
        return ModelSummary(
            self.parts,
            fit.fit_state_,
            name=f"Structure of {pretty_term(self.target)}_QS(φ)",
            n_candidates=len(fit.candidate_terms_),
            inclusion=[known.get(term, math.nan) for term in fit.terms_] if known else None,
            rivals=fit.rivals_ if searched else None,
            aliases=tuple(fit.aliases_.items()) if rows else None,
            noise=None if noise is None else (noise[0], np.asarray(noise[1]).tolist()),
            weak=getattr(fit, "weak_form_", None),
            path=fit.path_,
            input_ranges=np.array([[self.phi.min()], [self.phi.max()]]) if self.phi.size else None,
            cautions=self.cautions,
        )

    def equation(self, style: Literal["text", "latex", "python"] = "text") -> str:
        """Write the equation, rounded to its uncertainty.

        Parameters
        ----------
        style : {"text", "latex", "python"}
            "python" gives the source of a function that returns ψ'_QS.
        """
        if style != "python":
            from sindy_surge.text import write_equation

            return write_equation(self.parts, style)
        if self.fitted_to == "rows":
            return str(self.fit.equation("python"))
        from sindy_surge.candidate_terms import CandidateTerms
        from sindy_surge.export import python_source

        # The library that the whole runs were fitted with, over the φ that they were scored at.
        library = CandidateTerms(None, self.phi[:, None], ["phi"])
        columns = [library.names.index(term) for term in self.fit.terms_]
        ends = np.array([[self.phi.min()], [self.phi.max()]])
        return python_source(self.parts, lambda phi, _: library(phi)[:, columns], ends)

    def _repr_html_(self) -> str:
        if self.refused:
            code, advice = self.state
            return Sheet("No structure", (Field("state", f"{code}: {advice}", "advice"),)).html()
        return self.summary.sheet().html()

    def curve(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return φ over the range of the data, ψ'_QS and its standard error there."""
        phi = np.linspace(self.phi.min(), self.phi.max(), CURVE_POINTS)
        return (phi, *self.fit.characteristic(phi))


def find_structure(
    records: Sequence[CoefficientSeries],
    *,
    target: str = "psi_p",
    hold: Literal["first", "zero"] = "first",
    rows: bool = False,
    optimizer: str = "SSR",
    max_terms: int = 6,
    psi_terms: bool = True,
    seed: int = 0,
    **rows_only: Any,
) -> FoundStructure:
    """Choose the terms of the lag model by the sparse regression.

    Parameters
    ----------
    records : sequence of CoefficientSeries
        One or several records at one sample rate.
    target : {"psi_p", "psi"}
        Which coefficient is modelled.
    hold : {"first", "zero"}
        How φ acts between samples.
    rows : bool
        Fit the rows of the segments even where the records carry whole unfiltered runs.
    optimizer, max_terms, psi_terms, seed
        See `SparseLagRegressor`; terms in ψ' are looked for in rows alone.
    **rows_only
        Its ``degree``, ``knots``, ``constraints``, ``dead_time_s``, ``n_bootstrap``: any of them
        makes the fit one of rows. None stands for the default.

    Returns
    -------
    FoundStructure
        The structure, with why it was fitted to what.

    Raises
    ------
    InputError
        When the records do not go together, there is nothing to fit, or an option cannot be used.
    """
    given = {name: value for name, value in rows_only.items() if value is not None}
    settings: dict[str, Any] = {"hold": hold, "optimizer": optimizer, "max_terms": max_terms}
    needs = [flag for name, flag in ROWS_ONLY.items() if name in given]
    whole, reason = _whole_or_rows(records, target, rows, needs)
    if whole:
        run = fit_sparse_whole_runs(records, **settings)
        inputs, scored = run.stacked()
        phi, psi_p, n_runs = inputs.phi[scored], inputs.psi_p[scored], len(run.rows_)
        return FoundStructure(
            run, tuple(records), "psi_p", "whole runs", reason, phi, psi_p, n_runs, settings
        )
    from sindy_surge import SparseLagRegressor

    settings |= {"psi_terms": psi_terms, "random_state": seed, **given}
    stacked = stack_rows(records, target)
    _check_dead_time(given.get("dead_time_s"), stacked)
    fit = SparseLagRegressor(stacked.sample_period_s, output_name=target, **settings)
    try:
        fit.fit(stacked.X, stacked.measured, segments=stacked.labels)
    except InputError as error:
        # The option of the command line in place of the estimator's parameter.
        name, bracket, rest = error.where.partition("[")
        where = OPTIONS.get(name, name) + bracket + rest
        raise InputError(
            where, expected=error.expected, found=error.found, remedy=error.remedy
        ) from None
    return FoundStructure(
        fit,
        tuple(records),
        target,
        "rows",
        reason,
        stacked.phi,
        stacked.measured,
        stacked.n_segments,
        settings,
    )


def _check_dead_time(dead_time_s: Any, stacked: FitRows) -> None:
    """Refuse a dead time that leaves no segment with rows enough."""
    longest = max(run.stop - run.start for run in stacked.runs)
    most_s = (longest - MINIMUM_SEGMENT_ROWS) * stacked.sample_period_s
    if isinstance(dead_time_s, float) and abs(dead_time_s) > most_s:
        raise InputError(
            "--dead-time",
            expected=f"at most {most_s:.3g} s, which leaves {MINIMUM_SEGMENT_ROWS} rows of the "
            "longest segment",
            found=f"{dead_time_s:g} s",
        )


def _whole_or_rows(
    records: Sequence[CoefficientSeries], target: str, rows: bool, needs: Sequence[str]
) -> tuple[bool, str]:
    """Decide what is fitted, with the sentence that says so."""
    carry = [has_whole_run(record) for record in records]
    if not all(carry):
        why = ", since not every record carries a whole run" if any(carry) else ""
        return False, f"the rows of the segments{why}"
    flags = ["--rows"] * rows + ["--target psi"] * (target == "psi") + list(needs)
    if flags:
        return False, f"the rows of the segments, because of {' and '.join(flags)}"
    return True, "one free run through each unfiltered record, as compare does (not with --rows)"
