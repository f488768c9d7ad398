"""τ and the characteristic from the last rows.

The estimate is what `reduce` and `compare` give for these rows as a record: the whole reduction,
and one free run through it. It is provisional, since cycles still come.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from classic_ml.io import TestDescription
from classic_ml.records import Record
from classic_ml.reduction import reduce_record
from classic_ml.reduction_settings import ReductionSettings
from classic_ml.whole_run import fit_whole_runs
from classic_ml.whole_run_rows import has_whole_run
from surge_core.errors import InputError
from surge_core.rounding import round_to_error

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
    curve : tuple of tuple of float
        (φ, ψ'_QS, standard error) over the flows that were scored.
    """

    why_not: str = ""
    tau_s: float = float("nan")
    tau_stderr_s: float = float("nan")
    curve: tuple[tuple[float, float, float], ...] = ()

    @property
    def words(self) -> str:
        """The time constant as it is shown."""
        if self.why_not:
            return f"not yet: {self.why_not}"
        return f"{round_to_error(1e3 * self.tau_s, 1e3 * self.tau_stderr_s)} ms, provisional"


def estimate_of(record: Record, test: TestDescription, settings: ReductionSettings) -> Estimate:
    """Reduce rows and fit the lag model to them, as `reduce` and `compare` do.

    Parameters
    ----------
    record : Record
        The rows, as read.
    test : TestDescription
        The test, with the near-stall shifts where they are known.
    settings : ReductionSettings
        The switches of the reduction.

    Returns
    -------
    Estimate
        With the reason in it where the rows do not bear a fit yet.
    """
    try:
        series = reduce_record(record, test, settings).series
        if not has_whole_run(series):
            return Estimate("no row so far can be scored")
        fit = fit_whole_runs([series])
    except InputError as error:
        return Estimate(str(error))
    if not np.isfinite(fit.time_constant_s_):
        return Estimate(fit.fit_state_.advice)
    row = fit.rows_[0]
    low, high = np.percentile(row.phi[row.weight > 0.0], [1.0, 99.0]).tolist()
    phi = np.linspace(low, high, CURVE_POINTS)
    psi_p, stderr = fit.characteristic(phi)
    curve = tuple(zip(phi.tolist(), psi_p.tolist(), stderr.tolist(), strict=True))
    return Estimate("", fit.time_constant_s_, fit.time_constant_stderr_s_, curve)
