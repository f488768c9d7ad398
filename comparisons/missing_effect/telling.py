"""Which run and which stretch of it say most, and where the model and the measurement part."""

from __future__ import annotations

import math

import numpy as np

from comparisons.missing_effect.lag_curves import lag_where
from comparisons.missing_effect.lag_result import LagDiagnosis
from comparisons.missing_effect.results import Diagnosis
from comparisons.missing_effect.runs import CheckRun
from comparisons.missing_effect.systems.results import SystemDiagnosis
from comparisons.missing_effect.systems.where import where_of
from comparisons.missing_effect.where_rows import Where
from surge_core.errors import InputError
from surge_core.types import FloatArray

# Periods and rows of a stretch that is drawn, and how many are compared.
PERIODS, FEWEST_ROWS, MOST_ROWS = 6.0, 100, 1800
STARTS = 64
MOST_SWINGS = 1e6


def wheres_of(d: Diagnosis) -> tuple[Where, ...]:
    """Return where the residuals of each output stand out, the one that is missed most first.

    Parameters
    ----------
    d : Diagnosis
        The diagnosis.

    Returns
    -------
    tuple of Where
        Of a lag, of all rows; of a user's model, of its most telling run. Empty where the rows are
        too few or the run could not be simulated.
    """
    if isinstance(d, LagDiagnosis):
        try:
            return (lag_where(d),)
        except InputError:
            return ()
    run = telling_run(d)
    if not np.all(np.isfinite(run.before)):
        return ()
    model = d.model if isinstance(d, SystemDiagnosis) else None
    share = run.before_rms / run.swing
    order = np.argsort(-np.where(np.isfinite(share), share, np.inf), kind="stable")
    names = list(run.outputs)
    return tuple(where_of(run, d.missing, output=names[j], model=model) for j in order)


def telling_run(d: Diagnosis) -> CheckRun:
    """Return the run that the model before misses most, of those that say most.

    Parameters
    ----------
    d : Diagnosis
        The diagnosis.
    """
    return max(d.proof, key=_missed)


def _missed(run: CheckRun) -> float:
    share = float(np.sum((run.before_rms / run.swing) ** 2))
    return share if math.isfinite(share) else -1.0


def telling_stretch(run: CheckRun) -> slice:
    """Return a stretch of some periods over which what was added changes most.

    Where nothing was added, the one on which the residual is largest.

    Parameters
    ----------
    run : CheckRun
        A run.
    """
    measured = run.measured[run.settle :]
    n = measured.shape[0]
    level = measured - np.nanmean(measured, axis=0)
    period = max(_period_rows(column) for column in np.nan_to_num(level).T)
    length = int(min(max(PERIODS * period, FEWEST_ROWS), MOST_ROWS, n))
    before, after = (_squares(run, before=which) for which in (True, False))
    won = before - after if np.any(before != after) else before
    total = np.concatenate([[0.0], np.cumsum(won)])
    starts = np.unique(np.linspace(0, n - length, STARTS).astype(int))
    best = int(starts[np.argmax(total[starts + length] - total[starts])])
    return slice(run.settle + best, run.settle + best + length)


def _squares(run: CheckRun, *, before: bool) -> FloatArray:
    errors = run.errors(before=before) / run.swing
    # A run that went away is as telling as it can be; its squares need not overflow.
    errors = np.clip(np.nan_to_num(errors, nan=0.0), -MOST_SWINGS, MOST_SWINGS)
    return np.asarray(np.sum(errors**2, axis=1))


def _period_rows(values: FloatArray) -> float:
    """Return the rows of a period at the mean frequency of a signal."""
    power = np.abs(np.fft.rfft(values - np.mean(values))) ** 2
    if not power.sum() > 0.0:
        return 1.0
    mean_bin = float(np.arange(power.size) @ power / power.sum())
    return values.size / max(mean_bin, 1.0)
