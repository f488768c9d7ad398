"""Checks of a fit as rows: statistic, threshold, passed, and what it means.

Each threshold is set for a false alarm in about one clean record in a hundred; what simulated
records really give is stated with each check and held by its test. Correlations are those within
segments.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from classic_ml.characteristics import feature_names
from classic_ml.lag_regressor import LagRegressor
from classic_ml.likelihood import CycleShifts, LinearisedFit, cycle_shifts
from surge_core.autoregression import autoregression
from surge_core.segments import runs_of
from surge_core.types import FloatArray

# Of an autoregression, and a quarter of the typical segment, so that most rows remain.
LARGEST_ORDER = 27


def lagged_correlation(
    first: FloatArray, second: FloatArray, runs: list[slice], n_lags: int
) -> FloatArray:
    """Return the correlation of two signals, level and all, over lags -n_lags … n_lags.

    A lag is positive where the first signal comes later. Products are summed over what a segment
    has, straddle none, and are divided by the power of the whole.
    """
    from scipy.signal import correlate

    norm = math.sqrt(float(first @ first) * float(second @ second))
    total = np.zeros(2 * n_lags + 1)
    for run in runs:
        one, two = first[run], second[run]
        if one.size == 0:
            continue
        full = correlate(one, two, mode="full", method="auto")
        reach = min(n_lags, one.size - 1)
        middle = one.size - 1
        total[n_lags - reach : n_lags + reach + 1] += full[middle - reach : middle + reach + 1]
    return total / norm if norm > 0.0 else total


def bartlett_widening(
    first: FloatArray, second: FloatArray, runs: list[slice], n_lags: int
) -> float:
    """Return by how much the memory of two level signals widens the band of their correlation.

    √(1 + 2 Σ ρ₁(k) ρ₂(k)) over n_lags, at least 1 (Bartlett 1946).
    """
    memories = [lagged_correlation(s, s, runs, n_lags)[n_lags + 1 :] for s in (first, second)]
    return math.sqrt(max(1.0 + 2.0 * float(memories[0] @ memories[1]), 1.0))


# Down and up again, and once more: less than three sweeps is a single excursion.
FEWEST_SWEEPS = 3
FALSE_ALARM = 0.01
# Lags that are looked at.
N_LAGS = 20
# Below this the omnibus test's approximations do not hold (D'Agostino, Belanger, D'Agostino 1990).
FEWEST_FOR_NORMALITY = 20
CURVE_PERCENTILES = (5.0, 50.0, 95.0)


@dataclass(frozen=True)
class CheckRow:
    """One check.

    Parameters
    ----------
    check : str
        Name of the check.
    statistic : float
        What was computed.
    operator : {"<", ">="}
        On which side of the threshold the statistic should lie.
    threshold : float
        The limit.
    passed : bool
        Whether it does.
    meaning : str
        What the outcome says about the fit, in words.
    """

    check: str
    statistic: float
    operator: str
    threshold: float
    passed: bool
    meaning: str


def _row(check: str, statistic: float, limit: float, good: str, bad: str) -> CheckRow:
    """Return the row of a statistic that should lie below its limit."""
    passed = statistic < limit
    return CheckRow(check, statistic, "<", limit, passed, good if passed else bad)


def residual_checks(
    model: LagRegressor,
    X: ArrayLike,
    y: ArrayLike,
    segments: ArrayLike | None = None,
    *,
    stated_phi: tuple[float, float] | None = None,
) -> tuple[CheckRow, ...]:
    """Check a fitted lag model against the rows it was fitted to.

    Parameters
    ----------
    model : LagRegressor
        Fitted.
    X : array-like of shape (n, n_features)
        Inputs.
    y : array-like of shape (n,)
        ψ' as measured.
    segments : array-like of int, shape (n,), optional
        Labels as in the fit; each segment counts as a cycle.
    stated_phi : tuple of float, optional
        Range of φ in which the curve is to be stated; without it, all that the rows visit.

    Returns
    -------
    tuple of CheckRow
        Whiteness, correlation with each input, normality, leverage of single cycles, and
        sweeps of the first input; none where the fit has no lag.
    """
    if math.isnan(model.time_constant_s_):
        return ()
    inputs = np.asarray(X, dtype=np.float64)
    fit = model.linearised(inputs, y, segments)
    pieces = list(fit.pieces)
    errors, scored = fit.errors, inputs[fit.rows]
    names = feature_names(scored.shape[1], getattr(model, "feature_names_in_", None))
    rows = [whiteness(errors, pieces)]
    for column, name in enumerate(names):
        row = input_correlation(errors, scored[:, column], pieces, name=name)
        if len(names) > 1:
            row = replace(row, check=f"input_correlation({name})")
        rows.append(row)
    phi = scored[:, 0]
    stated = stated_phi or (float(phi.min()), float(phi.max()))
    swept = coverage(phi, runs_of(fit.segment, phi.size), stated)
    return (*rows, normality(errors, pieces), leverage(model, fit, scored), swept)


def whiteness(errors: FloatArray, runs: list[slice]) -> CheckRow:
    """Check that one-step errors do not predict each other.

    Parameters
    ----------
    errors : ndarray of shape (n,)
        One-step errors.
    runs : list of slice
        Their segments; no product straddles two.

    Notes
    -----
    The largest ``|ρ(k)|`` is held against the 1 % point of the largest of ``N_LAGS`` normal values
    of variance 1/n.
    """
    correlations = lagged_correlation(errors, errors, runs, N_LAGS)[N_LAGS + 1 :]
    return _row(
        "whiteness",
        float(np.max(np.abs(correlations))),
        _limit(errors.size, N_LAGS),
        "one-step errors are white within the noise",
        "one-step errors predict each other: the noise model is incomplete or the data were "
        "low-passed; the time constant is biased and textbook errors would be too small (those "
        "stated allow for it)",
    )


def input_correlation(
    errors: FloatArray, phi: FloatArray, runs: list[slice], *, name: str = "phi"
) -> CheckRow:
    """Check that the errors hold nothing more that an input could explain.

    Parameters
    ----------
    errors : ndarray of shape (n,)
        One-step errors.
    phi : ndarray of shape (n,)
        The input, φ as a rule.
    runs : list of slice
        Their segments.
    name : str
        What the input is called.
    """
    smooth = phi - phi.mean()
    correlations = lagged_correlation(errors, smooth, runs, N_LAGS)
    symbol = "φ" if name == "phi" else name
    return _row(
        "input_correlation",
        float(np.max(np.abs(correlations))),
        _limit(errors.size, 2 * N_LAGS + 1) * bartlett_widening(errors, smooth, runs, N_LAGS),
        f"nothing is left in the errors that {symbol} would explain",
        f"the errors still follow {symbol}: the characteristic, the lag or the alignment of "
        f"{symbol} and ψ' lacks something",
    )


def normality(errors: FloatArray, runs: list[slice]) -> CheckRow:
    """Check that the errors are normal, as maximum likelihood takes them to be.

    Parameters
    ----------
    errors : ndarray of shape (n,)
        Errors, white or not.
    runs : list of slice
        Their segments.

    Notes
    -----
    Skewness and kurtosis of coloured errors scatter more than the tables of any test of normality
    say, so that the errors are whitened by an autoregression first (its order by BIC): a linear
    filter of normal errors is normal. The statistic is D'Agostino and Pearson's K², χ² with two
    degrees of freedom, which holds at smaller n than Jarque and Bera's.
    """
    from scipy.stats import chi2, kurtosis, normaltest, skew

    limit = float(chi2.isf(FALSE_ALARM, 2))
    quarter = int(np.median([run.stop - run.start for run in runs])) // 4
    pieces = autoregression([errors[run] for run in runs], min(LARGEST_ORDER, quarter))[1]
    white = np.concatenate(pieces)
    if white.size < FEWEST_FOR_NORMALITY or np.ptp(white) == 0.0:
        meaning = f"fewer than {FEWEST_FOR_NORMALITY} errors: too few to know their law"
        return CheckRow("normality", math.nan, "<", limit, False, meaning)
    return _row(
        "normality",
        float(normaltest(white).statistic),
        limit,
        "the errors are normal within the noise",
        f"the errors are not normal (excess kurtosis {kurtosis(white):.2g}, skewness "
        f"{skew(white):.2g}; both 0 for normal ones): least squares is then not maximum "
        "likelihood, and single rows weigh more than they should; look for spikes, switches and "
        "clipped stretches",
    )


def leverage(model: LagRegressor, fit: LinearisedFit, inputs: FloatArray) -> CheckRow:
    """Check that no single cycle moves τ or the curve more than the others let expect.

    Parameters
    ----------
    model : LagRegressor
        Fitted.
    fit : LinearisedFit
        Its errors and their derivatives.
    inputs : ndarray of shape (n, n_features)
        Inputs of the scored rows.

    Notes
    -----
    The statistic is the largest externally studentised shift over all cycles, of τ and of the
    curve at the 5th, 50th and 95th percentile of the inputs; the threshold is the 1 % point of
    the largest of as many Student's t (Bonferroni).
    """
    from scipy.stats import t

    shifts = cycle_shifts(fit)
    contrasts = _contrasts(model, fit, inputs)
    size = np.abs(shifts.studentised(contrasts))
    cycle, contrast = np.unravel_index(int(np.argmax(size)), size.shape)
    effect = _about_cycle(model, shifts, contrasts, int(cycle), int(contrast))
    return _row(
        "leverage",
        float(size[cycle, contrast]),
        float(t.isf(0.5 * FALSE_ALARM / size.size, len(size) - 2)),
        f"no cycle outweighs the others ({effect})",
        f"one cycle moves the answer more than the others let expect: {effect}; look at that "
        "cycle before you trust either",
    )


def coverage(phi: FloatArray, runs: list[slice], valid: tuple[float, float]) -> CheckRow:
    """Check how often φ sweeps from one end of its range to the other.

    Parameters
    ----------
    phi : ndarray of shape (n,)
        Flow coefficient of the fitted rows.
    runs : list of slice
        Their segments.
    valid : tuple of float
        Range whose outer thirds count as its ends.
    """
    low, high = valid
    third = (high - low) / 3.0
    side = np.where(phi > high - third, 1, np.where(phi < low + third, -1, 0))
    ends = [side[run][side[run] != 0] for run in runs]
    sweeps = sum(int(np.count_nonzero(np.diff(own))) for own in ends)
    passed = sweeps >= FEWEST_SWEEPS
    meaning = (
        "φ sweeps its range several times"
        if passed
        else f"φ sweeps its range fewer than {FEWEST_SWEEPS} times: the curve rests on one event"
    )
    return CheckRow("phi_coverage", float(sweeps), ">=", float(FEWEST_SWEEPS), passed, meaning)


def _contrasts(model: LagRegressor, fit: LinearisedFit, inputs: FloatArray) -> FloatArray:
    """Return τ and the curve at three points as linear functions of the fit's parameters."""
    points = np.percentile(inputs, CURVE_PERCENTILES, axis=0)
    terms = model.terms_at(points) @ fit.back
    contrasts = np.zeros((1 + terms.shape[0], fit.jacobian.shape[1]))
    contrasts[0, 0] = 1.0
    contrasts[1:, 1 : 1 + terms.shape[1]] = terms
    return contrasts


def _about_cycle(
    model: LagRegressor, shifts: CycleShifts, contrasts: FloatArray, cycle: int, contrast: int
) -> str:
    """Say what the fit would be without a cycle."""
    rows = "without rows {} to {}".format(*shifts.edges[cycle])
    moved = float(contrasts[contrast] @ shifts.shift[cycle])
    if contrast == 0:
        tau_s = float(model.time_constant_s_)
        without = max(tau_s + moved, 0.0)
        return f"{rows}, τ would be {1e3 * without:.3g} instead of {1e3 * tau_s:.3g} ms"
    place = ("at the low end", "in the middle", "at the high end")[contrast - 1]
    side = "higher" if moved > 0.0 else "lower"
    return f"{rows}, the curve {place} of φ would lie {abs(moved):.2g} {side}"


def _limit(n_rows: int, n_lags: int) -> float:
    from scipy.stats import norm

    # Bonferroni over the lags keeps the stated 1 % for the largest of them.
    return float(norm.isf(0.5 * FALSE_ALARM / n_lags) / np.sqrt(max(n_rows, 1)))
