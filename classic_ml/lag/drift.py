"""Slow drift of the output, as a spline with knots stated in seconds."""

from __future__ import annotations

from classic_ml.lag.cells import Knots
from surge_core.errors import InputError

__all__ = ["knots_of"]

# A knot every other row leaves nothing for the lag to explain.
FEWEST_ROWS_A_KNOT = 4


def knots_of(runs: list[slice], sample_period_s: float, knot_spacing_s: float) -> Knots:
    """Return the knots of a continuous piecewise-linear drift of zero mean.

    Parameters
    ----------
    runs : list of slice
        The segments. The time between two of them is not known, so each drifts on its own: as
        a spline where it is longer than the knots are apart, else as one level.
    sample_period_s : float
        Sample period, in seconds.
    knot_spacing_s : float
        Distance of the knots, in seconds; 0.25 to 2 s serve equally well where the lag is tens
        of milliseconds.

    Raises
    ------
    InputError
        When there would be a knot every few rows.
    """
    if knot_spacing_s < FEWEST_ROWS_A_KNOT * sample_period_s:
        raise InputError(
            "knot_spacing_s",
            expected=f"at least {FEWEST_ROWS_A_KNOT} sample periods of {sample_period_s:g} s",
            found=f"{knot_spacing_s:g} s",
            remedy="raise knot_spacing_s to many times the time constant",
        )
    first, intervals, steps = [], [], []
    at = 0
    for run in runs:
        n = run.stop - run.start
        count = round((n - 1) * sample_period_s / knot_spacing_s)
        first.append(at)
        intervals.append(count)
        steps.append(count / (n - 1) if count else 0.0)
        at += max(count, 1) + 1
    return Knots(tuple(first), tuple(intervals), tuple(steps))
