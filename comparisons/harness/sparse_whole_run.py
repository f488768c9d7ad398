"""The sparse regression by one free run through whole records, from unfiltered signals.

Its rows are those in stall and forward flow, the stall cells cancelled and then averaged over one
period of them; `classic_ml` scores both branches on a shorter average, and its second reading keeps
the cells. Terms, τ and errors are found by `sindy_surge.sparse_run`, the errors from cycles left
out; whether the curve is a parabola is judged on both branches, whose state the record shows best.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from classic_ml.record_reading import RecordReading
from classic_ml.series import CoefficientSeries
from classic_ml.whole_record.branches import design, scored_rows
from classic_ml.whole_record.passes import passes_of
from classic_ml.whole_record.rakes import rake_signals_of
from classic_ml.whole_record_fit import LARGEST_SHARE, from_plane_to_plane, law_of_probes
from classic_ml.whole_record_run import window_of
from classic_ml.whole_run import (
    Spread,
    WholeRunFit,
    check_rates,
    output_error,
    specification_spread,
)
from classic_ml.whole_run_rows import (
    WholeRunRows,
    is_blowdown,
    scored_until,
    stacked_rows,
    whole_run_rows,
)
from comparisons.results import evaluate_terms
from sindy_surge.candidate_terms import CandidateTerms, polynomial_degree
from sindy_surge.free_run import FreeRunEquations
from sindy_surge.segments import Segments
from sindy_surge.selection import PathRow
from sindy_surge.sparse_run import Departure, SparseRun, select_on_free_run
from sindy_surge.text import EquationParts, ModelSummary, write_equation
from surge_core.errors import InputError
from surge_core.fit_state import FitState
from surge_core.lag import Hold
from surge_core.types import FloatArray


@dataclass(frozen=True)
class SparseWholeRunFit(WholeRunFit):
    """Terms chosen on whole runs, with the attributes of an estimator.

    ``rows_`` hold the terms that were chosen, and ``model_`` is output error with these, for the
    checks; ``degree`` is that of the highest power among them.

    Parameters
    ----------
    candidate_terms_ : tuple of str
        Every name of the library.
    path_ : tuple of PathRow
        Every structure tried, with its error on cycles left out.
    departure_ : Departure or None
        What speaks against the parabola.
    shared_share : float
        See `measurement_spread`.
    """

    candidate_terms_: tuple[str, ...]
    path_: tuple[PathRow, ...]
    departure_: Departure | None = None
    shared_share: float = 0.0

    @property
    def measurement_share_(self) -> float:
        """Standard deviation of log τ that `classic_ml` shares."""
        return self.shared_share

    @property
    def cautions_(self) -> tuple[str, ...]:
        """Whether the curve is a parabola."""
        known = self.departure_ is not None and math.isfinite(self.time_constant_s_)
        return (self.departure_.text,) if known and self.departure_ else ()

    def characteristic(self, phi: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return ψ'_QS and its standard error at φ, of shape (n,)."""
        values = evaluate_terms(self.terms_, np.ravel(np.asarray(phi, dtype=np.float64)))
        variance: FloatArray = np.einsum("ij,jk,ik->i", values, self.covariance_, values)
        return values @ self.coef_, np.sqrt(np.maximum(variance, 0.0))

    def summary(self) -> ModelSummary:
        """Return what is known of the fit; of a refused one no terms."""
        terms = () if math.isnan(self.time_constant_s_) else tuple(self.terms_)
        parts = EquationParts(
            terms,
            tuple(self.coef_[: len(terms)].tolist()),
            tuple(np.sqrt(np.diag(self.covariance_))[: len(terms)].tolist()),
            self.time_constant_s_,
            self.time_constant_stderr_s_,
        )
        return ModelSummary(
            parts,
            self.fit_state_,
            n_candidates=len(self.candidate_terms_),
        )

    def equation(self) -> str:
        """Write the equation, rounded to its uncertainty."""
        return write_equation(self.summary().parts)


def fit_sparse_whole_runs(
    records: Sequence[CoefficientSeries],
    *,
    hold: Hold = "first",
    until_s: Sequence[float] | None = None,
    max_terms: int = 6,
) -> SparseWholeRunFit:
    """Choose the terms of one lag model on whole runs through one or several records.

    Parameters
    ----------
    records : sequence of CoefficientSeries
        At one sample rate, with their unfiltered columns.
    hold : {"zero", "first"}
        How φ acts between samples.
    until_s : sequence of float, optional
        Score each record up to this time only; the rest is held out.
    max_terms : int
        Largest structure considered.

    Returns
    -------
    SparseWholeRunFit
        Refused by its state, with τ NaN, where hardly a row is in forward flow in stall, where
        probes at one immersion do not show which rows those are, and where its standard deviation
        exceeds 12 % of τ, as of `classic_ml`: 25.6 ms and 36.1 ms were stated for 11.9 and 11.7.

    Raises
    ------
    InputError
        When a series lacks the unfiltered columns.
    """
    check_rates(records)
    period_s = records[0].sample_period_s
    ends = [math.inf] * len(records) if until_s is None else until_s
    measured = [_without_cells(record, end) for record, end in zip(records, ends, strict=True)]
    plain = scored_until([whole_run_rows(record) for record in measured], until_s)
    scored_phi = stacked_rows(plain).scored_phi
    if not scored_phi.size:
        nothing = np.zeros(0), np.zeros((0, 0)), 0, 0, FitState.BLOWDOWN
        model = output_error(period_s, hold)
        return SparseWholeRunFit(math.nan, math.nan, [], *nothing, model, plain, (), ())
    # Knots and scales where the curve is asked for, not where φ is only simulated through.
    library = CandidateTerms(None, scored_phi[:, None], ["phi"])

    def rows_of(chosen: Sequence[CoefficientSeries]) -> tuple[WholeRunRows, ...]:
        return scored_until(
            [whole_run_rows(r, terms=lambda phi: library(phi[:, None])) for r in chosen], until_s
        )

    def equations_of(rows: Sequence[WholeRunRows]) -> FreeRunEquations:
        stacked = stacked_rows(rows)
        segments = Segments.from_labels(stacked.run, stacked.psi_p.size)
        given = stacked.terms, stacked.moving, stacked.psi_p, stacked.weight
        return FreeRunEquations(*given, segments, period_s, hold)

    rows = rows_of(measured)
    equations = equations_of(rows)
    readings = _readings(records, ends)
    spread = shared = Spread(0.0, np.zeros((1, 1)))
    if until_s is None and not is_blowdown(plain):
        spread = specification_spread(measured, hold=hold)
        shared = measurement_spread(readings)
    level = math.hypot(spread.level(scored_phi), shared.level(scored_phi))
    found = select_on_free_run(
        equations,
        library.names,
        [polynomial_degree(name, ["phi"]) for name in library.names],
        np.concatenate([row.cycle for row in rows]),
        [] if is_blowdown(plain) else _shape_equations(readings, library, hold),
        max_terms=max_terms,
        common_tau_share=math.hypot(spread.log_tau, min(shared.log_tau, LARGEST_SHARE)),
        common_curve_share=level / float(np.mean(np.abs(equations.output[equations.scored]))),
    )
    known = math.isfinite(shared.log_tau)
    withheld = _withheld(records, plain, found, known=known, whole=until_s is None)
    result = _result(found, period_s, hold, rows, library.names, withheld)
    return replace(result, shared_share=shared.log_tau)


def _withheld(
    records: Sequence[CoefficientSeries],
    plain: Sequence[WholeRunRows],
    found: SparseRun,
    *,
    known: bool,
    whole: bool,
) -> FitState | None:
    """Return why τ is not stated; None where it is."""
    if is_blowdown(plain):
        return FitState.BLOWDOWN
    if not whole:
        return None
    signals = [rake_signals_of(record) for record in records]
    if any(each is not None and each.hub_minus_tip() is None for each in signals):
        return FitState.ONE_IMMERSION
    if not known or not found.time_constant_stderr_s <= LARGEST_SHARE * found.time_constant_s:
        return FitState.UNCERTAIN
    return None


def _readings(
    records: Sequence[CoefficientSeries], ends: Sequence[float]
) -> list[RecordReading | None] | None:
    """Return the records as read on both branches, None for those without hub and tip.

    None for all where one cannot be read.
    """
    found: list[RecordReading | None] = []
    for record, end in zip(records, ends, strict=True):
        signals = rake_signals_of(record)
        if signals is None or signals.hub_minus_tip() is None:
            found.append(None)
            continue
        try:
            found.append(RecordReading.of(signals, window_of(record, end), by_flow=False))
        except InputError:
            return None
    return found


def measurement_spread(readings: Sequence[RecordReading | None] | None) -> Spread:
    """Return what no fit sees in its rows: the time from plane to plane, and Eq 2 near zero flow.

    Both are of the measurement; how far they move τ is taken from the fit to both branches. A
    record that this fit cannot read has no bound on them: an infinite one. Those without the
    signals of their probe pairs, or with one immersion, have no part in it.
    """
    worst = Spread(0.0, np.zeros((1, 1)))
    if readings is None:
        return Spread(math.inf, np.zeros((1, 1)))
    for reading in filter(None, readings):
        try:
            fit = reading.fit()
            planes = from_plane_to_plane(reading, fit)[1]
            log_tau = math.hypot(planes.log_tau, law_of_probes(reading, fit))
        except InputError:
            return Spread(math.inf, np.zeros((1, 1)))
        worst = max(worst, Spread(log_tau, planes.curve), key=lambda each: each.log_tau)
    return worst


def _without_cells(record: CoefficientSeries, until_s: float) -> CoefficientSeries:
    """Return a record with its stall cells cancelled, as it is where it lacks its probe pairs."""
    signals = rake_signals_of(record)
    if signals is None or record.psi_p_unfiltered is None:
        return record
    window = slice(0, int(np.searchsorted(record.time_s, until_s, side="right")))
    try:
        phi, psi_p, _ = signals.coefficients(passes_of(signals, window).planes)
    except InputError:
        return record
    known = np.where(np.isfinite(psi_p), psi_p, record.psi_p_unfiltered)
    return replace(record, phi_unfiltered=phi, psi_p_unfiltered=known)


def _shape_equations(
    readings: Sequence[RecordReading | None] | None, library: CandidateTerms, hold: Hold
) -> list[FreeRunEquations]:
    """Return the candidate terms on the rows of both branches; none where these show no shape.

    That takes two rakes in each record, with hub and tip. Scored in stall alone, a third of the
    kinks are found that both branches show: their rows hold the state and its timing.
    """
    found: list[FreeRunEquations] = []
    for reading in readings or ():
        if reading is None or reading.signals.one_rake:
            return []
        # The hinges above the flow of recovery would take up a kink.
        passes, spec = reading.passes, replace(reading.spec, hinges=False)
        inputs, psi_p = design(passes, spec, reading.in_stall)
        state = passes.smooth(reading.in_stall.astype(np.float64), spec.blend_s)
        terms = library(passes.phi[:, None])
        each = FreeRunEquations(
            np.column_stack([passes.smooth(state * term, spec.average_s) for term in terms.T]),
            inputs[:, spec.degree + 1 :],
            psi_p,
            scored_rows(passes, spec).astype(np.float64),
            Segments.from_labels(passes.piece, passes.piece.size),
            passes.sample_period_s,
            hold,
        )
        found.append(each)
    return found


def _result(
    found: SparseRun,
    sample_period_s: float,
    hold: Hold,
    rows: tuple[WholeRunRows, ...],
    names: tuple[str, ...],
    withheld: FitState | None,
) -> SparseWholeRunFit:
    chosen = tuple(replace(row, terms=row.terms[:, list(found.support)]) for row in rows)
    model = output_error(sample_period_s, hold)
    if found.terms:
        stacked_rows(chosen).fitted(model)
    refused = withheld is not None
    unknown = np.full((len(found.terms), len(found.terms)), math.nan)
    powers = [polynomial_degree(name, ["phi"]) for name in found.terms]
    return SparseWholeRunFit(
        math.nan if refused else found.time_constant_s,
        math.nan if refused else found.time_constant_stderr_s,
        list(found.terms),
        found.coefficients,
        unknown if refused else found.covariance[:-1, :-1],
        max((power for power in powers if power is not None), default=0),
        found.n_blocks,
        withheld or found.state,
        model,
        chosen,
        names,
        found.path,
        found.departure,
    )
