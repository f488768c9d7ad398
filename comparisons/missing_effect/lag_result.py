"""What a lag model lacks: a diagnosis with τ, the fits behind it, and the rows."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, product
from pathlib import PurePath
from typing import Any, ClassVar

import numpy as np

from classic_ml.records import short_names
from comparisons.missing_effect.candidates import LagCandidate, LagRound
from comparisons.missing_effect.catalogue import CATALOGUE
from comparisons.missing_effect.effect import Effect
from comparisons.missing_effect.fit import Fit
from comparisons.missing_effect.lag_curves import model_document, records_document
from comparisons.missing_effect.lag_data import LATER, OTHER, TRAIN, LagData
from comparisons.missing_effect.noise import Metric, NoiseModel
from comparisons.missing_effect.open_terms import with_own_state
from comparisons.missing_effect.probes import Leftover
from comparisons.missing_effect.quantities import (
    chance,
    label_of,
    model_equation,
    plain_name,
    tau_ms,
)
from comparisons.missing_effect.results import (
    LEAST_SIZE,
    CandidateRow,
    Diagnosis,
    Gap,
    MissingEffect,
)
from comparisons.missing_effect.runs import CheckRun
from comparisons.missing_effect.where import where_of
from comparisons.missing_effect.where_rows import Residuals, Where
from comparisons.missing_effect.whole_run_spectra import RippleLine
from surge_core.rounding import significant
from surge_core.types import FloatArray

_DRIFTS = ("facility_heating", "sensitivity_drift", "bias_drift", "speed_droop")
_SLOPE = (
    "the slope of the characteristic hardly changes over the flow that was swept, so that both act "
    "on dφ/dt"
)
_BRANCHES = "both change the characteristic where φ hardly ever is"
_WHY_ALIKE = {
    frozenset(("transport_delay", "second_order_lag")): "both move the phase alike, and part only "
    "in the second order of their time",
    frozenset(("transport_delay", "flow_inertia")): _SLOPE,
    frozenset(("second_order_lag", "flow_inertia")): _SLOPE,
    frozenset(("reverse_flow_branch", "characteristic_shape")): _BRANCHES,
    frozenset(("reverse_flow_branch", "hysteresis")): _BRANCHES,
    **{
        frozenset(pair): "both are slow drifts, and only a reading of temperature, speed or zero "
        "parts them"
        for pair in combinations(_DRIFTS, 2)
    },
}
_TAU_MEANING = {
    "amplitude_dependent_lag": "that at the mean amplitude",
    "flow_dependent_lag": "that above the threshold",
    "asymmetric_lag": "the mean of rising and falling flow",
}
# Rounding follows the signal itself unless noise of half a step is there before it (Widrow and
# Kollár, Quantization Noise, 2008): half a step, and the step's own share of 1/√12.
DITHERED = float(np.sqrt(1.0 / 4.0 + 1.0 / 12.0))
COARSE = "which no noise rounds off, so that their rounding follows ψ' itself"
# A τ that moves by less is said to stay.
_LEAST_CHANGE = 5e-4
_NOISE = ("sigma", "innovation", "ar", "heavy_share", "coloured", "heavy_tailed")
_LEFTOVER = ("gain", "degrees", "p_value", "structured")


@dataclass(frozen=True)
class ReverseLoss:
    """What the lag model leaves in reversed flow (``left``), and the loss c φ² that explains it.

    ``squared`` is φ² of the reversed rows, averaged as ψ' is; ``size`` is c, ``share`` the share of
    the squares of ``left`` that the loss explains.
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
    left: tuple[FloatArray, FloatArray]
    data: LagData
    noise: NoiseModel
    leftover: Leftover
    rounds: tuple[LagRound, ...]
    ripple: RippleLine | None = None
    reverse_loss: ReverseLoss | None = None
    catalogue: tuple[Effect, ...] = CATALOGUE
    of_series: ClassVar[bool] = True

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
    def lag_known(self) -> bool:
        """Whether τ is distinguished from zero, and shorter than the longest run."""
        longest_s = np.max(np.diff(self.data.runs)) * self.data.sample_period_s
        return bool(LEAST_SIZE * self.tau_stderr_s <= self.tau_after_s <= longest_s)

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
        return short_names(self.data.sources)

    @property
    def floor(self) -> tuple[float, ...]:
        """The measurement noise of ψ'."""
        return (self.gap.floor_rms,)

    @property
    def acts_unscored(self) -> bool:
        """Whether nothing was added to what is scored: the τ to quote is that of the comparison."""
        return 0 < len(self.missing) == bool(self.ripple) + bool(self.reverse_loss)

    @property
    def equations(self) -> tuple[str, ...]:
        """The equation of the model before and, where something was added, after."""
        models = (f"before: {model_equation(self.before)}", f"after:  {model_equation(self.after)}")
        return models if self.missing else models[:1]

    @property
    def tau_said(self) -> tuple[str, str]:
        """τ as it is, and where it went."""
        row = self.parameters[0]
        now = tau_ms(row.after, row.after_stderr)
        meaning = ", ".join(_TAU_MEANING[name] for name in self.names if name in _TAU_MEANING)
        means = f" ({meaning})" if meaning else ""
        if abs(row.after / row.before - 1.0) < _LEAST_CHANGE:
            return now, f"τ stays at {now}{means}"
        return now, f"τ goes from {tau_ms(row.before, row.before_stderr)} to {now}{means}"

    @property
    def coarse_step(self) -> float:
        """Step of the readings of ψ' where no noise rounds it off; 0 otherwise."""
        data = self.data
        own = [data.measured[data.record == number] for number in range(len(data.sources))]
        step = max(float(np.diff(np.unique(one)).min(initial=np.inf)) for one in own)
        return step if self.noise.sigma < DITHERED * step < np.inf else 0.0

    @property
    def noise_said(self) -> str:
        """What the noise is like."""
        noise, floor = self.noise, self.gap.floor_rms
        if self.whole_runs:
            return (
                f"The noise of the averaged ψ' is {significant(floor, 3)} rms; the model leaves "
                f"{noise.sigma / floor:.1f} times that: noise near zero flow, calibration, and "
                "what no effect here explains."
            )
        size = f"rms {significant(noise.sigma, 3)} in ψ'"
        if not noise.coloured and not noise.heavy_tailed:
            return f"The noise is white and about normal, {size}."
        out = [f"Readings of ψ' step by {self.coarse_step:.3g}, {COARSE}."] * bool(self.coarse_step)
        out.append(f"The noise has {size}{', outliers aside' if noise.heavy_tailed else ''}.")
        if noise.flow is not None:
            out.append(
                f"Errors depend on each other as noise of {significant(noise.flow_sigma, 2)} rms "
                "on φ, which its readings do not exclude, would make them behind the lag, so that "
                "rows count for less than their number."
            )
        elif noise.coloured:
            lags = ", ".join(f"{a:.2f}" for a in noise.ar)
            out.append(
                f"An error depends on those before it (autoregression {lags}), so that rows count "
                "for less than their number."
            )
        if noise.heavy_tailed:
            out.append(
                f"{100.0 * noise.heavy_share:.1f} % of the errors lie beyond three standard "
                "deviations, where the normal law has 0.3 %: they were held down."
            )
        out.append("An estimator that takes noise for white and normal states wrong errors.")
        return " ".join(out)

    @property
    def structure_said(self) -> str:
        """What a test of all effects and open terms together finds in what is left."""
        left = self.leftover
        if not left.degrees:
            return ""
        tested = "one column of the effects and open terms"
        if left.degrees > 1:
            tested = f"{left.degrees} columns of effects and open terms together"
        if left.structured:
            return (
                f"Yet {tested} would win {left.gain:.0f} log-units (p {chance(left.p_value)}): "
                "this is not “nothing missing”, it is something without a name."
            )
        return f"What {tested} could still win is chance (p {chance(left.p_value)})."

    @property
    def ledger_said(self) -> tuple[str, ...]:
        """Which effects were not fitted, and what was looked for in another way."""
        out = []
        if skipped := ", ".join(effect.name for effect in self.not_fitted):
            out.append(f"A score test promised too little of these effects to fit them: {skipped}.")
        if self.whole_runs:
            line = (
                f"One stands at {self.ripple.frequency_hz:.4g} Hz"
                if self.ripple
                else "There is none"
            )
            out.append(
                "A second pattern of stall cells would show as a spectral line of the rake "
                f"differences that the first pattern does not make. {line}."
            )
        return tuple(out)

    def alias_said(self, item: MissingEffect) -> str:
        """Return why the names of a set look alike, and τ under each."""
        reason = _WHY_ALIKE.get(frozenset(item.alias_set), "")
        tau = ", ".join(
            f"{plain_name(name)} {tau_ms(self.tau_by_alias_s[name])}"
            for name in item.alias_set
            if name in self.tau_by_alias_s
        )
        return f"{f': {reason}' if reason else ''}. τ under each name: {tau}"

    @cached_property
    def wheres(self) -> tuple[Where, ...]:
        """Where the residuals of the fits to all rows stand out of the noise."""
        data, noise = self.data, self.noise
        names = tuple(PurePath(source).name for source in data.sources)
        before, after = (
            data.measured - fit.errors(with_own_state(data, fit), Metric())
            for fit in (self.before, self.after)
        )
        residuals = Residuals(
            "psi_p",
            "1",
            data.sampled(data["time_s"]),
            np.where(data.scored(), data.measured, np.nan),
            before,
            after,
            data.sampled(data.signals.get("phi_averaged", data["phi"])),
            "phi",
            "1",
            data.slices,
            data.record.astype(np.int64),
            names if len(set(names)) == len(names) else data.sources,
            data.sample_period_s,
            floor_rms=float(self.gap.floor_rms),
            ar=np.array(noise.ar) if noise.coloured else np.zeros(0),
            cycle_hz=1.0 / data.surge_s,
        )
        return (where_of(residuals),) if residuals.enough else ()

    def own_document(self) -> dict[str, Any]:
        """Return what the JSON of a lag has beside that of all."""
        tau = self.parameters[0]
        return {
            "missing": [{"port": item.place["port"]} for item in self.missing],
            "time_constant_s": {
                "before": tau.before,
                "after": tau.after,
                "by_alias": dict(self.tau_by_alias_s),
                "before_stderr": tau.before_stderr,
                "after_stderr": tau.after_stderr,
            },
            "whole_runs": self.whole_runs,
            "noise": _some(self.noise, _NOISE),
            "leftover": _some(self.leftover, _LEFTOVER),
            "base": {"terms": list(self.before.structure.terms)},
            "records": records_document(self.data),
            "model": {
                "before": model_document(self.before, self.data),
                "after": model_document(self.after, self.data),
            },
        }

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
        decided = {row.effect for row in self.untold} | {row.effect for row in self.absent}
        known = fitted | self.unavailable.keys() | decided
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
            refused_on=() if e.accepted else e.refused_on,
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


def _some(value: object, names: Sequence[str]) -> dict[str, Any]:
    return {name: getattr(value, name) for name in names}
