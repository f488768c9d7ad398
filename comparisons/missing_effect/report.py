"""A diagnosis as a page: verdict, where, errors, what was added, who was tried, what is open."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from comparisons.missing_effect.lag_result import LagDiagnosis
from comparisons.missing_effect.lag_words import noise_words
from comparisons.missing_effect.quantities import model_equation, plain_name
from comparisons.missing_effect.results import CLEAR
from comparisons.missing_effect.systems.results import SystemDiagnosis
from comparisons.missing_effect.telling import telling_run, telling_stretch, wheres_of
from comparisons.missing_effect.terminal import (
    TOO_SHORT,
    candidate_grid,
    legend_of,
    on_records,
    timing_words,
)
from comparisons.missing_effect.where_words import describe
from comparisons.missing_effect.words import (
    confirm_words,
    effect_words,
    ledger_words,
    verdict_words,
)
from comparisons.page.blocks import Block, Bullets, Part, Picture, Table, Words
from comparisons.page.html import render_page
from surge_core.rounding import significant

if TYPE_CHECKING:
    from comparisons.missing_effect.results import Diagnosis
    from comparisons.missing_effect.where_rows import Where

_PROSE = ("effect", "adds", "candidate")
HOW = (
    "Each effect is laid wherever it may act and fitted together with all parameters of the model. "
    "It is accepted only where the fitted rows and those held out both speak for it, the search "
    "paid for; terms without a name compete beside it."
)
HOW_TWINS = (
    "Each effect is fitted together with τ and the characteristic, to the record and to twins of "
    "it, which lack nothing. It is accepted only where it explains more of the squared errors than "
    "of any twin, by a number beyond theirs, and on cycles left out."
)
READING = (
    "Top: the stretch on which what was added changes most, of the run that the model misses most, "
    "simulated from its inputs alone; below it what is left. Then the power density of the "
    "residual, and its mean in ranges of a signal with two standard errors and small triangles for "
    "a rising (up) and a falling (down) signal: a bend is a missing characteristic, two branches "
    "are a lag, a friction or a hysteresis. Bottom: what competed, the alias set hatched or pale."
)


def diagnosis_parts(
    d: Diagnosis, *, limits: Any = None, separation: Any = None
) -> tuple[Part, ...]:
    """Return the parts of a report section on what is missing.

    Parameters
    ----------
    d : Diagnosis
        Of a lag or of a user's model.
    limits, separation : object, optional
        With ``lines``: what would have been named, and what would separate an alias set.
    """
    words = verdict_words(d, limited=limits is not None, separated=separation is not None)
    wheres = wheres_of(d)
    parts = (
        Part(
            f"What is missing: {d.verdict.replace('_', ' ')}",
            (Words(words, "plain" if d.verdict in CLEAR else "caution"), _picture(d, wheres)),
        ),
        Part(
            "Errors before and after",
            (Table.of(d.errors_grid()),),
        ),
        Part(f"Where the model and the measurement part{on_records(wheres)}", _where(d, wheres)),
        Part("What was added", _added(d)),
        Part("Parameters of the model", _parameters(d)),
        Part("Effects tried", _tried(d)),
        Part("What is open, absent or out of reach", (Bullets(ledger_words(d)),)),
        Part("Limits", _lines(limits)),
        Part("What would separate an alias set", _lines(separation)),
    )
    first, *others = (
        part for part in parts if any(getattr(block, "items", True) for block in part.blocks)
    )
    return (first, *(replace(part, folded=True) for part in others))


def diagnosis_report(
    diagnoses: Mapping[str, Diagnosis],
    command: str = "sindy-surge diagnose",
    *,
    limits: Any = None,
    separation: Any = None,
) -> str:
    """Return diagnoses as one self-contained HTML page, a section each.

    Parameters
    ----------
    diagnoses : mapping of str to Diagnosis
        Diagnoses by what each section is called.
    command : str
        The command line that made it.
    limits, separation : object, optional
        See :func:`diagnosis_parts`.

    Returns
    -------
    str
        HTML with its style and its pictures in it; all text is escaped.
    """
    return render_page(
        [
            (name, diagnosis_parts(d, limits=limits, separation=separation))
            for name, d in diagnoses.items()
        ],
        title=f"What is missing in {', '.join(diagnoses)}",
        command=command,
    )


def _picture(d: Diagnosis, wheres: tuple[Where, ...]) -> Picture:
    from comparisons.missing_effect.plots import draw_diagnosis

    run = telling_run(d)
    rows = telling_stretch(run)
    first, last = run.time_s[rows.start], run.time_s[rows.stop - 1]
    gap = d.gap
    fell = f"{significant(gap.before_rms, 3)} before and " if d.missing else ""
    after = " after" if d.missing else ""
    return Picture(
        "The diagnosis in one picture",
        draw_diagnosis(d, wheres),
        f"Measured and simulated outputs of {run.title} from {first:.4g} to {last:.4g} s; rms "
        f"error {fell}{significant(gap.after_rms, 3)}{after}.",
        READING,
    )


def _where(d: Diagnosis, wheres: tuple[Where, ...]) -> tuple[Block, ...]:
    said = tuple(words for where in wheres for words in describe(where, two=bool(d.missing)))
    return (Bullets(said or (TOO_SHORT,)),)


def _added(d: Diagnosis) -> tuple[Block, ...]:
    if not d.missing:
        return (Words("Nothing was added."),)
    said = tuple(
        words for item in d.missing for words in (effect_words(item), *confirm_words(item))
    )
    doubts = tuple(
        f"{plain_name(item.label)}: {why}" for item in d.missing for why in d.doubts_of(item)
    )
    return (
        Table.of(d.effect_grid(), prose=_PROSE),
        Bullets(said),
        *((Bullets(doubts, "caution", "Why a name is not firm"),) if doubts else ()),
    )


def _parameters(d: Diagnosis) -> tuple[Block, ...]:
    blocks: list[Block] = []
    if isinstance(d, LagDiagnosis):
        models = [f"before: {model_equation(d.before)}", f"after:  {model_equation(d.after)}"]
        blocks.append(Words("\n".join(models[: 2 if d.missing else 1]), "code"))
    if d.parameters:
        marks = tuple("failed" if row.at_bound else "" for row in d.parameters)
        blocks.append(replace(Table.of(d.parameter_grid()), marks=marks))
    if isinstance(d, SystemDiagnosis):
        blocks += [Words(words) for words in [timing_words(d)] if words]
    if isinstance(d, LagDiagnosis):
        blocks.append(Words(noise_words(d)))
    return tuple(blocks)


def _tried(d: Diagnosis) -> tuple[Block, ...]:
    rows = [row for row in d.candidates if row.fitted]
    twins = isinstance(d, LagDiagnosis) and d.whole_runs
    if not rows:
        return (Words("No effect promised enough to be worth a fit."),)
    marks = tuple("best" if row.chosen or row.alias else "" for row in rows)
    more = len(d.candidates) - len(rows)
    left = f" {more} more promised too little to be fitted."
    return (
        Words(HOW_TWINS if twins else HOW),
        replace(Table.of(candidate_grid(rows), prose=_PROSE), marks=marks),
        Words(f"{legend_of(rows)}{left * (more > 0)}", "quiet"),
    )


def _lines(found: Any) -> tuple[Block, ...]:
    # The lines may be those of a table.
    return () if found is None else (Words("\n".join(found.lines), "code"),)
