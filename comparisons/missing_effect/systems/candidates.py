"""A candidate of the search, fitted and weighed, and a round of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from comparisons.missing_effect.evidence import LARGEST_P, Evidence
from comparisons.missing_effect.systems.bench import Bench
from comparisons.missing_effect.systems.dynamics import SLOTS
from comparisons.missing_effect.systems.fit import Fit
from comparisons.missing_effect.systems.metric import Metric
from comparisons.missing_effect.systems.model import Model
from comparisons.missing_effect.systems.places import Placed
from comparisons.missing_effect.systems.score import Probe
from comparisons.missing_effect.systems.shapes import Kind
from surge_core.types import FloatArray

# Effects that are nothing at the lower bound of their first number.
VANISHING = (Kind.INPUT_LAG, Kind.INPUT_DELAY, Kind.INPUT_PLAY, Kind.OUTPUT_LAG)
# An open term takes the place of a name only when it is better by this much.
UNNAMED_GAP = 12.0
# A term without a name that wins this share more on the rows fitted says that more is there.
OUTFITTED_SHARE = 0.5


@dataclass(frozen=True)
class Candidate:
    """One effect at one place, or two, fitted and weighed.

    Parameters
    ----------
    placed : Placed
        The effect, the first of two.
    probe : Probe
        What the score test promised.
    fit : Fit or None
        To the rows fitted, in the metric of the round; None where it was not promising.
    errors : ndarray or None
        Whitened errors, fitted rows before held-out ones.
    evidence : Evidence or None
        For it.
    raw : Fit or None
        The same in the raw metric.
    one_sided : bool
        Whether held-out blocks speak for it with hardly one against it, where it acts in episodes.
    wild : bool
        Whether small changes of the state grow much more with it than without.
    chance : float
        Log-units that the best of all candidates wins by chance.
    slow : float
        Log-units that it wins in plain errors, where those are more than chance.
    """

    placed: Placed
    probe: Probe
    fit: Fit | None = None
    errors: FloatArray | None = None
    evidence: Evidence | None = None
    raw: Fit | None = None
    one_sided: bool = False
    wild: bool = False
    chance: float = 0.0
    slow: float = 0.0

    @property
    def added(self) -> tuple[Placed, ...]:
        """The effects."""
        return self.probe.added

    @property
    def unnamed(self) -> bool:
        """Whether a term without a name is part of it."""
        return self.probe.unnamed

    def label(self, model: Model) -> str:
        """Return names and places in one line."""
        return " + ".join(placed.label(model) for placed in self.added)

    @property
    def score(self) -> float:
        """Its score; minus infinity where it was not fitted."""
        return -np.inf if self.evidence is None else self.evidence.score

    @property
    def accepted(self) -> bool:
        """Whether it stands, and wins more than the best of all candidates does by chance."""
        e = self.evidence
        return self.stands and e is not None and e.train + e.later > self.chance

    @property
    def stands(self) -> bool:
        """Whether fitted and held-out rows both speak for it, and it did not vanish."""
        e = self.evidence
        if e is None or self.vanished or self.wild:
            return False
        alone = e.later > 0.0 and e.p_value < LARGEST_P and self.one_sided
        return e.accepted or alone

    @property
    def accepted_slow(self) -> bool:
        """Whether it wins in plain errors what chance does not, here and on held-out rows.

        Chance is that of single effects: pairs are too many for it. The fast part of the errors
        must not speak against it.
        """
        e = self.evidence
        if e is None or e.train + e.later <= 0.0 or len(self.added) > 1:
            return False
        return self.slow > 0.0 and not self.vanished and not self.wild

    @property
    def vanished(self) -> bool:
        """Whether a first number ended at the bound where it is no effect any more.

        A lag or a delay of one sample is the timing offset that every model has.
        """
        return any(self._vanished(i) for i in range(len(self.added)))

    def _vanished(self, which: int) -> bool:
        placed = self.added[which]
        numbers = placed.effect.numbers
        if self.fit is None or not numbers:
            return False
        value = float(self.fit.theta[SLOTS * (which - len(self.added))])
        if placed.effect.linear:
            return value == 0.0
        smallest = placed.effect.kind in VANISHING
        return smallest and value <= numbers[0].low * (1.0 + 1e-6)

    @property
    def outgrown(self) -> bool:
        """Whether a shape ended at its upper bound: what is there is something wider."""
        if self.fit is None or not self.placed.effect.simple_form_of or len(self.added) > 1:
            return False
        shapes = self.fit.theta[-SLOTS:][1 : len(self.placed.effect.numbers)]
        bounds = [number.high for number in self.placed.effect.numbers[1:]]
        return any(value >= high * (1.0 - 1e-6) for value, high in zip(shapes, bounds, strict=True))


@dataclass(frozen=True)
class Round:
    """One round of the search.

    Parameters
    ----------
    bench : Bench
        The model of the round.
    metric : Metric
        In which candidates were weighed.
    candidates : tuple of Candidate
        All places tried, best first.
    winner : Candidate or None
        What is added.
    aliases : tuple of Candidate
        Those that the records cannot tell from the winner, the winner first.
    refused : mapping of str to str
        Effects that no signal can show, and why.
    rivalled : bool
        Whether a term without a name does as well as the winner.
    share : float
        Share of the squared whitened errors that the winner explains.
    rates : (float, float)
        Log-units that the winner gains a row, on rows fitted and held out.
    rival : Candidate or None
        The best name elsewhere that explains nearly as much as the winner.
    rival_p : float
        Chance of the winner's advantage if the rival were the truth.
    """

    bench: Bench
    metric: Metric
    candidates: tuple[Candidate, ...]
    winner: Candidate | None
    aliases: tuple[Candidate, ...]
    refused: dict[str, str]
    rivalled: bool = False
    share: float = 0.0
    rates: tuple[float, float] = (0.0, 0.0)
    rival: Candidate | None = None
    rival_p: float = 0.0

    @property
    def outfitted(self) -> bool:
        """Whether something without a name fits the rows fitted far better than the winner."""
        if self.winner is None or self.winner.evidence is None:
            return False
        won = self.winner.evidence.train
        return any(
            c.evidence.train > won + max(UNNAMED_GAP, OUTFITTED_SHARE * won)
            for c in self.candidates
            if c.evidence is not None and c.unnamed and not c.wild
        )
