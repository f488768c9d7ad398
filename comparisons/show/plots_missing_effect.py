"""The picture of a diagnosis: gap, where, candidates, and the characteristic before and after."""

from __future__ import annotations

from itertools import cycle
from textwrap import shorten
from typing import TYPE_CHECKING, Any

from comparisons.missing_effect.quantities import equation_of, numbers_of, open_words, tau_ms
from comparisons.missing_effect.ranked import CandidateRow, candidate_rows, effect_of
from comparisons.missing_effect.shown import (
    HeldOutRun,
    held_out_run,
    steady_curves,
    stretch,
)
from comparisons.missing_effect.where_panels import draw_over_signal, draw_spectrum
from comparisons.page.blocks import Picture
from comparisons.page.style import (
    ACCENT,
    FAINT,
    INK,
    MARK,
    MEASURED,
    QUIET,
    SHADE,
    dress,
    legend,
    new_figure,
    printable,
    robust_limits,
)
from surge_core.rounding import significant

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from comparisons.missing_effect.diagnosis import Diagnosis
    from comparisons.missing_effect.results import ReverseLoss
    from comparisons.missing_effect.where import Where
    from surge_core.types import FloatArray

__all__ = ["diagnosis_picture", "title"]

BEFORE, AFTER, PALE = MARK, ACCENT, "#d3e5f1"
DASHES = ("-", (0, (5, 1.5)), (0, (1.5, 1.2)), (0, (6, 1.5, 1.5, 1.5)))
SMALL = 8.5
TINY = 7.5
CANDIDATES_SHOWN = 6
BAND_FLOORS = 2.0
LONGEST_LINE = 130
# A heading longer than this is set smaller.
HEADING_LETTERS, HEADING_SIZE = 72, 14.0
LEFT: dict[str, Any] = {"fontsize": 9, "color": INK, "loc": "left"}


def title(d: Diagnosis) -> str:
    """Return the verdict in a line.

    Parameters
    ----------
    d : Diagnosis
        The diagnosis.
    """
    if not d.missing:
        return {
            "nothing_missing": "Nothing missing",
            "noise_model_wrong": "Nothing missing; the noise is not white and normal",
            "unexplained_structure": "Something is left that has no name",
        }[d.verdict]
    names = []
    for item in d.missing:
        effect = effect_of(d, item.effect)
        bare = equation_of(effect).removeprefix("+ ")
        names.append(bare if effect.unnamed else " or ".join(item.alias_set))
    lead = {"unnamed_term": "Missing, without a name", "provisional": "Missing, provisional name"}
    return f"{lead.get(d.verdict, 'Missing')}: {' and '.join(names)}"


def diagnosis_picture(d: Diagnosis, where: Where | None) -> Picture:
    """Draw a diagnosis in one picture: gap, where, who, characteristic, verdict.

    Parameters
    ----------
    d : Diagnosis
        The diagnosis.
    where : Where or None
        Of the models before and after; None where the records are too short.

    Returns
    -------
    Picture
        On top measured and simulated ψ' on a held-out stretch, and both residuals over the noise;
        below, the spectrum of the residuals and their mean over φ; then the candidates by score
        with τ, and the characteristic before and after.
    """
    heading, lines = title(d), _lines(d)
    reverse = d.reverse_loss
    figure = new_figure(height_in=(10.6 if reverse is None else 13.2) + 0.2 * len(lines))
    size = HEADING_SIZE * min(1.0, HEADING_LETTERS / len(heading))
    look: dict[str, Any] = {"x": 0.02, "ha": "left", "color": INK}
    figure.suptitle(_plain(heading), fontsize=size, fontweight="bold", **look)
    ratios = [1.15, 0.8, 1.15, 1.35, *([] if reverse is None else [1.2])]
    grid = figure.add_gridspec(len(ratios), 1, height_ratios=ratios)
    run = held_out_run(d)
    shown = stretch(d, run)
    upper = dress(figure.add_subplot(grid[0]))
    lower = dress(figure.add_subplot(grid[1], sharex=upper))
    _over_time(upper, d, run, shown)
    below = [shorten(_plain(line), LONGEST_LINE, placeholder=" …") for line in lines]
    upper.set_title("\n".join([*below, str(upper.get_title(loc="left"))]), **LEFT)
    _residuals(lower, d, run, shown)
    if where is not None:
        middle = grid[2].subgridspec(1, 2, width_ratios=[1.1, 1.0])
        left, right = (dress(figure.add_subplot(middle[i])) for i in range(2))
        draw_spectrum(left, where, two=bool(d.missing))
        legend(left, loc="best", fontsize=TINY, handlelength=2.2)
        draw_over_signal(right, where, two=bool(d.missing))
    bottom = grid[3].subgridspec(1, 2, width_ratios=[1.0, 1.0])
    _candidates(figure.add_subplot(bottom[0]), d)
    _curves(dress(figure.add_subplot(bottom[1])), d)
    if reverse is not None:
        _reverse(dress(figure.add_subplot(grid[4])), reverse)
    return Picture.of(
        "The diagnosis in one picture",
        figure,
        _shown_words(d, run.time_s[shown]),
        "Top: the held-out stretch on which the model before is worst, simulated from φ alone by "
        "fits to other rows; what is left of the error after should stay within the shaded band "
        "in 19 rows of 20. Below: power densities, and the mean residual in ranges of φ with two "
        "standard errors and small triangles for rising (up) and falling (down) flow: a bend is a "
        "missing characteristic, two branches are a lag or a hysteresis. Bottom: all that "
        "competed, the alias set hatched or pale; and the characteristic."
        + ("" if reverse is None else " Last: the loss in reversed flow where it acts."),
    )


def _shown_words(d: Diagnosis, time_s: FloatArray) -> str:
    gap = d.gap
    words = f"{title(d)}. Held-out rms of ψ' {significant(gap.before_rms, 3)} and τ "
    words += tau_ms(d.tau_before_s)
    if d.missing:
        words += f" before, {significant(gap.after_rms, 3)} and τ {tau_ms(d.tau_after_s)} after"
    return (
        f"{words}; noise {significant(gap.floor_rms, 3)}. Drawn over time: {time_s[0]:.4g} to "
        f"{time_s[-1]:.4g} s, where the model before is worst."
    )


def _lines(d: Diagnosis) -> list[str]:
    """Return what stands below the heading: each effect's numbers, τ, the gap."""
    before, after = d.gap.before_rms / d.gap.floor_rms, d.gap.after_rms / d.gap.floor_rms
    if not d.missing:
        tau = tau_ms(d.tau_before_s, d.tau_stderr_s)
        return [f"τ = {tau};  held-out rms {before:.2f} times the noise"]
    lines = [
        f"{equation_of(effect_of(d, item.effect))};  {numbers_of(item.effect, item.parameters)}"
        for item in d.missing
    ]
    if d.reverse_loss is not None:
        share = f"{100.0 * d.reverse_loss.share:.0f} %"
        lines.append(f"the loss explains {share} of what is left in reversed flow (last panel)")
    if not d.gap.shrink:
        return [
            *lines,
            f"τ = {tau_ms(d.tau_after_s, d.tau_stderr_s)}: the scored rows are untouched",
        ]
    closed = 100.0 * min(d.gap.shrink, 1.0)
    return [
        *lines,
        f"τ {tau_ms(d.tau_before_s)} → {tau_ms(d.tau_after_s, d.tau_stderr_s)};  held-out rms "
        f"{before:.2f} → {after:.2f} times the noise: {closed:.1f} % of the gap closed",
    ]


def _over_time(ax: Axes, d: Diagnosis, run: HeldOutRun, shown: slice) -> None:
    time_s = run.time_s[shown]
    ax.plot(time_s, run.measured[shown], color=MEASURED, lw=3.2, alpha=0.75, label="measured")
    if d.missing:
        ax.plot(time_s, run.before[shown], color=BEFORE, lw=1.4, label="simulated before")
        ax.plot(
            time_s, run.after[shown], color=AFTER, lw=1.3, ls=(0, (4, 1.2)), label="simulated after"
        )
    else:
        ax.plot(time_s, run.after[shown], color=AFTER, lw=1.3, label="simulated")
    ax.set_ylabel(r"$\psi'$ [-]")
    ax.tick_params(labelbottom=False)
    source = d.data.sources[int(d.data.record[shown.start])].rsplit("/", 1)[-1]
    how = "cycles left out in turn" if d.whole_runs else "held out"
    ax.set_title(f"{how}: {printable(source, 40)}", **LEFT)
    _legend_over(ax)


def _residuals(ax: Axes, d: Diagnosis, run: HeldOutRun, shown: slice) -> None:
    floor = d.gap.floor_rms
    ax.axhspan(
        -BAND_FLOORS, BAND_FLOORS, color=SHADE, lw=0, label=f"± {BAND_FLOORS:.0f} times the noise"
    )
    ax.axhline(0.0, color=INK, lw=0.7)
    lines = [(run.before, BEFORE, 1.2, "before"), (run.after, AFTER, 0.9, "after")]
    values = []
    for simulated, colour, width, word in lines[0 if d.missing else 1 :]:
        values.append((run.measured - simulated)[shown] / floor)
        label = word if d.missing else "residual"
        ax.plot(run.time_s[shown], values[-1], color=colour, lw=width, label=label)
    low, high = robust_limits(*values, margin=0.1)
    ax.set_ylim(min(low, -1.3 * BAND_FLOORS), max(high, 1.3 * BAND_FLOORS))
    ax.set_xlim(run.time_s[shown][0], run.time_s[shown][-1])
    ax.set_ylabel("residual [noise rms]", fontsize=9)
    ax.set_xlabel("facility clock [s]", fontsize=9)
    _legend_over(ax)


def _legend_over(ax: Axes) -> None:
    ax.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 0.98),
        ncols=3,
        fontsize=SMALL,
        frameon=False,
        borderaxespad=0.0,
        handlelength=1.8,
    )


def _candidates(ax: Axes, d: Diagnosis) -> None:
    """Draw bars of the scores, the name above each and τ beside it."""
    ax.set_axis_off()
    what = "squared errors explained" if d.whole_runs else "score in log-units"
    ax.set_title(f"who: {what}, and τ with it", **LEFT)
    rows = _rows_drawn(d)
    if not rows:
        ax.text(0.0, 0.6, "no effect promised enough\nto be worth a fit", fontsize=SMALL)
        return
    sizes = [100.0 * row.share if d.whole_runs else row.score for row in rows]
    largest = max(*sizes, 1.0)
    for place, (row, size) in enumerate(zip(rows, sizes, strict=True)):
        colour, edge, word = _fate(row)
        hatch = "////" if row.alias and not row.chosen else None
        box: dict[str, Any] = {"color": colour, "edgecolor": edge, "hatch": hatch, "lw": 0.7}
        ax.barh(place + 0.18, max(size, 0.004 * largest), height=0.36, **box)
        weight = "bold" if row.chosen else "normal"
        name = _plain(_name(row)) + word
        ax.text(0.0, place - 0.04, name, va="bottom", fontsize=SMALL, fontweight=weight)
        words = f"{size:.0f}{' %' if d.whole_runs else ''}, τ {1e3 * row.time_constant_s:.4g} ms"
        beside = max(size, 0.0) + 0.02 * largest
        ax.text(beside, place + 0.18, words, va="center", fontsize=TINY, color=QUIET)
    ax.set_xlim(0.0, 1.5 * largest)
    ax.set_ylim(max(len(rows), 4) - 0.45, -0.55)


def _rows_drawn(d: Diagnosis) -> list[CandidateRow]:
    """Return the candidates of the round that found first, names before pairs of them."""
    rows = candidate_rows(d)
    first = next((row.round for row in rows if row.chosen), 1)
    own = [row for row in rows if row.round == first]
    kept = [row for row in own if row.chosen or row.alias]
    kept += [row for row in own if row not in kept]
    shown = kept[:CANDIDATES_SHOWN]
    return sorted(shown, key=own.index)


def _name(row: CandidateRow) -> str:
    return open_words(row.name) if row.kind == "unnamed_term" else row.name


def _fate(row: CandidateRow) -> tuple[str, str, str]:
    """Return colour and edge of a candidate's bar, and the word behind its name."""
    if row.chosen:
        return AFTER, AFTER, ""
    if row.alias:
        return PALE, AFTER, " (alias)"
    return (FAINT, QUIET, "") if row.accepted else ("white", QUIET, " (refused)")


def _curves(ax: Axes, d: Diagnosis) -> None:
    """Draw the characteristic as a slow sweep would, two branches where there is hysteresis."""
    old = steady_curves(d.before, d.data)
    new = steady_curves(d.after, d.data) if d.missing else ()
    models = [(old, BEFORE, "before"), (new, AFTER, "after")] if new else [(old, AFTER, "model")]
    for curves, colour, word in models:
        for curve, dashes in zip(curves, cycle(DASHES), strict=False):
            label = ", ".join(filter(None, (word, curve.label)))
            ax.plot(curve.phi, curve.value, color=colour, lw=1.7, ls=dashes, label=label)
    ax.set_xlabel(r"flow coefficient $\varphi$ [-]", fontsize=9)
    ax.set_title(
        r"quasi-steady characteristic $\psi'_{\mathrm{QS}}$", fontsize=9, color=INK, loc="left"
    )
    legend(ax, loc="best", fontsize=TINY, handlelength=2.2)


def _reverse(ax: Axes, reverse: ReverseLoss) -> None:
    """Draw what the model leaves in reversed flow over φ², with the loss that explains it."""
    order = reverse.squared.argsort()
    squared, left = reverse.squared[order], reverse.left[order]
    ax.plot(squared, left, ".", ms=3, color=MEASURED, label="measured minus simulated")
    words = f"loss c φ², c = {significant(reverse.size, 3)}"
    ax.plot(squared, reverse.size * squared, color=AFTER, lw=1.8, label=printable(words))
    ax.axhline(0.0, color=INK, lw=0.7)
    ax.set_xlabel(r"$\varphi^2$ in reversed flow, averaged over the stall cells [-]", fontsize=9)
    ax.set_ylabel(r"$\psi'$ left [-]", fontsize=9)
    ax.set_title("reverse_flow_branch, where it acts", **LEFT)
    legend(ax, loc="upper left", fontsize=TINY)


def _plain(text: str) -> str:
    return printable(text, 400)
