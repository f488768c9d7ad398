"""τ by trial: the error of the reconstruction for each τ that is held fixed, as in the paper."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from comparisons.harness.fit_quality import rms
from comparisons.results import Comparison, FitRows, TauTrial
from sindy_surge.free_run import FreeRunEquations
from sindy_surge.segments import Segments
from surge_core.lag import Hold
from surge_core.paired import block_errors, paired_difference
from surge_core.types import BoolArray, FloatArray

N_TAUS = 61
# Half a decade and more to either side shows both arms of the curve.
REACH = 4.0
RUN_AWAY_S = 1.0


def trial_taus(*around_s: float) -> FloatArray:
    """Return values of τ spaced evenly on a log scale around some estimates.

    Those that are not finite or longer than a second do not count.
    """
    # A τ of many seconds is a fit that ran away; it must not stretch the axis.
    known = [tau for tau in around_s if 0.0 < tau <= RUN_AWAY_S]
    if not known:
        return np.geomspace(1e-3 * RUN_AWAY_S, RUN_AWAY_S, N_TAUS)
    return np.geomspace(min(known) / REACH, max(known) * REACH, N_TAUS)


def reconstruction_error_over_tau(
    rows: FitRows,
    terms: FloatArray,
    taus_s: FloatArray,
    *,
    hold: Hold = "first",
    scored: BoolArray | None = None,
) -> TauTrial:
    """Reconstruct with each τ in turn and score the free run.

    Parameters
    ----------
    rows : FitRows
        The rows, e.g. ``comparison.rows``.
    terms : ndarray of shape (n_rows, q)
        Inputs s_i(φ) of the lag, whose curve is refitted to each τ.
    taus_s : ndarray of shape (n,)
        Values of τ, in seconds and increasing.
    hold : {"zero", "first"}
        How φ acts between samples.
    scored : ndarray of bool, shape (n_rows,), optional
        Rows that count; the others are simulated through. All without it.

    Returns
    -------
    TauTrial

    Notes
    -----
    For a held τ the free run is linear in the curve's coefficients and in the start of each
    segment, and least squares gives both at once (the paper set τ by trial, after its fit had
    given 243 ms where 18 ms reconstructs).
    """
    keep = np.ones(rows.phi.size, dtype=np.bool_) if scored is None else scored
    runs = Segments.from_labels(rows.labels, rows.phi.size)
    weight, nuisance = keep.astype(np.float64), terms[:, :0]
    free_run = FreeRunEquations(
        terms, nuisance, rows.measured, weight, runs, rows.sample_period_s, hold
    )
    errors = [free_run.left(float(tau_s)) for tau_s in taus_s]
    refitted = np.array([rms(error) for error in errors])
    best = int(np.argmin(refitted))
    best_tau = _vertex(taus_s, refitted, best)
    interval = _interval(taus_s, best_tau, errors, best, rows, keep)
    return TauTrial(taus_s, refitted, best_tau, interval, float(refitted[best]), rows.target)


def trial_of(comparison: Comparison) -> TauTrial:
    """Try τ over the rows of a comparison, or over its whole runs where it has such a fit.

    Over whole runs, on averaged unfiltered signals, with the estimate from them alone: the other
    estimators saw other rows.
    """
    hold, rows = comparison.first.model.hold, comparison.rows
    fitted = [r for r in comparison.results if math.isfinite(r.model.time_constant_s)]
    # The same one whatever is trusted most.
    for result in sorted(fitted, key=lambda r: r.name != "classic_ml"):
        if result.whole_run is None:
            continue
        whole = result.whole_run.stacked()
        every = np.ones(whole.phi.size, dtype=np.bool_)
        signals = whole.phi, whole.psi_p, whole.time_s, whole.run, whole.run
        averaged = FitRows(*signals, rows.sample_period_s, "psi_p", every)
        taus = trial_taus(result.model.time_constant_s)
        trial = reconstruction_error_over_tau(
            averaged, whole.inputs, taus, hold=hold, scored=whole.scored
        )
        own_rms = float(result.whole_run.model_.residual_std_)
        return replace(trial, estimates=((result, own_rms),))
    # As many powers as the classical characteristic has.
    model = next((r for r in fitted if r.name == "classic_ml"), comparison.first).model
    powers = [term for term in model.terms if term.startswith("phi")]
    terms = np.vander(rows.phi, max(len(powers), 1) + 1, increasing=True)
    taus = trial_taus(*(result.model.time_constant_s for result in fitted))
    trial = reconstruction_error_over_tau(rows, terms, taus, hold=hold)
    return replace(trial, estimates=tuple((result, result.free_run.rms) for result in fitted))


def _vertex(taus: FloatArray, error: FloatArray, best: int) -> float:
    """Return the τ of least error, by the parabola of the squares over log τ."""
    if best in (0, taus.size - 1):
        return float(taus[best])
    x, y = np.log(taus[best - 1 : best + 2]), error[best - 1 : best + 2] ** 2
    square, slope, _ = np.polyfit(x - x[1], y, 2)
    move = -0.5 * slope / square if square > 0.0 else 0.0
    return float(np.exp(x[1] + np.clip(move, x[0] - x[1], x[2] - x[1])))


def _interval(
    taus: FloatArray,
    best_tau: float,
    errors: list[FloatArray],
    best: int,
    rows: FitRows,
    keep: BoolArray,
) -> tuple[float, float]:
    """Return the values whose error is within two paired standard errors of the least."""
    whole = np.zeros(rows.phi.size)
    blocks = []
    for error in errors:
        whole[keep] = error
        blocks.append(block_errors(whole, rows.runs, keep))
    paired = [paired_difference(own, blocks[best]) for own in blocks]
    far = np.flatnonzero([not worse <= 2.0 * error for worse, error in paired])
    low = int(far[far < best].max(initial=-1)) + 1
    high = int(far[far > best].min(initial=taus.size)) - 1
    return min(float(taus[low]), best_tau), max(float(taus[high]), best_tau)
