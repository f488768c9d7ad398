"""How a search for equations ended: what they leave, and what lies beyond the library."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2, norm

from sindy_surge.discover.collocation import Fit
from sindy_surge.discover.equations import Rival
from sindy_surge.discover.levels import HELD, Level, other_inputs, pays_beyond
from sindy_surge.discover.trajectories import LEAST_NOISE
from sindy_surge.search import Tried
from sindy_surge.segments import Segments
from surge_core.fit_state import FitState
from surge_core.types import BoolArray, FloatArray

# States that state equations without reserve; those whose rest comes in runs; and all in which
# terms beyond the library, and late readings, are asked for.
CLEAN = (FitState.OK, FitState.UNDECIDED)
COLOURED = (FitState.COLOURED_REST, FitState.UNEXPLAINED)
ASKED = (*CLEAN, *COLOURED, FitState.LIBRARY_TOO_SMALL)
# Of splines through the inputs, beside the cubic ones: where both agree, either will do.
_OTHER_DEGREE = 5
# What is left over the noise that differences show, before a run of it withholds the equations.
EXCESS = 1.2
# Lags at which what the equations leave is held against white noise, and how rarely that may fail
# by chance. A pendulum with cubic terms and 2 % noise left 1.03 times the noise, and its
# coefficients were off by seven and more of their stated errors.
_LAGS = 10
_BY_CHANCE = 1e-4


def ended(
    level: Level, best: Tried[Fit], rivals: Sequence[Rival], columns: Sequence[str], *, late: bool
) -> tuple[FitState, tuple[str, ...]]:
    """Return the state of a search, and terms beyond the library that would pay.

    ``columns`` name states and inputs; ``late`` is whether readings were moved.
    """
    problem = level.likelihood
    if not np.isfinite(best.score) or not best.support:
        return FitState.NO_EQUATIONS, ()
    # What is left below the noise assumed at least, or below one step of the readings, is
    # rounding, which follows the signal.
    left = (problem.data.y - best.fit.x)[:, ~problem.hidden]
    y = problem.data.y[:, ~problem.hidden]
    step = np.array([np.min(np.diff(np.unique(column))) for column in y.T])
    least = np.maximum(LEAST_NOISE * np.std(y, axis=0), step)
    # States that follow noisy inputs leave coloured errors even of the right model.
    new = problem.innovations(best.fit)[:, ~problem.hidden] if problem.input_noise.any() else left
    coloured = (np.std(left, axis=0) > least) & _coloured(new, problem.data.runs)
    large = np.std(left, axis=0) > EXCESS * problem.data.noise[~problem.hidden]
    # The largest of so many normal numbers; one run may be noisier than another.
    most = norm.isf(_BY_CHANCE / (2.0 * left.size))
    runs = [left[rows] for rows in problem.data.runs.slices()]
    errors = np.sqrt(np.diag(best.fit.covariance))
    far = [abs(own) > most * np.maximum(np.std(own, axis=0), least) for own in runs]
    found = {
        FitState.UNEXPLAINED: np.any(coloured & large),
        FitState.SHORT_RUNS_ONLY: problem.rows is not None,
        # By more than a standard error each, in the mean square.
        FitState.COARSE_ROWS: problem.rule_moves(best.support, best.fit, _OTHER_DEGREE)
        > len(best.support)
        or _depends_on_inputs(level, best),
        FitState.COLOURED_REST: np.any(coloured),
        FitState.ODD_ROWS: any(map(np.any, far)),
        FitState.READ_LATE: late,
        # The weight of a model is e to its score. A term within its error is worth no price: where
        # it stands, the model without it did not converge.
        FitState.UNDECIDED: sum(np.exp(-rival.behind) for rival in rivals) > 1.0
        or np.any(np.abs(best.fit.xi.T.ravel()[list(best.support)]) < errors),
    }
    state = next((state for state, is_so in found.items() if is_so), FitState.OK)
    beyond: tuple[str, ...] = ()
    if state in (*ASKED, FitState.READ_LATE) and np.any(np.std(left, axis=0) > least):
        beyond = pays_beyond(level, best, columns)
    too_small = bool(beyond) and state not in COLOURED
    return FitState.LIBRARY_TOO_SMALL if too_small else state, beyond


def _depends_on_inputs(level: Level, best: Tried[Fit]) -> bool:
    """Tell whether inputs held that were smooth, as likely, give other coefficients."""
    errors = np.sqrt(np.diag(best.fit.covariance))
    places = np.array(best.support, dtype=np.intp)
    return any(
        gain > -HELD and np.any(np.abs((fit.xi - best.fit.xi).T.ravel()[places]) > errors)
        for gain, _, fit, own in other_inputs([level], best)
        if own.data.open is level.likelihood.data.open
    )


def _coloured(left: FloatArray, runs: Segments) -> BoolArray:
    """Tell which columns of what the equations leave come in runs.

    By the sum over lags of the squared correlations, each in units of its own scatter, so that
    noise may differ between rows (Lobato, Nankervis & Savin 2001). Those below zero do not count:
    starts that are fitted make them.
    """
    offset, q = runs.offsets(), np.zeros(left.shape[1])
    for lag in range(1, _LAGS + 1):
        pairs = (offset[lag:] >= lag)[:, None] * left[lag:] * left[:-lag]
        scatter = np.maximum(np.sum(pairs**2, axis=0), 1e-300)
        q += np.maximum(pairs.sum(axis=0), 0.0) ** 2 / scatter
    return np.asarray(chi2.sf(q, _LAGS) < _BY_CHANCE)
