"""Estimators side by side: what each made of the rows, and the table that sets them in order."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import PurePath

from classic_ml.checks import CheckRow
from classic_ml.series import CoefficientSeries
from classic_ml.whole_record_run import Reading
from classic_ml.whole_run import WholeRunFit
from comparisons.results.caution import Caution, texts_of
from comparisons.results.lag import FittedLag, LagModel
from comparisons.results.names import SYMBOLS, named
from comparisons.results.rows import FitRows, FitScore
from surge_core.display import Displayed, Field, Grid, Sheet
from surge_core.fit_state import WITHHOLDING
from surge_core.rounding import NOT_KNOWN, round_like, round_to_error, significant
from surge_core.types import FloatArray

ONE_SIDED_95 = 1.645
# Heading of each column of the table, and what it says.
COLUMNS = {
    "#": "the estimator whose τ is to be quoted first, then by trust",
    "estimator": "how τ and the characteristic were estimated",
    "τ [ms]": "time constant ± standard error",
    "95 % [ms]": "95 % interval of τ: on log τ where τ is well separated from zero, symmetric and "
    "cut at zero where it is less so, an upper bound where it is not separated from zero",
    "rows": "the signals that it was fitted to and is scored on: low-passed, as a "
    "series without a ledger gives them, or unfiltered and averaged over a period of the stall "
    "cells",
    "held-out rms": "root mean square of measurement minus free run on the rows held out",
    "Δ to least": "difference of that rms to the least on the same rows ± paired jackknife error",
    "p": "chance of so great a difference of the squared errors between two that are alike, by "
    "Diebold and Mariano's test",
    "trust": "what in this line should not be relied on",
}


# Differences of ψ' below this are no differences: solvers end at about 1e-9 of its range.
SAME_RMS = 1e-7


@dataclass(frozen=True)
class EstimatorResult:
    """What one estimator made of the rows.

    Parameters
    ----------
    name, label : str
        Key and what people call it.
    model : FittedLag
        The fitted model as a value, from all rows.
    state, advice : str
        Code of how the fit ended and what to do about it.
    equation : str
        The model in one line.
    rows : FitRows
        The rows that it is scored on: of the kind that it was fitted to.
    free_run, one_step : FitScore
        Scores over all of them.
    held_out : FitScore or None
        Free run on the rows held out, by a fit to the others; None where there were too few.
    reconstruction : ndarray of shape (n,)
        Free run over its rows from each segment's measured start.
    trained : ndarray of shape (n,)
        The same by the fit to the training rows alone: what the held-out rows are scored with.
    checks : tuple of CheckRow
        Residual checks.
    seconds : float
        Time of the fit.
    whole_run : WholeRunFit or None
        The free run through whole records behind it; None where it was fitted to the rows.
    remarks : tuple of str
        What the estimator itself warns of.
    extended : LagModel or None
        The model with its effects, where it has any; ``model`` is then its characteristic and τ.
    held_out_stderr : float
        Standard error of the held-out rms over the blocks.
    difference, paired_error, p_value : float
        Of that rms to the least one on rows of the same kind, on the same blocks, with the
        p-value of Diebold and Mariano's test; 0 and NaN for the least one.
    trust : str
        What in this line of the table should not be relied on.
    """

    name: str
    label: str
    model: FittedLag
    state: str
    advice: str
    equation: str
    rows: FitRows
    free_run: FitScore
    one_step: FitScore
    held_out: FitScore | None
    reconstruction: FloatArray
    trained: FloatArray
    checks: tuple[CheckRow, ...]
    seconds: float
    whole_run: WholeRunFit | None = None
    remarks: tuple[str, ...] = ()
    extended: LagModel | None = None
    held_out_stderr: float = math.nan
    difference: float = math.nan
    paired_error: float = math.nan
    p_value: float = math.nan
    trust: str = ""

    @property
    def converged(self) -> bool:
        """Whether the fit ended with an answer."""
        return self.state in ("converged", "two_readings")

    @property
    def states_curve(self) -> bool:
        """Whether its characteristic may be read; else it is written as null.

        That of a whole run is none where a constant foretells cycles left out better.
        """
        foretells = self.whole_run is None or self.held_out is None or not self.held_out.r2 < 0.0
        return foretells and self.state != "rank_deficient" and self.state not in WITHHOLDING

    @property
    def has_tau(self) -> bool:
        """Whether a τ is its business: a fit that ended well without one has none to state."""
        return not self.converged or math.isfinite(self.model.time_constant_s)

    @property
    def has_curve(self) -> bool:
        """Whether a characteristic is."""
        return not self.converged or any(math.isfinite(value) for _, value, _ in self.model.table)

    @property
    def second_reading(self) -> Reading | None:
        """Another reading of τ from the same records, where the two part."""
        return getattr(self.whole_run, "second_reading_", None)

    @property
    def tau_ms(self) -> str:
        """τ in ms, rounded to its standard error."""
        model = self.model
        return round_to_error(1e3 * model.time_constant_s, 1e3 * model.time_constant_stderr_s)

    @property
    def failed(self) -> tuple[str, ...]:
        """Names of the checks that failed."""
        return tuple(check.check for check in self.checks if not check.passed)


@dataclass(frozen=True)
class Comparison(Displayed):
    """Estimators side by side on the same rows of one or several records.

    Parameters
    ----------
    records : tuple of CoefficientSeries
        What was compared.
    rows : FitRows
        The rows that were fitted.
    results : tuple of EstimatorResult
        One for each estimator: the recommended one first, then by trust.
    cautions : tuple of Caution
        What a reader should know of all lines.
    quotable : tuple of str
        Keys of the estimators whose τ may be quoted as that of the compressor, the recommended
        first.
    """

    records: tuple[CoefficientSeries, ...]
    rows: FitRows
    results: tuple[EstimatorResult, ...]
    cautions: tuple[Caution, ...] = ()
    quotable: tuple[str, ...] = ()

    @property
    def recommended(self) -> str | None:
        """Key of the estimator whose τ is to be quoted; None where none may be."""
        return next(iter(self.quotable), None)

    @property
    def first(self) -> EstimatorResult:
        """The recommended estimator; the first of the table where none is."""
        return self.results[0]

    def result(self, name: str) -> EstimatorResult:
        """Return the result of one estimator."""
        return next(result for result in self.results if result.name == name)

    @property
    def models(self) -> tuple[tuple[str, FittedLag], ...]:
        """Names and models that another record may be run through.

        A refused fit is no model, and a model with effects has a file of its own.
        """
        own = "" if self.rows.target == "psi_p" else f":{self.rows.target}"
        return tuple(
            (f"{result.name}{own}", result.model)
            for result in self.results
            if result.state not in WITHHOLDING and result.extended is None
        )

    def grid(self) -> Grid:
        """Return the table as terminal, page and notebook show it, a column for each heading."""
        return Grid(
            f"Estimators of {SYMBOLS[self.rows.target]}",
            tuple(COLUMNS),
            tuple(_cells(rank, result) for rank, result in enumerate(self.results, start=1)),
            frozenset({1, len(COLUMNS) - 1}),
            () if self.recommended is None else ("best",),
            COLUMNS,
        )

    def _sheet(self) -> Sheet:
        rows = self.first.rows
        low, high = self.first.model.valid_phi
        cautions, quoted = texts_of(self.cautions), "none of these"
        if self.recommended is not None:
            quoted = f"{self.first.tau_ms} ms by {self.recommended}"
        fields = (
            Field("records", tuple(PurePath(record.source).name for record in self.records)),
            Field(
                "rows",
                f"{rows.phi.size} in {rows.n_segments} segments, {1 / rows.sample_period_s:g} Hz",
            ),
            Field("φ dwells", f"{low:.3f} to {high:.3f} (5th to 95th percentile)"),
            Field("τ to quote", quoted),
            *((Field("cautions", cautions, "advice"),) if cautions else ()),
        )
        return Sheet(f"Comparison of {len(self.results)} estimators", fields, (self.grid(),))


def _cells(rank: int, result: EstimatorResult) -> tuple[str, ...]:
    held_out = difference = p = NOT_KNOWN
    if result.held_out is not None and math.isfinite(result.held_out.rms):
        held_out = round_to_error(result.held_out.rms, result.held_out_stderr)
        difference, p = difference_cells(result.difference, result.paired_error, result.p_value)
    about = (
        str(rank),
        named(result.label, result.name),
        result.tau_ms,
        _interval(result.model),
        result.rows.called,
    )
    return (*about, held_out, difference, p, result.trust)


def difference_cells(difference: float, paired_error: float, p_value: float) -> tuple[str, str]:
    """Return a difference to the least error and its p-value as a table shows them."""
    if difference == 0.0:
        return "least", ""
    # Two fits of the same rows by the same equation: what is left is how they were solved.
    if abs(difference) < SAME_RMS and not paired_error > SAME_RMS:
        return "alike", ""
    p = NOT_KNOWN if math.isnan(p_value) else f"{p_value:.3f}" if p_value >= 0.001 else "< 0.001"
    return round_to_error(difference, paired_error), p


def _interval(model: FittedLag) -> str:
    low, high = (1e3 * end for end in model.ci95_s)
    tau, error = 1e3 * model.time_constant_s, 1e3 * model.time_constant_stderr_s
    if error == 0.0:
        return "held"
    if not (math.isfinite(low) and math.isfinite(high)):
        return NOT_KNOWN
    if not error < tau:
        # The lower end of so wide an interval says nothing: the bound from above does.
        return f"< {significant(tau + ONE_SIDED_95 * error, 2)}"
    return f"{round_like(low, error)} … {round_like(high, error)}"
