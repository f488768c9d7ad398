"""τ and the in-stall characteristic of a whole record, with an interval that holds the truth.

A jackknife over cycles cannot see what all cycles share: the specification of the fit, the errors
of calibration and of noise near zero flow, and what Eq 5 leaves out between the planes. The first
is varied; the second is drawn again by measuring a twin of the record; the third lies between
bounds that the record and the duct give.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from classic_ml.record_reading import RecordReading
from classic_ml.whole_record.branches import BranchFit, FreeRun, specifications
from classic_ml.whole_record.passes import passes_of
from classic_ml.whole_record.rakes import RakeSignals
from classic_ml.whole_record.stall_state import INDEPENDENT_S, state_by_levels
from surge_core.fit_state import FitState
from surge_core.segments import runs_of
from surge_core.types import FloatArray

MOST_BLOCKS = 20
# Eq 2 was calibrated down to about this calculated Mach number; below it is an assumption.
RAMP_MACH = 0.03
# The model may prefer plane 31 so many steps later or earlier; beyond, the curves would not fit.
DELAY_STEP_S, DELAY_STEPS = 1e-3, 6


@dataclass(frozen=True)
class Scatter:
    """How far an estimate moves under one kind of change."""

    log_tau: float  # Standard deviation of log τ
    bias: float  # Mean of log τ less that of the estimate
    curve: FloatArray  # (q, q): Covariance of the in-stall coefficients
    n: int  # Estimates behind it


def jackknife(reading: RecordReading, fit: BranchFit) -> Scatter:
    """Leave out blocks of whole surge cycles in turn; NaN where there is a single one.

    The square of a move counts by the share of the information on τ that is left (Wu 1986, Annals
    of Statistics 14, 1261): loops in stall make one cycle long, and often it alone knows τ.
    """
    cycle, q = reading.passes.cycle, reading.spec.degree + 1
    n = min(MOST_BLOCKS, int(cycle[-1]) + 1)
    if n < 2:
        return scatter_of((), fit, reading.spec.degree, 1.0)
    block = (cycle * n) // (int(cycle[-1]) + 1)
    kept = [fit.scored & (block != b) for b in range(n)]
    fits = [reading.fit(scored=rows, near_s=fit.tau_s) for rows in kept]
    moves = np.array([[*one.coefficients[:q], math.log(one.tau_s)] for one in fits])
    moves -= [*fit.coefficients[:q], math.log(fit.tau_s)]
    run = FreeRun.of(reading.passes, reading.spec, reading.in_stall, fit.scored)
    left = np.array([run.information(fit, rows) for rows in kept])
    covariance = (left / run.information(fit, fit.scored) * moves.T) @ moves
    return Scatter(math.sqrt(covariance[q, q]), 0.0, covariance[:q, :q], n)


def variants(reading: RecordReading, fit: BranchFit) -> Scatter:
    """Fit under other specifications, and with the state as hub and tip alone show it.

    A curve without a hinge that the record rejects could not as well have been taken for granted.
    """
    others = [replace(reading, spec=spec) for spec in specifications(reading.spec)]
    others.append(reading.by_hub_and_tip())
    tried = [(other, other.fit(near_s=fit.tau_s)) for other in others]
    kept = [
        each for each in tried if each[0].spec.hinges or not _is_rejected(reading, fit, each[1])
    ]
    fits = [one for _, one in kept]
    degree = reading.spec.degree
    alike = [one for other, one in kept if other.spec.degree == degree]
    tau = scatter_of([fit, *fits], fit, 0, 1.0)
    return replace(tau, curve=scatter_of([fit, *alike], fit, degree, 1.0).curve)


def _is_rejected(reading: RecordReading, fit: BranchFit, smaller: BranchFit) -> bool:
    """Return whether the likelihood ratio rejects a fit with fewer columns at 1 %."""
    from scipy.stats import chi2

    n = fit.errors.size * reading.passes.sample_period_s / INDEPENDENT_S
    fewer = fit.coefficients.size - smaller.coefficients.size
    return bool(fewer > 0 and n * math.log(smaller.cost / fit.cost) > chi2.ppf(0.99, fewer))


def law_of_probes(reading: RecordReading, fit: BranchFit) -> float:
    """Return how far log τ moves when the probes' law has a ramp in place of its jump."""
    passes = passes_of(reading.signals.ramped(RAMP_MACH), reading.window)
    levels = reading.levels
    state = passes.in_stall if levels is None else state_by_levels(passes, levels)
    ramped = replace(reading, passes=passes, in_stall=state)
    return math.log(ramped.fit(near_s=fit.tau_s).tau_s / fit.tau_s)


def read_later(reading: RecordReading, fit: BranchFit, late_s: float) -> BranchFit:
    """Fit with plane 31 read so much later: a time shift between the planes is read as lag."""
    planes, period_s = reading.passes.planes, reading.passes.sample_period_s
    index = np.arange(planes.exit_Pa.size)
    exit_Pa = np.interp(index + late_s / period_s, index, planes.exit_Pa)
    moved = reading.signals.coefficients(replace(planes, exit_Pa=exit_Pa))
    return _with_psi_p(moved[1], reading, fit)


def preferred_shift(reading: RecordReading, fit: BranchFit) -> float:
    """Return by how much plane 31 seems late to the model, in seconds.

    It is the shift of least error, to a part of a step by the parabola through the three least.
    """
    step_s = max(DELAY_STEP_S, reading.passes.sample_period_s)
    tried = range(-DELAY_STEPS, DELAY_STEPS + 1)
    costs = [read_later(reading, fit, n * step_s).cost if n else fit.cost for n in tried]
    best = int(np.argmin(costs))
    late = float(tried[best])
    if 0 < best < len(tried) - 1:
        before, least, after = costs[best - 1 : best + 2]
        if before + after > 2.0 * least:
            late += 0.5 * (before - after) / (before - 2.0 * least + after)
    return late * step_s


def with_stored_gas(reading: RecordReading, fit: BranchFit) -> BranchFit:
    """Fit ψ' whose inertia acts on the flow in the middle of the duct between the planes.

    Eq 5 takes the flow of plane 25 for that of the whole duct, as if waves took no time from plane
    to plane. In a duct that stores gas evenly its middle passes less by half of what is stored.
    """
    stored = reading.signals.coefficients(reading.passes.planes, stored=True)
    return _with_psi_p(stored[1], reading, fit)


def _with_psi_p(psi_p: FloatArray, reading: RecordReading, fit: BranchFit) -> BranchFit:
    moved = psi_p[reading.passes.row]
    moved = np.where(np.isfinite(moved), moved, reading.passes.psi_p)
    return reading.with_psi_p(moved).fit(near_s=fit.tau_s)


def from_plane_to_plane(
    reading: RecordReading, fit: BranchFit
) -> tuple[tuple[float, float], Scatter]:
    """Return by how much plane 31 is late and how far log τ moves by it, and what Eq 5 leaves open.

    The flows say how late it is. Where it is early waves in the duct may do that, and the shift
    that the model prefers stands for them. Two moved fits show how far off the truth may be, and no
    more: between bounds of ± a with nothing known inside the standard deviation is a/√3 (Guide to
    the Expression of Uncertainty in Measurement, JCGM 100:2008, 4.3.7).
    """
    found, q = reading.signals.chain.alignment, reading.spec.degree + 1
    by_flows = found.off_clock or found.on_time
    late_s = found.late_s if by_flows else preferred_shift(reading, fit)
    moved = read_later(reading, fit, late_s), with_stored_gas(reading, fit)
    logs = np.log([each.tau_s / fit.tau_s for each in moved])
    apart = np.array([(each.coefficients - fit.coefficients)[:q] for each in moved])
    open_ = Scatter(math.sqrt(float(logs @ logs) / 3.0), 0.0, apart.T @ apart / 3.0, len(moved))
    return (late_s, float(logs[0])), open_


def scatter_of(fits: Sequence[BranchFit], fit: BranchFit, degree: int, widened: float) -> Scatter:
    """Return the spread of fits about their mean, times a factor.

    Of records that were measured again the factor is that of a sample, √(n/(n-1)).
    """
    if len(fits) < 2:
        return Scatter(math.nan, 0.0, np.full((degree + 1, degree + 1), math.nan), len(fits))
    logs = np.log([each.tau_s for each in fits])
    curves = np.array([each.coefficients[: degree + 1] for each in fits])
    apart = curves - curves.mean(axis=0)
    return Scatter(
        widened * float(np.std(logs)),
        float(np.mean(logs)) - math.log(fit.tau_s),
        widened**2 * (apart.T @ apart) / len(fits),
        len(fits),
    )


def errors_of(twins: Sequence[BranchFit], fit: BranchFit, degree: int) -> Scatter:
    """Return the scatter of twins, of the curve about the fit, which is the truth of theirs."""
    scatter = scatter_of(twins, fit, degree, math.sqrt(len(twins) / max(len(twins) - 1, 1)))
    if len(twins) < 2:
        return scatter
    own = fit.coefficients[: degree + 1]
    apart = np.array([each.coefficients[: degree + 1] - own for each in twins])
    return replace(scatter, curve=apart.T @ apart / len(twins))


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
        By how much plane 31 is late, in seconds, and how far log τ moves without that.
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
    def parts(self) -> dict[str, float]:
        """What leaves τ open, each as a standard deviation of log τ, the largest first."""
        found = {
            "the scatter of the cycles": self.cycles.log_tau,
            "the choices of the fit": self.specification.log_tau,
            "the noise of the probes": self.twins.log_tau if self.twins.n else 0.0,
            "the time from plane to plane": self.planes.log_tau,
            "the law of the probes near zero flow": abs(self.probe_law),
        }
        # What is not known comes first.
        parts = {name: part if math.isfinite(part) else math.inf for name, part in found.items()}
        return dict(sorted(parts.items(), key=lambda each: -each[1]))

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
        alignment, (late_s, moved) = self.reading.signals.chain.alignment, self.delay
        # What the model prefers is no shift by a single step.
        step_s = max(DELAY_STEP_S, self.reading.passes.sample_period_s)
        apart = alignment.off_clock or (not alignment.on_time and abs(late_s) > 1.5 * step_s)
        if apart and abs(moved) > self.share:
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
    delay, planes = from_plane_to_plane(reading, fit)
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
        delay,
    )
