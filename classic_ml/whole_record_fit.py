"""τ and the in-stall characteristic of a whole record, with an interval that holds the truth."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from classic_ml.twin import Twin, twin_of
from classic_ml.whole_record.branches import (
    BranchFit,
    Specification,
    fit_branches,
    specification,
)
from classic_ml.whole_record.interval import (
    DELAY_STEP_S,
    Scatter,
    delay_of_exit,
    errors_of,
    jackknife,
    law_of_probes,
    scatter_of,
    variants,
    with_stored_gas,
    within_bounds,
)
from classic_ml.whole_record.passes import Passes, passes_of
from classic_ml.whole_record.rakes import RakeSignals
from classic_ml.whole_record.stall_state import StallLevels, estimated_state, refined_state
from surge_core.fit_state import FitState
from surge_core.segments import runs_of
from surge_core.types import BoolArray, FloatArray

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
    fit : BranchFit
        The estimate.
    passes : Passes
        The rows it was made from.
    spec : Specification
        What was taken for granted.
    in_stall : ndarray of bool, shape (n,)
        The state.
    levels : StallLevels or None
        The flows of recovery and entry; None where the state is the one by hub and tip.
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

    fit: BranchFit
    passes: Passes
    spec: Specification
    in_stall: BoolArray
    levels: StallLevels | None
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
    def share(self) -> float:
        """Standard deviation of log τ but for `planes`, which another method shares."""
        parts = [self.cycles.log_tau, self.specification.log_tau, self.probe_law]
        return math.hypot(*parts, *([self.twins.log_tau] if self.twins.n else []))

    @property
    def contradictions(self) -> int:
        """Episodes of a cell period and more, in stall or out of it, that one way does not see.

        The two ways are the flow levels and the hub-minus-tip flow.
        """
        passes, found = self.passes, 0
        if self.levels is None or passes.shift is None:
            return 0
        for one, other in ((self.in_stall, passes.in_stall), (passes.in_stall, self.in_stall)):
            for run in runs_of(one, one.size):
                long = run.stop - run.start >= passes.rows_of(passes.period_s)
                found += long and not np.any(other[run] == one[run.start])
        return found

    @property
    def _hub_and_tip_explain_more(self) -> bool:
        """Whether ψ' speaks for the state by hub and tip, too: else their profile has misled it."""
        other = fit_branches(self.passes, self.spec, self.passes.in_stall, near_s=self.tau_s)
        return other.cost < self.fit.cost

    @property
    def coefficients(self) -> FloatArray:
        """β of the in-stall powers of φ."""
        return self.fit.coefficients[: self.spec.degree + 1]

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
        step_s = max(DELAY_STEP_S, self.passes.sample_period_s)
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
    random_state: int = 0,
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
    random_state : int
        Seed of the twins.
    progress : callable
        Wraps the iteration over the twins, to show how far it is.

    Raises
    ------
    InputError
        When the record has no rows to fit.
    """
    passes = passes_of(signals, window)
    spec = specification(signals, passes, degree)
    in_stall, levels = estimated_state(passes, spec)
    fit = fit_branches(passes, spec, in_stall)
    n_cycles = int(passes.cycle[-1]) + 1
    if not interval:
        nothing = scatter_of((), fit, degree, 1.0)
        parts = nothing, nothing, nothing, nothing
        return WholeRecordFit(fit, passes, spec, in_stall, levels, *parts, n_cycles, False)
    twins: list[BranchFit] = []
    if n_twins:
        twin = twin_of(signals, passes, spec, in_stall, fit)
        rng = np.random.default_rng(random_state)
        twins = [
            _fit_twin(twin, spec, levels, fit.tau_s, rng, window) for _ in progress(range(n_twins))
        ]
    late_s, on_time = delay_of_exit(signals, passes, spec, in_stall, fit)
    stored = with_stored_gas(signals, passes, spec, in_stall, fit)
    return WholeRecordFit(
        fit,
        passes,
        spec,
        in_stall,
        levels,
        jackknife(passes, spec, in_stall, fit),
        variants(passes, spec, in_stall, fit),
        errors_of(twins, fit, degree),
        within_bounds((on_time, stored), fit, degree),
        n_cycles,
        True,
        law_of_probes(signals, window, spec, levels, fit),
        (late_s, math.log(on_time.tau_s / fit.tau_s)),
    )


def _fit_twin(
    twin: Twin,
    spec: Specification,
    levels: StallLevels | None,
    near_s: float,
    rng: np.random.Generator,
    window: slice | None,
) -> BranchFit:
    passes = passes_of(twin.measured(rng), window)
    state = refined_state(passes, spec, levels, near_s)
    return fit_branches(passes, spec, state, near_s=near_s)
