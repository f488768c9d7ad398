"""τ and the characteristic from the last rows.

The estimate is what `reduce` and `compare` give for these rows as a record: the whole reduction,
and one free run through it. It is provisional, since cycles still come.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from classic_ml.readers import TestDescription
from classic_ml.records import Record
from classic_ml.reduction import ReductionSettings, reduce_record
from surge_core.errors import InputError

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
        τ and its standard error, in seconds.
    n_cycles : int
        Cycles in the window that was fitted; 0 where test.toml states the window.
    curve : tuple of tuple of float
        (φ, ψ'_QS, standard error) over the flows that were scored.
    """

    why_not: str = ""
    tau_s: float = float("nan")
    tau_stderr_s: float = float("nan")
    n_cycles: int = 0
    curve: tuple[tuple[float, float, float], ...] = ()


def estimate_of(
    read: Callable[[], Record], test: TestDescription, settings: ReductionSettings
) -> Estimate:
    """Reduce rows and fit the lag model to them, as `reduce` and `compare` do.

    Parameters
    ----------
    read : callable
        Gives the rows, as read.
    test : TestDescription
        The test, with the near-stall shifts where they are known.
    settings : ReductionSettings
        The switches of the reduction.

    Returns
    -------
    Estimate
        With the reason in it where the rows do not bear a fit yet.
    """
    from classic_ml.whole_run import fit_whole_runs, has_whole_run

    try:
        series = reduce_record(read(), test, settings).series
        if not has_whole_run(series):
            return Estimate("no row so far can be scored")
        fit = fit_whole_runs([series])
    except InputError as error:
        return Estimate(str(error))
    if not np.isfinite(fit.time_constant_s_):
        return Estimate(fit.fit_state_.advice)
    row = fit.rows_[0]
    low, high = np.percentile(row.phi[row.weight > 0.0], [1.0, 99.0])
    phi = np.linspace(float(low), float(high), CURVE_POINTS)
    psi_p, stderr = fit.characteristic(phi)
    found = [e.parameters.get("n_cycles", 0) for e in series.history if e.step == "window"]
    return Estimate(
        tau_s=fit.time_constant_s_,
        tau_stderr_s=fit.time_constant_stderr_s_,
        n_cycles=int(found[0]) if found else 0,
        curve=tuple(zip(phi.tolist(), psi_p.tolist(), stderr.tolist(), strict=True)),
    )
