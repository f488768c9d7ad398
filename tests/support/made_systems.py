"""A diagnosis of a system, made by hand: three outputs, three rounds, records of every kind."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from comparisons.missing_effect.effect import FittedParameter
from comparisons.missing_effect.evidence import Evidence
from comparisons.missing_effect.results import MissingEffect, ParameterRow
from comparisons.missing_effect.runs import CheckRun
from comparisons.missing_effect.systems.catalogue import SYSTEM_CATALOGUE
from comparisons.missing_effect.systems.experiments import Experiment
from comparisons.missing_effect.systems.fit import Fit
from comparisons.missing_effect.systems.model import Model, P
from comparisons.missing_effect.systems.open_terms import OPEN_TERMS
from comparisons.missing_effect.systems.places import Placed
from comparisons.missing_effect.systems.records import Records
from comparisons.missing_effect.systems.results import SystemDiagnosis
from comparisons.missing_effect.systems.structure import Structure
from comparisons.missing_effect.systems.system import ModelCandidate, ModelRound, ModelSystem

PERIOD_S = 0.02
STATES = {"q": "m", "v": "m/s", "i": "A"}
OUTPUTS = {"position": "m", "current": "A", "strain": "1"}
# Size of each output, of the error of the model before and after, and of the noise.
SWING = np.array([0.02, 1.5, 4e-4])
BEFORE = np.array([2e-3, 0.2, 3e-5])
AFTER = np.array([4e-5, 0.15, 4e-6])
NOISE = np.array([3e-5, 0.02, 3e-6])


def _rhs(t: float, x: Any, u: Any, p: Any) -> tuple[float, float, float]:
    force = p.kf * x.i - p.c * x.v - p.k * x.q
    return x.v, force / p.m, (u.U - p.R * x.i) / p.L


def _output(t: float, x: Any, u: Any, p: Any) -> tuple[float, float, float]:
    return x.q, x.i, 0.02 * x.q


def machine(name: str = "voice coil") -> Model:
    """Return a model with three states, one input and three outputs."""
    params = {
        "m": P(0.5, 0.1, 2.0, "kg"),
        "c": P(1.0, 0.01, 9.0, "N·s/m"),
        "k": P(80.0, 9.0, 400.0, "N/m"),
        "kf": P(5.0, 0.5, 20.0, "N/A"),
        "R": P(4.0, 0.5, 20.0, "Ω"),
        "L": P(2e-3, 1e-5, 1e-2, "H"),
    }
    return Model(
        STATES, {"U": "V"}, OUTPUTS, params, _rhs, _output, exact=("q",),
        balance={"v": ("m", "N")}, name=name,
    )  # fmt: skip


def run_of(
    name: str, *, held_out: bool, n: int = 900, seed: int = 0, worse: float = 1.0
) -> CheckRun:
    """Return a run whose error is the cube of its first output before, and little after."""
    rng = np.random.default_rng(seed)
    t = PERIOD_S * np.arange(n)
    wave = sum(
        np.sin(2 * np.pi * f * t + p)
        for f, p in zip((0.7, 1.3, 3.1), rng.uniform(0, 6, 3), strict=True)
    )
    shape = np.asarray(wave) / np.std(wave)
    clean = shape[:, None] * SWING
    measured = clean + NOISE * rng.standard_normal((n, 3))
    cube = (shape**3 - 2.0 * shape)[:, None] / 2.0
    before, after = clean - worse * BEFORE * cube, clean - AFTER * np.roll(cube, 40, axis=0)
    channels = {"U": shape, **{key: measured[:, j] for j, key in enumerate(OUTPUTS)}}
    kind, settle = ("check", 10) if held_out else ("fitted", 0)
    return CheckRun(
        name, kind, PERIOD_S, t, OUTPUTS, measured, before, after, settle, signals=channels
    )


def placed_at(model: Model, name: str, which: int = 0) -> Placed:
    """Return an effect of the catalogue at one of its places."""
    entries = [e for e in (*SYSTEM_CATALOGUE, *OPEN_TERMS) if e.name == name]
    effect = next(e for e in entries if e.places(model))
    return Placed(effect, effect.places(model)[which], (1.0, 1.0, 1.0), ())


def candidate(placed: Placed, score: float, *, accepted: bool = True) -> ModelCandidate:
    """Return a candidate with a score, or one that was not fitted for NaN."""
    promised = max(score, 3.0) if np.isfinite(score) else 2.0
    model_fit = fit_of(machine(), (), ())
    if not np.isfinite(score):
        return ModelCandidate((placed,), model_fit, promised=promised)
    p = 1e-12 if accepted else 0.3
    evidence = Evidence(0.7 * score, 0.3 * abs(score), float("nan"), 6.0, p, score)
    return ModelCandidate((placed,), model_fit, evidence=evidence, promised=promised)


def fit_of(model: Model, effects: tuple[Placed, ...], runs: tuple[CheckRun, ...]) -> Fit:
    """Return a fit that nothing was fitted for."""
    structure = Structure(model, effects, "linear")
    theta = np.concatenate([structure.start(), *(structure.slots((0.1,)) for _ in effects)])
    errors = tuple(run.measured - run.after for run in runs)
    return Fit(structure, theta, (), np.ones(3), 0.0, errors, ())


def _found(model: Model, won: ModelCandidate, aliases: tuple[ModelCandidate, ...]) -> MissingEffect:
    effect = won.added[0].effect
    place = won.added[0].where(model)
    numbers = enumerate(effect.numbers)
    return MissingEffect(
        effect.name,
        tuple(dict.fromkeys(c.added[0].name for c in aliases)),
        False,
        tuple(FittedParameter(n.name, 12.3 + j, 0.4, "N/m^3") for j, n in numbers),
        {"train": 812.0, "held_out": 340.0, "z": 8.1, "score": 1148.0, "p_value": 1e-200},
        label=won.added[0].label(model),
        place=place,
        alias_labels=tuple(c.added[0].label(model) for c in aliases),
        unnamed=effect.unnamed,
        equation=effect.equation.replace("{s}", place.get("signal", place.get("input", ""))),
        says=effect.says,
        confirm={c.added[0].label(model): c.added[0].effect.confirm for c in aliases},
    )


def _rounds(model: Model, bench: ModelSystem) -> tuple[ModelRound, ...]:
    nan = float("nan")

    def tried(name: str, which: int, score: float, *, accepted: bool = True) -> ModelCandidate:
        return candidate(placed_at(model, name, which), score, accepted=accepted)

    first = (
        tried("cubic_stiffness", 0, 18344.0),
        tried("parameter_drift", 4, 412.0, accepted=False),
        tried("transport_delay", 0, nan),
    )
    second = (
        tried("coulomb_friction", 0, 512.4),
        tried("stribeck_friction", 0, 511.8),
        tried("constant_bias", 2, -3.6, accepted=False),
    )
    third = (tried("open_product", 1, 61.3),)
    refused = {"backlash(U) of U": "the input never turns around"}
    return tuple(
        ModelRound(bench, ranked, ranked[0], ranked[:n_aliases], refused, share=share)
        for ranked, n_aliases, share in ((first, 1, 0.93), (second, 2, 0.31), (third, 1, 0.01))
    )


def made_diagnosis(
    *, name: str = "voice coil", runs: Mapping[str, str] | None = None, nothing: bool = False
) -> SystemDiagnosis:
    """Return a diagnosis.

    Parameters
    ----------
    name : str
        Of the model.
    runs : mapping of str to str
        Names of its records, and "training" or "check" for each.
    nothing : bool
        Whether nothing is missing.
    """
    model = machine(name)
    splits = runs or {
        "sweep up": "training",
        "sweep down": "training",
        "multisine_full_test": "check",
        "arrow": "check",
    }
    made = [
        run_of(key, held_out=split == "check", seed=i, worse=1.0 + i)
        for i, (key, split) in enumerate(splits.items())
    ]
    if nothing:
        made = [replace(run, before=run.after) for run in made]
    training = tuple(run for run in made if not run.held_out)
    records = Records.of(model, [Experiment(run.name, PERIOD_S, run.signals) for run in training])
    before = fit_of(model, (), training)
    rounds = _rounds(model, ModelSystem(records, (), (), before))
    if nothing:
        refused = tuple(c for c in rounds[1].candidates if not c.accepted)
        rounds = (replace(rounds[1], candidates=refused, winner=None, aliases=()),)
    won = [] if nothing else [step for step in rounds[:2] if step.winner is not None]
    missing = tuple(_found(model, r.winner, r.aliases) for r in won if r.winner is not None)
    after = fit_of(model, tuple(r.winner.added[0] for r in won if r.winner is not None), training)
    parameters = tuple(
        ParameterRow(
            key, p.unit, 1.3 * p.start, p.start, 0.02 * p.start, 0.01 * p.start, key == "L"
        )
        for key, p in model.params.items()
    )
    return SystemDiagnosis(
        verdict="nothing_missing" if nothing else "alias_set",
        missing=missing,
        parameters=parameters,
        unavailable=rounds[-1].refused,
        remarks=() if nothing else ("open_product would explain 1.0 % that is left; not added.",),
        model=model,
        records=records,
        rounds=rounds,
        before=before,
        after=after,
        offsets=(FittedParameter("U", 0.31, 0.02, "samples"),),
        training=training,
        checks=tuple(run for run in made if run.held_out),
        floor=tuple(NOISE.tolist()),
    )
