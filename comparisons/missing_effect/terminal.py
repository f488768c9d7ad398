"""A diagnosis on the terminal: the verdict, where, and who was tried."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from comparisons.missing_effect.quantities import chance, model_equation, open_words
from comparisons.missing_effect.ranked import CandidateRow, candidate_rows
from comparisons.missing_effect.text import ROWS_PRINTED, aligned, wrapped
from comparisons.missing_effect.where_words import describe
from comparisons.missing_effect.words import (
    noise_words,
    opening_words,
    untold_words,
    untried_words,
    verdict_words,
)
from surge_core.rounding import log_units, significant

if TYPE_CHECKING:
    from comparisons.missing_effect.diagnosis import Diagnosis
    from comparisons.missing_effect.where import Where

__all__ = ["candidate_cells", "candidate_heads", "candidate_table", "diagnosis_text", "legend_of"]

_NAME, _END = ("round", "candidate"), ("τ [ms]", "n", "fate")
_CHANCE_HEADS = (*_NAME, "score", "fitted", "later", "other", "z", "p", *_END)
_SHARE_HEADS = (*_NAME, "explains", "asked", "left out", "last", *_END)
# The columns that a candidate can be refused on.
_CHANCE_COLUMNS = {
    "fitted rows": "fitted",
    "later time": "later",
    "other record": "other",
    "held-out blocks": "z",
}
_SHARE_COLUMNS = {
    "share": "explains",
    # Without twins no share is asked for, and chance decides as on other rows.
    "fitted rows": "explains",
    "later time": "left out",
    "other record": "last",
    "held-out blocks": "left out",
}
_LEFT = ("candidate", "fate")
TOO_SHORT = "The records are too short to tell where."


def candidate_heads(d: Diagnosis) -> tuple[str, ...]:
    """Return the heads of the table of candidates.

    Parameters
    ----------
    d : Diagnosis
        The diagnosis.
    """
    return _SHARE_HEADS if d.whole_runs else _CHANCE_HEADS


def candidate_cells(d: Diagnosis, row: CandidateRow) -> tuple[str, ...]:
    """Return the cells of a candidate, in the order of the heads.

    Parameters
    ----------
    d : Diagnosis
        The diagnosis.
    row : CandidateRow
        The candidate.
    """
    start = (str(row.round), open_words(row.name) if row.kind == "unnamed_term" else row.name)
    end = (significant(1e3 * row.time_constant_s), str(row.parameters_added), _fate(d, row))
    other = _gain(row.other_record_gain)
    if d.whole_runs:
        asked = f"{100 * row.least_share:.0f} %" if np.isfinite(row.least_share) else "n/a"
        return (*start, f"{100 * row.share:.1f} %", asked, _gain(row.later_gain), other, *end)
    return (
        *start,
        _gain(row.score),
        _gain(row.train_gain),
        _gain(row.later_gain),
        other,
        f"{row.held_out_z:.1f}",
        chance(row.p_value),
        *end,
    )


def candidate_table(d: Diagnosis) -> str:
    """Return the ranked candidates as text.

    Parameters
    ----------
    d : Diagnosis
        The diagnosis.
    """
    rows = candidate_rows(d)
    if not rows:
        return "No effect promised enough to be worth a fit."
    heads = candidate_heads(d)
    lines: list[tuple[str, ...]] = [heads]
    more = 0
    for number in range(1, len(d.rounds) + 1):
        own = [row for row in rows if row.round == number]
        kept = [row for i, row in enumerate(own) if i < ROWS_PRINTED or row.chosen or row.alias]
        more += len(own) - len(kept)
        lines += [candidate_cells(d, row) for row in kept]
    text = aligned(lines, _LEFT)
    if more:
        text += f"\nand {more} more (--json holds all)"
    return "\n".join([text, *wrapped(legend_of(d))])


def legend_of(d: Diagnosis) -> str:
    """Say what the columns of the candidates are.

    Parameters
    ----------
    d : Diagnosis
        The diagnosis.
    """
    if d.whole_runs:
        return (
            "Share of the squared errors that it explains, and the share asked for; gain in "
            "log-units on cycles left out, and those of the last record; n numbers added. Refused: "
            "by these columns."
        )
    return (
        "Gains in log-units on the rows fitted, on later time and on the other record; z of the "
        "held-out gain; p with all that was searched; n numbers added; τ on the fitted rows alone. "
        "Refused: by the columns that show no more than chance."
    )


def diagnosis_text(
    d: Diagnosis,
    where: Where | None,
    *,
    limits: Any = None,
    separation: Any = None,
) -> str:
    """Return all that is known as text of at most 100 columns; the table may be wider.

    Parameters
    ----------
    d : Diagnosis
        The diagnosis.
    where : Where or None
        Of the models before and after; None where the records are too short to tell.
    limits, separation : object, optional
        With ``lines``: what would have been named, and what would tell an alias set apart.
    """
    words = verdict_words(d, limited=limits is not None, separated=separation is not None)
    lines = [*wrapped(opening_words(d)), "", f"VERDICT: {d.verdict}", *wrapped(words), ""]
    lines += ["Model", *wrapped(f"  before: {model_equation(d.before)}", "    ")]
    if d.after.structure.effects:
        lines += wrapped(f"  after:  {model_equation(d.after)}", "    ")
    lines += ["", "Where the model and the measurement part"]
    listed = (TOO_SHORT,) if where is None else describe(where, two=bool(d.missing))
    lines += [line for words in listed for line in wrapped(f"  {words}", "    ")]
    if d.verdict != "noise_model_wrong":
        lines += ["", *wrapped(noise_words(d))]
    lines += ["", "Who was tried", candidate_table(d)]
    said = (*untold_words(d), *untried_words(d))
    lines += [line for words in said for line in wrapped(words)]
    for heading, more in (("Limits", limits), ("What would tell them apart", separation)):
        if more is not None:
            lines += ["", heading, *(line for words in more.lines for line in _kept(words))]
    return "\n".join(lines)


def _gain(gain: float) -> str:
    return log_units(gain, "n/a")


def _fate(d: Diagnosis, row: CandidateRow) -> str:
    if row.chosen:
        return "added"
    if row.alias:
        return "alias"
    if row.accepted:
        return "accepted"
    columns = _SHARE_COLUMNS if d.whole_runs else _CHANCE_COLUMNS
    return f"refused: {', '.join(columns[on] for on in row.refused_on)}"


def _kept(line: str) -> list[str]:
    """Wrap a line that may be indented, as one of a table is."""
    return wrapped(line, line[: len(line) - len(line.lstrip())] + "  ")
