"""What a report says of a diagnosis: verdict, where, who, added, shown, limits."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

from comparisons.missing_effect.quantities import (
    equation_of,
    model_equation,
    quantity,
    symbol,
    tau_ms,
)
from comparisons.missing_effect.ranked import candidate_rows, effect_of, not_fitted
from comparisons.missing_effect.shown import tau_before_stderr_s
from comparisons.missing_effect.terminal import (
    TOO_SHORT,
    candidate_cells,
    candidate_heads,
    legend_of,
)
from comparisons.missing_effect.where_words import describe
from comparisons.missing_effect.words import (
    noise_words,
    opening_words,
    untold_words,
    untried_words,
    verdict_words,
)
from comparisons.page.blocks import Block, Bullets, Head, Part, Table, Words
from comparisons.page.html import render_page
from comparisons.show.plots_missing_effect import diagnosis_picture
from surge_core.rounding import significant

if TYPE_CHECKING:
    from comparisons.missing_effect.diagnosis import Diagnosis
    from comparisons.missing_effect.effect import Parameter
    from comparisons.missing_effect.where import Where

__all__ = ["diagnosis_parts", "diagnosis_report"]

_WORDS_COLUMNS = ("candidate", "fate")


def diagnosis_parts(
    d: Diagnosis,
    where: Where | None,
    *,
    limits: Any = None,
    separation: Any = None,
) -> tuple[Part, ...]:
    """Return the parts of a report section on what is missing.

    Parameters
    ----------
    d : Diagnosis
        The diagnosis.
    where : Where or None
        Where the residuals before and after stand out; None where the records are too short.
    limits, separation : object, optional
        With ``lines``: what would have been named, and what would separate an alias set.
    """
    words = verdict_words(d, limited=limits is not None, separated=separation is not None)
    tone = "plain" if d.verdict in ("named", "nothing_missing", "alias_set") else "caution"
    parts = (
        Part(
            f"What is missing: {d.verdict.replace('_', ' ')}",
            (Words(words, tone), diagnosis_picture(d, where), _gap_table(d)),
        ),
        Part("Where the model and the measurement part", _where(d, where)),
        Part("Who was tried", _candidates(d)),
        Part("What was added", _added(d)),
        Part("Noise and what is left", _left(d)),
        Part("Limits", _lines(limits)),
        Part("What would separate an alias set", _lines(separation)),
        Part("Effects that could not be tried", (_ledger(d),)),
    )
    first, *others = (part for part in parts if part.blocks)
    return (first, *(replace(part, folded=True) for part in others))


def diagnosis_report(
    d: Diagnosis,
    where: Where | None,
    *,
    limits: Any = None,
    separation: Any = None,
    command: str = "sindy-surge diagnose",
) -> str:
    """Return a diagnosis as one self-contained HTML page.

    Parameters
    ----------
    d, where, limits, separation
        See :func:`diagnosis_parts`.
    command : str
        The command line that made it.
    """
    names = ", ".join(PurePath(source).name for source in d.data.sources)
    parts = diagnosis_parts(d, where, limits=limits, separation=separation)
    return render_page(
        [(names, parts)],
        title=f"What is missing in the lag model of {names}",
        command=command,
    )


def _gap_table(d: Diagnosis) -> Table:
    gap = d.gap
    stderr = tau_before_stderr_s(d)
    heads = (
        Head("model"),
        Head("held-out rms of ψ'", "by a fit to other rows", numeric=True),
        Head("times the noise", numeric=True),
        Head("τ", "by a fit to all rows, with its standard error", numeric=True),
    )
    rows = [("before", gap.before_rms, tau_ms(d.tau_before_s, stderr))]
    if d.missing:
        rows.append(("after", gap.after_rms, tau_ms(d.tau_after_s, d.tau_stderr_s)))
        aliases = [name for item in d.missing for name in item.alias_set[1:]]
        rows += [
            (f"with {name} instead", math.nan, tau_ms(d.tau_by_alias_s[name]))
            for name in aliases
            if name in d.tau_by_alias_s
        ]
    cells = [
        (name, *(("", "") if math.isnan(rms) else _rms_cells(rms, gap.floor_rms)), tau)
        for name, rms, tau in rows
    ]
    cells.append(("noise", significant(gap.floor_rms, 3), "1.00", ""))
    closed = (
        f"; {100.0 * min(gap.shrink, 1.0):.1f} % of it closed" if d.missing and gap.shrink else ""
    )
    return Table(f"Gap on rows held out{closed}", heads, tuple(cells))


def _rms_cells(rms: float, floor: float) -> tuple[str, str]:
    return significant(rms, 3), f"{rms / floor:.2f}"


def _where(d: Diagnosis, where: Where | None) -> tuple[Block, ...]:
    if where is None:
        return (Words(TOO_SHORT),)
    return (
        Words(opening_words(d), "quiet"),
        Bullets(describe(where, two=bool(d.missing))),
    )


def _candidates(d: Diagnosis) -> tuple[Block, ...]:
    heads = tuple(
        Head(text, numeric=text not in _WORDS_COLUMNS, prose=text == "fate")
        for text in candidate_heads(d)
    )
    rows = candidate_rows(d)
    marks = tuple("best" if row.chosen or row.alias else "" for row in rows)
    table = Table(
        "Candidates, round by round, best first",
        heads,
        tuple(candidate_cells(d, row) for row in rows),
        marks,
    )
    said = (*untold_words(d), *untried_words(d)[: bool(not_fitted(d))])
    untried = tuple(Words(words, "quiet") for words in said)
    if not rows:
        return (Words("No effect promised enough to be worth a fit."), *untried)
    how = (
        "Each effect is fitted together with τ and the characteristic, and accepted only where the "
        "fitted rows, later time and the other record all speak for it, the search paid for. Open "
        "terms, which have no name, compete beside them."
    )
    if d.whole_runs:
        how = (
            "Each effect is fitted together with τ and the characteristic, to the record and to "
            "twins of it, which lack nothing. It is accepted only where it explains more of the "
            "squared errors than of any twin, by a number beyond theirs, and on cycles left out."
        )
    return (
        Words(how),
        table,
        Words(legend_of(d), "quiet"),
        *untried,
    )


def _added(d: Diagnosis) -> tuple[Block, ...]:
    models = [f"before: {model_equation(d.before)}"]
    if not d.missing:
        return (Words("\n".join(models), "code"), Words("Nothing was added."))
    if d.after.structure.effects:
        models.append(f"after:  {model_equation(d.after)}")
    heads = (
        Head("effect"),
        Head("port"),
        Head("equation", prose=True),
        Head("number"),
        Head("value", numeric=True),
        Head("bounds", "physical bounds of the search"),
    )
    rows = []
    for item in d.missing:
        effect = effect_of(d, item.effect)
        bounds = {own.name: _bounds(own) for own in effect.parameters}
        for i, p in enumerate(item.parameters):
            first = (item.effect, effect.port, equation_of(effect)) if i == 0 else ("", "", "")
            rows.append(
                (
                    *first,
                    symbol(p.name),
                    quantity(p.value, p.stderr, p.unit),
                    bounds.get(p.name, ""),
                )
            )
    names = [name for item in d.missing for name in item.alias_set]
    named = [each for each in (effect_of(d, name) for name in names) if not each.unnamed]
    added = {item.effect for item in d.missing}
    lists = (
        Bullets(tuple(f"{e.name}: {e.confirm}" for e in named), heading="What would confirm it"),
        Bullets(
            tuple(f"{e.name}: {e.on_tau}" for e in named if e.name in added),
            heading="What τ suffers without it",
        ),
    )
    return (
        Words("\n".join(models), "code"),
        Table("What was added, fitted to all rows", heads, tuple(rows)),
        *(each for each in lists if each.items),
    )


def _bounds(parameter: Parameter) -> str:
    if not math.isfinite(parameter.high):
        return "none"
    unit = "" if parameter.unit == "1" else f" {parameter.unit}"
    return f"{parameter.low:g} to {parameter.high:g}{unit}"


def _left(d: Diagnosis) -> tuple[Block, ...]:
    left = d.leftover
    words = (
        f"A joint test of {left.degrees} columns, those of all effects and open terms that were "
        f"not added, would win {left.gain:.1f} log-units on the fitted rows (p "
        f"{left.p_value:.2g}): "
        + ("structure is left." if left.structured else "no more than chance.")
    )
    return (Words(noise_words(d)), *([Words(words)] if left.degrees else []))


def _lines(found: Any) -> tuple[Block, ...]:
    # The lines may be those of a table.
    return () if found is None else (Words("\n".join(found.lines), "code"),)


def _ledger(d: Diagnosis) -> Block:
    if not d.unavailable:
        return Words("None: these records can show every effect of the catalogue.")
    return Table(
        "Effects that these records cannot show",
        (Head("effect"), Head("why", prose=True)),
        tuple(d.unavailable.items()),
    )
