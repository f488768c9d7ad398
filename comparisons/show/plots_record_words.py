"""What the pictures of a record show, in numbers."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from classic_ml.series import CoefficientSeries
from comparisons.harness.residual_analysis import stall_inception
from comparisons.page.style import robust_limits
from comparisons.show.plots_record import CELL_HZ, LOOP_ROWS, rows_drawn, where_defined, window_rows
from surge_core.errors import InputError
from surge_core.rounding import significant
from surge_core.types import FloatArray

if TYPE_CHECKING:
    from classic_ml.reduction import Reduction

__all__ = [
    "filter_words",
    "hub_and_tip_words",
    "inlet_spectra_words",
    "loops_words",
    "operating_points_words",
    "series_words",
    "span",
    "surge_cycles_words",
]

DIGITS = 3
# Bins of equal counts over which a loop's two branches are compared, and rows that a mean needs.
LOOP_BINS, FEWEST_ROWS = 16, 8
# Share of the coefficient's range below which its two branches are one line in the picture.
SHUT = 0.005
# Half the width over which the line of the stall cells is summed up.
CELL_BAND_HZ = 2.0


def span(values: FloatArray, unit: str = "") -> str:
    """Return the least and the greatest of a signal's finite values.

    Parameters
    ----------
    values : ndarray of shape (n,)
        The signal.
    unit : str
        Its unit; empty for none.
    """
    finite = values[np.isfinite(values)]
    if not finite.size:
        return "not known"
    low, high = (significant(float(end), DIGITS) for end in (finite.min(), finite.max()))
    return f"{low} to {high}" + (f" {unit}" if unit else "")


def operating_points_words(reduction: Reduction) -> str:
    """Return what the operating points of a reduced record show.

    Parameters
    ----------
    reduction : Reduction
        A reduced record.
    """
    record = reduction.record
    flow, ratio = record["Wc25_kg_s"], record["pressure_ratio"]
    keep = window_rows(reduction)
    from_s, to_s = reduction.window_s
    words = (
        f"Pressure ratio over inlet corrected flow. Whole record: ratio {span(ratio)}, flow "
        f"{span(flow, 'kg/s')}. Quasi-steady cycles, {from_s:.2f} to {to_s:.2f} s: ratio "
        f"{span(ratio[keep])}, flow {span(flow[keep], 'kg/s')}"
    )
    start = None
    if reduction.series.in_stall is not None:
        start = stall_inception(ratio, reduction.series.in_stall, record.sample_rate_hz)
    if start is None:
        return f"{words}. The record shows no inception of stall."
    return (
        f"{words}. Stall begins at {record.time_s[start]:.2f} s, at a ratio of "
        f"{significant(float(ratio[start]), DIGITS)} and "
        f"{significant(float(flow[start]), DIGITS)} kg/s."
    )


def hub_and_tip_words(reduction: Reduction) -> str:
    """Return what the operating points of the tip and of the hub probes show.

    Parameters
    ----------
    reduction : Reduction
        A reduced record with both immersions.
    """
    keep = window_rows(reduction)
    told = []
    for place in ("tip", "hub"):
        flow = reduction.record[f"Wc25_{place}_kg_s"][keep]
        reverse = 100.0 * float(np.mean(flow < 0.0))
        told.append(f"{place} {span(flow, 'kg/s')}, reversed {reverse:.0f} % of the time")
    return (
        "Pressure ratio over the corrected flow of the tip probes and of the hub probes. In the "
        f"quasi-steady cycles: {'; '.join(told)}."
    )


def surge_cycles_words(reduction: Reduction) -> str:
    """Return what the quasi-steady cycles in time show.

    Parameters
    ----------
    reduction : Reduction
        A reduced record.
    """
    record, keep = reduction.record, window_rows(reduction)
    from_s, to_s = reduction.window_s
    flow = record["Wc25_kg_s"][keep]
    signals = (
        f"inlet corrected flow {span(flow, 'kg/s')}",
        f"inlet total pressure {span(1e-3 * record['P25_Pa'][keep], 'kPa')}",
        f"exit total pressure {span(1e-3 * record['P31_Pa'][keep], 'kPa')}",
        f"inlet total temperature {span(record['T25_K'][keep], 'K')}",
        f"corrected speed {span(100.0 * record['Nc_frac'][keep], '% of design')}",
    )
    warmer = _drift(record.time_s[keep], record["T25_K"][keep])
    faster = _drift(record.time_s[keep], 100.0 * record["Nc_frac"][keep])
    return (
        f"From {from_s:.2f} to {to_s:.2f} s: {'; '.join(signals)}. "
        f"{_cycle_words(record['P31_Pa'][keep], record.sample_rate_hz)} Over the window the "
        f"temperature drifts by {warmer:+.2g} K and the speed by {faster:+.2g} %."
    )


def inlet_spectra_words(reduction: Reduction) -> str:
    """Return what the spectra of inlet pressure and flow show.

    Parameters
    ----------
    reduction : Reduction
        A reduced record.
    """
    from classic_ml.spectra import power_spectrum

    record, keep = reduction.record, window_rows(reduction)
    told = []
    for name, before, after in (
        ("inlet total pressure", "P25_unfiltered_Pa", "P25_Pa"),
        ("inlet corrected flow", "Wc25_unfiltered_kg_s", "Wc25_kg_s"),
    ):
        frequency, raw = power_spectrum(record[before][keep], record.sample_rate_hz)
        density = power_spectrum(record[after][keep], record.sample_rate_hz)[1]
        peak = 1 + int(np.argmax(density[1:]))
        words = f"{name} is strongest at {significant(float(frequency[peak]), DIGITS)} Hz"
        near = np.abs(frequency - CELL_HZ) <= CELL_BAND_HZ
        if reduction.settings.phase != "none" and near.any() and density[near].sum() > 0.0:
            change = 10.0 * np.log10(density[near].sum() / raw[near].sum())
            words += f", and the filter changes its power at {CELL_HZ:g} Hz by {change:+.1f} dB"
        told.append(words)
    return f"Power spectra before and after the filter ({filter_words(reduction)}): " + (
        "; ".join(told) + "."
    )


def filter_words(reduction: Reduction) -> str:
    """Return which low-pass a record was reduced with.

    Parameters
    ----------
    reduction : Reduction
        A reduced record.
    """
    settings = reduction.settings
    if settings.phase == "none":
        return "no low-pass was used"
    return (
        f"Butterworth of order {settings.filter_order} at {settings.cutoff_hz:g} Hz, phase "
        f"“{settings.phase}”"
    )


def series_words(series: CoefficientSeries) -> str:
    """Return what φ and the coefficients in time show.

    Parameters
    ----------
    series : CoefficientSeries
        A reduced record.
    """
    keep = rows_drawn(series)
    time_s, psi = series.time_s[keep], where_defined(series)
    signals = [f"φ {span(series.phi[keep])}", f"ψ' {span(series.psi_p[keep])}"]
    if psi is not None:
        signals.append(f"ψ {span(psi[keep])}")
    if series.T25_K is not None:
        signals.append(f"T25 {span(series.T25_K[keep], 'K')}")
    if series.Nc_frac is not None:
        signals.append(f"corrected speed {span(100.0 * series.Nc_frac[keep], '% of design')}")
    share = 100.0 * float(np.mean(series.scored[keep]))
    ends = f"{series.time_s[0]:.2f} to {series.time_s[-1]:.2f} s"
    whole = f" of its {ends}" if time_s.size < series.n_samples else ""
    return (
        f"{series.source} from {time_s[0]:.2f} to {time_s[-1]:.2f} s{whole}: "
        f"{'; '.join(signals)}. "
        f"{_cycle_words(series.psi_p[keep], series.sample_rate_hz)} {share:.0f} % of these rows "
        "are in intervals to be fitted."
    )


def loops_words(series: CoefficientSeries, target: str = "psi_p") -> str:
    """Return what the loops over φ show: ranges, and how wide the loop is open.

    Parameters
    ----------
    series : CoefficientSeries
        A reduced record.
    target : {"psi_p", "psi"}
        Which coefficient.
    """
    symbol = "ψ'" if target == "psi_p" else "ψ"
    values = series.psi_p if target == "psi_p" else where_defined(series)
    if values is None:
        raise InputError(series.source, expected=f"a column {target}", found="none")
    some = slice(0, LOOP_ROWS)
    phi, values = series.phi[some], values[some]
    known = series.scored[some] & np.isfinite(values)
    low, high = robust_limits(values[known], margin=0.0)
    words = (
        f"{symbol} of {series.source} over φ: φ {span(phi[known])}, {symbol} "
        f"{significant(low, DIGITS)} to {significant(high, DIGITS)} in the intervals to be fitted"
    )
    rising = np.gradient(phi) > 0.0
    opened = _widest(phi[known], values[known], rising[known])
    if opened is None or abs(opened[1]) < SHUT * (high - low):
        return f"{words}. No loop is open."
    at, apart = opened
    way = "falls" if apart < 0.0 else "rises"
    return (
        f"{words}. The loop is widest at φ = {significant(at, 2)}: {symbol} is "
        f"{significant(abs(apart), 2)} higher there while φ {way}."
    )


def _widest(
    phi: FloatArray, values: FloatArray, rising: NDArray[np.bool_]
) -> tuple[float, float] | None:
    """Return where the branch while φ rises lies furthest from that while it falls, and by what."""
    if not phi.size:
        return None
    edges = np.unique(np.quantile(phi, np.linspace(0.0, 1.0, LOOP_BINS + 1)))
    up, down = (_branch(phi[way], values[way], edges) for way in (rising, ~rising))
    if min(up.shape[1], down.shape[1]) < 2:
        return None
    # Both at the same φ: within a bin the two branches do not dwell at the same place.
    shared = up[:, (up[0] >= down[0, 0]) & (up[0] <= down[0, -1])]
    apart = shared[1] - np.interp(shared[0], *down)
    if not apart.size:
        return None
    at = int(np.argmax(np.abs(apart)))
    return float(shared[0, at]), float(apart[at])


def _branch(phi: FloatArray, values: FloatArray, edges: FloatArray) -> FloatArray:
    """Return mean φ and mean value of the rows in each bin that holds enough of them."""
    means = []
    for low, high in pairwise(edges.tolist()):
        inside = (phi >= low) & (phi <= high)
        if np.count_nonzero(inside) >= FEWEST_ROWS:
            means.append((phi[inside].mean(), values[inside].mean()))
    return np.array(means, dtype=np.float64).reshape(-1, 2).T


def _cycle_words(values: FloatArray, sample_rate_hz: float) -> str:
    """Say how long a surge cycle takes: of the pressure, since flow can be stronger at twice it."""
    from comparisons.missing_effect.excitation import surge_frequency_hz

    surge_hz = surge_frequency_hz(values, sample_rate_hz) if np.ptp(values) > 0.0 else 0.0
    if surge_hz <= 0.0:
        return "No cycle stands out."
    return (
        f"A cycle takes {significant(1e3 / surge_hz, DIGITS)} ms "
        f"({significant(surge_hz, DIGITS)} Hz)."
    )


def _drift(time_s: FloatArray, values: FloatArray) -> float:
    """Return what a straight line through a signal changes over its rows."""
    slope = float(np.polyfit(time_s - time_s[0], values, 1)[0])
    return slope * float(time_s[-1] - time_s[0])
