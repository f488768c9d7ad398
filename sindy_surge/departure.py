"""Whether free runs speak against the parabola, and for what: a kink, a cubic, either, or nothing.

The error of the model comes again in every cycle, so that no likelihood and no cycle left out
shows what is part of the curve. What a needless term saves of the squared error differs from
record to record; records measured again from a fitted parabola (twins) show how much.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sindy_surge.linear_problem import Support, leave_out_moves
from surge_core.leave_out import scatter
from surge_core.types import IndexArray

if TYPE_CHECKING:
    from sindy_surge.sparse_run import FreeRunEquations

__all__ = ["Departure", "departure_from"]

# Gain is √(squared error saved / squared error of the parabola) over the free run. On 43 true
# parabolas (machines drawn at random, and the simulated rig) it was 0.06 to 0.56; 95 % stayed below
# 1.05 (0.2 + the mean of their own twins), which 30 % of the kinks of 25 exceeded; a constant of
# 0.56 holds as many of the parabolas and finds 21 % of the kinks.
_FACTOR, _BESIDE_TWINS = 1.05, 0.2
_WITHOUT_TWINS = 0.56
# A hinge near an end of the range stands for an error at the change of state.
_ENDS = (0.15, 0.9)


@dataclass(frozen=True)
class Departure:
    """What speaks against the parabola.

    Parameters
    ----------
    finding : {"kink", "kink or cubic", "undecidable"}
        What the curve has beside a parabola; undecidable where no more is saved than a needless
        term may save.
    gain, needed : float
        √(squared error saved / squared error of the parabola) at the best term, and what a
        departure takes.
    structure : tuple of int
        The terms.
    rivals : tuple of tuple of int
        Structures that the data do not separate from it.
    cubic, cubic_stderr : float
        Coefficient of φ³ beside the parabola, and its standard error from cycles left out.
    tried : tuple of tuple of int
        The structures that were compared.
    """

    finding: str
    gain: float
    needed: float
    structure: Support
    rivals: tuple[Support, ...]
    cubic: float
    cubic_stderr: float
    tried: tuple[Support, ...]

    @property
    def text(self) -> str:
        """Say what was found, in one sentence."""
        low, high = (self.cubic + side * 1.96 * self.cubic_stderr for side in (-1.0, 1.0))
        if self.finding == "undecidable":
            return (
                "whether the curve is a parabola is undecidable here: no kink and no cubic saves "
                f"more of the error than on a true parabola (gain {self.gain:.2f}, needed "
                f"{self.needed:.2f}); a cubic of {low:.0f} to {high:.0f} φ³ beside it is possible"
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
    cycles: IndexArray,
    twins: Sequence[FreeRunEquations],
) -> Departure:
    """Compare the parabola with a cubic and with a hinge at every knot.

    Each run has a parabola, nuisances and a lag of its own; knot and slope are common to all.

    Parameters
    ----------
    equations : FreeRunEquations
        The record or records, one run each.
    parabola, cubic : tuple of int
        The terms of each; of the cubic those of the parabola first.
    hinges : sequence of int
        Terms with a knot.
    cycles : ndarray of int of shape (n_rows,)
        Number of the cycle of each row.
    twins : sequence of FreeRunEquations
        The same measured again, where the truth is a parabola.
    """
    own = equations.apart()
    kinks = [(*parabola, hinge) for hinge in _inner(own, hinges)]
    others = [*kinks, cubic] if cubic != parabola else kinks
    nothing = Departure("undecidable", 0.0, np.inf, parabola, (), 0.0, np.inf, (parabola,))
    if not others:
        return nothing
    gains = [_gain(own, parabola, other) for other in others]
    best = others[int(np.argmax(gains))]
    nulls = [max(_gain(twin.apart(), parabola, o) for o in others) for twin in twins]
    needed = _needed(nulls)
    value, stderr = _cubic(own, cubic, cycles) if cubic != parabola else (0.0, np.inf)
    tried = tuple(dict.fromkeys((parabola, cubic, best)))
    found = max(gains)
    if not found > needed:
        return Departure("undecidable", found, needed, parabola, (), value, stderr, tried)
    if best == cubic or not kinks:
        kink = max(kinks, key=lambda k: gains[others.index(k)], default=best)
    else:
        kink = best
    beyond = _gain(own, cubic, (*cubic, kink[-1])) if kink[-1] not in cubic else 0.0
    null = [_gain(twin.apart(), cubic, (*cubic, kink[-1])) for twin in twins]
    if best != cubic and beyond > _needed(null):
        return Departure("kink", found, needed, best, (), value, stderr, tried)
    rivals = tuple(s for s in (cubic, kink) if s not in (best, parabola))
    return Departure("kink or cubic", found, needed, best, rivals, value, stderr, tried)


def _needed(nulls: Sequence[float]) -> float:
    """Return the gain that a departure takes, from the gains of twins."""
    return _FACTOR * (_BESIDE_TWINS + float(np.mean(nulls))) if nulls else _WITHOUT_TWINS


def _inner(own: Sequence[FreeRunEquations], hinges: Sequence[int]) -> list[int]:
    """Return the hinges with scored rows on either side of their knots."""
    values = np.concatenate([each.columns[each.scored] for each in own])
    above = [float(np.mean(values[:, hinge] > 0.0)) for hinge in hinges]
    return [h for h, share in zip(hinges, above, strict=True) if _ENDS[0] < share < _ENDS[1]]


def _gain(own: Sequence[FreeRunEquations], one: Support, other: Support) -> float:
    """Return √(share of the squared error saved) by a last term with one coefficient for all."""
    plain = sum(each.profiled(one)[0] for each in own)
    errors, values, information = np.array([each.profiled(other) for each in own]).T
    common = float(information @ values) / float(information.sum())
    saved = plain - float(errors.sum() + information @ (values - common) ** 2)
    return float(np.sqrt(max(saved, 0.0) / plain))


def _cubic(
    own: Sequence[FreeRunEquations], cubic: Support, cycles: IndexArray
) -> tuple[float, float]:
    """Return the coefficient of the last term over all runs, and its standard error."""
    found, first = [], 0
    for each in own:
        n_rows = each.output.size
        fit = each.solve(cubic)
        blocks = each.blocks(cycles[first : first + n_rows], float(fit.parameters[-1]))
        first += n_rows
        at = len(cubic) - 1
        variance = float(scatter(leave_out_moves(fit.joint, fit.residual, blocks))[at, at])
        found.append((float(fit.parameters[at]), variance))
    values, variances = np.array(found).T
    weights = 1.0 / variances
    return float(weights @ values / weights.sum()), float(weights.sum() ** -0.5)
