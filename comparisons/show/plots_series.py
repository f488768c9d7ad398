"""Picture of a series that came as coefficients: its loops over φ."""

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
from comparisons.show.plots_record import span
from surge_core.errors import InputError
from surge_core.types import FloatArray

# Of a longer record more would only blacken the paper.
LOOP_ROWS = 20_000


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


def _where_defined(series: CoefficientSeries) -> FloatArray | None:
    """Return ψ with a gap where it was interpolated: at small and at reversed flow."""
    if series.psi is None:
        return None
    return np.where(psi_is_known(series.phi), series.psi, np.nan)
