"""Sparse regression on free runs: a parabola, or what the runs speak for; τ and β with errors.

For columns that are ready-made, e.g. averaged after the terms were formed, and runs that are
scored only where the model holds. What such runs leave is coloured by the average and has an
error of the model in it, which comes again in every cycle, so that no likelihood and no cycle left
out shows what is part of the curve. What shows it is the rms of ψ' that a term saves over the whole
free run, against what needless terms save on true parabolas.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sindy_surge.candidate_terms import independent_columns
from sindy_surge.free_run import FreeRunEquations, FreeRunFit
from sindy_surge.held_out import Trials, polynomial_ladder, with_held_out
from sindy_surge.linear_problem import Support, least_squares
from sindy_surge.selection import PathRow
from surge_core.fit_state import FitState
from surge_core.leave_out import leave_out, scatter
from surge_core.types import FloatArray, IndexArray

# Gain is √(squared error saved / rows); by the standard deviation of φ in stall, averaged with the
# state as all terms are, a slope. On 84 true parabolas of machines drawn at random that slope was
# 0.12 in the middle, 0.25 for nine of ten and 0.32 for 95 %, on 25 pairs of them 0.31.
_NEEDED_SLOPE = 0.33
# Beyond a cubic, the slope of a kink where the truth is a cubic of 600: 95 % below.
_BEYOND_CUBIC_SLOPE = 0.95
# A hinge near an end of the range stands for an error at the change of state.
_ENDS = (0.15, 0.9)


@dataclass(frozen=True)
class Departure:
    """What speaks against the parabola."""

    # {"kink", "kink or cubic", "undecidable"}: What the curve has beside a parabola; undecidable
    # where no more is saved than a needless term may save
    finding: str
    # √(squared error saved / rows), in ψ', of the best term, and what a departure takes
    gain: float
    needed: float
    structure: Support  # The terms
    rivals: tuple[Support, ...]  # Structures that the data do not separate from it
    # Coefficients of φ³ beside the parabola that save no more than a needless term may
    cubic: tuple[float, float]
    tried: tuple[Support, ...]  # The structures that were compared

    @property
    def text(self) -> str:
        """Say what was found, in one sentence."""
        low, high = self.cubic
        if self.finding == "undecidable":
            if not math.isfinite(self.needed):
                return (
                    "whether the curve is a parabola was not judged: that takes four terms, two "
                    "rakes with hub and tip each, and rows in stall on both sides of a knot"
                )
            return (
                "the record does not decide whether the curve is a parabola: a kink or a cubic "
                f"saves no more than on true parabolas (rms {self.gain:.3f} of ψ', needed "
                f"{self.needed:.3f}). A term of {low:.0f} to {high:.0f} φ³ fits as well"
            )
        which = "a kink" if self.finding == "kink" else "a kink or a cubic, which are rivals here"
        return (
            f"the curve is no parabola but has {which} (it saves rms {self.gain:.3f} of ψ', "
            f"needed {self.needed:.3f}; as a cubic {low:.0f} to {high:.0f} φ³)"
        )


def departure_from(
    own: Sequence[FreeRunEquations], parabola: Support, cubic: Support, hinges: Sequence[int]
) -> Departure:
    """Compare the parabola with a cubic, whose first terms it is, and with a hinge at every knot.

    Each record has a parabola, nuisances and a lag of its own; knot and slope are common to all.
    Without records nothing is judged.
    """
    shown = len(parabola) > 1 and bool(own) and all(len(_in_stall(e, parabola)) for e in own)
    kinks = [(*parabola, hinge) for hinge in _inner(own, parabola, hinges)] if shown else []
    others = [*kinks, cubic] if shown and cubic != parabola else kinks
    if not others:
        anything = -math.inf, math.inf
        return Departure("undecidable", 0.0, math.inf, parabola, (), anything, (parabola,))
    saved = {other: _saved(own, parabola, other) for other in others}
    gains = [saved[other][0] for other in others]
    best = others[int(np.argmax(gains))]
    variances = [float(np.var(_in_stall(each, parabola)[:, parabola[1]])) for each in own]
    spread = math.sqrt(np.average(variances, weights=[each.scored.size for each in own]))
    needed = _NEEDED_SLOPE * spread
    _, value, reach = saved.get(cubic, (0.0, 0.0, math.inf))
    within = value - needed * reach, value + needed * reach
    tried = tuple(dict.fromkeys((parabola, cubic, best)))
    found = max(gains)
    if not found > needed:
        return Departure("undecidable", found, needed, parabola, (), within, tried)
    beyond = 0.0 if best == cubic else _saved(own, cubic, (*cubic, best[-1]))[0]
    if beyond > _BEYOND_CUBIC_SLOPE * spread:
        return Departure("kink", found, needed, best, (), within, tried)
    kink = max(kinks, key=lambda other: saved[other][0], default=best)
    rivals = tuple(s for s in (cubic, kink) if s not in (best, parabola))
    return Departure("kink or cubic", found, needed, best, rivals, within, tried)


def _in_stall(equations: FreeRunEquations, parabola: Support) -> FloatArray:
    """Return the columns of the scored rows in stall.

    The constant, averaged with the state as all terms are, tells which these are.
    """
    scored = equations.columns[equations.scored]
    return np.asarray(scored[scored[:, parabola[0]] > 0.5])


def _inner(own: Sequence[FreeRunEquations], parabola: Support, hinges: Sequence[int]) -> list[int]:
    """Return the hinges with rows in stall on either side of their knots."""
    values = np.concatenate([_in_stall(each, parabola) for each in own])
    above = [float(np.mean(values[:, hinge] > 0.0)) for hinge in hinges]
    return [h for h, share in zip(hinges, above, strict=True) if _ENDS[0] < share < _ENDS[1]]


def _saved(
    own: Sequence[FreeRunEquations], one: Support, other: Support
) -> tuple[float, float, float]:
    """Return what a last term with one coefficient for all runs saves.

    That is √(squared error saved / rows), the coefficient, and the one of gain 1.
    """
    plain, rows = sum(each.profiled(one)[0] for each in own), sum(each.scored.size for each in own)
    errors, values, information = np.array([each.profiled(other) for each in own]).T
    common = float(information @ values) / float(information.sum())
    saved = plain - float(errors.sum() + information @ (values - common) ** 2)
    reach = math.sqrt(rows / float(information.sum()))
    return math.sqrt(max(saved, 0.0) / rows), common, reach


# A cycle that alone reaches part of the range of φ cannot be foretold by the others: its error
# would decide the mean of twenty.
_MOST_LEVERAGE = 0.5
# The first terms of a library are its simplest: enough to find the basin of τ.
_SIMPLEST = 3
# Scored rows for each parameter; below it nothing is fitted.
_ROWS_A_PARAMETER = 2


@dataclass(frozen=True)
class SparseRun:
    """Terms, τ and β found on free runs; without terms where too few rows are scored."""

    support: Support = ()  # Columns of the terms that were chosen
    terms: tuple[str, ...] = ()  # Their names
    time_constant_s: float = float("nan")  # τ in seconds
    # (n_terms,): β in physical units
    coefficients: FloatArray = field(default_factory=lambda: np.zeros(0))
    # (n_terms + 1, n_terms + 1): Of β and, last, τ: a jackknife over cycles, what all cycles share
    # and, where others stand beside it, what structures differ by that the data cannot separate
    # from the chosen one
    covariance: FloatArray = field(default_factory=lambda: np.full((1, 1), np.nan))
    n_blocks: int = 0  # Cycles behind the jackknife
    departure: Departure | None = None  # What speaks against the parabola
    path: tuple[PathRow, ...] = ()  # Every structure tried, with its error on cycles left out
    state: FitState = FitState.TOO_FEW_ROWS  # What became of the fit

    @property
    def time_constant_stderr_s(self) -> float:
        """Standard error of τ in seconds."""
        return float(np.sqrt(self.covariance[-1, -1]))


def select_on_free_run(
    equations: FreeRunEquations,
    names: Sequence[str],
    degrees: Sequence[int | None],
    cycles: IndexArray,
    judged: Sequence[FreeRunEquations],
    *,
    max_terms: int = 6,
    common_tau_share: float = 0.0,
    common_curve_share: float = 0.0,
) -> SparseRun:
    """Choose a parabola, a cubic or a parabola with a kink, and fit it on free runs.

    The parabola is left only where that saves more than a needless term does. ``names`` and total
    ``degrees`` are those of the candidate terms, None for one that is no polynomial; ``cycles``
    numbers the cycle of each row, which is left out as one. ``judged`` are the same columns on
    other rows of each record, which show more of the curve, where they would move τ; empty where a
    record does not show the shape. The common shares are standard errors of τ, and of the mean of
    abs(ψ'), that no jackknife over cycles sees.
    """
    columns = equations.columns
    most = min(max_terms, columns.shape[1])
    unknowns = most + equations.nuisance.shape[1] + equations.runs.starts.size + 1
    if equations.scored.size < _ROWS_A_PARAMETER * unknowns:
        return SparseRun()
    # τ of the simplest terms shows what can be separated, and how long errors hang together.
    pilot_s = float(equations.solve(tuple(range(min(_SIMPLEST, most)))).parameters[-1])
    usable = independent_columns(equations.simulated(pilot_s))
    if not usable.size:
        return SparseRun()
    most = min(most, usable.size)
    equations = replace(equations, columns=columns[:, usable])
    blocks = equations.blocks(cycles, pilot_s)
    trials = Trials(equations, [(rows, rows) for rows in blocks], _MOST_LEVERAGE)
    kept = [names[i] for i in usable]
    powers = [degrees[i] for i in usable]
    ladder = [*polynomial_ladder(powers, most), tuple(range(most))]
    parabola, cubic = ladder[min(1, len(ladder) - 2)], ladder[min(2, max(len(ladder) - 2, 0))]
    hinges = [i for i, name in enumerate(kept) if name.startswith("relu") and most > len(parabola)]
    own = [replace(each, columns=each.columns[:, usable]) for each in judged]
    found = departure_from(own, parabola, cubic, hinges)
    chosen = found.structure
    for structure in found.tried:
        trials.error(structure)
    fit = equations.solve(chosen)
    # The nuisances are estimated again without each cycle as well.
    moves, _ = leave_out(-fit.joint, fit.residual, blocks)
    n = len(chosen)
    covariance = scatter(np.delete(moves, np.s_[n : n + fit.nuisance.size], axis=1))
    common_shares = common_tau_share, common_curve_share
    covariance += _beyond_cycles(equations, fit, chosen, found.rivals, common_shares)
    tau, stderr = float(fit.parameters[-1]), float(np.sqrt(covariance[-1, -1]))
    if tau < equations.sample_period_s / 2:
        state = FitState.LAG_BELOW_RESOLUTION
    elif not stderr < tau or tau > 0.99 * equations.longest_lag_s:
        state = FitState.LAG_UNDETERMINED
    else:
        state = FitState.OK
    return SparseRun(
        tuple(int(usable[i]) for i in chosen),
        tuple(kept[i] for i in chosen),
        tau,
        fit.parameters[:-1],
        covariance,
        len(blocks),
        found,
        with_held_out((), trials, chosen, kept),
        state,
    )


def _beyond_cycles(
    equations: FreeRunEquations,
    fit: FreeRunFit,
    chosen: Support,
    rivals: Sequence[Support],
    common_shares: tuple[float, float],
) -> FloatArray:
    """Return the covariance of what no jackknife over cycles sees.

    The choice among structures that the data cannot separate adds the mean square of what the curve
    and τ of each differ by, the curves as far as the terms that were chosen can follow; errors that
    all cycles share add their shares of τ and of the curve's level.
    """
    values, tau = equations.columns[equations.scored], float(fit.parameters[-1])
    own = values[:, list(chosen)]
    curve = own @ fit.parameters[:-1]
    result = np.zeros((len(chosen) + 1, len(chosen) + 1))
    for rival in rivals:
        other = equations.solve(rival).parameters
        apart = least_squares(own, values[:, list(rival)] @ other[:-1] - curve)
        shift = np.append(apart, other[-1] - tau)
        result += np.outer(shift, shift) / len(rivals)
    # The level moves along whatever the terms make of a constant.
    level = least_squares(own, np.ones(len(own))) * common_shares[1]
    level = level * float(np.mean(np.abs(equations.output[equations.scored])))
    result[:-1, :-1] += np.outer(level, level)
    result[-1, -1] += (common_shares[0] * tau) ** 2
    return result
