"""What a lag model lacks: a diagnosis with τ, the fits behind it, and the rows."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import PurePath

import numpy as np

from comparisons.missing_effect.candidates import LagCandidate, LagRound
from comparisons.missing_effect.catalogue import CATALOGUE
from comparisons.missing_effect.effect import Effect
from comparisons.missing_effect.evidence import LARGEST_P, LEAST_Z, Evidence
from comparisons.missing_effect.fit import Fit
from comparisons.missing_effect.lag_data import LATER, OTHER, TRAIN, LagData
from comparisons.missing_effect.leftover import Leftover
from comparisons.missing_effect.noise import NoiseModel
from comparisons.missing_effect.quantities import label_of
from comparisons.missing_effect.results import (
    CandidateRow,
    Diagnosis,
    Gap,
)
from comparisons.missing_effect.runs import CheckRun
from comparisons.missing_effect.whole_run_spectra import RippleLine
from surge_core.types import FloatArray


@dataclass(frozen=True)
class ReverseLoss:
    """What the lag model leaves in reversed flow, and the loss that explains it.

    Parameters
    ----------
    squared : ndarray of shape (n,)
        φ² of the reversed rows, averaged as ψ' is.
    left : ndarray of shape (n,)
        Measured minus simulated ψ' there.
    size : float
        c of the loss c φ².
    share : float
        Share of the squares of ``left`` that it explains.
    """

    squared: FloatArray
    left: FloatArray
    size: float
    share: float


@dataclass(frozen=True, eq=False, kw_only=True)
class LagDiagnosis(Diagnosis):
    """What a lag model of these records lacks; τ is the first of its parameters.

    Parameters
    ----------
    gap : Gap
        On held-out rows.
    tau_by_alias_s : mapping of str to float
        τ under every name of the alias sets, in seconds.
    before, after : Fit
        To all rows.
    before_fitted, after_fitted : Fit
        To the fitted rows alone.
    left : tuple of two ndarray of shape (n,)
        Errors before and after, on held-out rows by fits to other rows.
    data : LagData
        The rows.
    noise : NoiseModel
        Of the model after.
    leftover : Leftover
        What the model after leaves.
    rounds : tuple of Round
        The search.
    ripple : RippleLine, optional
        A second pattern of stall cells, on whole runs.
    reverse_loss : ReverseLoss, optional
        The loss in reversed flow where it acts, on whole runs.
    catalogue : tuple of Effect
        The names that competed.
    """

    gap: Gap
    tau_by_alias_s: Mapping[str, float]
    before: Fit
    after: Fit
    before_fitted: Fit
    after_fitted: Fit
    left: tuple[FloatArray, FloatArray]
    data: LagData
    noise: NoiseModel
    leftover: Leftover
    rounds: tuple[LagRound, ...]
    ripple: RippleLine | None = None
    reverse_loss: ReverseLoss | None = None
    catalogue: tuple[Effect, ...] = CATALOGUE

    @property
    def tau_before_s(self) -> float:
        """τ without what was added, by a fit to all rows."""
        return self.parameters[0].before

    @property
    def tau_after_s(self) -> float:
        """τ with what was added."""
        return self.parameters[0].after

    @property
    def tau_stderr_s(self) -> float:
        """Standard error of the τ after."""
        return self.parameters[0].after_stderr

    @property
    def whole_runs(self) -> bool:
        """Whether the records were taken as whole runs, averaged over the stall cells."""
        return self.data.average_s > 0.0

    @property
    def subject(self) -> str:
        """What lacks something."""
        return "The lag model"

    @property
    def title(self) -> str:
        """The records."""
        return ", ".join(PurePath(source).name for source in self.data.sources)

    @property
    def floor(self) -> tuple[float, ...]:
        """The measurement noise of ψ'."""
        return (self.gap.floor_rms,)

    @cached_property
    def runs(self) -> tuple[CheckRun, ...]:
        """Each record, its fitted rows and those that were not."""
        data, runs = self.data, []
        kinds: dict[str, tuple[int, ...]] = {"fitted": (TRAIN,), "held out": (LATER, OTHER)}
        if self.whole_runs:
            kinds = {"left out": (TRAIN, LATER, OTHER)}
        for number, source in enumerate(data.sources):
            for kind, parts in kinds.items():
                rows = data.scored() & (data.record == number) & np.isin(data.part, parts)
                if rows.any():
                    runs.append(self._run(PurePath(source).name, kind, rows))
        return tuple(runs)

    def _run(self, name: str, kind: str, scored: np.ndarray) -> CheckRun:
        data = self.data
        at = np.flatnonzero(scored)
        rows = slice(int(at[0]), int(at[-1]) + 1)
        measured = np.where(scored, data.measured, np.nan)[rows]
        before, after = (measured - left[rows] for left in self.left)
        return CheckRun(
            name,
            kind,
            data.sample_period_s,
            data.sampled(data["time_s"])[rows],
            {"psi_p": "1"},
            measured[:, None],
            before[:, None],
            after[:, None],
        )

    @cached_property
    def candidates(self) -> tuple[CandidateRow, ...]:
        """All that competed: those fitted, round by round and best first, then the others."""
        rows = []
        for number, step in enumerate(self.rounds, start=1):
            stand_ins = self._stand_ins(step)
            tried = sorted(step.candidates, key=_rank)
            rows += [self._row(number, step, c, stand_ins) for c in tried]
        return (*rows, *map(_untried, self.not_fitted))

    @property
    def not_fitted(self) -> tuple[Effect, ...]:
        """The effects that were tested and promised too little to be worth a fit."""
        fitted = {e.name for step in self.rounds for c in step.candidates for e in c.added}
        known = fitted | self.unavailable.keys() | {row.effect for row in self.untold}
        return tuple(
            effect
            for effect in self.catalogue
            if effect.name not in known
            # On whole runs a ripple is a line of the spectrum, and reversed rows are not scored.
            and not (self.whole_runs and (effect.episodes or effect.name == "reverse_flow_branch"))
        )

    def _stand_ins(self, step: LagRound) -> set[frozenset[str]]:
        """Return what could stand for the winner of a round, it among them, if any."""
        if step.winner is None:
            return set()
        names = [effect.name for effect in step.winner.added]
        sets = {item.effect: item.alias_set for item in self.missing}
        found = {frozenset(chosen) for chosen in product(*(sets.get(n, (n,)) for n in names))}
        return found if len(found) > 1 else set()

    def _row(
        self, number: int, step: LagRound, c: LagCandidate, stand_ins: set[frozenset[str]]
    ) -> CandidateRow:
        e, names = c.evidence, frozenset(effect.name for effect in c.added)
        added = {effect.name for effect in self.after.structure.effects}
        wins = step.winner is not None and c.name == step.winner.name
        alias = names in stand_ins
        fate = "alias" if alias else "accepted" if e.accepted else "refused"
        return CandidateRow(
            number,
            c.name,
            " + ".join(map(label_of, c.added)),
            {"port": c.added[0].port},
            "pair" if len(c.added) > 1 else "unnamed_term" if c.unnamed else "name",
            "added" if wins and names <= added else fate,
            bool(e.accepted),
            alias,
            float(e.score),
            float(e.train),
            float(e.later),
            float(e.other),
            float(e.z),
            float(e.p_value),
            time_constant_s=float(c.fit.tau_s),
            parameters_added=int(c.fit.n_parameters - step.bench.fit.n_parameters),
            refused_on=() if e.accepted else _refused_on(e),
            share=float(e.share),
            least_share=float(e.least_share),
        )


def _untried(effect: Effect) -> CandidateRow:
    place = {"port": effect.port}
    return CandidateRow(
        1, effect.name, label_of(effect), place, "name", "not fitted", refused_on=("score test",)
    )


def _rank(candidate: LagCandidate) -> float:
    e = candidate.evidence
    return -float(e.score if math.isnan(e.share) else e.share)


def _refused_on(e: Evidence) -> tuple[str, ...]:
    if e.at_end:
        return ("τ at the end of its search",)
    by_share = not math.isnan(e.least_share)
    rows = []
    if by_share and not e.share >= e.least_share:
        rows.append("share")
    if not by_share and not e.p_value < LARGEST_P:
        rows.append("fitted rows")
    if not e.later > 0.0:
        rows.append("later time")
    if not math.isnan(e.other) and e.other <= 0.0:
        rows.append("other record")
    if not rows and not by_share and not e.z > LEAST_Z:
        rows.append("held-out blocks")
    return tuple(rows)
