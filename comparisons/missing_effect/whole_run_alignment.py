"""A plane that is recorded late: named by the flows of both planes, in which is no lag of ψ'."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import astuple, dataclass, replace
from typing import Self

import numpy as np

from classic_ml.work.alignment import ACCURACY_S, ON_TIME_S, STANDARD_ERRORS, Alignment
from comparisons.missing_effect.candidates import LagCandidate, LagRound
from comparisons.missing_effect.catalogue import NAMELESS
from comparisons.missing_effect.effect import Effect
from comparisons.missing_effect.results import Absent, MissingEffect, Untold
from comparisons.missing_effect.whole_runs import WholeRuns

DELAY, LAG = "transport_delay", "second_order_lag"
EARLY_PLANE = "plane 31 is early, by waves or a clock, and what that leaves may be read as a lag"
LATE_PLANE = "what a late plane leaves takes other names"
WITHOUT_DELAY = "the same records with plane 31 on the clock of plane 25"
NO_NAME = "by the flows plane 31 is late, {} would do as well, and has no name in the catalogue"

Named = tuple[WholeRuns, list[LagRound], dict[Hashable, tuple[LagCandidate, ...]]]


@dataclass(frozen=True)
class PlaneTiming:
    """What the flows of both planes say of the names for a plane that is late.

    Parameters
    ----------
    found : Alignment
        Of all records: they share a recorder.
    slow : tuple of Effect
        What can have made plane 31 late; empty where it is on time.
    nameless : str
        What can, and has no name among the effects that compete; empty for nothing.
    refuted : tuple of Effect
        What cannot be there to any size, since plane 31 is on time.
    """

    found: Alignment
    slow: tuple[Effect, ...]
    nameless: str
    refuted: tuple[Effect, ...]

    @classmethod
    def of(cls, each: Sequence[Alignment], effects: Sequence[Effect]) -> Self:
        """Hold the alignment of the records of a test against the effects that compete."""
        values = np.array([astuple(one) for one in each])
        late_s, stderr_s, *others = np.mean(values, axis=0).tolist()
        found = Alignment(late_s, max(stderr_s, float(np.std(values[:, 0]))), *others)
        by_name, names = {effect.name: effect for effect in effects}, _slow_names(found)
        return cls(
            found,
            tuple(_as_late(by_name[name], found) for name in names if name in by_name),
            next((NO_NAME.format(NAMELESS[name]) for name in names if name not in by_name), ""),
            (by_name[DELAY],) if found.on_time and DELAY in by_name else (),
        )

    def named(self, bench: WholeRuns) -> Named:
        """Return a model with the first of them, its round, and all as its alias set.

        That is the delay, also where it may be a lag: of as much as the flows are late it leaves
        τ right (17.9 and 18.7 ms for 18 where a lag of 5 ms was hidden). What ψ' takes for a second
        lag need not be what the flows show: of 20 late planes two gave none, one a lag of 22 ms.
        """
        aliases = tuple(map(bench.weighed, bench.tried(self.slow).candidates))
        step = LagRound(bench, aliases, aliases[0], aliases, leftover=bench.leftover(None, (), ()))
        return bench.with_winner(step), [step], {aliases[0].added[0].key: aliases}

    def judged(self, item: MissingEffect) -> MissingEffect:
        """Return an effect that is firm by the flows; of a delay they give the number, too.

        Where they show waves a lag is not firm: on 2 of 59 records it was, and they had none.
        """
        if self.found.early:
            return item.doubted(EARLY_PLANE) if item.effect in (DELAY, LAG) else item
        if not self.found.late:
            return item
        numbers = item.parameters
        if item.effect == DELAY:
            # By how much a wave made it early is between nothing and its time: a bound of ± a is a
            # standard deviation of a/√3 (JCGM 100:2008, 4.3.7).
            parts = self.found.stderr_s, ACCURACY_S, self.found.wave_s / np.sqrt(3.0)
            stderr = float(np.linalg.norm(parts))
            numbers = (replace(numbers[0], value=self.found.late_s, stderr=stderr),)
        evidence = {**item.evidence, "late_by_flows_s": self.found.late_s}
        sure = replace(item, parameters=numbers, evidence=evidence, provisional=False, doubts=())
        return sure.doubted(self.nameless) if self.nameless else sure

    @property
    def remarks(self) -> tuple[str, ...]:
        """Say how much later than its flow plane 31 may be."""
        found = self.found
        least = f"By the flows of both planes plane 31 is late by {1e3 * found.late_s:.2f} ms"
        more = f"a wave in the duct can hide up to {1e3 * found.wave_s:.2f} ms more"
        return (f"{least} or more: {more}.",) if found.late else ()

    def untold(self, effects: Sequence[Effect]) -> tuple[Untold, ...]:
        """Return the effects about which records with a late plane decide nothing."""
        return tuple(Untold(effect.name, LATE_PLANE, WITHOUT_DELAY) for effect in effects)

    @property
    def absent(self) -> tuple[Absent, ...]:
        """What would have been seen, and from which size on: of less a wave may hide all."""
        least_s = ON_TIME_S + self.found.wave_s
        return tuple(Absent(effect.name, "d", least_s, "s") for effect in self.refuted)


def _slow_names(found: Alignment) -> tuple[str, ...]:
    """Return what can have made plane 31 late.

    A lag of its pressures makes its flow late, too. The shape of its flow speaks against one, never
    for one: on machines drawn at random a shift explained none of 12 lags better, a lag 4 of 23
    shifts.
    """
    if not found.late:
        return ()
    if found.lag_z < -STANDARD_ERRORS:
        return (DELAY,)
    return DELAY, LAG


def _as_late(effect: Effect, found: Alignment) -> Effect:
    """Return a delay within what the flows leave open."""
    if effect.name != DELAY:
        return effect
    delay, *others = effect.parameters
    reach_s = ON_TIME_S + STANDARD_ERRORS * found.stderr_s
    bounded = replace(delay, low=found.late_s - reach_s, high=found.late_s + reach_s)
    return replace(effect, parameters=(bounded, *others))
