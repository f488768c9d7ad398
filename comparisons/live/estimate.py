"""τ and the characteristic from the rows so far.

The estimate is what `reduce` and `compare` give for the record up to now: the whole reduction, and
the fit `classic_ml` of one free run through it. It is provisional, since cycles still come.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from comparisons.live.columns import FeedColumns
from surge_core.types import FloatArray

if TYPE_CHECKING:
    from classic_ml.reduction import ReductionSettings

__all__ = ["Estimate", "estimate_of"]

CURVE_POINTS = 41


@dataclass(frozen=True)
class Estimate:
    """A provisional fit, or why there is none yet.

    Parameters
    ----------
    why_not : str
        Why there is no estimate; empty where there is one.
    tau_s, tau_stderr_s : float
        τ and its standard error, in seconds; NaN where the record does not hold it.
    n_cycles : int
        Cycles in the window that was fitted; 0 where test.toml names the window.
    from_s, to_s : float
        That window.
    phi, psi_p, psi_p_stderr : tuple of float
        The characteristic over the flows that were scored, with its standard error.
    seconds : float
        How long the work took.
    """

    why_not: str = ""
    tau_s: float = float("nan")
    tau_stderr_s: float = float("nan")
    n_cycles: int = 0
    from_s: float = 0.0
    to_s: float = 0.0
    phi: tuple[float, ...] = ()
    psi_p: tuple[float, ...] = ()
    psi_p_stderr: tuple[float, ...] = ()
    seconds: float = 0.0


def estimate_of(
    columns: FeedColumns,
    readings: FloatArray,
    start_s: float,
    settings: ReductionSettings | None = None,
) -> Estimate:
    """Reduce rows and fit the lag model to them, as `reduce` and `compare` do.

    Parameters
    ----------
    columns : FeedColumns
        The channels.
    readings : ndarray of shape (n, n_channels)
        Counts, Pa and K of rows that follow one another.
    start_s : float
        Clock of the first row.
    settings : ReductionSettings, optional
        The switches of the reduction; the defaults without them.

    Returns
    -------
    Estimate
        With the reason in it where the rows do not bear a fit yet.
    """
    from classic_ml.reduction import reduce_record
    from classic_ml.whole_run import fit_whole_runs, has_whole_run
    from surge_core.errors import InputError

    begun = time.monotonic()
    try:
        reduction = reduce_record(columns.record(readings, start_s), columns.test, settings)
        series = reduction.series
        if not has_whole_run(series):
            return Estimate("no row so far can be scored", seconds=time.monotonic() - begun)
        fit = fit_whole_runs([series])
    except InputError as error:
        return Estimate(str(error), seconds=time.monotonic() - begun)
    if not np.isfinite(fit.time_constant_s_):
        return Estimate(fit.fit_state_.advice, seconds=time.monotonic() - begun)
    row = fit.rows_[0]
    scored = row.phi[row.weight > 0.0]
    low, high = np.percentile(scored, [1.0, 99.0])
    phi = np.linspace(float(low), float(high), CURVE_POINTS)
    psi_p, stderr = fit.characteristic(phi)
    found = [e.parameters.get("n_cycles", 0) for e in series.history if e.step == "window"]
    return Estimate(
        tau_s=fit.time_constant_s_,
        tau_stderr_s=fit.time_constant_stderr_s_,
        n_cycles=int(found[0]) if found else 0,
        from_s=reduction.window_s[0],
        to_s=reduction.window_s[1],
        phi=tuple(phi.tolist()),
        psi_p=tuple(psi_p.tolist()),
        psi_p_stderr=tuple(stderr.tolist()),
        seconds=time.monotonic() - begun,
    )
