"""Pictures of a record, and of free runs over it: operating points, cycles, loops; errors."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from classic_ml.coefficients import psi_is_known
from classic_ml.flow import LBM_KG
from classic_ml.reduction import Reduction
from classic_ml.series import CoefficientSeries
from comparisons.harness.fit_quality import rms
from comparisons.missing_effect.loading import surge_frequency_hz
from comparisons.page import style
from comparisons.page.blocks import Picture
from comparisons.results import SYMBOLS, Comparison, FitRows, Reconstruction
from comparisons.results.names import NAMES
from surge_core.rounding import significant
from surge_core.segments import runs_of
from surge_core.types import BoolArray, FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DIGITS = 3
ZOOM_S = 0.8
# Of a longer record more would only blacken the paper.
LOOP_ROWS = 20_000
IMMERSIONS = {"tip": "Wc25_tip_kg_s", "hub": "Wc25_hub_kg_s"}


def operating_points(reduction: Reduction) -> Picture:
    """Draw pressure ratio over inlet corrected flow (paper, Fig 9, 11, 14 and 15).

    Above the whole record with the quasi-steady cycles in colour, and the cycles alone; below the
    same over the flow of the tip and of the hub probes, where the record has both; kg/s below and
    lbm/s above.
    """
    record, keep = reduction.record, _window_rows(reduction)
    flow, ratio = record["Wc25_kg_s"], record["pressure_ratio"]
    flows = {"face average": flow, "face average, quasi-steady cycles": flow}
    if all(name in record for name in IMMERSIONS.values()):
        flows |= {f"{place} probes": record[name] for place, name in IMMERSIONS.items()}
    figure = style.new_figure(height_in=1.0 + 2.2 * len(flows))
    panels = np.ravel(figure.subplots(len(flows) // 2, 2))
    from_s, to_s = reduction.window_s
    label = f"quasi-steady cycles, {from_s:.2f} to {to_s:.2f} s"
    for ax, (name, own) in zip(panels, flows.items(), strict=True):
        style.dress(ax).set_xlabel(f"$W_{{c25}}$ [kg/s], {name}")
        ax.axvline(0.0, color=style.INK, lw=0.6)
        _pounds_above(ax)
        if ax is not panels[1]:
            ax.plot(own, ratio, color=style.FAINT, lw=0.9, label="whole record")
        ax.plot(own[keep], ratio[keep], color=style.ACCENT, lw=0.8, alpha=0.8, label=label)
    for ax in panels[::2]:
        ax.set_ylabel("pressure ratio $P_{31}/P_{25}$ [-]")
    style.legend_above(figure, panels[0])
    sides = [
        f"{name} {span(own[keep], 'kg/s')}, reversed {100.0 * np.mean(own[keep] < 0.0):.0f} % of "
        "the time"
        for name, own in list(flows.items())[2:]
    ]
    return Picture(
        "Operating points",
        figure,
        f"Pressure ratio over inlet corrected flow. Whole record: ratio {span(ratio)}, flow "
        f"{span(flow, 'kg/s')}. Quasi-steady cycles, {from_s:.2f} to {to_s:.2f} s: ratio "
        f"{span(ratio[keep])}, flow {span(flow[keep], 'kg/s')}."
        + (f" In the cycles: {'; '.join(sides)}." if sides else ""),
        "As Fig 9, 11, 14 and 15 of the paper. From the stall point the machine reverses, blows "
        "down at reversed flow and settles into cycles that need not return to the first stall "
        "point: the heated inlet drives corrected speed down. Where tip and hub reverse unlike, an "
        "average of both hides it.",
    )


def surge_cycles(reduction: Reduction) -> Picture:
    """Draw the quasi-steady cycles in time (paper, Fig 12, 13 and 16 to 19)."""
    record, keep = reduction.record, _window_rows(reduction)
    time_s, in_stall = record.time_s[keep], reduction.series.in_stall
    signals = {
        "inlet corrected flow": ("$W_{c25}$ [kg/s]", record["Wc25_kg_s"][keep], "kg/s"),
        "inlet total pressure": ("$P_{25}$ [kPa]", 1e-3 * record["P25_Pa"][keep], "kPa"),
        "exit total pressure": ("$P_{31}$ [kPa]", 1e-3 * record["P31_Pa"][keep], "kPa"),
        "inlet total temperature": ("$T_{25}$ [K]", record["T25_K"][keep], "K"),
        "corrected speed": ("$N_c$ [% design]", 100.0 * record["Nc_frac"][keep], "% of design"),
    }
    figure, panels = style.strips(len(signals), 8.2, "facility clock [s]")
    for ax, (label, values, _) in zip(panels, signals.values(), strict=True):
        ax.set_ylabel(label)
        if in_stall is not None:
            shade(ax, time_s, ~in_stall[keep], "unstalled")
        ax.plot(time_s, values, color=style.ACCENT, lw=1.0)
    panels[0].axhline(0.0, color=style.INK, lw=0.6)
    panels[-1].set_xlim(float(time_s[0]), float(time_s[-1]))
    if panels[0].get_legend_handles_labels()[1]:
        style.legend_above(figure, panels[0])
    figure.align_ylabels(panels)
    spans = "; ".join(f"{name} {span(values, unit)}" for name, (_, values, unit) in signals.items())
    return Picture(
        "Quasi-steady surge cycles",
        figure,
        f"From {reduction.window_s[0]:.2f} to {reduction.window_s[1]:.2f} s: {spans}. "
        f"{cycle_words(record['P31_Pa'][keep], record.sample_rate_hz)}",
        "As Fig 12, 13 and 16 to 19 of the paper. A cycle starts at stall: flow and exit pressure "
        "collapse and the flow reverses; inlet temperature rises in stall and falls as the machine "
        "recovers; corrected speed mirrors it. Shaded, where there is any: unstalled. A slow slope "
        "of temperature or speed over the cycles is the facility, not the compressor.",
    )


def loops(series: CoefficientSeries, target: str = "psi_p") -> Picture:
    """Draw the coefficient of a reduced record over φ, as the record ran through it."""
    values = np.asarray(getattr(series, target))
    if target == "psi":
        # A gap where it was interpolated: at small and at reversed flow.
        values = np.where(psi_is_known(series.phi), values, np.nan)
    some = slice(0, LOOP_ROWS)
    phi, shown, scored = series.phi[some], values[some], series.scored[some]
    words = f"instantaneous {style.coefficient_symbol(target)} [-]"
    figure, ax = style.panel(style.PHI, words, 5.4)
    if not scored.all():
        ax.plot(phi, shown, color=style.FAINT, lw=0.7, label="whole record")
    label = "record" if scored.all() else "intervals that are fitted"
    fitted = np.where(scored, phi, np.nan), np.where(scored, shown, np.nan)
    ax.plot(*fitted, color=style.ACCENT, lw=0.7, alpha=0.7, label=label)
    ax.set_ylim(*style.robust_limits(shown))
    ax.set_xlim(*style.robust_limits(phi))
    style.legend_above(figure, ax)
    symbol = SYMBOLS[target]
    return Picture(
        f"{symbol} over φ, {series.source}",
        figure,
        f"{symbol} of {series.source} over φ: φ {span(phi[scored])}, {symbol} "
        f"{span(shown[scored])} in the intervals to be fitted.",
        "The record came as coefficients, so that pressure ratio and flow are not known. A loop "
        "that is open is lag: at one φ the coefficient is higher on the way down than on the way "
        "up, or the other way round. Blue: intervals that are fitted.",
    )


def span(values: FloatArray, unit: str = "") -> str:
    """Return the least and the greatest of a signal's finite values, with their unit."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return "not known"
    low, high = (significant(float(end), DIGITS) for end in (finite.min(), finite.max()))
    return f"{low} to {high} {unit}".rstrip()


def cycle_words(values: FloatArray, sample_rate_hz: float) -> str:
    """Say how long a surge cycle takes: of the pressure, since flow can be stronger at twice it."""
    surge_hz = surge_frequency_hz(values, sample_rate_hz) if np.ptp(values) > 0.0 else 0.0
    if surge_hz <= 0.0:
        return "No cycle stands out."
    period = significant(1e3 / surge_hz, DIGITS)
    return f"A cycle takes {period} ms ({significant(surge_hz, DIGITS)} Hz)."


def _window_rows(reduction: Reduction) -> BoolArray:
    time_s = reduction.record.time_s
    from_s, to_s = reduction.window_s
    return np.asarray((time_s >= from_s) & (time_s <= to_s))


def _pounds_above(ax: Axes) -> None:
    both_ways = (lambda kg: np.asarray(kg) / LBM_KG, lambda lbm: np.asarray(lbm) * LBM_KG)
    axis = ax.secondary_xaxis("top", functions=both_ways)
    axis.set_xlabel("[lbm/s]", fontsize=9, color=style.QUIET)
    axis.tick_params(labelsize=8.5, colors=style.QUIET)
    axis.spines["top"].set_color("#888888")


def reconstruction(comparison: Comparison, record: int = 0, kind: str = "filtered") -> Picture:
    """Draw the free run of each estimator against the measurement of one record (Fig 27).

    Above, the whole record with the first of the estimators that were fitted to rows of this kind;
    below, the cycles around the border to the held-out rows with all of them.
    """
    results = [result for result in comparison.results if result.rows.kind == kind]
    first, rows, source = results[0], results[0].rows, comparison.records[record].source
    own = rows.record == record
    time_s, measured, held_out = rows.time_s[own], rows.measured[own], ~rows.train[own]
    styles = style.estimator_styles(result.name for result in comparison.results)
    runs = {result.label: (styles[result.name], result.trained[own]) for result in results}
    both = bool(held_out.any() and not held_out.all())
    middle = float(time_s[held_out][0]) if both else None
    figure = _two_panels(rows, own, runs, held_out, "held-out cycles", middle=middle)
    errors = ", ".join(
        f"{r.label} {significant(rms(measured - r.trained[own]), 2)}" for r in results
    )
    return Picture(
        f"Reconstructed {NAMES[rows.target]}, {rows.called} rows of {source}",
        figure,
        f"Measured {SYMBOLS[rows.target]} of {source} from {time_s[0]:.2f} to {time_s[-1]:.2f} s "
        "and its free runs by fits to the rows not held out. rms of the error: "
        f"{errors}.",
        f"As Fig 27 of the paper. Above: {first.label}; below: all that were fitted to "
        f"{rows.called} rows, around the border to the held-out cycles. A free run knows the "
        "measured flow, and "
        "of the measured coefficient only the first row of each segment. Shaded cycles were held "
        "out: the lines drawn are of a fit to the other cycles alone.",
    )


def validation(validated: Sequence[Reconstruction]) -> Picture:
    """Draw models that were fitted elsewhere against the measurement of another record.

    Above, the whole record with the first model; below, the cycles in its middle with all of them
    and the first one's band, rows shaded whose φ lies outside the range where it dwelt in the fit.
    """
    best, rows = validated[0], validated[0].rows
    styles = style.estimator_styles(run.model.estimator for run in validated)
    runs = {run.label: (styles[run.model.estimator], run.reconstructed) for run in validated}
    every = np.ones(rows.phi.size, dtype=np.bool_)
    label = r"$\varphi$ beyond where it dwelt in the fit"
    figure = _two_panels(rows, every, runs, best.beyond, label, band=best.band)
    scores = ", ".join(
        f"{label} {significant(run.score.rms, 2)}"
        for label, run in zip(runs, validated, strict=True)
    )
    return Picture(
        f"Validation: {best.title}, {rows.called} rows",
        figure,
        f"Measured {best.title}, {rows.called} rows, and free runs of saved models; rms "
        f"{scores}. In {100.0 * best.outside:.0f} % of the rows φ lies beyond where it "
        "dwelt in the fit.",
        f"Nothing was refitted. Above {next(iter(runs))} over "
        "the whole record, below all models of such rows in its middle, with the pointwise 95 % "
        "band of the first by the covariance of its τ and coefficients: it says where the free run "
        "lies, not how far the measurement scatters. Shaded: φ beyond where it dwelt in the fit "
        "(5th to 95th percentile), where the reconstruction rests on extrapolated curves.",
    )


def errors_in_time(comparison: Comparison) -> Picture:
    """Draw what the free run of each estimator with a τ leaves, over time, all to one scale."""
    rows = comparison.rows
    states_tau = [r for r in comparison.results if math.isfinite(r.model.time_constant_s)]
    results = states_tau or comparison.results
    # Records of one test keep their order on the clock; others may overlap, so rows are counted.
    by_clock = bool(np.all(np.diff(rows.time_s) > 0.0))
    axes: dict[str, FloatArray] = {}
    for each in (result.rows for result in results):
        counted = rows.sample_period_s * np.arange(each.phi.size, dtype=np.float64)
        axes[each.kind] = each.time_s if by_clock else counted
    styles = style.estimator_styles(result.name for result in results)
    clock = "facility clock [s]" if by_clock else "fitted rows in a row [s]"
    figure, panels = style.strips(len(results), 1.1 + 1.35 * len(results), clock, sharey=True)
    errors, shown = [], []
    for ax, result in zip(panels, results, strict=True):
        rows, axis = result.rows, axes[result.rows.kind]
        error = rows.measured - result.reconstruction
        errors.append(error)
        shade(ax, axis, ~rows.train, "held-out cycles")
        ax.axhline(0.0, color=style.INK, lw=0.6)
        colour, label = styles[result.name].colour, style.printable(result.label)
        ax.plot(*style.broken(axis, error, rows.runs), color=colour, lw=0.9, label=label)
        shown.append(f"{result.label} {significant(result.free_run.rms, 2)}")
    panels[0].set_ylim(*style.robust_limits(*errors, margin=0.1))
    ends = [axis[[0, -1]] for axis in axes.values()]
    panels[0].set_xlim(float(np.min(ends)), float(np.max(ends)))
    symbol = style.coefficient_symbol(rows.target)
    words = f"free-run error of {symbol}: measured - reconstructed [-]"
    figure.supylabel(words, fontsize=10)
    style.legend_above(figure, *panels)
    return Picture(
        f"Free-run errors in time, {NAMES[rows.target]}",
        figure,
        f"Measured minus reconstructed {SYMBOLS[rows.target]} over time, one strip an estimator; "
        f"rms {'; '.join(shown)}.",
        "All strips have one scale. What repeats in every cycle is structure that the model lacks, "
        "not noise; a level that wanders over the cycles is drift.",
    )


def shade(ax: Axes, time_s: FloatArray, where: BoolArray, label: str) -> None:
    """Shade the stretches of rows, by their clock, that a mask marks."""
    name: str | None = label
    step = float(np.median(np.diff(time_s))) if time_s.size > 1 else 0.0
    # Rows of two segments lie further apart than one step; the shade does not bridge them.
    gaps = np.concatenate([[False], np.diff(time_s) > 1.5 * step])
    for run in runs_of(2 * np.cumsum(gaps) + where, time_s.size):
        if where[run.start]:
            left, right = time_s[run.start] - 0.5 * step, time_s[run.stop - 1] + 0.5 * step
            ax.axvspan(left, right, color=style.SHADE, lw=0, zorder=0, label=name)
            name = None


def _two_panels(
    rows: FitRows,
    own: BoolArray,
    runs: Mapping[str, tuple[style.LineStyle, FloatArray]],
    shaded: BoolArray,
    shade_label: str,
    *,
    middle: float | None = None,
    band: FloatArray | None = None,
) -> Figure:
    """Draw the first of some free runs over all of its rows, and below all over a part of them.

    ``middle`` is that of the part, without it that of the record; ``band`` half the width of the
    band of the first run.
    """
    time_s, measured = rows.time_s[own], rows.measured[own]
    pieces = runs_of(rows.labels[own], time_s.size)
    first, last = float(time_s[0]), float(time_s[-1])
    span = min(ZOOM_S, last - first)
    wanted = (0.5 * (first + last) if middle is None else middle) - 0.5 * span
    start = float(np.clip(wanted, first, last - span))
    figure = style.new_figure(height_in=6.6)
    upper, lower = figure.subplots(2, 1)
    for ax, names, ends in (
        (upper, list(runs)[:1], (first, last)),
        (lower, list(runs), (start, start + span)),
    ):
        shade(style.dress(ax), time_s, shaded, shade_label)
        width = 0.8 if len(names) == 1 else 1.2
        # Thick and pale below the thin lines: where they part is seen, where they agree too.
        known = style.broken(time_s, measured, pieces)
        ax.plot(*known, color=style.MEASURED, lw=2.2 * width, label="measured")
        for name in names:
            look, values = runs[name]
            # One alone is full.
            dashes = "-" if len(names) == 1 else look.dashes
            line = style.broken(time_s, values, pieces)
            label = style.printable(name)
            ax.plot(*line, color=look.colour, ls=dashes, lw=width, label=label)
        ax.set_xlim(*ends)
        ax.set_ylim(*style.robust_limits(measured, margin=0.15))
        ax.set_ylabel(f"{style.coefficient_symbol(rows.target)} [-]")
    if band is not None and np.all(np.isfinite(band)):
        look, values = next(iter(runs.values()))
        at_s, low = style.broken(time_s, values - band, pieces)
        high = style.broken(time_s, values + band, pieces)[1]
        label = "its 95 % band"
        lower.fill_between(at_s, low, high, color=look.colour, alpha=0.25, lw=0, label=label)
    lower.set_xlabel("facility clock [s]")
    style.legend_above(figure, lower)
    return figure
