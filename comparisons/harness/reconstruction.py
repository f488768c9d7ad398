"""Reconstruction of a record by models that were fitted to another: validation runs."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace

import numpy as np

from classic_ml.series import CoefficientSeries
from comparisons.harness.fit_quality import score_fit
from comparisons.harness.rows import averaged_rows, stack_rows
from comparisons.results import FittedLag, LagModel, Reconstruction
from surge_core.paired import compared

NORMAL_95 = 1.96


def reconstruct_record(model: LagModel, record: CoefficientSeries) -> Reconstruction:
    """Run a fitted model over another record, with nothing refitted.

    Parameters
    ----------
    model : LagModel
        Fitted elsewhere, with effects or without.
    record : CoefficientSeries
        Measured φ drives it; the measured coefficient serves for each segment's start and for
        the score. Its sample rate need not be that of the fit.

    Returns
    -------
    Reconstruction
        On unfiltered rows where the model was fitted to such and the record has them.

    Raises
    ------
    InputError
        When the record lacks the coefficient that the model gives, or a channel that it needs.
    """
    plain = model if isinstance(model, FittedLag) else None
    unfiltered = averaged_rows([record]) if plain and plain.rows == "unfiltered" else None
    rows = unfiltered or stack_rows([record], model.target)
    reconstructed = model.free_run_over(rows, [record])
    band = wide = np.full(rows.phi.size, math.nan)
    if plain is not None:
        band = plain.quantile * plain.free_run_stderr(rows)
        wide = np.hypot(band, NORMAL_95 * plain.free_run_rms)
    score = score_fit(rows.measured, reconstructed)
    return Reconstruction(model, record, rows, reconstructed, score, band, wide)


def validate_models(
    models: Iterable[LagModel],
    records: Iterable[CoefficientSeries],
    fitted: Collection[float] = (),
) -> list[Reconstruction]:
    """Run models over other records, and compare those that are scored on the same rows.

    Parameters
    ----------
    models : iterable of LagModel
        Fitted elsewhere.
    records : iterable of CoefficientSeries
        The records; a model whose coefficient one lacks is not run on it.
    fitted : collection of float
        Mean φ of the records that the models were fitted to.

    Returns
    -------
    list of Reconstruction
        Each with its difference to the least error on the same rows of the same record.
    """
    chosen, found = list(models), []
    for record in records:
        runs = [
            reconstruct_record(model, record)
            for model in chosen
            if model.target == "psi_p" or record.psi is not None
        ]
        # Models that are scored on the same rows stand together.
        runs.sort(key=lambda run: run.rows.kind, reverse=True)
        seen = float(np.mean(record.phi)) in fitted
        found += [replace(_against_least(run, runs), seen=seen) for run in runs]
    return found


def _against_least(run: Reconstruction, runs: Sequence[Reconstruction]) -> Reconstruction:
    alike = [r for r in runs if (r.model.target, r.rows.kind) == (run.model.target, run.rows.kind)]
    least = min(alike, key=lambda each: each.score.rms)
    if least is run:
        return run
    errors, other = (each.rows.measured - each.reconstructed for each in (run, least))
    difference, paired_error, p_value = compared(errors, other, run.rows.runs)
    return replace(run, difference=difference, paired_error=paired_error, p_value=p_value)
