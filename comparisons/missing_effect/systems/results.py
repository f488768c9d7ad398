"""What a user's model lacks: a diagnosis with the model, its records, and the fits behind it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np

from comparisons.missing_effect.effect import FittedParameter
from comparisons.missing_effect.quantities import NOT_FIXED, last_digits
from comparisons.missing_effect.results import (
    CandidateRow,
    Diagnosis,
    Gap,
    MissingEffect,
)
from comparisons.missing_effect.runs import CheckRun, rms
from comparisons.missing_effect.systems.fit import Fit
from comparisons.missing_effect.systems.model import Model
from comparisons.missing_effect.systems.places import label_of
from comparisons.missing_effect.systems.records import Records
from comparisons.missing_effect.systems.roles import measured_as
from comparisons.missing_effect.systems.system import ModelCandidate, ModelRound
from comparisons.missing_effect.where import where_of
from comparisons.missing_effect.where_rows import Residuals, Where

# Where an effect names the signal that it acts on.
SIGNAL_KEYS = ("signal", "input", "sensor", "state")
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
    def fit_said(self) -> str:
        """How inputs run between samples, and how late each acts."""
        if not self.model.inputs:
            return ""
        each = [f"{o.name} {last_digits(o.value, o.stderr)} samples" for o in self.offsets]
        listed = ", ".join(each).replace(f"{NOT_FIXED} samples", NOT_FIXED)
        before, after = (
            way if isinstance(way, str) else ", ".join(f"{name} {own}" for name, own in way.items())
            for way in map(_between, (self.before, self.after))
        )
        earlier = f" (before: {before})" if before != after else ""
        return f"Inputs between samples: {after}{earlier}; timing offsets: {listed}."

    @cached_property
    def wheres(self) -> tuple[Where, ...]:
        """Where the residuals of the most telling run stand out."""
        run = self.telling_run
        if not np.all(np.isfinite(run.before)):
            return ()
        share = run.before_rms / run.swing
        order = np.argsort(-np.where(np.isfinite(share), share, np.inf), kind="stable")
        residuals = (residuals_of(run, j, self.missing, self.model) for j in order.tolist())
        return tuple(where_of(one) for one in residuals if one.enough)

    def own_document(self) -> dict[str, Any]:
        """Return what the JSON of a user's model has beside that of all."""
        return {
            # Of one name; those of the others stand in the report.
            "missing": [{"confirm": item.confirm.get(item.label)} for item in self.missing],
            "gap": {"unit": self.gap.unit},
            "time_constant_s": {"before": math.nan, "after": math.nan, "by_alias": {}},
            "timing_offsets": [asdict(offset) for offset in self.offsets],
            "input_between_samples": _between(self.after) if self.model.inputs else None,
            "model": {
                "name": self.model.name,
                "states": self.model.states,
                "inputs": self.model.inputs,
                "outputs": self.model.outputs,
            },
        }

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
        # Over all rows of all outputs, each over its swing.
        before, after = (
            np.concatenate([run.errors(before=which) for run in runs]) / swing
            for which in (True, False)
        )
        floor = np.asarray(self.floor, dtype=np.float64)
        floor_rms = float(np.sqrt(np.mean((floor / swing) ** 2))) if floor.size else math.nan
        unit = next(iter(self.model.outputs.values())) if single else SHARE_UNIT
        # The floor comes from the fitted records: the check records may be quieter.
        sizes = rms(np.column_stack([before.ravel(), after.ravel()])).tolist()
        return Gap(sizes[0], sizes[1], floor_rms, unit, 1.0)

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
            beside and c in step.aliases,
            score=float(e.score),
            train_gain=float(e.train),
            later_gain=float(e.later),
            held_out_z=float(e.z),
            p_value=float(e.p_value),
            promised=float(c.promised),
            refused_on=() if c.accepted or not c.fitted else e.refused_on,
        )

    def _fate(self, step: ModelRound, c: ModelCandidate) -> str:
        if c is step.winner:
            added = {effect.key for effect in self.after.structure.effects}
            return "added" if c.added[0].key in added else "too little"
        if c in step.aliases:
            return "alias"
        if not c.fitted:
            return "not fitted"
        return "accepted" if c.accepted else "refused"


def _between(fit: Fit) -> str | dict[str, str]:
    """Return the way of all inputs between samples, or that of each by its name."""
    ways = fit.structure.ways
    named = dict(zip(fit.structure.model.inputs, ways, strict=True))
    return ways[0] if len(set(ways)) == 1 else named


def residuals_of(
    check: CheckRun, column: int, effects: Sequence[MissingEffect], model: Model
) -> Residuals:
    """Return the residuals of one output of a run, to be looked at over a signal.

    Of the effects that were added, the signal of the first whose signal is measured is looked at,
    of none the output itself as it was simulated.
    """
    output, scored = list(check.outputs)[column], slice(check.settle, None)
    signal = _signal(check, effects, model) or output
    measured, before, after = (
        values[scored, column] for values in (check.measured, check.before, check.after)
    )
    own = signal == output
    simulated = after if np.all(np.isfinite(check.after[:, column])) else before
    units = {**model.inputs, **check.outputs}
    return Residuals(
        output,
        units[output],
        check.time_s[scored],
        measured,
        before,
        after,
        simulated if own else check.signals[signal][scored],
        signal,
        units.get(signal, "1"),
        (slice(0, measured.size),),
        np.zeros(measured.size, dtype=np.int64),
        (check.name,),
        check.period_s,
        own,
    )


def _signal(check: CheckRun, effects: Sequence[MissingEffect], model: Model) -> str:
    """Return the signal of an effect as far as it is measured; an empty text where none is."""
    also = {model.state_names[i]: name for i, name in measured_as(model).items()}
    for effect in effects:
        name = next((effect.place[key] for key in SIGNAL_KEYS if key in effect.place), "")
        # A state may share its name with an output that is something else.
        channel = also.get(name, "" if name in model.states else name)
        if channel in check.signals:
            return channel
    return ""
