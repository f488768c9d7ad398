"""Pictures of a series that came as coefficients, each with what it shows: loops, and time."""

from __future__ import annotations

import numpy as np

from classic_ml.coefficients import psi_is_known
from classic_ml.series import CoefficientSeries
from comparisons.page.blocks import Picture
from comparisons.page.style import (
    ACCENT,
    FAINT,
    coefficient_symbol,
    dress,
    legend,
    new_figure,
    robust_limits,
)
from comparisons.show.plots_record import cycle_words, span
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["loops", "series_in_time"]

# Of a longer record more would only blacken the paper.
LOOP_ROWS = 20_000
LONGEST_S = 4.0


def loops(series: CoefficientSeries, target: str = "psi_p") -> Picture:
    """Draw the coefficient over φ, as the record ran through it.

    Parameters
    ----------
    series : CoefficientSeries
        A reduced record.
    target : {"psi_p", "psi"}
        Which coefficient.

    Raises
    ------
    InputError
        When the record lacks it.
    """
    values = series.psi_p if target == "psi_p" else _where_defined(series)
    if values is None:
        raise InputError(series.source, expected=f"a column {target}", found="none")
    some = slice(0, LOOP_ROWS)
    phi, shown, scored = series.phi[some], values[some], series.scored[some]
    figure = new_figure(height_in=5.4)
    ax = dress(figure.add_subplot())
    if not scored.all():
        ax.plot(phi, shown, color=FAINT, lw=0.7, label="whole record")
    label = "record" if scored.all() else "intervals that are fitted"
    fitted = np.where(scored, phi, np.nan), np.where(scored, shown, np.nan)
    ax.plot(*fitted, color=ACCENT, lw=0.7, alpha=0.7, label=label)
    ax.set_ylim(*robust_limits(shown))
    ax.set_xlim(*robust_limits(phi))
    ax.set_xlabel(r"flow coefficient $\varphi$ [-]")
    ax.set_ylabel(f"instantaneous {coefficient_symbol(target)} [-]")
    legend(ax, loc="best")
    symbol = "ψ'" if target == "psi_p" else "ψ"
    return Picture.of(
        f"{symbol} over φ, {series.source}",
        figure,
        f"{symbol} of {series.source} over φ: φ {span(phi[scored])}, {symbol} "
        f"{span(shown[scored])} in the intervals to be fitted.",
        "The record came as coefficients, so that pressure ratio and flow are not known. A loop "
        "that is open is lag: at one φ the coefficient is higher on the way down than on the way "
        "up, or the other way round. Blue: intervals that are fitted.",
    )


def series_in_time(series: CoefficientSeries) -> Picture:
    """Draw φ and the coefficients in time, of a record of which no more is known.

    Parameters
    ----------
    series : CoefficientSeries
        A reduced record; of a long one the first seconds from the first fitted interval on.
    """
    speed = None if series.Nc_frac is None else 100.0 * series.Nc_frac
    signals: dict[str, tuple[str, FloatArray | None, str]] = {
        "φ": (r"$\varphi$ [-]", series.phi, ""),
        "ψ'": (f"{coefficient_symbol('psi_p')} [-]", series.psi_p, ""),
        "ψ": (f"{coefficient_symbol('psi')} [-]", _where_defined(series), ""),
        "T25": ("$T_{25}$ [K]", series.T25_K, "K"),
        "corrected speed": ("$N_c$ [% design]", speed, "% of design"),
    }
    known = {name: (a, v, u) for name, (a, v, u) in signals.items() if v is not None}
    first = int(np.argmax(series.scored)) if series.scored.any() else 0
    count = int(LONGEST_S * series.sample_rate_hz) + 1
    start = max(0, min(first, series.n_samples - count))
    keep = slice(start, start + count)
    time_s, scored = series.time_s[keep], series.scored[keep]
    figure = new_figure(height_in=1.2 + 1.45 * len(known))
    panels = np.atleast_1d(np.asarray(figure.subplots(len(known), 1, sharex=True)))
    for ax, (label, values, _) in zip(panels, known.values(), strict=True):
        dress(ax).plot(time_s, values[keep], color=FAINT, lw=0.9)
        ax.plot(time_s, np.where(scored, values[keep], np.nan), color=ACCENT, lw=0.9)
        ax.set_ylim(*robust_limits(values[keep]))
        ax.set_ylabel(label)
    panels[-1].set_xlim(float(time_s[0]), float(time_s[-1]))
    panels[-1].set_xlabel("facility clock [s]")
    figure.align_ylabels(list(panels))
    ends = f" of its {series.time_s[0]:.2f} to {series.time_s[-1]:.2f} s"
    spans = "; ".join(f"{name} {span(v[keep], unit)}" for name, (_, v, unit) in known.items())
    return Picture.of(
        f"φ and the coefficients in time, {series.source}",
        figure,
        f"{series.source} from {time_s[0]:.2f} to {time_s[-1]:.2f} s"
        f"{ends if time_s.size < series.n_samples else ''}: {spans}. "
        f"{cycle_words(series.psi_p[keep], series.sample_rate_hz)} "
        f"{100.0 * float(np.mean(scored)):.0f} % of these rows are in intervals to be fitted.",
        "Blue: rows in the intervals to be fitted; grey: the rest. Of a long record only the first "
        "seconds from the first interval on are drawn. A gap in ψ marks flow too small or "
        "reversed, where it is not known.",
    )


def _where_defined(series: CoefficientSeries) -> FloatArray | None:
    """Return ψ with a gap where it was interpolated: at small and at reversed flow."""
    if series.psi is None:
        return None
    return np.where(psi_is_known(series.phi), series.psi, np.nan)
