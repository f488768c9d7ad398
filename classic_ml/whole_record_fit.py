"""τ and the in-stall characteristic of a whole record, with an interval that holds the truth."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from classic_ml.record_reading import RecordReading
from classic_ml.whole_record.branches import BranchFit
from classic_ml.whole_record.rakes import RakeSignals
from classic_ml.whole_record_interval import (
    DELAY_STEP_S,
    Scatter,
    errors_of,
    from_plane_to_plane,
    jackknife,
    law_of_probes,
    scatter_of,
    variants,
)
from surge_core.fit_state import FitState
from surge_core.segments import runs_of
from surge_core.types import FloatArray

N_TWINS = 20
# Fewer cycles than this make no jackknife.
FEWEST_CYCLES = 6
# Of τ: beyond it an answer says too little.
LARGEST_SHARE = 0.12


@dataclass(frozen=True)
class WholeRecordFit:
    """A lag over both branches of one record, and what is known of it.

    Parameters
    ----------
    reading : RecordReading
        The rows it was made from, what was taken for granted, and the state.
    fit : BranchFit
        The estimate.
    cycles, specification, twins : Scatter
        Scatter over cycles left out, over specifications and over twins; that over twins has
        ``n`` 0 where none were measured.
    planes : Scatter
        What the time from plane to plane may do, for every method alike.
    n_cycles : int
        Surge cycles.
    estimated : bool
        Whether the scatter was estimated.
    probe_law : float
        How far log τ moves under a law of the probes without a jump at zero flow.
    delay : tuple of float
        By how much plane 31 seems late, in seconds, and how far log τ moves without that.
    """

    reading: RecordReading
    fit: BranchFit
    cycles: Scatter
    specification: Scatter
    twins: Scatter
    planes: Scatter
    n_cycles: int
    estimated: bool
    probe_law: float = 0.0
    delay: tuple[float, float] = (0.0, 0.0)

    @property
    def tau_s(self) -> float:
        """Time constant, in seconds."""
        return self.fit.tau_s

    @property
    def own_share(self) -> float:
        """Standard deviation of log τ by what another record does not share."""
        parts = [self.cycles.log_tau, self.specification.log_tau]
        return math.hypot(*parts, *([self.twins.log_tau] if self.twins.n else []))

    @property
    def share(self) -> float:
        """Standard deviation of log τ but for `planes`, which another method shares."""
        return math.hypot(self.own_share, self.probe_law)

    @property
    def contradictions(self) -> int:
        """Episodes of a cell period and more, in stall or out of it, that one way does not see.

        The two ways are the flow levels and the hub-minus-tip flow.
        """
        passes, state, found = self.reading.passes, self.reading.in_stall, 0
        if self.reading.levels is None or passes.shift is None:
            return 0
        for one, other in ((state, passes.in_stall), (passes.in_stall, state)):
            for run in runs_of(one, one.size):
                long = run.stop - run.start >= passes.rows_of(passes.period_s)
                found += long and not np.any(other[run] == one[run.start])
        return found

    @property
    def _hub_and_tip_explain_more(self) -> bool:
        """Whether ψ' speaks for the state by hub and tip, too: else their profile has misled it."""
        return self.reading.by_hub_and_tip().fit(near_s=self.tau_s).cost < self.fit.cost

    @property
    def coefficients(self) -> FloatArray:
        """β of the in-stall powers of φ."""
        return self.fit.coefficients[: self.reading.spec.degree + 1]

    @property
    def covariance(self) -> FloatArray:
        """Of β, but for `planes`."""
        total = self.cycles.curve + self.specification.curve
        return total + self.twins.curve if self.twins.n else total

    @property
    def state(self) -> FitState:
        """How the fit ended; some states withhold τ."""
        if self.n_cycles < FEWEST_CYCLES:
            return FitState.TOO_FEW_CYCLES
        if self.fit.at_end:
            return FitState.AT_SEARCH_END
        if not self.estimated:
            return FitState.CONVERGED
        # A single step is none: the responses of the probes differ by as much.
        late_s, moved = self.delay
        step_s = max(DELAY_STEP_S, self.reading.passes.sample_period_s)
        if abs(late_s) > 1.5 * step_s and abs(moved) > self.share:
            return FitState.MISALIGNED
        if self.contradictions > 0.5 * self.n_cycles and self._hub_and_tip_explain_more:
            return FitState.STATES_PART
        biased = abs(self.twins.bias) > 2.0 * self.share
        return FitState.TWIN_BIASED if biased else FitState.CONVERGED


def fit_whole_record(
    signals: RakeSignals,
    window: slice | None = None,
    *,
    degree: int = 2,
    interval: bool = True,
    n_twins: int = N_TWINS,
    progress: Callable[[Iterable[int]], Iterable[int]] = iter,
) -> WholeRecordFit:
    """Estimate τ and the in-stall characteristic from all forward rows of a record.

    Parameters
    ----------
    signals : RakeSignals
        Every probe pair, unfiltered.
    window : slice, optional
        Rows to stay in.
    degree : int
        Of the in-stall characteristic.
    interval : bool
        Whether the scatter is estimated; without it the numbers alone are.
    n_twins : int
        Twins behind the interval; 0 leaves their part out of it.
    progress : callable
        Wraps the iteration over the twins, to show how far it is.

    Raises
    ------
    InputError
        When the record has no rows to fit.
    """
    reading = RecordReading.of(signals, window, degree, by_flow=False)
    fit = reading.fit()
    n_cycles = int(reading.passes.cycle[-1]) + 1
    if not interval:
        none = scatter_of((), fit, degree, 1.0)
        return WholeRecordFit(reading, fit, none, none, none, none, n_cycles, False)
    twins: list[BranchFit] = []
    if n_twins:
        twin, rng = reading.twin_under(fit), np.random.default_rng(0)
        for _ in progress(range(n_twins)):
            twins.append(reading.again(twin, rng, fit.tau_s).fit(near_s=fit.tau_s))
    late_s, on_time, planes = from_plane_to_plane(reading, fit)
    return WholeRecordFit(
        reading,
        fit,
        jackknife(reading, fit),
        variants(reading, fit),
        errors_of(twins, fit, degree),
        planes,
        n_cycles,
        True,
        law_of_probes(reading, fit),
        (late_s, math.log(on_time.tau_s / fit.tau_s)),
    )
