"""The picture of a diagnosis: where, who, before and after."""

from __future__ import annotations

import math
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from comparisons.missing_effect.lag_curves import steady_curves
from comparisons.missing_effect.lag_result import LagDiagnosis, ReverseLoss
from comparisons.missing_effect.quantities import scale_of, typical
from comparisons.missing_effect.where_rows import SYMBOLS
from comparisons.page.style import (
    ACCENT,
    FAINT,
    INK,
    MARK,
    MEASURED,
    QUIET,
    coefficient_symbol,
    dress,
    legend,
    new_figure,
    printable,
    robust_limits,
)
from surge_core.rounding import significant

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from comparisons.missing_effect.results import CandidateRow, Diagnosis
    from comparisons.missing_effect.runs import CheckRun
    from comparisons.missing_effect.where_rows import Where
    from surge_core.types import FloatArray

BEFORE, AFTER, PALE = MARK, ACCENT, "#d3e5f1"
DASHES = ("-", (0, (5, 1.5)), (0, (1.5, 1.2)), (0, (6, 1.5, 1.5, 1.5)))
SMALL, TINY = 8.5, 7.5
# Panels beside each other; candidates of a round; runs in the chart of errors (tables hold all).
COLUMNS, CANDIDATES_SHOWN, MOST_RUNS = 3, 8, 16
LONGEST_LABEL, LONGEST_NAME = 44, 30
# Errors further apart than this are drawn on a logarithmic axis.
LOGARITHMIC_RATIO = 8.0
# Periods and rows of a stretch that is drawn, and how many are compared.
PERIODS, FEWEST_ROWS, MOST_ROWS = 6.0, 100, 1800
STARTS = 64
MOST_SWINGS = 1e6
LEFT: dict[str, Any] = {"fontsize": 9, "color": INK, "loc": "left"}


def draw_diagnosis(d: Diagnosis) -> Figure:
    """Draw a diagnosis in one picture.

    On top each output, measured and simulated, and its residuals on a telling stretch; below, the
    spectrum of the residuals and their mean over a signal, of the output that is missed most; then
    the candidates by score, and the characteristic of a lag before and after, or the rms errors of
    that output on every record. Last, the loss in reversed flow where there is one.
    """
    reverse = d.reverse_loss if isinstance(d, LagDiagnosis) else None
    figure = new_figure(height_in=9.8 if reverse is None else 12.4)
    ratios = [1.15, 0.8, 1.15, 1.35, *([] if reverse is None else [1.2])]
    run, wheres = d.telling_run, d.wheres
    rows, n = telling_stretch(run), min(len(run.outputs), COLUMNS)
    # One grid for all panels, so that their edges lie on common lines.
    columns = max(n, 2)
    grid = figure.add_gridspec(len(ratios), columns, height_ratios=ratios)
    halves = (slice(None, columns - 1), slice(columns - 1, None))
    for j in range(n):
        own = slice(j, j + 1) if n > 1 else slice(None)
        upper = dress(figure.add_subplot(grid[0, own]))
        lower = dress(figure.add_subplot(grid[1, own], sharex=upper))
        _run_panels(upper, lower, d, run, rows, j)
        if j == 0:
            lower.set_xlabel(f"time [s], {printable(run.title)}", fontsize=9)
            legend(upper, loc="upper right", fontsize=TINY, ncols=3 if n == 1 else 1)
    if wheres:
        left, right = (dress(figure.add_subplot(grid[2, half])) for half in halves)
        _spectrum(left, wheres[0], two=bool(d.missing))
        legend(left, loc="best", fontsize=TINY, handlelength=2.2)
        _over_signal(right, wheres[0], two=bool(d.missing))
    _candidates(figure.add_subplot(grid[3, halves[0]]), d)
    last = dress(figure.add_subplot(grid[3, halves[1]]))
    if isinstance(d, LagDiagnosis):
        _curves(last, d)
    else:
        _errors(last, d, wheres[0].of.output if wheres else next(iter(d.outputs)))
    if reverse is not None:
        _reverse(dress(figure.add_subplot(grid[4, :])), reverse)
    return figure


def _spectrum(ax: Axes, where: Where, *, two: bool) -> None:
    """Draw the power density of the measured output and of the residuals."""
    rows = where.frequency
    at = np.array([math.sqrt(max(row.low_hz, 0.5 * rows[0].high_hz) * row.high_hz) for row in rows])
    curves = [("measured_psd", MEASURED, "measured", 2.4)]
    curves += [("before_psd", BEFORE, "residual before", 1.5)] if two else []
    curves.append(("after_psd", AFTER, "residual after" if two else "residual", 1.5))
    for key, colour, label, width in curves:
        values = np.array([getattr(row, key) for row in rows])
        ax.loglog(at, values, color=colour, lw=width, marker=".", ms=4, label=label)
    floor = np.array([row.before_psd / row.ratio for row in rows])
    if np.all(np.isfinite(floor)):
        ax.loglog(at, floor, color=QUIET, lw=1.0, ls=(0, (5, 2)), label="noise")
    unit = where.of.unit
    squared = "1" if unit == "1" else f"{unit}²" if unit.isalpha() else f"({unit})²"
    density = f"power density [{squared}/Hz]"
    _name(ax, f"{_shown(where.of.output)}: spectrum", "frequency [Hz]", density)


def _over_signal(ax: Axes, where: Where, *, two: bool) -> None:
    """Draw the mean residual with two standard errors in ranges of a signal."""
    both = [("before", BEFORE, "o")] * two + [("after", AFTER, "s")]
    cells = {key: [getattr(row, key) for row in where.flow] for key, _, _ in both}
    scale = scale_of(where.of.unit, [abs(c["any"].mean) for own in cells.values() for c in own])
    over = scale_of(where.of.signal_unit, [edge for r in where.flow for edge in (r.low, r.high)])
    at = over.factor * np.array([row.at for row in where.flow])
    ax.axhline(0.0, color=INK, lw=0.7)
    for key, colour, marker in both:
        mean = scale.factor * np.array([c["any"].mean for c in cells[key]])
        error = scale.factor * np.array([c["any"].stderr for c in cells[key]])
        look: dict[str, Any] = {"color": colour, "marker": marker, "ms": 3.5, "lw": 1.1}
        bars: dict[str, Any] = {"capsize": 2.0, "elinewidth": 0.9}
        ax.errorbar(at, mean, 2.0 * np.nan_to_num(error), **look, **bars)
        for way, sign in (("rising", "^"), ("falling", "v")):
            part = scale.factor * np.array([c[way].mean for c in cells[key]])
            ax.plot(at, part, color=colour, marker=sign, ms=3.0, lw=0, alpha=0.45)
    ax.locator_params(axis="x", nbins=6)
    name, simulated = _shown(where.of.signal), " simulated" * where.of.simulated
    title = f"{_shown(where.of.output)}: mean residual"
    along = f"{name}{simulated} {printable(over.bracketed)}"
    _name(ax, title, along, f"mean residual {scale.bracketed}")


def _name(ax: Axes, title: str, x: str, y: str = "") -> None:
    """Name axes; the name of the horizontal one and the title may hold mathtext."""
    ax.set_title(title, fontsize=9, color=INK, loc="left")
    ax.set_xlabel(x, fontsize=9)
    ax.set_ylabel(printable(y), fontsize=SMALL)


def _shown(name: str) -> str:
    return printable(SYMBOLS.get(name, name), LONGEST_NAME)


def _errors(ax: Axes, d: Diagnosis, output: str) -> None:
    """Draw the rms error of one output in every run, before and after joined by a bar."""
    from matplotlib.ticker import LogLocator

    runs, j = d.runs[:MOST_RUNS], list(d.outputs).index(output)
    before, after = (
        np.array([r[j] for r in sizes])
        for sizes in ([run.before_rms for run in runs], [run.after_rms for run in runs])
    )
    scale = scale_of(d.outputs[output], [typical([*before, *after])])
    before, after = scale.factor * before, scale.factor * after
    place = np.arange(len(runs))
    if d.missing:
        ax.hlines(place, np.minimum(before, after), np.maximum(before, after), color=FAINT, lw=3.0)
        ax.plot(before, place, "o", color=BEFORE, ms=6.5, label="before", zorder=3)
    last = "after" if d.missing else "simulated"
    ax.plot(after, place, "o", color=AFTER, ms=6.5, label=last, zorder=3)
    for level in d.floor[j : j + 1]:
        style: dict[str, Any] = {"color": INK, "lw": 0.9, "ls": (0, (5, 2)), "label": "noise"}
        ax.axvline(scale.factor * level, **style)
    known = [size for size in (*before, *after) if size > 0.0]
    if known and max(known) > LOGARITHMIC_RATIO * min(known):
        # Labels of every minor tick lie on each other within a decade or two.
        ax.set_xscale("log", subs=[])
        ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.xaxis.set_major_formatter("{x:g}")
    else:
        ax.locator_params(axis="x", nbins=4)
    ax.set_yticks(place, [printable(run.title, LONGEST_NAME) for run in runs], fontsize=SMALL)
    ax.set_ylim(len(runs) - 0.4, -0.6)
    ax.grid(False, axis="y")
    title = f"{printable(output, LONGEST_NAME)}: every record"
    _name(ax, title, f"rms error {printable(scale.bracketed)}")
    legend(ax, loc="best", fontsize=TINY)


def _run_panels(upper: Axes, lower: Axes, d: Diagnosis, run: CheckRun, rows: slice, j: int) -> None:
    """Draw an output and its residuals on a stretch."""
    time_s = run.time_s[rows]
    # Where the clock jumps, another segment begins.
    jump = np.diff(time_s, prepend=time_s[0]) > 1.5 * run.period_s
    all_values = (run.measured, run.before, run.after)
    measured, before, after = (np.where(jump, np.nan, v[rows, j]) for v in all_values)
    name, unit = list(run.outputs.items())[j]
    # From reading to reading, also where they are not in every row; rows that are not scored part.
    there = np.isfinite(measured) | ~np.isfinite(after)
    read_s, measured = time_s[there], measured[there]
    scale = scale_of(unit, [_largest(measured)])
    models = [(after, AFTER, "simulated", "-")]
    if d.missing:
        models = [(before, BEFORE, "before", "-"), (after, AFTER, "after", (0, (4, 1.2)))]  # type: ignore[list-item]
    upper.plot(
        read_s, scale.factor * measured, color=MEASURED, lw=3.0, alpha=0.75, label="measured"
    )
    for values, colour, label, dashes in models:
        upper.plot(time_s, scale.factor * values, color=colour, lw=1.2, label=label, ls=dashes)
    upper.set_ylim(*robust_limits(scale.factor * measured, scale.factor * after, margin=0.2))
    upper.tick_params(labelbottom=False)
    upper.set_ylabel(printable(scale.bracketed), fontsize=9)
    errors = [measured - values[there] for values, *_ in models]
    own = scale_of(unit, map(_largest, errors))
    if j < len(d.floor) and d.floor[j] > 0.0:
        for side in (-2.0, 2.0):
            lower.axhline(side * own.factor * d.floor[j], color=QUIET, lw=0.7, ls=(0, (5, 2)))
    lower.axhline(0.0, color=INK, lw=0.7)
    for values, (_, colour, *_) in zip(errors, models, strict=True):
        lower.plot(read_s, own.factor * values, color=colour, lw=1.0)
    lower.set_ylim(*robust_limits(*(own.factor * v for v in errors), margin=0.1))
    lower.set_ylabel(printable(f"residual {own.bracketed}"), fontsize=9)
    lower.set_xlim(float(time_s[0]), float(time_s[-1]))
    sizes = [float(run.before_rms[j]), float(run.after_rms[j])]
    fall = scale_of(unit, [typical(sizes)])
    # What acts where no row is scored leaves these rows as they were.
    fell = bool(d.missing) and sizes[0] != sizes[1]
    first = f"{significant(sizes[0] * fall.factor, 3)} → " if fell else ""
    shown = printable(f"{SYMBOLS.get(name, name)}: rms {first}{fall.text(sizes[1])}", 44)
    upper.set_title(shown, **LEFT)


def _largest(values: FloatArray) -> float:
    return float(np.max(np.abs(values[np.isfinite(values)]), initial=0.0))


def _candidates(ax: Axes, d: Diagnosis) -> None:
    """Draw bars of the scores of the round that found first, the names beside them."""
    rows = _rows_drawn(d)
    by_share = any(math.isfinite(row.share) for row in rows)
    if not rows:
        ax.set_axis_off()
        ax.text(0.0, 0.6, "no effect promised enough\nto be worth a fit", fontsize=SMALL)
        return
    what = "squared errors explained [%]" if by_share else "score [log-units]"
    dress(ax)
    ax.set_title(f"effects tried, round {rows[0].round}: {what}", **LEFT)
    sizes = [100.0 * row.share if by_share else row.score for row in rows]
    largest = max(*sizes, 1.0)
    for place, (row, size) in enumerate(zip(rows, sizes, strict=True)):
        ax.barh(place + 0.2, max(size, 0.004 * largest), height=0.36, **_look(row))
        weight = "bold" if row.chosen else "normal"
        word = {"alias": " (alias)", "refused": " (refused)"}.get(row.fate, "")
        text = printable(row.shown, LONGEST_LABEL) + word
        ax.text(0.0, place - 0.02, text, va="bottom", fontsize=SMALL, fontweight=weight)
        tau = f", τ {1e3 * row.time_constant_s:.4g} ms" if row.time_constant_s > 0.0 else ""
        number = f"{significant(size, 3) if abs(size) < 100.0 else f'{size:.0f}'}{tau}"
        beside = max(size, 0.0) + 0.02 * largest
        ax.text(beside, place + 0.2, number, va="center", fontsize=TINY, color=QUIET)
    ax.set_xlim(0.0, 1.5 * largest)
    ax.locator_params(axis="x", nbins=5)
    ax.set_ylim(max(len(rows), 4) - 0.45, -0.55)
    ax.set_yticks([])
    ax.grid(False)


def _rows_drawn(d: Diagnosis) -> list[CandidateRow]:
    """Return the best candidates of the round that found first, the alias set among them."""
    first = next((row.round for row in d.candidates if row.chosen), 1)
    own = [row for row in d.candidates if row.round == first and row.fitted]
    own = [row for row in own if math.isfinite(row.share) or math.isfinite(row.score)]
    kept = [row for row in own if row.chosen or row.alias]
    kept += [row for row in own if row not in kept]
    return sorted(kept[:CANDIDATES_SHOWN], key=own.index)


def _look(row: CandidateRow) -> dict[str, Any]:
    face = {"added": AFTER, "alias": PALE, "accepted": FAINT}.get(row.fate, "white")
    edge = AFTER if row.fate in ("added", "alias", "too little") else QUIET
    hatch = "////" if row.fate == "alias" else None
    return {"facecolor": face, "edgecolor": edge, "linewidth": 0.8, "hatch": hatch}


def _curves(ax: Axes, d: LagDiagnosis) -> None:
    """Draw the characteristic as a slow sweep would, two branches where there is hysteresis."""
    old = steady_curves(d.before, d.data)
    new = steady_curves(d.after, d.data) if d.missing else ()
    models = [(old, BEFORE, "before"), (new, AFTER, "after")] if new else [(old, AFTER, "model")]
    for curves, colour, word in models:
        for curve, dashes in zip(curves, cycle(DASHES), strict=False):
            label = ", ".join(filter(None, (word, curve.label)))
            ax.plot(curve.phi, curve.value, color=colour, lw=1.7, ls=dashes, label=label)
    title = f"quasi-steady characteristic {coefficient_symbol('psi_p', quasi_steady=True)}"
    _name(ax, title, r"flow coefficient $\varphi$ [-]")
    legend(ax, loc="best", fontsize=TINY, handlelength=2.2)


def _reverse(ax: Axes, reverse: ReverseLoss) -> None:
    """Draw what the model leaves in reversed flow over φ², with the loss that explains it."""
    order = reverse.squared.argsort()
    squared, left = reverse.squared[order], reverse.left[order]
    ax.plot(squared, left, ".", ms=3, color=MEASURED, label="measured minus simulated")
    words = f"loss c φ², c = {significant(reverse.size, 3)}"
    ax.plot(squared, reverse.size * squared, color=AFTER, lw=1.8, label=printable(words))
    ax.axhline(0.0, color=INK, lw=0.7)
    along = r"$\varphi^2$ in reversed flow, averaged over the stall cells [-]"
    share = f"the loss explains {100.0 * reverse.share:.0f} % of what is left in reversed flow"
    _name(ax, f"reverse flow branch: {share}", along, "ψ' left [-]")
    legend(ax, loc="upper left", fontsize=TINY)


def telling_stretch(run: CheckRun) -> slice:
    """Return a stretch of some periods over which what was added changes most.

    Where nothing was added, the one on which the residual is largest.
    """
    measured = run.measured[run.settle :]
    n = measured.shape[0]
    level = measured - np.nanmean(measured, axis=0)
    period = max(_period_rows(column) for column in np.nan_to_num(level).T)
    length = int(min(max(PERIODS * period, FEWEST_ROWS), MOST_ROWS, n))
    before, after = (_squares(run, before=which) for which in (True, False))
    won = before - after if np.any(before != after) else before
    total = np.concatenate([[0.0], np.cumsum(won)])
    starts = np.unique(np.linspace(0, n - length, STARTS).astype(int))
    best = int(starts[np.argmax(total[starts + length] - total[starts])])
    return slice(run.settle + best, run.settle + best + length)


def _squares(run: CheckRun, *, before: bool) -> FloatArray:
    errors = run.errors(before=before) / run.swing
    # A run that went away is as telling as it can be; its squares need not overflow.
    errors = np.clip(np.nan_to_num(errors, nan=0.0), -MOST_SWINGS, MOST_SWINGS)
    return np.asarray(np.sum(errors**2, axis=1))


def _period_rows(values: FloatArray) -> float:
    """Return the rows of a period at the mean frequency of a signal."""
    power = np.abs(np.fft.rfft(values - np.mean(values))) ** 2
    if not power.sum() > 0.0:
        return 1.0
    mean_bin = float(np.arange(power.size) @ power / power.sum())
    return values.size / max(mean_bin, 1.0)
