"""What is not known of τ: cycles, what the fit takes for granted, and the measurement itself.

A jackknife over cycles cannot see what all cycles share: the specification of the fit, the errors
of calibration and of noise near zero flow, and what Eq 5 leaves out between the planes. The first
is varied; the second is drawn again by measuring a twin of the record; the third lies between
bounds that the record and the duct give.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from classic_ml.record_reading import RecordReading
from classic_ml.whole_record.branches import BranchFit, specifications
from classic_ml.whole_record.passes import passes_of
from classic_ml.whole_record.stall_state import state_by_levels
from surge_core.types import FloatArray

MOST_BLOCKS = 20
# Eq 2 was calibrated down to about this calculated Mach number; below it is an assumption.
RAMP_MACH = 0.03
# Plane 31 is tried up to so many steps later and earlier; tubes and converters differ by less than
# one step, and beyond the ends the curves themselves would not fit.
DELAY_STEP_S, DELAY_STEPS = 1e-3, 6


@dataclass(frozen=True)
class Scatter:
    """How far an estimate moves under one kind of change."""

    log_tau: float  # Standard deviation of log τ
    bias: float  # Mean of log τ less that of the estimate
    curve: FloatArray  # (q, q): Covariance of the in-stall coefficients
    n: int  # Estimates behind it


def jackknife(reading: RecordReading, fit: BranchFit) -> Scatter:
    """Leave out blocks of whole surge cycles in turn; NaN where there is a single one."""
    cycle = reading.passes.cycle
    n = min(MOST_BLOCKS, int(cycle[-1]) + 1)
    block = (cycle * n) // (int(cycle[-1]) + 1)
    fits = [
        reading.fit(scored=fit.scored & (block != b), near_s=fit.tau_s) for b in range(n) if n > 1
    ]
    return scatter_of(fits, fit, reading.spec.degree, math.sqrt(max(n - 1, 0)))


def variants(reading: RecordReading, fit: BranchFit) -> Scatter:
    """Fit under other specifications, and with the state as hub and tip alone show it."""
    others = [replace(reading, spec=spec) for spec in specifications(reading.spec)]
    others.append(reading.by_hub_and_tip())
    fits = [other.fit(near_s=fit.tau_s) for other in others]
    degree = reading.spec.degree
    alike = [one for one, other in zip(fits, others, strict=True) if other.spec.degree == degree]
    tau = scatter_of([fit, *fits], fit, 0, 1.0)
    return replace(tau, curve=scatter_of([fit, *alike], fit, degree, 1.0).curve)


def law_of_probes(reading: RecordReading, fit: BranchFit) -> float:
    """Return how far log τ moves when the probes' law has a ramp in place of its jump."""
    passes = passes_of(reading.signals.ramped(RAMP_MACH), reading.window)
    levels = reading.levels
    state = passes.in_stall if levels is None else state_by_levels(passes, levels)
    ramped = replace(reading, passes=passes, in_stall=state)
    return math.log(ramped.fit(near_s=fit.tau_s).tau_s / fit.tau_s)


def delay_of_exit(reading: RecordReading, fit: BranchFit) -> tuple[float, BranchFit]:
    """Return by how much plane 31 seems late, in seconds, and the fit without that.

    A time shift between the planes is read as lag; the least error over shifts shows it, to a part
    of a step by the parabola through the three least.
    """
    passes = reading.passes
    rows = max(passes.rows_of(DELAY_STEP_S), 1)
    index = np.arange(passes.planes.exit_Pa.size)

    def without(steps: float) -> BranchFit:
        exit_Pa = np.interp(index + steps * rows, index, passes.planes.exit_Pa)
        planes = replace(passes.planes, exit_Pa=exit_Pa)
        return _with_psi_p(reading.signals.coefficients(planes)[1], reading, fit)

    tried = range(-DELAY_STEPS, DELAY_STEPS + 1)
    costs = [without(step).cost if step else fit.cost for step in tried]
    best = int(np.argmin(costs))
    late = float(tried[best])
    if 0 < best < len(tried) - 1:
        before, least, after = costs[best - 1 : best + 2]
        if before + after > 2.0 * least:
            late += 0.5 * (before - after) / (before - 2.0 * least + after)
    return late * rows * passes.sample_period_s, without(late)


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


def within_bounds(moved: Sequence[BranchFit], fit: BranchFit, degree: int) -> Scatter:
    """Return the spread where each moved fit shows how far off the truth may be, and no more.

    Between bounds of ± a with nothing known inside the standard deviation is a/√3 (Guide to the
    Expression of Uncertainty in Measurement, JCGM 100:2008, 4.3.7).
    """
    logs = np.log([each.tau_s / fit.tau_s for each in moved])
    apart = np.array([(each.coefficients - fit.coefficients)[: degree + 1] for each in moved])
    return Scatter(math.sqrt(float(logs @ logs) / 3.0), 0.0, apart.T @ apart / 3.0, len(moved))


def from_plane_to_plane(reading: RecordReading, fit: BranchFit) -> tuple[float, BranchFit, Scatter]:
    """Return by how much plane 31 seems late, the fit without that, and what Eq 5 leaves open."""
    late_s, on_time = delay_of_exit(reading, fit)
    moved = on_time, with_stored_gas(reading, fit)
    return late_s, on_time, within_bounds(moved, fit, reading.spec.degree)


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
