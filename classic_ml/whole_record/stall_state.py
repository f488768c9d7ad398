"""The in-stall state by two flows: recovery above one, going up, stall below one, going down.

Both are estimated together: by what the state leaves of ψ' in the free run, and by what it leaves
of the hub-minus-tip flow, each by its likelihood.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np

from classic_ml.whole_record.branches import FreeRun, Specification
from classic_ml.whole_record.passes import Passes
from surge_core.segments import runs_of
from surge_core.types import BoolArray, FloatArray

# After stall φ must fall below this share of the flow of recovery before it can recover again.
REARMED_SHARE = 0.4
# φ and its slope are read over these, so that noise switches nothing.
LEVEL_AVERAGE_S, SLOPE_AVERAGE_S = 0.003, 0.006
FEWEST_EPISODES = 3
FEWEST_ROWS = 20
TAUS_S = np.geomspace(0.007, 0.04, 9)
# In place of these: ψ' has no say.
NONE = np.zeros(0)
NEARBY = np.array([0.8, 1.0, 1.25])
GRID = 9
LOWEST_RECOVERY, LOWEST_ENTRY = 0.06, 0.04
PEAK_S = 0.06
HALVINGS = 3
# How far apart errors of ψ' count as independent in the likelihood.
INDEPENDENT_S = 0.003


@dataclass(frozen=True)
class StallLevels:
    """The flows at which the machine changes its state."""

    recovery_phi: float  # φ above which stall ends, on the way up
    # φ below which it begins, on the way down; above the other where the unstalled branch peaks
    # beyond the flow of recovery
    entry_phi: float


def state_by_levels(passes: Passes, levels: StallLevels) -> BoolArray:
    """Return the in-stall state that two levels give."""
    phi = passes.smooth(passes.phi, LEVEL_AVERAGE_S)
    slope = np.gradient(passes.smooth(passes.phi, SLOPE_AVERAGE_S))
    rises = (phi > levels.recovery_phi) & (slope > 0.0)
    falls = (phi < levels.entry_phi) & (slope < 0.0)
    low = phi < REARMED_SHARE * levels.recovery_phi
    state = np.empty(phi.size, dtype=np.bool_)
    for piece in passes.pieces:
        stalled, armed = bool(passes.in_stall[piece.start]), True
        for row in range(piece.start, piece.stop):
            if stalled:
                armed = armed or bool(low[row])
                stalled = not (armed and rises[row])
            elif falls[row]:
                stalled, armed = True, False
            state[row] = stalled
    return state


def estimated_state(
    passes: Passes, spec: Specification, *, by_flow: bool = False
) -> tuple[BoolArray, StallLevels | None]:
    """Return the state and its levels, estimated over a grid, then by halving its steps.

    With ``by_flow`` the hub-minus-tip flow alone decides, where there is one. Without levels (None)
    the state is that by hub and tip: the record changes it too seldom to estimate them, or most of
    the recoveries that they give are none at hub and tip.
    """
    state = passes.in_stall
    inner = passes.piece[1:] == passes.piece[:-1]
    recoveries = np.flatnonzero(state[:-1] & ~state[1:] & inner)
    entries = int(np.count_nonzero(~state[:-1] & state[1:] & inner))
    if min(recoveries.size, entries) < FEWEST_EPISODES:
        return state, None
    phi = passes.smooth(passes.phi, LEVEL_AVERAGE_S)
    reach = passes.rows_of(PEAK_S)
    peak = float(np.median([phi[row : row + reach].max() for row in recoveries]))
    recovery = np.linspace(LOWEST_RECOVERY, max(0.95 * peak, 1.5 * LOWEST_RECOVERY), GRID)
    entry = np.linspace(LOWEST_ENTRY, max(0.98 * peak, 1.5 * LOWEST_RECOVERY), GRID)
    tried = [StallLevels(float(a), float(b)) for a, b in product(recovery, entry)]
    taus_s = NONE if by_flow and passes.shift is not None else TAUS_S
    misfit = partial(_misfit, passes, spec, taus_s)
    best = min(tried, key=misfit)
    steps = recovery[1] - recovery[0], entry[1] - entry[0]
    for halving in range(1, HALVINGS + 1):
        best = _around(best, misfit, steps[0] / 2**halving, steps[1] / 2**halving)
    found = state_by_levels(passes, best)
    return (found, best) if _recoveries_are_seen(passes, found) else (state, None)


def _recoveries_are_seen(passes: Passes, in_stall: BoolArray) -> bool:
    """Return whether hub and tip see most of the episodes out of stall.

    Where all loops stay in stall, levels buy ψ' a second curve for the top of each loop: τ was 13
    to 44 % too small on 7 of 10 such records, and off by up to 19 % with the state by hub and tip.
    """
    if passes.shift is None:
        return True
    out = [run for run in runs_of(in_stall, in_stall.size) if not in_stall[run.start]]
    return 2 * sum(bool(passes.in_stall[run].all()) for run in out) <= len(out)


def refined_state(
    passes: Passes,
    spec: Specification,
    levels: StallLevels | None,
    near_s: float = math.nan,
    *,
    by_flow: bool = False,
) -> BoolArray:
    """Return the state of another record of the same machine, its levels searched nearby.

    ``levels`` and the time constant ``near_s`` are those of the first; see `estimated_state`.
    """
    if levels is None:
        return passes.in_stall
    taus_s = near_s * NEARBY if np.isfinite(near_s) else TAUS_S
    taus_s = NONE if by_flow and passes.shift is not None else taus_s
    misfit = partial(_misfit, passes, spec, taus_s)
    return state_by_levels(passes, _around(levels, misfit, 0.015, 0.03))


def _around(
    at: StallLevels, misfit: Callable[[StallLevels], float], step: float, entry_step: float
) -> StallLevels:
    recovery, entry = at.recovery_phi, at.entry_phi
    moves = product((0.0, -1.0, 1.0), repeat=2)
    tried = (StallLevels(recovery + i * step, entry + k * entry_step) for i, k in moves)
    return min(tried, key=misfit)


def _misfit(passes: Passes, spec: Specification, taus_s: FloatArray, levels: StallLevels) -> float:
    """Return twice the negative log likelihood of ψ', given a τ, and of hub-minus-tip flow."""
    state = state_by_levels(passes, levels)
    if min(np.count_nonzero(state), np.count_nonzero(~state)) < FEWEST_ROWS:
        return math.inf
    length_s, total = passes.phi.size * passes.sample_period_s, 0.0
    if taus_s.size:
        run = FreeRun.of(passes, spec, state)
        least = min(map(run.least_error, taus_s))
        total = length_s / INDEPENDENT_S * math.log(max(least, 1e-12))
    if passes.shift is not None:
        total += length_s / passes.period_s * math.log(_shift_error(passes, passes.shift, state))
    return total


def _shift_error(passes: Passes, shift: FloatArray, state: BoolArray) -> float:
    """Return the mean square of what the averaged state leaves of the hub-minus-tip flow."""
    stalled = passes.smooth(state.astype(np.float64), passes.period_s)
    flow = passes.smooth(passes.phi, passes.period_s)
    columns = np.column_stack([np.ones(stalled.size), stalled, stalled * flow])
    left = shift - columns @ np.linalg.lstsq(columns, shift)[0]
    return float(np.mean(left**2))
