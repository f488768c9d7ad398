"""A diagnosis as parts: verdict, what was added, errors, where, who was tried, what is open.

One list for the page and the terminal, which leaves out the picture and the ends of long tables.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from comparisons.missing_effect.quantities import chance
from comparisons.missing_effect.results import CLEAR, CandidateRow
from comparisons.missing_effect.where_rows import describe
from comparisons.missing_effect.words import effect_words, ledger_words, verdict_words
from comparisons.page.blocks import Block, Bullets, Part, Picture, Words
from comparisons.page.html import render_page
from surge_core.display import Grid
from surge_core.rounding import log_units, significant

if TYPE_CHECKING:
    from comparisons.missing_effect.results import Diagnosis

# Columns of a terminal.
WIDTH = 100
# Of a long ranking the best are printed; --json holds all.
ROWS_PRINTED = 8
TOO_SHORT = "The records are too short to say where, or could not be simulated."
NONE_FITTED = "No effect promised enough to be worth a fit."
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
OWN_ERRORS = (
    "The errors of τ and of the size of an effect hold the scatter of twins and of choices of the "
    "fit, where twins were measured. What the time from plane to plane and the law of the probes "
    "near zero flow may do to τ is not in them; `sindy-surge compare` counts it in."
)
READING = (
    "Top: the stretch on which what was added changes most, of the run that the model misses most, "
    "simulated from its inputs alone; below it what is left. Then the power density of the "
    "residual, and its mean in ranges of a signal with two standard errors and small triangles for "
    "a rising (up) and a falling (down) signal: a bend is a missing characteristic, two branches "
    "are a lag, a friction or a hysteresis. Bottom: what competed, the alias set hatched or pale."
)
_REFUSED = {
    "fitted rows": "gains too little",
    "later time": "no gain held out",
    "other record": "no gain on the other record",
    "held-out blocks": "gain not steady",
    "share": "explains too little",
    "end of the search": "a number at its end",
}


def diagnosis_parts(
    d: Diagnosis, *, limits: Any = None, separation: Any = None, brief: bool = False
) -> tuple[Part, ...]:
    """Return the parts of a report section on what is missing.

    Parameters
    ----------
    d : Diagnosis
        Of a lag or of a user's model.
    limits, separation : object, optional
        With ``lines``: what would have been named, and what would separate an alias set.
    brief : bool
        Without the picture, the equations of the model and the ends of long tables.
    """
    where = [said for one in d.wheres for said in describe(one, two=bool(d.missing))]
    on = f", on {', '.join(d.wheres[0].of.record_names)}" if d.wheres else ""
    noise = (Words(d.noise_said),) if d.verdict != "noise_model_wrong" and d.noise_said else ()
    parts = (
        Part(
            f"What is missing: {d.verdict.replace('_', ' ')}",
            (
                Words(verdict_words(d), "plain" if d.verdict in CLEAR else "caution"),
                *(() if brief else (_picture(d),)),
            ),
        ),
        Part("What was added", _added(d)),
        Part("Parameters of the model", _parameters(d, brief)),
        Part("Errors before and after", (d.errors_grid(),)),
        Part(
            f"Where the model and the measurement part{on}",
            (Bullets(tuple(where) or (TOO_SHORT,)), *noise),
        ),
        Part("Effects tried", _tried(d, brief)),
        Part("What is open, absent or out of reach", (Bullets(ledger_words(d)),)),
        Part("Limits", _lines(limits)),
        Part("What would separate them", _lines(separation)),
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


def diagnosis_text(d: Diagnosis, *, limits: Any = None, separation: Any = None) -> str:
    """Return all that a reader needs as text, in at most 100 columns; tables may be wider.

    Parameters
    ----------
    d : Diagnosis
        Of a lag or of a user's model.
    limits, separation : object, optional
        See :func:`diagnosis_parts`.
    """
    first, *others = diagnosis_parts(d, limits=limits, separation=separation, brief=True)
    verdict = [f"VERDICT: {d.verdict}", *(line for b in first.blocks for line in _printed(b))]
    paragraphs = [verdict, *(lines for part in others for lines in _paragraphs(part))]
    return "\n\n".join(map("\n".join, paragraphs))


def _paragraphs(part: Part) -> list[list[str]]:
    """Return the lines of each block; lists and small print go on with what is above them."""
    # A table has a title of its own, a sentence needs none.
    out = [[part.title]] if _goes_on(part.blocks[0]) else []
    for block in part.blocks:
        if _goes_on(block):
            out[-1] += _printed(block)
        else:
            out.append(_printed(block))
    return out


def _goes_on(block: Block) -> bool:
    return isinstance(block, Bullets) or getattr(block, "tone", "") in ("quiet", "code")


def _printed(block: Block) -> list[str]:
    if isinstance(block, Bullets):
        return [line for item in block.items for line in _wrapped(f"  {item}", "    ")]
    if isinstance(block, Grid):
        return [block.title, *(f"  {line}" for line in block.lines())]
    assert isinstance(block, Words)
    if block.tone != "code":
        return _wrapped(block.text)
    # A line may be indented, as one of a table is.
    lines = [(line, len(line) - len(line.lstrip())) for line in block.text.split("\n")]
    return [out for line, indent in lines for out in _wrapped(line, " " * (indent + 2))]


def _wrapped(prose: str, later: str = "") -> list[str]:
    return textwrap.wrap(prose, WIDTH, subsequent_indent=later, break_on_hyphens=False)


def _picture(d: Diagnosis) -> Picture:
    from comparisons.missing_effect.plots import draw_diagnosis, telling_stretch

    run, gap = d.telling_run, d.gap
    rows = telling_stretch(run)
    first, last = run.time_s[rows.start], run.time_s[rows.stop - 1]
    fell = f"{significant(gap.before_rms, 3)} before and " if d.missing else ""
    after = " after" if d.missing else ""
    return Picture(
        "The diagnosis in one picture",
        draw_diagnosis(d),
        f"Measured and simulated outputs of {run.title} from {first:.4g} to {last:.4g} s; rms "
        f"error {fell}{significant(gap.after_rms, 3)}{after}.",
        READING,
    )


def _added(d: Diagnosis) -> tuple[Block, ...]:
    if not d.missing:
        return ()
    said = tuple(words for item in d.missing for words in effect_words(item))
    return (d.effect_grid(), Bullets(said))


def _parameters(d: Diagnosis, brief: bool) -> tuple[Block, ...]:
    blocks: list[Block] = []
    if d.equations and not brief:
        blocks.append(Words("\n".join(d.equations), "code"))
    if d.parameters:
        marks = tuple("failed" if row.at_bound else "" for row in d.parameters)
        blocks.append(replace(d.parameter_grid(), marks=marks))
    if d.fit_said:
        blocks.append(Words(d.fit_said))
    if d.whole_runs:
        blocks.append(Words(OWN_ERRORS, "quiet"))
    return tuple(blocks)


def _tried(d: Diagnosis, brief: bool) -> tuple[Block, ...]:
    fitted = [row for row in d.candidates if row.fitted]
    if not fitted:
        return (Words(NONE_FITTED),)
    if not brief:
        marks = tuple("best" if row.chosen or row.alias else "" for row in fitted)
        left = f" {len(d.candidates) - len(fitted)} more promised too little to be fitted."
        more = left if len(d.candidates) > len(fitted) else ""
        return (
            Words(HOW_TWINS if d.whole_runs else HOW),
            replace(_candidate_grid(fitted), marks=marks),
            Words(_legend(fitted) + more, "quiet"),
        )
    kept: list[CandidateRow] = []
    for number in dict.fromkeys(row.round for row in fitted):
        own = [row for row in fitted if row.round == number]
        kept += [r for i, r in enumerate(own) if i < ROWS_PRINTED or r.chosen or r.alias]
    rest = len(d.candidates) - len(kept)
    said = [Words(f"and {rest} more (--json holds all)", "quiet")] if rest else []
    return (_candidate_grid(kept), *said, Words(_legend(kept), "quiet"))


def _lines(found: Any) -> tuple[Block, ...]:
    # The lines may be those of a table.
    return () if found is None else (Words("\n".join(found.lines), "code"),)


def _candidate_grid(rows: Sequence[CandidateRow]) -> Grid:
    """Return a line for each candidate of a diagnosis, without columns that none fills."""
    by_share = any(math.isfinite(row.share) for row in rows)
    columns: dict[str, Callable[[CandidateRow], str]] = {
        "round": lambda row: str(row.round),
        "candidate": lambda row: row.shown,
        "promised": lambda row: log_units(row.promised, ""),
        "explains": lambda row: _text(100.0 * row.share, "{:.1f} %"),
        "asked": lambda row: _text(100.0 * row.least_share, "{:.0f} %"),
        "score": lambda row: "" if by_share else log_units(row.score, ""),
        "fitted": lambda row: "" if by_share else log_units(row.train_gain, ""),
        "held out": lambda row: log_units(row.later_gain, ""),
        "other": lambda row: log_units(row.other_record_gain, ""),
        "z": lambda row: _text(row.held_out_z, "{:.1f}"),
        "p": lambda row: "" if by_share or math.isnan(row.p_value) else chance(row.p_value),
        "τ [ms]": lambda row: _text(1e3 * row.time_constant_s),
        "fate": _fate,
    }
    cells = {head: [cell(row) for row in rows] for head, cell in columns.items()}
    kept = {head: column for head, column in cells.items() if any(column)}
    header = tuple(kept)
    words = frozenset((header.index("candidate"), header.index("fate")))
    return Grid("Effects tried", header, tuple(zip(*kept.values(), strict=True)), words)


def _legend(rows: Sequence[CandidateRow]) -> str:
    """Say what the columns of the candidates are."""
    other = ", other" if any(math.isfinite(row.other_record_gain) for row in rows) else ""
    gains = f"held out{other}: the gain there, in log-units; z: of the held-out gain"
    if any(math.isfinite(row.share) for row in rows):
        return f"explains: the share of the squared errors; asked: the least share; {gains}."
    promised = any(math.isfinite(row.promised) for row in rows)
    first = "promised: by a score test before the fit; " if promised else ""
    return f"{first}score, fitted, {gains}; p: chance of the gain, the whole search counted."


def _text(value: float, form: str = "") -> str:
    if not math.isfinite(value):
        return ""
    return form.format(value) if form else significant(value)


def _fate(row: CandidateRow) -> str:
    # What explains too little was not tried on cycles left out.
    reasons = ("share",) if "share" in row.refused_on else row.refused_on
    on = ", ".join(_REFUSED[name] for name in reasons if name in _REFUSED)
    return f"refused: {on}" if row.fate == "refused" and on else row.fate
