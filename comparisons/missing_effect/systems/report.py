"""What a report says of a user's model: verdict, where, who, added, parameters, errors, limits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from comparisons.missing_effect.scales import scale_of, typical
from comparisons.missing_effect.systems.report_words import (
    between_words,
    candidate_cells,
    errors_words,
    floor_words,
    rounds_words,
    stretch_words,
    unfitted_words,
)
from comparisons.missing_effect.systems.results import CheckRun, SystemDiagnosis
from comparisons.missing_effect.systems.shown import (
    all_runs,
    candidates_shown,
    fate_of,
    split_of,
    telling_run,
    telling_stretch,
)
from comparisons.missing_effect.systems.where import where_of
from comparisons.missing_effect.systems.words import doubt_words, number_words, system_words
from comparisons.missing_effect.where_words import describe
from comparisons.page.blocks import Block, Bullets, Cell, Head, Part, Picture, Table, Words
from comparisons.page.html import render_page
from surge_core.rounding import round_to_error, significant

if TYPE_CHECKING:
    from comparisons.missing_effect.systems.search import Round

__all__ = ["system_parts", "system_report"]

CLEAR = ("named", "nothing_missing", "alias_set")


def system_parts(d: SystemDiagnosis) -> tuple[Part, ...]:
    """Return the parts of a report section on what a user's model lacks.

    Parameters
    ----------
    d : SystemDiagnosis
        The diagnosis.
    """
    tone = "plain" if d.verdict in CLEAR else "caution"
    parts = (
        Part(
            f"What is missing: {d.verdict.replace('_', ' ')}",
            (Words(system_words(d), tone), _errors_picture(d)),
        ),
        Part("Where the model and the measurement part", _where(d)),
        Part("Who was tried", _who(d)),
        Part("What was added", _added(d)),
        Part("Parameters of the model", _parameters(d)),
        Part("Errors on each record", (_errors_table(d),)),
        Part("Timing, and inputs between samples", _timing(d)),
        Part("What no model of this kind can know", _floor(d)),
        Part("Effects that could not be tried", (_ledger(d),)),
        Part("Remarks", (Bullets(d.remarks, "caution"),) if d.remarks else ()),
    )
    return tuple(part for part in parts if part.blocks)


def system_report(diagnoses: Mapping[str, SystemDiagnosis], command: str) -> str:
    """Return diagnoses as one self-contained HTML page, a section each.

    Parameters
    ----------
    diagnoses : mapping of str to SystemDiagnosis
        Diagnoses by what each section is called.
    command : str
        The command line that made it.

    Returns
    -------
    str
        HTML with its style and its pictures in it; all text is escaped.
    """
    return render_page(
        [(name, system_parts(d)) for name, d in diagnoses.items()],
        title=f"What is missing in {', '.join(diagnoses)}",
        command=command,
    )


def _errors_picture(d: SystemDiagnosis) -> Picture:
    from comparisons.missing_effect.systems.plots import MOST_RUNS, draw_errors

    runs = all_runs(d)
    cut = (
        f" The first {MOST_RUNS} of {len(runs)} records are drawn." if len(runs) > MOST_RUNS else ""
    )
    two = "Orange: the model as it was; blue: with what was added. " if d.missing else ""
    return Picture.of(
        "Errors of every record and output",
        draw_errors(d),
        f"rms error of the free run of each record: {errors_words(d)}.",
        f"{two}Each record is simulated from its inputs alone by a fit to the training records; "
        "the start of a check record comes from its first rows, which are not scored. Dashed: "
        f"what is new in each sample of the training records, which nothing foretells.{cut}",
    )


def _where(d: SystemDiagnosis) -> tuple[Block, ...]:
    from comparisons.missing_effect.systems.plots import draw_residuals, draw_runs

    run = telling_run(d)
    rows = telling_stretch(run)
    e = run.experiment
    name = f"{e.name} ({split_of(run)})"
    from_s = e.first_s + rows.start * e.sample_period_s
    to_s = e.first_s + rows.stop * e.sample_period_s
    wheres = [where_of(run, d.missing, output=output, model=d.model) for output in run.outputs]
    listed = tuple(words for where in wheres for words in describe(where, two=bool(d.missing)))
    how = (
        "the stretch on which what was added changes most"
        if d.missing
        else "the stretch on which the residual is largest"
    )
    return (
        Bullets(listed, heading=f"On {name}"),
        Picture.of(
            f"Measured and simulated, {name}",
            draw_runs(d, run),
            f"Measured and simulated outputs of {name} from {from_s:.4g} to {to_s:.4g} s, and "
            f"what is left: {stretch_words(d, run, rows)}.",
            f"Of all records of its kind the one that the model misses most, and of it {how}. The "
            "rms above each column is of the whole record.",
        ),
        Picture.of(
            f"Residuals over frequency and over a signal, {name}",
            draw_residuals(d, run),
            " ".join(listed),
            "Left: power densities; where a residual reaches the measured line, the model knows "
            "nothing of that band. Right: mean residual in ranges of a signal with two standard "
            "errors, and small triangles for the rows where the signal rises (up) and falls "
            "(down): a bend is a missing characteristic, two branches are a lag, a friction or a "
            "hysteresis. An output is laid over its own simulated value, since its residual is "
            "part of the measured one.",
            said_above=True,
        ),
    )


def _who(d: SystemDiagnosis) -> tuple[Block, ...]:
    if not d.rounds:
        return (Words("No round of the search was begun."),)
    from comparisons.missing_effect.systems.plots import draw_candidates

    how = (
        "Each effect is laid at each place where it may sit; those that promise most are fitted "
        "together with all parameters of the model, and accepted only where the fitted rows and "
        "the last third, held out, both speak for it, the search paid for. Open terms, which have "
        "no name, compete beside them."
    )
    blocks: list[Block] = [
        Words(how),
        Picture.of(
            "Candidates of each round",
            draw_candidates(d),
            rounds_words(d),
            "Score: log-units won on fitted and held-out rows, less the price of its numbers. "
            "Lengths compare within a round only.",
        ),
    ]
    for number, step in enumerate(d.rounds, start=1):
        blocks += _round(d, step, number)
    return tuple(blocks)


def _round(d: SystemDiagnosis, step: Round, number: int) -> list[Block]:
    heads = (
        Head("candidate"),
        Head("adds", prose=True),
        Head("promise", "log-units by a score test, before it was fitted", numeric=True),
        Head("fitted rows", "log-units won", numeric=True),
        Head("held out", "log-units won", numeric=True),
        Head("z", "mean gain of held-out blocks over its standard error", numeric=True),
        Head("score", numeric=True),
        Head("fate"),
    )
    fitted = candidates_shown(step, most=len(step.candidates))
    rows = tuple(candidate_cells(d, step, c) for c in fitted)
    marks = tuple("best" if fate_of(d, step, c) in ("added", "alias") else "" for c in fitted)
    share = f"; the best explains {100.0 * step.share:.3g} % of the squared whitened errors"
    caption = f"Round {number}{share if step.winner is not None else ''}"
    table = [Table(caption, heads, rows, marks)] if rows else []
    return [*table, Words(unfitted_words(d, step, number), "quiet")]


def _added(d: SystemDiagnosis) -> tuple[Block, ...]:
    if not d.missing:
        return (Words("Nothing was added."),)
    heads = (
        Head("effect"),
        Head("place"),
        Head("equation", prose=True),
        Head("number"),
        Head("value", "with its standard error", numeric=True),
    )
    rows: list[tuple[str | Cell, ...]] = []
    for item in d.missing:
        place = ", ".join(f"{key} {value}" for key, value in item.place.items())
        first: tuple[str | Cell, ...] = (Cell(item.effect, item.label), place, item.equation)
        for cells in [(n.name, number_words(n)) for n in item.numbers] or [("none", "")]:
            rows.append((*first, *cells))
            first = ("", "", "")
    return (
        Table("What was added, fitted to all training rows", heads, tuple(rows)),
        Bullets(tuple(f"{item.label}: {item.says}" for item in d.missing), heading="What happens"),
        *_alias_sets(d),
        *_confirmations(d),
        *((Bullets(doubt_words(d), "caution", "Provisional"),) if doubt_words(d) else ()),
    )


def _alias_sets(d: SystemDiagnosis) -> tuple[Block, ...]:
    listed = tuple(
        f"{item.label}: or {', '.join(label for label in item.alias_labels if label != item.label)}"
        for item in d.missing
        if len(item.alias_labels) > 1
    )
    return (Bullets(listed, "caution", "What these records cannot separate"),) if listed else ()


def _confirmations(d: SystemDiagnosis) -> tuple[Block, ...]:
    """Return the measurement that would confirm each name, those of alias sets included."""
    listed: dict[str, str] = {item.label: item.confirm for item in d.missing if item.confirm}
    kept = {label for item in d.missing for label in item.alias_labels}
    for step in d.rounds:
        for candidate in step.aliases:
            label = candidate.placed.label(d.model)
            if label in kept and candidate.placed.effect.confirm:
                listed.setdefault(label, candidate.placed.effect.confirm)
    items = tuple(f"{label}: {words}" for label, words in listed.items())
    return (Bullets(items, heading="What would confirm it"),) if items else ()


def _parameters(d: SystemDiagnosis) -> tuple[Block, ...]:
    if not d.parameters:
        return (Words("The model has no parameters."),)
    heads = [Head("parameter"), Head("unit"), Head("bounds", "of the user's")]
    heads.append(Head("before" if d.missing else "value", "with standard error", numeric=True))
    if d.missing:
        heads.append(Head("change", "in standard errors before", numeric=True))
        heads.append(Head("after", "with what was added", numeric=True))
    heads.append(Head("note"))
    rows, marks = [], []
    for row in d.parameters:
        own = d.model.params[row.name]
        cells = [row.name, "" if row.unit == "1" else row.unit, f"{own.low:g} to {own.high:g}"]
        cells.append(round_to_error(row.before, row.before_stderr))
        if d.missing:
            known = row.before_stderr > 0.0 and math.isfinite(row.before_stderr)
            change = (row.after - row.before) / row.before_stderr if known else math.nan
            cells.append(f"{change:+.1f}" if known else "")
            cells.append(round_to_error(row.after, row.after_stderr))
        rows.append((*cells, "at its bound" if row.at_bound else ""))
        marks.append("failed" if row.at_bound else "")
    errors = "Errors are robust against coloured residuals: a sandwich over blocks of rows."
    return (
        Table("Fitted to all training rows", tuple(heads), tuple(rows), tuple(marks)),
        Words(errors, "quiet"),
    )


def _errors_table(d: SystemDiagnosis) -> Table:
    last = "after" if d.missing else "rms error"
    heads = [Head("record"), Head("split"), Head("rows", "scored", numeric=True), Head("output")]
    if d.missing:
        heads.append(Head("before", "rms error", numeric=True))
    heads.append(Head(last, "rms error", numeric=True))
    if d.missing:
        heads.append(Head("times smaller", numeric=True))
    heads.append(Head("of the swing", "rms over the output's standard deviation", numeric=True))
    rows = []
    for run in all_runs(d):
        lead = (run.experiment.name, split_of(run), f"{run.measured.shape[0] - run.settle}")
        for j in range(len(run.outputs)):
            rows.append((*lead, *_error_cells(d, run, j)))
            lead = ("", "", "")
    return Table("rms error of the free run", tuple(heads), tuple(rows))


def _error_cells(d: SystemDiagnosis, run: CheckRun, j: int) -> tuple[str, ...]:
    before, after = float(run.before_rms[j]), float(run.after_rms[j])
    scale = scale_of(d.model.outputs[run.outputs[j]], [typical([before, after])])
    swing = float(np.nanstd(run.measured[run.settle :, j]))
    share = f"{significant(100.0 * after / swing, 3)} %" if swing > 0.0 else ""
    if not d.missing:
        return (run.outputs[j], scale.text(after), share)
    ratio = significant(before / after, 3) if after > 0.0 else ""
    return (run.outputs[j], scale.text(before), scale.text(after), ratio, share)


def _timing(d: SystemDiagnosis) -> tuple[Block, ...]:
    if not d.model.inputs:
        return ()
    period_s = d.records.whole[0].sample_period_s
    scale = scale_of("s", [period_s])
    rows = []
    for row in d.offsets:
        time = scale.text(row.value * period_s)
        held = row.stderr <= 0.0
        value = significant(row.value, 3) if held else round_to_error(row.value, row.stderr)
        rows.append((row.name, value, time))
    heads = (
        Head("input"),
        Head("offset", "in samples; positive: the input acts late", numeric=True),
        Head("in time", numeric=True),
    )
    table = (Table("Timing offsets of the inputs", heads, tuple(rows)),) if rows else ()
    return (Words(between_words(d)), *table)


def _floor(d: SystemDiagnosis) -> tuple[Block, ...]:
    if not d.floor:
        return ()
    heads = (
        Head("output"),
        Head("new in each sample", "rms", numeric=True),
        Head("of the swing", "over the output's standard deviation", numeric=True),
        Head("share of the squared error", "of the training records, after", numeric=True),
    )
    return (
        Words(
            "What is left of each error once its own past has foretold what it can: noise of the "
            "measurement, and all that no model with these inputs knows. The rest of an error is "
            "slow or coloured: a disturbance, or something that the model still lacks."
        ),
        Table("Floor of the training records", heads, floor_words(d)),
    )


def _ledger(d: SystemDiagnosis) -> Block:
    if not d.unavailable:
        return Words("None: these records can show every effect of the catalogue.")
    return Table(
        "Effects that no signal of these records can show",
        (Head("effect"), Head("why", prose=True)),
        tuple(d.unavailable.items()),
    )
