"""Sparse regression on free runs: a parabola, or what the runs speak for; τ and β with errors.

For columns that are ready-made, e.g. averaged after the terms were formed, and runs that are
scored only where the model holds. What such runs leave is coloured by the average and has an
error of the model in it, which comes again in every cycle, so that no likelihood and no cycle left
out shows what is part of the curve. What shows it is the share of the squared error that a term
saves over the whole free run, against what needless terms save on true parabolas.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sindy_surge.candidate_terms import independent_columns
from sindy_surge.free_run import FreeRunEquations, FreeRunFit
from sindy_surge.held_out import Trials, polynomial_ladder, with_held_out
from sindy_surge.linear_problem import Support, least_squares, leave_out_moves
from sindy_surge.selection import PathRow
from surge_core.fit_state import FitState
from surge_core.leave_out import scatter
from surge_core.types import FloatArray, IndexArray

# Gain is √(squared error saved / squared error of the parabola) over the free run. On 90 true
# parabolas of machines drawn at random, gain · √(seconds scored) was 0.21 in the middle, 0.39 for
# nine of ten and 0.46 for 95 %; of 46 fresh ones 4 exceeded it. The fewer passes, the more of their
# errors a term follows.
_GAIN_OF_A_SECOND = 0.47
# Beyond a cubic, the gain of a kink where the truth is a cubic: 95 % below.
_BEYOND_CUBIC = 0.54
# A hinge near an end of the range stands for an error at the change of state.
_ENDS = (0.15, 0.9)


@dataclass(frozen=True)
class Departure:
    """What speaks against the parabola."""

    # {"kink", "kink or cubic", "undecidable"}: What the curve has beside a parabola; undecidable
    # where no more is saved than a needless term may save
    finding: str
    # √(squared error saved / squared error of the parabola) at the best term, and what a departure
    # takes
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
                    "whether the curve is a parabola was not judged: that takes four terms and two "
                    "rakes, each with hub and tip"
                )
            return (
                "the record does not decide whether the curve is a parabola: a kink or a cubic "
                f"lowers the error no more than on true parabolas (gain {self.gain:.2f}, needed "
                f"{self.needed:.2f}). A term of {low:.0f} to {high:.0f} φ³ fits as well"
            )
        which = "a kink" if self.finding == "kink" else "a kink or a cubic, which are rivals here"
        return (
            f"the curve is no parabola but has {which} (gain {self.gain:.2f}, needed "
            f"{self.needed:.2f}; as a cubic {low:.0f} to {high:.0f} φ³)"
        )


def departure_from(
    equations: FreeRunEquations,
    parabola: Support,
    cubic: Support,
    hinges: Sequence[int],
    seconds: float,
) -> Departure:
    """Compare the parabola with a cubic, whose first terms it is, and with a hinge at every knot.

    Each run has a parabola, nuisances and a lag of its own; knot and slope are common to all. The
    ``seconds`` are those scored for τ in each run, on average; 0 for runs that cannot show the
    shape.
    """
    own = equations.apart()
    kinks = [(*parabola, hinge) for hinge in _inner(own, hinges)]
    others = [*kinks, cubic] if cubic != parabola else kinks
    if not others or not all(each.scored.size for each in own):
        anything = -math.inf, math.inf
        return Departure("undecidable", 0.0, math.inf, parabola, (), anything, (parabola,))
    saved = {other: _saved(own, parabola, other) for other in others}
    gains = [saved[other][0] for other in others]
    best = others[int(np.argmax(gains))]
    needed = _GAIN_OF_A_SECOND / math.sqrt(seconds) if seconds > 0.0 else math.inf
    _, value, reach = saved.get(cubic, (0.0, 0.0, math.inf))
    within = value - needed * reach, value + needed * reach
    tried = tuple(dict.fromkeys((parabola, cubic, best)))
    found = max(gains)
    if not found > needed:
        return Departure("undecidable", found, needed, parabola, (), within, tried)
    if best != cubic and _saved(own, cubic, (*cubic, best[-1]))[0] > _BEYOND_CUBIC:
        return Departure("kink", found, needed, best, (), within, tried)
    kink = max(kinks, key=lambda other: saved[other][0], default=best)
    rivals = tuple(s for s in (cubic, kink) if s not in (best, parabola))
    return Departure("kink or cubic", found, needed, best, rivals, within, tried)


def _inner(own: Sequence[FreeRunEquations], hinges: Sequence[int]) -> list[int]:
    """Return the hinges with scored rows on either side of their knots."""
    values = np.concatenate([each.columns[each.scored] for each in own])
    above = [float(np.mean(values[:, hinge] > 0.0)) for hinge in hinges]
    return [h for h, share in zip(hinges, above, strict=True) if _ENDS[0] < share < _ENDS[1]]


def _saved(
    own: Sequence[FreeRunEquations], one: Support, other: Support
) -> tuple[float, float, float]:
    """Return what a last term with one coefficient for all runs saves.

    That is √(share of the squared error saved), the coefficient, and the one of gain 1.
    """
    plain = sum(each.profiled(one)[0] for each in own)
    errors, values, information = np.array([each.profiled(other) for each in own]).T
    common = float(information @ values) / float(information.sum())
    saved = plain - float(errors.sum() + information @ (values - common) ** 2)
    reach = math.sqrt(plain / float(information.sum()))
    return math.sqrt(max(saved, 0.0) / plain), common, reach


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
    *,
    judged: FreeRunEquations | None = None,
    shows_shape: bool = True,
    max_terms: int = 6,
    common_tau_share: float = 0.0,
    common_curve_share: float = 0.0,
) -> SparseRun:
    """Choose a parabola, a cubic or a parabola with a kink, and fit it on free runs.

    The parabola is left only where that saves more of the error than a needless term does, and
    where the runs show the shape at all. ``names`` and total ``degrees`` are those of the candidate
    terms, None for one that is no polynomial; ``cycles`` numbers the cycle of each row, which is
    left out as one. ``judged`` are the same columns with other rows scored, on which terms are
    chosen: more rows show more of the curve, where they would move τ. The common shares are
    standard errors of τ, and of the mean of abs(ψ'), that no jackknife over cycles sees.
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
    equations = replace(equations, columns=columns[:, usable])
    blocks = equations.blocks(cycles, pilot_s)
    trials = Trials(equations, [(rows, rows) for rows in blocks], _MOST_LEVERAGE)
    kept = [names[i] for i in usable]
    powers = [degrees[i] for i in usable]
    ladder = [*polynomial_ladder(powers, most), tuple(range(most))]
    parabola, cubic = ladder[min(1, len(ladder) - 2)], ladder[min(2, max(len(ladder) - 2, 0))]
    hinges = [i for i, name in enumerate(kept) if name.startswith("relu") and most > len(parabola)]
    judge = equations if judged is None else replace(judged, columns=judged.columns[:, usable])
    seconds = equations.scored.size * equations.sample_period_s / equations.runs.starts.size
    found = departure_from(judge, parabola, cubic, hinges, seconds if shows_shape else 0.0)
    chosen = found.structure
    for structure in found.tried:
        trials.error(structure)
    fit = equations.solve(chosen)
    # The nuisances are estimated again without each cycle as well.
    moves = leave_out_moves(fit.joint, fit.residual, blocks)
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
