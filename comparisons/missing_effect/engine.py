"""What the search works on: a system and its policy, candidates, and rounds.

A system is a model that stands so far, with its records: a lag series, whole runs from counts, or
a user's own model. It lays effects along its run and fits them; everything else is one search
(`search.search`) for all of them, whose rules are one and whose measured numbers are the policy's.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from comparisons.missing_effect.evidence import (
    ALIAS,
    LEAST_Z,
    NOT_FITTED,
    Evidence,
    Rows,
    Tie,
    are_alike,
    evidence_of,
)
from surge_core.types import FloatArray


class Addition(Protocol):
    """What may be added to a model: an effect at its place."""

    @property
    def name(self) -> str:
        """Name of the effect."""

    @property
    def key(self) -> Hashable:
        """What makes it the same as another: name and place."""

    @property
    def unnamed(self) -> bool:
        """Whether it is a term without a name."""

    @property
    def brings(self) -> int:
        """How many numbers and states it adds."""

    def is_plain_form_of(self, other: Any) -> bool:
        """Tell whether another is this one with something more, at the same place."""


class Fitted(Protocol):
    """A model with its numbers."""

    @property
    def n_parameters(self) -> int:
        """Numbers that were fitted."""


A = TypeVar("A", bound=Addition)
F = TypeVar("F", bound=Fitted)
# Names behind which a second effect is looked for.
MOST_HEADS = 3


@dataclass(frozen=True)
class Policy:
    """What differs between the kinds of systems for a measured reason.

    Parameters
    ----------
    term : Tie
        A term without a name takes the place of a name only where the rows tell the two apart.
    same_share, same_cosine : float
        Nor where the name wins this share of what the term wins, by nearly the same correction.
    alias : Tie
        When two stand beside each other.
    one_sided : float
        See `evidence_of`.
    plain_speaks : bool
        Whether of a set the one with fewest numbers speaks, and not the best.
    terms_stand : bool
        Whether terms without a name stand beside another.
    refused_stand : bool
        Whether what is not accepted by itself may stand beside what is.
    rival_share : float, optional
        What explains this share of what the winner explains, elsewhere, is a rival.
    further_share, further_raw : float
        What an effect beyond the first must explain: of the squared whitened errors, or of the
        squared plain errors on held-out rows.
    stops_clean : bool
        Whether the search ends once what is left is chance.
    aliases_refitted : bool
        Whether each of an alias set must stand in the model that was found, fitted again.
    """

    term: Tie
    same_share: float = np.inf
    same_cosine: float = 1.0
    alias: Tie = ALIAS
    one_sided: float = 0.0
    plain_speaks: bool = False
    terms_stand: bool = False
    refused_stand: bool = False
    rival_share: float | None = None
    further_share: float = 0.0
    further_raw: float = 0.0
    stops_clean: bool = False
    aliases_refitted: bool = False


@dataclass(frozen=True, eq=False)
class Candidate(Generic[A, F]):
    """A model with something added, fitted and weighed.

    Parameters
    ----------
    added, fit : tuple, Fit
        What it has that the model has not, fitted to the rows in the metric of the round; the
        model's own fit where it promised too little.
    errors, evidence : ndarray of shape (n,), Evidence
        Whitened errors on all rows, by which it differs from others, and what speaks for it.
    promised, rank : float
        Log-units that a score test promised, and those by which candidates are ranked.
    onward : Fit, optional
        The fit from which the model goes on: to all rows, or in the raw metric.
    slow : float
        Log-units that it wins in plain errors, where those are more than chance.
    outgrown : bool
        Whether a shape ended at its upper bound: what is there is something wider.
    """

    added: tuple[A, ...]
    fit: F
    errors: FloatArray = field(default_factory=lambda: np.zeros(0))
    evidence: Evidence = NOT_FITTED
    promised: float = float("nan")
    rank: float = -np.inf
    onward: F | None = None
    slow: float = 0.0
    outgrown: bool = False

    @property
    def name(self) -> str:
        """Identifier."""
        return " + ".join(one.name for one in self.added)

    @property
    def keys(self) -> frozenset[Hashable]:
        """What makes it the same as another, whatever the order."""
        return frozenset(one.key for one in self.added)

    @property
    def unnamed(self) -> bool:
        """Whether a term without a name is part of it."""
        return any(one.unnamed for one in self.added)

    @property
    def fitted(self) -> bool:
        """Whether it promised enough to be fitted."""
        return self.evidence is not NOT_FITTED

    @property
    def accepted(self) -> bool:
        """Whether all rows speak for it, beyond chance."""
        return self.evidence.accepted

    @property
    def accepted_slow(self) -> bool:
        """Whether it wins in plain errors what chance does not, here and on held-out rows.

        The fast part of the errors must not speak against it, beyond the scatter of the held-out
        blocks.
        """
        e = self.evidence
        against = e.train <= 0.0 or e.z < -LEAST_Z
        return self.slow > 0.0 and not (against or e.at_end)


class System(ABC, Generic[A, F]):
    """A model that stands so far, on its records, in the metric in which candidates are weighed."""

    policy: Policy
    fit: Any

    @property
    def found(self) -> tuple[A, ...]:
        """What was added to the model."""
        added: tuple[A, ...] = self.fit.structure.effects
        return added

    @property
    def failed(self) -> bool:
        """Whether the model could not be simulated."""
        return False

    @property
    def base(self) -> F:
        """The model, fitted in the metric."""
        own: F = self.fit
        return own

    @property
    @abstractmethod
    def base_errors(self) -> FloatArray:
        """Its whitened errors on all rows."""

    @property
    @abstractmethod
    def rows(self) -> Rows:
        """Which rows are fitted and held out, and their blocks."""

    @abstractmethod
    def tried(self, effects: Sequence[Any], library: Sequence[Any]) -> Tried[A, F]:
        """Lay effects along the run, race what promises, and fit in the metric of the best."""

    @abstractmethod
    def errors_of(self, fit: F) -> tuple[FloatArray, tuple[float, float]]:
        """Return whitened errors on all rows, and what phases fitted there cost."""

    @abstractmethod
    def searched(self, added: Sequence[A]) -> float:
        """Return how many independent trials the search for something was worth."""

    @abstractmethod
    def with_winner(self, step: Round[A, F]) -> System[A, F]:
        """Return the model with what a round found."""

    @abstractmethod
    def without_needless(self, one: A) -> System[A, F] | None:
        """Return the model without something it has, fitted again, if it can do without."""

    def with_refined(self, plain: A, refined: Candidate[A, F]) -> System[A, F] | None:
        """Return it with a refined form for its plain form and what acts beside that, if alike."""
        return None

    def judged(self, candidate: Candidate[A, F]) -> Candidate[A, F]:
        """Return a weighed candidate with what this kind of system says of it beside."""
        return candidate

    def ranked(self, candidates: Sequence[Candidate[A, F]]) -> tuple[Candidate[A, F], ...]:
        """Return candidates, best first."""
        return tuple(sorted(candidates, key=lambda c: -c.rank))

    def near(
        self, best: Candidate[A, F], others: Sequence[Candidate[A, F]], tie: Tie
    ) -> list[Candidate[A, F]]:
        """Return those of several that the rows do not tell from the best."""
        top = max([best, *others], key=lambda c: c.rank)
        return [
            c
            for c in others
            if c is top
            or are_alike(
                self.rows, self.base_errors, (c.errors, top.errors), (c.rank, top.rank), tie
            )
        ]

    def heads(self, ranked: Sequence[Candidate[A, F]]) -> list[Candidate[A, F]]:
        """Return the names beside which a second effect may be looked for."""
        return [c for c in ranked if not c.unnamed][:MOST_HEADS]

    def second(
        self, head: Candidate[A, F], effects: Sequence[Any], known: Collection[frozenset[Hashable]]
    ) -> list[Candidate[A, F]]:
        """Return a candidate with each second effect that its errors ask for, not weighed."""
        return []

    def leftover(
        self, winner: Candidate[A, F] | None, effects: Sequence[Any], library: Sequence[Any]
    ) -> Any:
        """Return what the model leaves with a winner; None where that is tested at the end."""
        return None

    def leaves_nothing(self, candidate: Candidate[A, F]) -> bool:
        """Tell whether a candidate surely leaves nothing more to be found."""
        return False

    def stand_ins(
        self, one: A, step: Round[A, F] | None, effects: Sequence[Any]
    ) -> tuple[Candidate[A, F], ...]:
        """Return what could stand in the place of something that was found, it first."""
        return () if step is None else step.aliases

    def rejected(self, winner: Candidate[A, F], rival: Candidate[A, F]) -> float:
        """Return the chance of a winner's advantage if its rival were the truth.

        Asked only of systems whose policy has a ``rival_share``.
        """
        raise NotImplementedError

    def held_out_size(self) -> float:
        """Return the plain error on held-out rows; asked only with a ``further_share``."""
        raise NotImplementedError

    def weighed(self, candidate: Candidate[A, F]) -> Candidate[A, F]:
        """Return a candidate, fitted in this metric, with its evidence against the model."""
        errors, phases = self.errors_of(candidate.fit)
        evidence = evidence_of(
            self.rows,
            self.base_errors,
            errors,
            added=candidate.fit.n_parameters - self.base.n_parameters,
            searched=self.searched(candidate.added),
            episodes=phases,
            one_sided=self.policy.one_sided,
        )
        return self.judged(
            replace(candidate, errors=errors, evidence=evidence, rank=evidence.score)
        )


@dataclass(frozen=True, eq=False)
class Tried(Generic[A, F]):
    """What came out of a race: the model in the metric of the best, and what was fitted in it.

    ``others`` promised too little, where they are listed; ``refused`` says why no signal can show
    an effect.
    """

    system: Any
    candidates: Sequence[Candidate[A, F]]
    others: Sequence[Candidate[A, F]] = ()
    refused: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Round(Generic[A, F]):
    """One round of the search.

    Parameters
    ----------
    bench : System
        The model of the round, in its metric.
    candidates : tuple of Candidate
        All that was tried, best first, pairs behind.
    winner, aliases : Candidate or None, tuple of Candidate
        What is added, if anything is; those that the records cannot tell from it, it first.
    refused : mapping of str to str
        Effects that no signal can show, and why.
    leftover : Leftover
        What the winner, or the model itself, leaves; None where that is tested at the end.
    rivalled : bool
        Whether a term without a name does as well as the winner.
    share, rates : float, (float, float)
        Share of the squared whitened errors that the winner explains, and the log-units that it
        gains a row, on rows fitted and held out.
    rival, rival_p : Candidate or None, float
        The best elsewhere that explains nearly as much as the winner, and the chance of the
        winner's advantage if it were the truth.
    """

    bench: Any
    candidates: tuple[Candidate[A, F], ...]
    winner: Candidate[A, F] | None
    aliases: tuple[Candidate[A, F], ...] = ()
    refused: Mapping[str, str] = field(default_factory=dict)
    leftover: Any = None
    rivalled: bool = False
    share: float = 0.0
    rates: tuple[float, float] = (0.0, 0.0)
    rival: Candidate[A, F] | None = None
    rival_p: float = 0.0
