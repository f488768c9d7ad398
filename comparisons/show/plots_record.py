"""Pictures of a record, each with what it shows: operating points, cycles, loops over φ."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from classic_ml.coefficients import psi_is_known
from classic_ml.flow import LBM_KG
from classic_ml.reduction import Reduction
from classic_ml.series import CoefficientSeries
from comparisons.missing_effect.loading import surge_frequency_hz
from comparisons.page import style
from comparisons.page.blocks import Picture
from comparisons.results import SYMBOLS
from comparisons.show.plots_runs import shade
from surge_core.rounding import significant
from surge_core.types import BoolArray, FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DIGITS = 3
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
