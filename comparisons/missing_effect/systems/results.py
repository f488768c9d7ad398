"""What a user's model lacks: a diagnosis with the model, its records, and the fits behind it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from comparisons.missing_effect.effect import FittedParameter
from comparisons.missing_effect.results import CandidateRow, Diagnosis, Gap
from comparisons.missing_effect.runs import CheckRun
from comparisons.missing_effect.systems.fit import Fit
from comparisons.missing_effect.systems.model import Model
from comparisons.missing_effect.systems.places import label_of
from comparisons.missing_effect.systems.records import Records
from comparisons.missing_effect.systems.system import ModelCandidate, ModelRound
from surge_core.types import FloatArray

SHARE_UNIT = "1 (share of swing)"


@dataclass(frozen=True, eq=False, kw_only=True)
class SystemDiagnosis(Diagnosis):
    """What a user's model lacks.

    Parameters
    ----------
    model : Model
        The model.
    records : Records
        Training records.
    rounds : tuple of Round
        The search.
    before, after : Fit
        To all training rows, without and with what was added.
    offsets : tuple of FittedParameter
        Timing offset of each input, in samples, with what was added.
    training, checks : tuple of CheckRun
        Training and check records, simulated.
    floor : tuple of float
        What is new in each error of each output, after whitening: no model of this kind foretells
        less.
    """

    model: Model
    records: Records
    rounds: tuple[ModelRound, ...]
    before: Fit
    after: Fit
    offsets: tuple[FittedParameter, ...]
    training: tuple[CheckRun, ...]
    checks: tuple[CheckRun, ...]
    floor: tuple[float, ...]

    @property
    def subject(self) -> str:
        """What lacks something."""
        return f"The model '{self.model.name}'"

    @property
    def title(self) -> str:
        """The name of the model."""
        return self.model.name

    @property
    def runs(self) -> tuple[CheckRun, ...]:
        """Training and check runs, in this order."""
        return (*self.training, *self.checks)

    @property
    def gap(self) -> Gap:
        """The errors of all outputs as one number, on check records where there are any."""
        runs = self.checks or self.training
        single = len(self.model.outputs) == 1
        measured = np.concatenate([run.measured[run.settle :] for run in runs])
        swing = np.ones(1) if single else np.nanstd(measured, axis=0)
        before, after = (
            _joined([run.errors(before=which) for run in runs], swing) for which in (True, False)
        )
        floor = np.asarray(self.floor, dtype=np.float64)
        floor_rms = float(np.sqrt(np.mean((floor / swing) ** 2))) if floor.size else math.nan
        unit = next(iter(self.model.outputs.values())) if single else SHARE_UNIT
        # The floor comes from the fitted records: the check records may be quieter.
        return Gap(before, after, floor_rms, unit, 1.0)

    @cached_property
    def candidates(self) -> tuple[CandidateRow, ...]:
        """All that competed, round by round: those fitted, best first, then the others."""
        return tuple(
            self._row(number, step, candidate)
            for number, step in enumerate(self.rounds, start=1)
            for candidate in step.candidates
        )

    def _row(self, number: int, step: ModelRound, c: ModelCandidate) -> CandidateRow:
        e, first = c.evidence, c.added[0]
        beside = len(step.aliases) > 1
        return CandidateRow(
            number,
            first.name,
            label_of(c.added, self.model),
            first.where(self.model),
            "pair" if len(c.added) > 1 else "unnamed_term" if c.unnamed else "name",
            self._fate(step, c),
            bool(c.accepted),
            beside and any(c is other for other in step.aliases),
            score=float(e.score),
            train_gain=float(e.train),
            later_gain=float(e.later),
            held_out_z=float(e.z),
            p_value=float(e.p_value),
            promised=float(c.promised),
        )

    def _fate(self, step: ModelRound, c: ModelCandidate) -> str:
        if c is step.winner:
            added = {effect.key for effect in self.after.structure.effects}
            return "added" if c.added[0].key in added else "too little"
        if any(c is other for other in step.aliases):
            return "alias"
        if not c.fitted:
            return "not fitted"
        return "accepted" if c.accepted else "refused"


def _joined(errors: Sequence[FloatArray], swing: FloatArray) -> float:
    """Return the root mean square over all rows of all outputs, each over its swing."""
    shares = np.concatenate(errors) / swing
    kept = shares[np.isfinite(shares)]
    return float(np.sqrt(np.mean(kept**2))) if kept.size else math.nan
