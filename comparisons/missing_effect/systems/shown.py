"""What pictures and tables of a diagnosis show: units that read well, runs, stretches, fates."""

from __future__ import annotations

import math

import numpy as np

from comparisons.missing_effect.systems.results import CheckRun, SystemDiagnosis
from comparisons.missing_effect.systems.search import Candidate, Round
from surge_core.types import FloatArray

__all__ = [
    "added",
    "all_runs",
    "candidates_shown",
    "fate_of",
    "split_of",
    "telling_run",
    "telling_stretch",
]

# Candidates of a round that are drawn.
MOST_SHOWN = 8
# Periods and rows of a stretch that is drawn.
PERIODS, FEWEST_ROWS, MOST_ROWS = 8.0, 150, 2000
STARTS = 64
MOST_SWINGS = 1e6


def all_runs(d: SystemDiagnosis) -> tuple[CheckRun, ...]:
    """Return training and check runs, in this order."""
    return (*d.training, *d.checks)


def split_of(run: CheckRun) -> str:
    """Return what a run is to the diagnosis."""
    return "check" if run.held_out else "training"


def telling_run(d: SystemDiagnosis) -> CheckRun:
    """Return the check run that the model before misses most; of training runs without any.

    Parameters
    ----------
    d : SystemDiagnosis
        The diagnosis.
    """
    return max(d.checks or d.training, key=_missed)


def _missed(run: CheckRun) -> float:
    share = float(np.sum((run.before_rms / _swing(run)) ** 2))
    return share if math.isfinite(share) else -1.0


def _swing(run: CheckRun) -> FloatArray:
    swing = np.nanstd(run.measured[run.settle :], axis=0)
    return np.asarray(np.where(swing > 0.0, swing, 1.0))


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
    before = _squares(run, run.before)
    after = _squares(run, run.after)
    won = before - after if np.any(run.before != run.after) else before
    total = np.concatenate([[0.0], np.cumsum(won)])
    starts = np.unique(np.linspace(0, n - length, STARTS).astype(int))
    best = int(starts[np.argmax(total[starts + length] - total[starts])])
    return slice(run.settle + best, run.settle + best + length)


def _squares(run: CheckRun, simulated: FloatArray) -> FloatArray:
    errors: FloatArray = (run.measured - simulated)[run.settle :] / _swing(run)
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


def added(d: SystemDiagnosis, candidate: Candidate | None) -> bool:
    """Tell whether a candidate is in the model after.

    Parameters
    ----------
    d : SystemDiagnosis
        The diagnosis.
    candidate : Candidate or None
        Of one of its rounds.
    """
    keys = {effect.key for effect in d.after.structure.effects}
    return candidate is not None and candidate.placed.key in keys


def fate_of(d: SystemDiagnosis, step: Round, candidate: Candidate) -> str:
    """Return what became of a candidate.

    Parameters
    ----------
    d : SystemDiagnosis
        The diagnosis.
    step : Round
        The round.
    candidate : Candidate
        Of that round.

    Returns
    -------
    str
        ``added``; ``alias``: these records cannot tell it from the winner; ``too little``: the
        winner, but not worth adding; ``accepted``; ``refused``; ``not fitted``.
    """
    if candidate is step.winner:
        return "added" if added(d, candidate) else "too little"
    if any(candidate is other for other in step.aliases):
        return "alias"
    if candidate.evidence is None:
        return "not fitted"
    return "accepted" if candidate.accepted else "refused"


def candidates_shown(step: Round, most: int = MOST_SHOWN) -> tuple[Candidate, ...]:
    """Return the fitted candidates of a round, best first; the alias set is never cut.

    Parameters
    ----------
    step : Round
        The round.
    most : int
        So many, at most, where the alias set is no larger.
    """
    fitted = [c for c in step.candidates if c.evidence is not None]
    own = [c for c in fitted if any(c is other for other in step.aliases)]
    rest = [c for c in fitted if not any(c is other for other in own)]
    kept = [*own, *rest[: max(most - len(own), 0)]]
    return tuple(c for c in fitted if any(c is other for other in kept))
