"""What is shown of comparisons, models, diagnoses and studies in a notebook."""

from __future__ import annotations

import math
from pathlib import PurePath
from typing import TYPE_CHECKING

import numpy as np

from surge_core.display import Field, Grid, Sheet
from surge_core.rounding import round_to_error, significant

if TYPE_CHECKING:
    from comparisons.harness.compare import Comparison
    from comparisons.harness.lag_value import FittedLag
    from comparisons.harness.structure_fit import FoundStructure
    from comparisons.missing_effect.extended_lag import ExtendedLag
    from comparisons.missing_effect.results import Diagnosis
    from comparisons.missing_effect.systems.model import Model
    from comparisons.missing_effect.systems.results import SystemDiagnosis

__all__ = [
    "comparison_sheet",
    "diagnosis_sheet",
    "extended_sheet",
    "lag_value_sheet",
    "model_sheet",
    "structure_html",
    "system_sheet",
]

CLEAR = ("named", "nothing_missing", "alias_set")
SYMBOLS = {"psi_p": "ψ'", "psi": "ψ"}


def comparison_sheet(comparison: Comparison) -> Sheet:
    """Return what is shown of a comparison: the table of the terminal.

    Parameters
    ----------
    comparison : Comparison
        Estimators side by side.
    """
    from comparisons.harness.cautions import grouped_cautions
    from comparisons.show.table import FIELDS, comparison_cells

    rows = comparison.rows
    low, high = comparison.valid_phi
    cautions = tuple(grouped_cautions(comparison.cautions))
    fields = (
        Field("records", tuple(PurePath(record.source).name for record in comparison.records)),
        Field(
            "rows",
            f"{rows.phi.size} in {rows.n_segments} segments, {1 / rows.sample_period_s:g} Hz",
        ),
        Field("φ dwells", f"{low:.3f} to {high:.3f} (5th to 95th percentile)"),
        *((Field("cautions", cautions, "advice"),) if cautions else ()),
    )
    grid = Grid(
        f"Estimators of {SYMBOLS[rows.target]}, best first",
        tuple(field.heading for field in FIELDS),
        tuple(map(tuple, comparison_cells(comparison))),
        frozenset(i for i, field in enumerate(FIELDS) if not field.numeric),
        marked=0,
    )
    return Sheet(f"Comparison of {len(comparison.results)} estimators", fields, (grid,))


def lag_value_sheet(model: FittedLag) -> Sheet:
    """Return what is shown of a fitted lag model.

    Parameters
    ----------
    model : FittedLag
        The model.
    """
    low, high = (1e3 * end for end in model.ci95_s)
    interval: tuple[Field, ...] = ()
    if math.isfinite(low) and math.isfinite(high):
        interval = (Field("τ, 95 % interval", f"{low:.3g} to {high:.3g} ms"),)
    dead = (Field("dead time", f"{1e3 * model.dead_time_s:.3g} ms"),) if model.dead_time_s else ()
    return Sheet(
        f"Lag model of {SYMBOLS[model.target]} by {model.estimator}",
        (
            Field("time constant τ", _tau(model.time_constant_s, model.time_constant_stderr_s)),
            *interval,
            *dead,
            Field("hold", model.hold),
            Field("φ dwells", f"{model.valid_phi[0]:.3f} to {model.valid_phi[1]:.3f}"),
        ),
        (_terms(model.terms, model.coefficients, model.stderr),),
    )


def extended_sheet(model: ExtendedLag) -> Sheet:
    """Return what is shown of a lag model with effects.

    Parameters
    ----------
    model : ExtendedLag
        The model.
    """
    from comparisons.missing_effect.quantities import equation_of, quantity, symbol

    rows = tuple(
        (added.name, equation_of(added.effect), symbol(p.name), quantity(value, stderr, p.unit))
        for added in model.effects
        for p, value, stderr in zip(
            added.effect.parameters, added.values, added.stderr, strict=True
        )
    )
    effects = Grid("Effects", ("effect", "adds", "number", "value"), rows, frozenset({0, 1, 2}))
    return Sheet(
        f"Lag model with effects: {model.label}",
        (
            Field("time constant τ", _tau(model.time_constant_s, model.time_constant_stderr_s)),
            Field("φ dwells", f"{model.valid_phi[0]:.3f} to {model.valid_phi[1]:.3f}"),
            Field("noise (std)", significant(model.noise_sigma, 3)),
        ),
        (_terms(model.terms, model.coefficients, model.stderr), *((effects,) if rows else ())),
    )


def diagnosis_sheet(d: Diagnosis) -> Sheet:
    """Return what is shown of a diagnosis.

    Parameters
    ----------
    d : Diagnosis
        The diagnosis.
    """
    from comparisons.missing_effect.quantities import equation_of, numbers_of, tau_ms
    from comparisons.missing_effect.ranked import effect_of
    from comparisons.missing_effect.words import verdict_words

    gap = d.gap
    found = tuple(
        (
            " or ".join(item.alias_set) + (" (provisional)" if item.provisional else ""),
            equation_of(effect_of(d, item.effect)),
            numbers_of(item.effect, item.parameters),
        )
        for item in d.missing
    )
    before = (f"{gap.before_rms / gap.floor_rms:.2f}", tau_ms(d.tau_before_s))
    after = (f"{gap.after_rms / gap.floor_rms:.2f}", tau_ms(d.tau_after_s, d.tau_stderr_s))
    models: tuple[tuple[str, ...], ...] = (
        (("before", *before), ("after", *after)) if d.missing else (("the model", *after),)
    )
    grids = [Grid("On rows held out", ("model", "rms over the noise's", "τ"), models)]
    if found:
        header = ("effect", "adds", "numbers")
        grids.insert(0, Grid("Missing", header, found, frozenset(range(3)), marked=0))
    return Sheet(
        f"Diagnosis: {d.verdict.replace('_', ' ')}",
        (
            Field("records", tuple(PurePath(source).name for source in d.data.sources)),
            Field("verdict", verdict_words(d), "good" if d.verdict in CLEAR else "advice"),
            Field("noise (rms)", significant(gap.floor_rms, 3)),
            *((Field("remarks", d.remarks, "advice"),) if d.remarks else ()),
        ),
        tuple(grids),
    )


def model_sheet(model: Model) -> Sheet:
    """Return what is shown of a user's model: its signals and parameters with their units.

    Parameters
    ----------
    model : Model
        The model.
    """
    fields = tuple(
        Field(kind, ", ".join(f"{n} [{_unit(u)}]" for n, u in signals.items()) or "none")
        for kind, signals in (
            ("states", model.states),
            ("inputs", model.inputs),
            ("outputs", model.outputs),
        )
    )
    rows = tuple(
        (name, f"{p.start:g}", f"{p.low:g} to {p.high:g}", _unit(p.unit))
        for name, p in model.params.items()
    )
    header = ("parameter", "start", "bounds", "unit")
    grid = Grid("Parameters", header, rows, frozenset({0, 3}))
    between = Field("inputs between samples", model.input_between_samples)
    return Sheet(f"Model: {model.name}", (*fields, between), (grid,) if rows else ())


def system_sheet(d: SystemDiagnosis) -> Sheet:
    """Return what is shown of a diagnosis of a user's model.

    Parameters
    ----------
    d : SystemDiagnosis
        The diagnosis.
    """
    from comparisons.missing_effect.systems.shown import all_runs, scale_of, split_of, typical
    from comparisons.missing_effect.systems.words import number_words, system_words

    found = tuple(
        (" or ".join(item.alias_labels), item.equation, ", ".join(map(number_words, item.numbers)))
        for item in d.missing
    )
    errors = []
    for run in all_runs(d):
        for j, output in enumerate(run.outputs):
            before, after = float(run.before_rms[j]), float(run.after_rms[j])
            scale = scale_of(d.model.outputs[output], [typical([before, after])])
            record = f"{run.experiment.name} ({split_of(run)})"
            told = (scale.told(before),) if d.missing else ()
            errors.append((record, output, *told, scale.told(after)))
    header = ("record", "output", *(("before", "after") if d.missing else ("rms",)))
    parameters = tuple(
        (
            row.name,
            round_to_error(row.after, row.after_stderr),
            _unit(row.unit),
            "at its bound" if row.at_bound else "",
        )
        for row in d.parameters
    )
    grids = [
        Grid("rms error of the free run", header, tuple(errors), frozenset({0, 1})),
        Grid(
            "Parameters with what was added" if d.missing else "Parameters",
            ("parameter", "value ± std error", "unit", "note"),
            parameters,
            frozenset({0, 2, 3}),
            folded=len(parameters) > 8,
        ),
    ]
    if found:
        words = frozenset(range(3))
        grids.insert(0, Grid("Missing", ("effect", "adds", "numbers"), found, words, marked=0))
    return Sheet(
        f"Diagnosis of {d.model.name}: {d.verdict.replace('_', ' ')}",
        (
            Field("verdict", system_words(d), "good" if d.verdict in CLEAR else "advice"),
            *((Field("remarks", d.remarks, "advice"),) if d.remarks else ()),
        ),
        tuple(grids),
    )


def structure_html(found: FoundStructure) -> str:
    """Return what is shown of a structure, or why there is none.

    Parameters
    ----------
    found : FoundStructure
        The structure.
    """
    if found.refused:
        code, advice = found.state
        return Sheet("No structure", (Field("state", f"{code}: {advice}", "advice"),)).html()
    from sindy_surge.display import html_summary

    return html_summary(found.summary)


def _terms(terms: tuple[str, ...], values: tuple[float, ...], errors: tuple[float, ...]) -> Grid:
    rows = tuple(
        (name, round_to_error(value, error))
        for name, value, error in zip(terms, values, errors, strict=True)
    )
    return Grid("Quasi-steady characteristic", ("term", "coefficient ± std error"), rows)


def _tau(value_s: float, stderr_s: float) -> str:
    known = np.isfinite(value_s)
    return f"{round_to_error(1e3 * value_s, 1e3 * stderr_s)} ms" if known else "not known"


def _unit(unit: str) -> str:
    return "-" if unit == "1" else unit
