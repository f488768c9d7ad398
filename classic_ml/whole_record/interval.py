"""What is not known of τ: cycles, what the fit takes for granted, and the measurement itself.

A jackknife over cycles cannot see what all cycles share: the specification of the fit, and the
errors of calibration and of noise near zero flow. The first is varied; the second is drawn again
by measuring a twin of the record.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from classic_ml.whole_record.branches import BranchFit, Specification, fit_branches
from classic_ml.whole_record.passes import Passes
from surge_core.types import BoolArray, FloatArray

__all__ = ["Scatter", "jackknife", "scatter_of", "specifications", "variants"]

MOST_BLOCKS = 20


@dataclass(frozen=True)
class Scatter:
    """How far an estimate moves under one kind of change.

    Parameters
    ----------
    log_tau : float
        Standard deviation of log τ.
    bias : float
        Mean of log τ less that of the estimate.
    curve : ndarray of shape (q, q)
        Covariance of the in-stall coefficients.
    n : int
        Estimates behind it.
    """

    log_tau: float
    bias: float
    curve: FloatArray
    n: int


def jackknife(passes: Passes, spec: Specification, in_stall: BoolArray, fit: BranchFit) -> Scatter:
    """Leave out blocks of whole surge cycles in turn.

    Parameters
    ----------
    passes, spec, in_stall
        What was fitted.
    fit : BranchFit
        The estimate.

    Returns
    -------
    Scatter
        With ``n`` the number of blocks; NaN where there is a single one.
    """
    cycle = passes.cycle
    n = min(MOST_BLOCKS, int(cycle[-1]) + 1)
    block = (cycle * n) // (int(cycle[-1]) + 1)
    fits = [
        fit_branches(passes, spec, in_stall, scored=fit.scored & (block != b), near_s=fit.tau_s)
        for b in range(n)
        if n > 1
    ]
    return _scatter(fits, fit, spec.degree, math.sqrt(max(n - 1, 0)))


def specifications(spec: Specification) -> tuple[Specification, ...]:
    """Return what could as well have been taken for granted, one thing changed in each."""
    return (
        replace(spec, average_s=0.6 * spec.average_s),
        replace(spec, average_s=1.4 * spec.average_s),
        replace(spec, lowest_phi=3.0 * spec.lowest_phi),
        replace(spec, guard_s=2.0 * spec.guard_s),
        replace(spec, degree=spec.degree + 1),
        replace(spec, hinges=not spec.hinges),
        replace(spec, blend_s=0.5 * spec.blend_s),
        replace(spec, blend_s=1.5 * spec.blend_s),
        replace(spec, moves=not spec.moves),
    )


def variants(passes: Passes, spec: Specification, in_stall: BoolArray, fit: BranchFit) -> Scatter:
    """Fit under other specifications, and with the state as hub and tip alone show it."""
    others = [*specifications(spec), spec]
    states = [in_stall] * (len(others) - 1) + [passes.in_stall]
    fits = [
        fit_branches(passes, other, state, near_s=fit.tau_s)
        for other, state in zip(others, states, strict=True)
    ]
    alike = [one for one, other in zip(fits, others, strict=True) if other.degree == spec.degree]
    tau = _scatter([fit, *fits], fit, 0, 1.0)
    return replace(tau, curve=_scatter([fit, *alike], fit, spec.degree, 1.0).curve)


def _scatter(fits: Sequence[BranchFit], fit: BranchFit, degree: int, widened: float) -> Scatter:
    """Return the spread of fits about their mean, times a factor."""
    if len(fits) < 2:
        return Scatter(math.nan, 0.0, np.full((degree + 1, degree + 1), math.nan), len(fits))
    logs = np.log([each.tau_s for each in fits])
    curves = np.array([each.coefficients[: degree + 1] for each in fits])
    apart = curves - curves.mean(axis=0)
    return Scatter(
        widened * float(np.std(logs)),
        float(np.mean(logs)) - math.log(fit.tau_s),
        widened**2 * (apart.T @ apart) / len(fits),
        len(fits),
    )


def scatter_of(fits: Sequence[BranchFit], fit: BranchFit, degree: int) -> Scatter:
    """Return the standard deviation over records that were measured again."""
    return _scatter(fits, fit, degree, math.sqrt(len(fits) / max(len(fits) - 1, 1)))
