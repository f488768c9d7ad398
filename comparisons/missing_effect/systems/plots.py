"""Pictures of a diagnosis of a user's model: runs, residuals, candidates, errors."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from comparisons.missing_effect.scales import Scale, scale_of, typical
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
from comparisons.missing_effect.where_panels import draw_over_signal, draw_spectrum
from comparisons.page.style import (
    ACCENT,
    FAINT,
    INK,
    MARK,
    MEASURED,
    QUIET,
    dress,
    legend_above,
    new_figure,
    printable,
    robust_limits,
)
from surge_core.rounding import significant

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from comparisons.missing_effect.systems.search import Candidate, Round
    from surge_core.types import FloatArray

__all__ = ["MOST_RUNS", "draw_candidates", "draw_errors", "draw_residuals", "draw_runs"]

BEFORE, AFTER = MARK, ACCENT
PALE = "#d3e5f1"
SMALL = 8.5
TINY = 7.5
# Panels beside each other.
COLUMNS = 3
# Runs in the chart of errors; tables hold all.
MOST_RUNS = 24
LONGEST_LABEL, LONGEST_NAME = 48, 30
# Errors further apart than this are drawn on a logarithmic axis.
LOGARITHMIC_RATIO = 8.0
FATES = ("added", "alias", "too little", "accepted", "refused")
_MEANT = {
    "added": "added",
    "alias": "cannot be separated from it by these records",
    "too little": "best, but not added",
    "accepted": "accepted",
    "refused": "not accepted",
}


def draw_runs(d: SystemDiagnosis, run: CheckRun | None = None) -> Figure:
    """Draw measured and simulated outputs and both residuals on a telling stretch of a run.

    Parameters
    ----------
    d : SystemDiagnosis
        The diagnosis.
    run : CheckRun, optional
        One of its runs; without it the check run that the model before misses most.

    Returns
    -------
    Figure
        One column an output: above measured, before and after; below the residuals.
    """
    chosen = telling_run(d) if run is None else run
    rows = telling_stretch(chosen)
    names = chosen.outputs
    columns = min(len(names), COLUMNS)
    tiers = math.ceil(len(names) / columns)
    figure = new_figure(height_in=0.5 + 4.2 * tiers)
    grid = figure.add_gridspec(2 * tiers, columns, height_ratios=[1.15, 1.0] * tiers)
    for j, name in enumerate(names):
        tier, column = divmod(j, columns)
        upper = dress(figure.add_subplot(grid[2 * tier, column]))
        lower = dress(figure.add_subplot(grid[2 * tier + 1, column], sharex=upper))
        _run_panels(upper, lower, d, chosen, rows, j)
        if j == 0:
            panels = (upper,)
        unit = d.model.outputs[name]
        fall = printable(_fall(d, chosen, j, unit))
        _heading(upper, f"{printable(name, LONGEST_NAME)}: {fall}")
    label = f"time [s], {printable(chosen.experiment.name, LONGEST_NAME)} ({split_of(chosen)})"
    figure.supxlabel(label, fontsize=9)
    legend_above(figure, *panels, columns=3)
    return figure


def _run_panels(
    upper: Axes, lower: Axes, d: SystemDiagnosis, run: CheckRun, rows: slice, j: int
) -> None:
    e = run.experiment
    time_s = e.first_s + e.sample_period_s * np.arange(rows.start, rows.stop)
    measured, before, after = (v[rows, j] for v in (run.measured, run.before, run.after))
    unit = d.model.outputs[run.outputs[j]]
    # From reading to reading, also where they are not in every row.
    there = np.isfinite(measured)
    read_s, measured = time_s[there], measured[there]
    scale = scale_of(unit, [float(np.max(np.abs(measured), initial=0.0))])
    same = not d.missing
    upper.plot(
        read_s, scale.factor * measured, color=MEASURED, lw=3.0, alpha=0.75, label="measured"
    )
    if not same:
        upper.plot(time_s, scale.factor * before, color=BEFORE, lw=1.2, label="before")
    upper.plot(
        time_s,
        scale.factor * after,
        color=AFTER,
        lw=1.2,
        ls="-" if same else (0, (4, 1.2)),
        label="simulated" if same else "after",
    )
    upper.set_ylim(*robust_limits(scale.factor * measured, scale.factor * after, margin=0.2))
    upper.tick_params(labelbottom=False)
    upper.set_ylabel(printable(scale.bracketed), fontsize=9)
    runs = (after,) if same else (before, after)
    errors = [measured - simulated[there] for simulated in runs]
    own = scale_of(unit, [float(np.max(np.abs(_finite(e)), initial=0.0)) for e in errors])
    lower.axhline(0.0, color=INK, lw=0.7)
    for values, colour in zip(errors, (AFTER,) if same else (BEFORE, AFTER), strict=True):
        lower.plot(read_s, own.factor * values, color=colour, lw=1.0)
    lower.set_ylim(*robust_limits(*(own.factor * v for v in errors), margin=0.1))
    lower.set_ylabel(printable(f"residual {own.bracketed}"), fontsize=9)
    lower.set_xlim(float(time_s[0]), float(time_s[-1]))


def _fall(d: SystemDiagnosis, run: CheckRun, j: int, unit: str) -> str:
    """Return the rms of an output in the whole run, before and after."""
    before, after = float(run.before_rms[j]), float(run.after_rms[j])
    scale = scale_of(unit, [typical([before, after])])
    if not d.missing:
        return f"rms {scale.text(after)}"
    return f"rms {significant(before * scale.factor, 3)} → {scale.text(after)}"


def draw_residuals(d: SystemDiagnosis, run: CheckRun | None = None) -> Figure:
    """Draw the spectrum of the residuals of a run, and their mean over a signal.

    Parameters
    ----------
    d : SystemDiagnosis
        The diagnosis.
    run : CheckRun, optional
        One of its runs; without it the check run that the model before misses most.

    Returns
    -------
    Figure
        One row an output: left the power density of the measured output and of the residuals,
        right the mean residual, with two standard errors, in ranges of a signal.
    """
    chosen = telling_run(d) if run is None else run
    n = len(chosen.outputs)
    figure = new_figure(height_in=0.5 + 2.7 * n)
    grid = figure.add_gridspec(n, 2, width_ratios=[1.1, 1.0])
    for j, name in enumerate(chosen.outputs):
        where = where_of(chosen, d.missing, output=name, model=d.model)
        left = dress(figure.add_subplot(grid[j, 0]))
        right = dress(figure.add_subplot(grid[j, 1]))
        draw_spectrum(left, where, two=bool(d.missing))
        draw_over_signal(right, where, two=bool(d.missing))
        if j == 0:
            panels = (left,)
        if j < n - 1:
            left.set_xlabel("")
    legend_above(figure, *panels, columns=3)
    return figure


def draw_candidates(d: SystemDiagnosis) -> Figure:
    """Draw the candidates that were fitted in each round, by score.

    Parameters
    ----------
    d : SystemDiagnosis
        The diagnosis.

    Returns
    -------
    Figure
        One panel a round: what was added is filled, its alias set hatched, what was not accepted
        empty.
    """
    counts = [max(len(candidates_shown(step)), 1) for step in d.rounds]
    inches = [0.55 + 0.25 * count for count in counts]
    figure = new_figure(height_in=0.75 + sum(inches) if inches else 1.5)
    grid = figure.add_gridspec(max(len(counts), 1), 1, height_ratios=inches or [1.0])
    if not d.rounds:
        _nothing(figure.add_subplot(grid[0]), "no round of the search was begun")
    seen: set[str] = set()
    for i, step in enumerate(d.rounds):
        seen |= _round_panel(figure.add_subplot(grid[i]), d, step, i)
    if seen:
        figure.supxlabel("score [log-units]", fontsize=9)
    _fates_legend(figure, seen)
    return figure


def _round_panel(ax: Axes, d: SystemDiagnosis, step: Round, number: int) -> set[str]:
    """Draw one round; return the fates that it shows."""
    shown = candidates_shown(step)
    fitted = sum(c.evidence is not None for c in step.candidates)
    cut = f", {len(shown)} shown" if len(shown) < fitted else ""
    _heading(ax, f"round {number + 1}: {len(step.candidates)} tried, {fitted} fitted{cut}")
    if not shown:
        _nothing(ax, "no effect promised enough to be worth a fit")
        return set()
    dress(ax)
    largest = max(*(c.score for c in shown), 1.0)
    seen = set()
    for place, candidate in enumerate(shown):
        fate = fate_of(d, step, candidate)
        seen.add(fate)
        size = max(candidate.score, 0.0)
        ax.barh(place, max(size, 0.003 * largest), height=0.62, **_look(fate))
        ax.text(
            size + 0.012 * largest,
            place,
            _score(candidate),
            va="center",
            fontsize=SMALL,
            color=QUIET,
        )
    labels = [printable(c.placed.label(d.model), LONGEST_LABEL) for c in shown]
    ax.set_yticks(range(len(shown)), labels, fontsize=SMALL)
    for text, candidate in zip(ax.get_yticklabels(), shown, strict=True):
        if fate_of(d, step, candidate) == "added":
            text.set_fontweight("bold")
    ax.set_ylim(len(shown) - 0.45, -0.55)
    ax.set_xlim(0.0, 1.14 * largest)
    ax.grid(False, axis="y")
    ax.tick_params(axis="y", length=0)
    return seen


def _score(candidate: Candidate) -> str:
    label = (
        significant(candidate.score, 3) if abs(candidate.score) < 100 else f"{candidate.score:.0f}"
    )
    return label.replace("-", "−")


def _look(fate: str) -> dict[str, Any]:
    face = {"added": AFTER, "alias": PALE, "accepted": FAINT}.get(fate, "white")
    edge = AFTER if fate in ("added", "alias", "too little") else QUIET
    return {
        "facecolor": face,
        "edgecolor": edge,
        "linewidth": 0.8,
        "hatch": "////" if fate == "alias" else None,
    }


def _fates_legend(figure: Figure, seen: set[str]) -> None:
    from matplotlib.patches import Patch

    handles = [Patch(label=_MEANT[fate], **_look(fate)) for fate in FATES if fate in seen]
    if handles:
        figure.legend(
            handles=handles,
            loc="outside upper left",
            ncols=len(handles),
            fontsize=SMALL,
            frameon=False,
            columnspacing=1.5,
        )


def _nothing(ax: Axes, words: str) -> None:
    ax.set_axis_off()
    ax.text(0.0, 0.5, words, fontsize=9, color=QUIET, transform=ax.transAxes, va="center")


def draw_errors(d: SystemDiagnosis) -> Figure:
    """Draw the rms error of every run and output, before and after.

    Parameters
    ----------
    d : SystemDiagnosis
        The diagnosis.

    Returns
    -------
    Figure
        One panel an output, one line a run: before and after joined by a bar; dashed, what no
        model of this kind can foretell.
    """
    runs = all_runs(d)[:MOST_RUNS]
    names = d.model.output_names
    columns = min(len(names), COLUMNS)
    tiers = math.ceil(len(names) / columns)
    figure = new_figure(height_in=0.5 + tiers * (0.85 + 0.34 * len(runs)))
    grid = figure.add_gridspec(tiers, columns)
    panels = []
    for j, name in enumerate(names):
        tier, column = divmod(j, columns)
        ax = dress(figure.add_subplot(grid[tier, column]))
        panels.append(ax)
        _dumbbells(ax, d, runs, j)
        _heading(ax, printable(name, LONGEST_NAME))
        if column:
            ax.tick_params(labelleft=False)
    legend_above(figure, panels[0], columns=3)
    return figure


def _dumbbells(ax: Axes, d: SystemDiagnosis, runs: tuple[CheckRun, ...], j: int) -> None:
    before = np.array([run.before_rms[j] for run in runs])
    after = np.array([run.after_rms[j] for run in runs])
    scale = scale_of(d.model.outputs[d.model.output_names[j]], [typical([*before, *after])])
    before, after = scale.factor * before, scale.factor * after
    place = np.arange(len(runs))
    if d.missing:
        ax.hlines(place, np.minimum(before, after), np.maximum(before, after), color=FAINT, lw=3.0)
        ax.plot(before, place, "o", color=BEFORE, ms=6.5, label="before", zorder=3)
    last = "after" if d.missing else "simulated"
    ax.plot(after, place, "o", color=AFTER, ms=6.5, label=last, zorder=3)
    floor = _floor(ax, d, j, scale)
    _annotated(ax, before, after, bool(d.missing))
    _error_axis(ax, np.concatenate([before, after, floor]))
    labels = [f"{printable(run.experiment.name, LONGEST_NAME)} ({split_of(run)})" for run in runs]
    ax.set_yticks(place, labels, fontsize=SMALL)
    ax.set_ylim(len(runs) - 0.4, -0.6)
    ax.grid(False, axis="y")
    ax.set_xlabel(f"rms error {printable(scale.bracketed)}", fontsize=9)


def _floor(ax: Axes, d: SystemDiagnosis, j: int, scale: Scale) -> FloatArray:
    if j >= len(d.floor) or not d.floor[j] > 0.0:
        return np.zeros(0)
    level = scale.factor * d.floor[j]
    ax.axvline(level, color=INK, lw=0.9, ls=(0, (5, 2)), label="new in each sample", zorder=1)
    return np.array([level])


def _annotated(ax: Axes, before: FloatArray, after: FloatArray, both: bool) -> None:
    """Write the numbers outside of each pair, so that they cannot meet."""
    for place, pair in enumerate(zip(before.tolist(), after.tolist(), strict=True)):
        ends = sorted(zip(pair, (BEFORE, AFTER), strict=True))
        sides = [(ends[0], -8, "right"), (ends[1], 8, "left")]
        for (value, colour), shift, anchor in sides if both else [(ends[1], 8, "left")]:
            if math.isfinite(value):
                ax.annotate(
                    significant(value, 3),
                    (value, place),
                    xytext=(shift, 0),
                    textcoords="offset points",
                    ha=anchor,
                    va="center",
                    fontsize=TINY,
                    color=colour if both else AFTER,
                    bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6},
                )


def _error_axis(ax: Axes, values: FloatArray) -> None:
    """Lay the axis so that the numbers beside the outermost points have room."""
    known = values[np.isfinite(values) & (values > 0.0)]
    if not known.size:
        return
    low, high = float(known.min()), float(known.max())
    if high > LOGARITHMIC_RATIO * low:
        from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

        ax.set_xscale("log")
        ax.set_xlim(low / (high / low) ** 0.4, high * (high / low) ** 0.35)
        ax.xaxis.set_major_locator(LogLocator(10.0, numticks=6))
        ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        ax.xaxis.set_minor_formatter(NullFormatter())
    else:
        room = 0.35 * max(high - low, 0.3 * high)
        ax.set_xlim(max(low - room, 0.0) if low > 2.0 * room else low - room, high + room)


def _finite(values: FloatArray) -> FloatArray:
    return values[np.isfinite(values)]


def _heading(ax: Axes, text: str) -> None:
    ax.set_title(text, fontsize=9, color=INK, loc="left")
