"""A diagnosis on the terminal, in at most 100 columns; tables may be wider."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Sequence
from typing import Any

from comparisons.missing_effect.lag_result import LagDiagnosis
from comparisons.missing_effect.lag_words import noise_words
from comparisons.missing_effect.quantities import chance, open_words, plain_name
from comparisons.missing_effect.results import CandidateRow, Diagnosis
from comparisons.missing_effect.systems.results import SystemDiagnosis
from comparisons.missing_effect.telling import wheres_of
from comparisons.missing_effect.where_rows import Where
from comparisons.missing_effect.where_words import describe
from comparisons.missing_effect.words import (
    confirm_words,
    effect_words,
    ledger_words,
    verdict_words,
)
from surge_core.display import Grid
from surge_core.rounding import bracketed, log_units, significant

WIDTH = 100
# Of a long ranking the best are printed; --json holds all.
ROWS_PRINTED = 8
TOO_SHORT = "The records are too short to say where, or could not be simulated."
_REFUSED = {
    "fitted rows": "fitted",
    "later time": "held out",
    "other record": "other",
    "held-out blocks": "z",
    "share": "explains",
}


def diagnosis_text(d: Diagnosis, *, limits: Any = None, separation: Any = None) -> str:
    """Return all that a reader needs as text.

    Parameters
    ----------
    d : Diagnosis
        Of a lag or of a user's model.
    limits, separation : object, optional
        With ``lines``: what would have been named, and what would tell an alias set apart.
    """
    lag = d if isinstance(d, LagDiagnosis) else None
    words = verdict_words(d, limited=limits is not None, separated=separation is not None)
    parts = [
        [f"VERDICT: {d.verdict}", *_wrapped(words)],
        _effects(d),
        _table(d.parameter_grid()) if d.parameters else [],
        _wrapped(timing_words(d)) if isinstance(d, SystemDiagnosis) else [],
        _table(d.errors_grid()),
        _where(d),
        _wrapped(noise_words(lag)) if lag and lag.verdict != "noise_model_wrong" else [],
        _candidates(d),
        [line for said in ledger_words(d) for line in _wrapped(said)],
    ]
    for heading, more in (("Limits", limits), ("What would separate them", separation)):
        if more is not None:
            parts.append([heading, *(line for said in more.lines for line in _kept(said))])
    return "\n\n".join("\n".join(part) for part in parts if part)


def candidate_grid(rows: Sequence[CandidateRow]) -> Grid:
    """Return a line for each candidate, without columns that none fills.

    Parameters
    ----------
    rows : sequence of CandidateRow
        Of one diagnosis.
    """
    by_share = any(math.isfinite(row.share) for row in rows)
    columns: dict[str, Callable[[CandidateRow], str]] = {
        "round": lambda row: str(row.round),
        # A name of a lag says where it acts.
        "candidate": lambda row: plain_name(
            open_words(row.name) if "port" in row.place else row.label
        ),
        "promised": lambda row: _gain(row.promised),
        "explains": lambda row: f"{100.0 * row.share:.1f} %" if math.isfinite(row.share) else "",
        "asked": lambda row: (
            f"{100.0 * row.least_share:.0f} %" if math.isfinite(row.least_share) else ""
        ),
        "score": lambda row: "" if by_share else _gain(row.score),
        "fitted": lambda row: "" if by_share else _gain(row.train_gain),
        "held out": lambda row: _gain(row.later_gain),
        "other": lambda row: _gain(row.other_record_gain),
        "z": lambda row: f"{row.held_out_z:.1f}" if math.isfinite(row.held_out_z) else "",
        "p": lambda row: "" if by_share or math.isnan(row.p_value) else chance(row.p_value),
        "τ [ms]": lambda row: (
            significant(1e3 * row.time_constant_s) if math.isfinite(row.time_constant_s) else ""
        ),
        "fate": _fate,
    }
    lines = [tuple(cell(row) for cell in columns.values()) for row in rows]
    kept = [j for j in range(len(columns)) if any(line[j] for line in lines)]
    header = tuple(list(columns)[j] for j in kept)
    words = frozenset((header.index("candidate"), header.index("fate")))
    return Grid("Effects tried", header, tuple(tuple(r[j] for j in kept) for r in lines), words)


def legend_of(rows: Sequence[CandidateRow]) -> str:
    """Say what the columns of the candidates are.

    Parameters
    ----------
    rows : sequence of CandidateRow
        Of one diagnosis.
    """
    gains = "held out, other: gains in log-units there; z of the held-out gain."
    if any(math.isfinite(row.share) for row in rows):
        return f"Share of the squared errors that it explains, and the share asked for; {gains}"
    promised = any(math.isfinite(row.promised) for row in rows)
    first = "Promised by a score test before the fit; score" if promised else "Score"
    return f"{first}, fitted, {gains.removesuffix('.')}; p with all that was searched."


def timing_words(d: SystemDiagnosis) -> str:
    """Say how inputs run between samples, and how late each acts.

    Parameters
    ----------
    d : SystemDiagnosis
        The diagnosis.
    """
    if not d.model.inputs:
        return ""
    listed = ", ".join(f"{o.name} {bracketed(o.value, o.stderr)} samples" for o in d.offsets)
    before, after = d.before.structure.between, d.after.structure.between
    earlier = f" (before: {before})" if before != after else ""
    return f"Inputs between samples: {after}{earlier}; timing offsets: {listed}."


def on_records(wheres: Sequence[Where]) -> str:
    """Return the end of a heading: on which records it was looked.

    Parameters
    ----------
    wheres : sequence of Where
        Where the residuals of one diagnosis stand out.
    """
    return f", on {', '.join(wheres[0].of.record_names)}" if wheres else ""


def _effects(d: Diagnosis) -> list[str]:
    if not d.missing:
        return []
    lines = _table(d.effect_grid())
    said = [words for i in d.missing for words in (effect_words(i), *confirm_words(i)) if words]
    return [*lines, *(line for words in said for line in _wrapped(f"  {words}", "    "))]


def _where(d: Diagnosis) -> list[str]:
    wheres = wheres_of(d)
    said = [words for where in wheres for words in describe(where, two=bool(d.missing))]
    lines = [line for words in said or (TOO_SHORT,) for line in _wrapped(f"  {words}", "    ")]
    return [f"Where the model and the measurement part{on_records(wheres)}", *lines]


def _candidates(d: Diagnosis) -> list[str]:
    fitted = [row for row in d.candidates if row.fitted]
    if not fitted:
        return ["No effect promised enough to be worth a fit."]
    kept: list[CandidateRow] = []
    for number in dict.fromkeys(row.round for row in fitted):
        own = [row for row in fitted if row.round == number]
        kept += [r for i, r in enumerate(own) if i < ROWS_PRINTED or r.chosen or r.alias]
    lines = _table(candidate_grid(kept))
    more = len(d.candidates) - len(kept)
    lines += [f"and {more} more (--json holds all)"] if more else []
    return [*lines, *_wrapped(legend_of(kept))]


def _fate(row: CandidateRow) -> str:
    on = ", ".join(_REFUSED[name] for name in row.refused_on if name in _REFUSED)
    return f"refused: {on}" if row.fate == "refused" and on else row.fate


def _gain(gain: float) -> str:
    return log_units(gain, "")


def _table(grid: Grid) -> list[str]:
    return [grid.title, *(f"  {line}" for line in grid.lines())]


def _wrapped(prose: str, later: str = "") -> list[str]:
    return textwrap.wrap(prose, WIDTH, subsequent_indent=later, break_on_hyphens=False)


def _kept(line: str) -> list[str]:
    """Wrap a line that may be indented, as one of a table is."""
    return _wrapped(line, line[: len(line) - len(line.lstrip())] + "  ")
