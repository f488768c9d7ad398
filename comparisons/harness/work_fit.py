"""The work characteristic of a raw record, its breakpoints searched where they are not given."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np

from classic_ml.characteristics import PiecewiseLinear
from classic_ml.io import TestDescription
from classic_ml.records import Record, counted
from classic_ml.reduction import reduce_record
from classic_ml.reduction_settings import ReductionSettings
from classic_ml.whole_record_fit import LARGEST_SHARE
from classic_ml.work.coefficient import WorkCharacteristic, fit_work_characteristic
from comparisons.harness.cautions import unknown_work
from surge_core.errors import InputError
from surge_core.fit_state import FitState

# Slopes over less than this share of the range are not separated from the errors of φ.
LEAST_PIECE = 0.25
GRID_POINTS = 7
FEWEST_ROWS = 60
# φ at which the curves of different breakpoints are compared.
CURVE_POINTS = 50


def fit_work(
    record: Record,
    test: TestDescription,
    *,
    breakpoints: tuple[float, float] | None = None,
    time_constant_s: float | None = None,
    progress: Callable[[Iterable[Any]], Iterable[Any]] = iter,
) -> WorkCharacteristic:
    """Reduce a raw record without any low-pass and fit its work characteristic.

    Parameters
    ----------
    record, test : Record, TestDescription
        Counts and kelvin, and the test they belong to, as :func:`classic_ml.io.read_raw` returns
        them.
    breakpoints : tuple of float, optional
        Where the straight pieces of Fig 22 meet; without them the pair with the least error is
        taken from a grid over the flow that the record visits.
    time_constant_s : float, optional
        Hold τ at this value.
    progress : callable
        Wraps the iteration over the pairs, to show how far it is.

    Raises
    ------
    InputError
        When there is no T31 that counts, so no W31 and no ψ.
    """
    settings = ReductionSettings(phase="none", thermocouple_inversion=True)
    reduction = reduce_record(record, test, settings)
    if "W31_kg_s" not in reduction.record:
        raise InputError(
            f"{record.source}: ψ",
            expected="T31 inside the range of its acquisition in the surge cycles",
            found=str(unknown_work(reduction.record.history) or "none"),
        )
    # All rows of the settled machine: cycles that do not repeat each other serve as well.
    window = reduction.record["free_run"] > 0.5

    def fitted(pair: tuple[float, float]) -> WorkCharacteristic:
        return fit_work_characteristic(
            reduction.record, test, window, breakpoints=pair, time_constant_s=time_constant_s
        )

    if breakpoints is not None:
        return fitted(breakpoints)
    phi = reduction.series.phi[reduction.record["free_run"] == 2.0]
    if phi.size < FEWEST_ROWS:
        raise InputError(
            f"{record.source}: ψ",
            expected=f"at least {FEWEST_ROWS} rows of forward flow in stall",
            found=f"{phi.size}",
            remedy="within a period of the stall cells of stall entry and recovery none counts",
        )
    low, high = np.percentile(phi, [5.0, 95.0])
    apart = LEAST_PIECE * (high - low)
    # A little off the grid's own spacing, so that rounding decides nothing.
    grid = np.linspace(low, high, GRID_POINTS + 2)[1:-1]
    pairs = [(float(a), float(b)) for a, b in combinations(grid, 2) if b - a >= 0.99 * apart]
    fits = [fitted(pair) for pair in progress(pairs)]
    best = min(fits, key=lambda fit: (math.isnan(fit.residual_std), fit.residual_std))
    if math.isnan(best.time_constant_s):
        return best
    return _with_spread(best, [fit for fit in fits if math.isfinite(fit.time_constant_s)])


def _with_spread(best: WorkCharacteristic, fits: list[WorkCharacteristic]) -> WorkCharacteristic:
    """Return a fit whose errors hold what the choice of its breakpoints adds.

    Each pair weighs by its likelihood, its cycles taken for as many independent residuals.
    """
    std = np.array([fit.residual_std for fit in fits])
    weights = np.exp(-best.n_cycles * np.log(std / best.residual_std))
    weights /= weights.sum()
    phi = np.linspace(*best.valid_phi, CURVE_POINTS)
    lines = np.asarray(PiecewiseLinear(best.breakpoints).fit_transform(phi[:, None]))
    curves = np.column_stack([fit.characteristic(phi)[0] for fit in fits])
    apart = np.linalg.lstsq(lines, curves, rcond=None)[0] - best.coef[:, None]
    tau_s = np.array([fit.time_constant_s for fit in fits])
    variance = best.time_constant_stderr_s**2 + weights @ (tau_s - best.time_constant_s) ** 2
    return replace(
        best,
        time_constant_stderr_s=float(np.sqrt(variance)),
        covariance=best.covariance + (weights * apart) @ apart.T,
    )


def why_withheld(fit: WorkCharacteristic) -> str:
    """Say why a fit states neither τ nor curve; empty where it states both."""
    if math.isfinite(fit.time_constant_s):
        return ""
    if fit.fit_state is FitState.UNCERTAIN:
        return (
            f"τ or the curve is known to no better than {100 * LARGEST_SHARE:.0f} %; hold τ with "
            "`sindy-surge work --tau`, or take a longer record."
        )
    cycles = counted(fit.n_cycles, "cycle")
    if fit.fit_state is FitState.TOO_FEW_CYCLES:
        return (
            "A row counts in forward flow in stall, a period of the stall cells and more from its "
            f"entry and its end: {fit.n_scored} rows of {cycles} do, too few to know the scatter."
        )
    if fit.fit_state is FitState.LAG_UNDETERMINED:
        return f"τ does not show in {cycles}: its error is as large as τ itself."
    return fit.fit_state.advice


def is_vague(fit: WorkCharacteristic) -> bool:
    """Return whether τ or the curve is known worse than a whole run's τ may be."""
    if not math.isfinite(fit.time_constant_s):
        return False
    value, error = fit.characteristic(np.linspace(*fit.valid_phi, GRID_POINTS))
    curve_share = float(np.mean(error) / np.mean(np.abs(value)))
    return max(fit.time_constant_stderr_s / fit.time_constant_s, curve_share) > LARGEST_SHARE


def withheld_if_vague(fit: WorkCharacteristic) -> WorkCharacteristic:
    """Return a fit without numbers where one is vague, as an answer states it."""
    if not is_vague(fit):
        return fit
    known = {k: v for k, v in fit.entry.parameters.items() if k != "time_constant_s"}
    return replace(
        fit,
        time_constant_s=math.nan,
        time_constant_stderr_s=math.nan,
        coef=np.full_like(fit.coef, math.nan),
        covariance=np.full_like(fit.covariance, math.nan),
        fit_state=FitState.UNCERTAIN,
        entry=replace(fit.entry, parameters=known),
    )
