"""Whether free runs speak against the parabola, and for what: a kink, a cubic, either, or nothing.

The error of the model comes again in every cycle, so that no likelihood and no cycle left out
shows what is part of the curve. What shows it is the share of the squared error that a term saves
over the whole free run, against what needless terms save on true parabolas.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sindy_surge.free_run_equations import FreeRunEquations
from sindy_surge.linear_problem import Support

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
