"""Figures 3 to 6: the stall cells in the inlet signals of the 90 % test, and the low-pass."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from classic_ml.calibration import calibrate, match_near_stall
from classic_ml.faults.search import inspect_readings
from classic_ml.filters import butterworth_gain, filter_channels
from classic_ml.flow import LBM_KG
from classic_ml.planes import local_flows
from classic_ml.records import Record
from classic_ml.spectra import peak_frequency_hz, power_spectrum
from comparisons.page.style import ACCENT, INK, MARK, MEASURED, legend_above
from comparisons.paper.figures_common import (
    HIGH,
    PSI_PA,
    PaperFigure,
    between,
    kpa_right,
    mark_time,
    one_panel,
    panels,
    pounds,
    secondary_y,
    shade_unstalled,
    stall_time_s,
)
from comparisons.paper.instabilities import InstabilityRun
from surge_core.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["InletSignals", "draw_filter_figures", "inlet_signals"]

# A probe at the tip, where the cells are strongest.
PROBE = "25_A_tip"
PROBE_WORDS = "tip probes of rake A at plane 25"
# The two orders that the paper tried, numbered so in its Fig 5.
ORDERS = (3, 5)
# Peaks that the paper reads off its Fig 4, and 82.5 Hz from the interstage wall pressures.
PAPER_PEAKS_HZ = (7.0, 16.0, 81.2, 162.0)
WALL_PRESSURE_HZ = 82.5
# Where the rig's counterparts of them are looked for.
BANDS_HZ = ((4.0, 11.5), (11.5, 21.0), (60.0, 105.0), (145.0, 185.0))
CELL_BAND_HZ = (75.0, 90.0)
SHOWN_HZ = 200.0
ZOOM_S = 0.4
FILTERED = {3: (ACCENT, "-"), 5: (MARK, (0, (4, 1.5)))}


@dataclass(frozen=True)
class InletSignals:
    """One probe pair at plane 25 before and after the filters of the paper.

    Parameters
    ----------
    time_s : ndarray of shape (n,)
        Facility clock.
    window : ndarray of bool, shape (n,)
        The quasi-steady cycles.
    pressure_Pa, flow_kg_s : mapping of int to ndarray of shape (n,)
        Total pressure and local corrected flow by the order of the filter; 0: unfiltered.
    sample_rate_hz, cutoff_hz : float
        Samples a second and the filters' cut-off.
    """

    time_s: FloatArray
    window: NDArray[np.bool_]
    pressure_Pa: dict[int, FloatArray]
    flow_kg_s: dict[int, FloatArray]
    sample_rate_hz: float
    cutoff_hz: float

    def spectrum(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the power spectrum over the window, first-order trend removed."""
        return power_spectrum(values[self.window], self.sample_rate_hz)


def inlet_signals(run: InstabilityRun) -> InletSignals:
    """Reduce one probe pair without a filter and with both of the paper's.

    The filters act on the pressures, before the flow is computed from them.

    Parameters
    ----------
    run : InstabilityRun
        The test; its paper's settings give the cut-off.
    """
    test, settings = run.paper.test, run.paper.settings
    calibrated = calibrate(inspect_readings(run.rig.raw, test), test)
    plain = match_near_stall(calibrated, test, settings.near_stall_match)
    by_order: dict[int, Record] = {0: local_flows(plain, test)}
    for order in ORDERS:
        filtered = filter_channels(
            plain, test.channel_names, order=order, cutoff_hz=settings.cutoff_hz, phase="causal"
        )
        by_order[order] = local_flows(filtered, test)
    time_s = plain.time_s
    return InletSignals(
        time_s,
        between(time_s, run.paper.window_s),
        {order: record[f"Pt{PROBE}_Pa"] for order, record in by_order.items()},
        {order: record[f"Wc{PROBE}_kg_s"] for order, record in by_order.items()},
        plain.sample_rate_hz,
        settings.cutoff_hz,
    )


def draw_filter_figures(run: InstabilityRun) -> list[PaperFigure]:
    """Draw Figures 3 to 6 from the 90 % test.

    Parameters
    ----------
    run : InstabilityRun
        The 90 % test.
    """
    signals = inlet_signals(run)
    return [
        _pressure(run, signals),
        _spectrum(signals),
        _filtered_spectra(signals),
        _flow(signals),
    ]


def _pressure(run: InstabilityRun, signals: InletSignals) -> PaperFigure:
    figure, grid = panels(2, height_in=HIGH)
    whole, part = grid[:, 0]
    psia = signals.pressure_Pa[0] / PSI_PA
    stalled = run.rig.truth["in_stall"] > 0.5
    first = stall_time_s(run)
    zoom = _zoom(signals)
    whole.plot(signals.time_s, psia, color=ACCENT, lw=0.5)
    shade_unstalled(whole, signals.time_s, signals.time_s >= first, "before the instability")
    mark_time(whole, first, "first stall", left=True)
    whole.axvspan(*zoom, facecolor="none", edgecolor=INK, lw=0.9, label="enlarged below")
    whole.set_xlim(signals.time_s[0], signals.time_s[-1])
    rows = between(signals.time_s, zoom)
    part.plot(signals.time_s[rows], psia[rows], color=ACCENT, lw=0.9)
    shade_unstalled(part, signals.time_s[rows], stalled[rows], "recovered (truth of the rig)")
    part.set_xlim(*zoom)
    for ax in (whole, part):
        ax.set_ylabel("inlet total pressure [psia]")
        kpa_right(ax)
    part.set_xlabel("time [s]")
    legend_above(figure, whole, part)
    swing = _cell_rms(signals, psia)
    caption = (
        f"Total pressure at the {PROBE_WORDS} as it was digitised, 90 % speed: "
        f"{psia[signals.time_s < first].mean():.1f} psia before the instability, then "
        f"{psia[signals.window].min():.1f} to {psia[signals.window].max():.1f} psia in the "
        f"quasi-steady cycles. The fast ripple on every cycle, {swing:.2f} psi rms between "
        f"{CELL_BAND_HZ[0]:g} and {CELL_BAND_HZ[1]:g} Hz, is rotating stall; it never stops, not "
        "even where the flow recovers."
    )
    return PaperFigure(
        3,
        "Unfiltered inlet pressure, 90 % speed",
        figure,
        caption,
        "Unfiltered Inlet Total Pressure Signal, 90% Instability.",
    )


def _spectrum(signals: InletSignals) -> PaperFigure:
    figure, ax = one_panel()
    frequency, density = signals.spectrum(signals.pressure_Pa[0] / PSI_PA)
    ax.semilogy(frequency[1:], density[1:], color=ACCENT, lw=1.1)
    peaks = [peak_frequency_hz(frequency, density, *band) for band in BANDS_HZ]
    low, high = 0.5 * density[1:].min(), 6.0 * density.max()
    for peak, (begin, end) in zip(peaks, BANDS_HZ, strict=True):
        inside = (frequency >= begin) & (frequency <= end)
        ax.annotate(
            f"{peak:.1f} Hz",
            (peak, float(density[inside].max())),
            xytext=(5, 3),
            textcoords="offset points",
            fontsize=9,
            color=INK,
        )
    ax.plot(
        PAPER_PEAKS_HZ,
        np.full(len(PAPER_PEAKS_HZ), 1.6 * low),
        marker="^",
        markersize=8,
        linestyle="none",
        color=MARK,
        label="peaks stated in the paper: 7, 16, 81.2 and 162 Hz",
    )
    ax.set_ylim(low, high)
    ax.set_xlim(0.0, SHOWN_HZ)
    _density_label(ax)
    legend_above(figure, ax)
    caption = (
        f"Power spectrum of the signal of Fig 3 over the quasi-steady cycles, first-order trend "
        f"removed, bins of {frequency[1]:.3g} Hz. The highest of the fast peaks is at "
        f"{peaks[2]:.1f} Hz (paper: 81.2 Hz, and {WALL_PRESSURE_HZ} Hz from wall pressures, which "
        f"is what the rig's cells turn at) with its second harmonic at {peaks[3]:.0f} Hz (162); "
        f"the surge itself is at {peaks[0]:.1f} and {peaks[1]:.1f} Hz (7 and 16), here a "
        "fundamental and its second harmonic."
    )
    return PaperFigure(
        4,
        "Spectrum of the unfiltered inlet pressure, 90 % speed",
        figure,
        caption,
        "Power Spectrum of Unfiltered Pressure Signal with First Order Trend Removed, 90% Nc "
        "Instability.",
    )


def _filtered_spectra(signals: InletSignals) -> PaperFigure:
    figure, ax = one_panel()
    spectra = {
        order: signals.spectrum(values / PSI_PA) for order, values in signals.pressure_Pa.items()
    }
    frequency, plain = spectra[0]
    _three_spectra(ax, spectra)
    mark_time(ax, signals.cutoff_hz, f"cut-off, {signals.cutoff_hz:g} Hz", colour=INK)
    ax.set_ylim(1e-10 * plain.max(), 6.0 * plain.max())
    _density_label(ax)
    legend_above(figure, ax)
    cell = peak_frequency_hz(frequency, plain, *BANDS_HZ[2])
    at = int(np.argmin(np.abs(frequency - cell)))
    words = []
    for order in ORDERS:
        found = 10.0 * np.log10(plain[at] / spectra[order][1][at])
        gain = butterworth_gain(
            np.array([cell]), signals.sample_rate_hz, order=order, cutoff_hz=signals.cutoff_hz
        )
        expected = -20.0 * np.log10(float(gain[0]))
        words.append(f"{found:.1f} dB by order {order} (its gain: {expected:.1f} dB)")
    caption = (
        "The signal of Fig 3 unfiltered (1), and from pressures behind a Butterworth low-pass of "
        f"third (3) and of fifth order (5), numbered as in the paper. At {cell:.1f} Hz the cells "
        f"are attenuated by {' and '.join(words)}; well below {signals.cutoff_hz:g} Hz the three "
        "agree."
    )
    return PaperFigure(
        5,
        "Spectra of the inlet pressure before and after the filters, 90 % speed",
        figure,
        caption,
        "Power Spectra of Unfiltered and Filtered Inlet Total Pressure Signal, 90% Nc Instability.",
    )


def _flow(signals: InletSignals) -> PaperFigure:
    figure, grid = panels(2, height_in=HIGH)
    time_ax, ax = grid[:, 0]
    rows = between(signals.time_s, _zoom(signals))
    flow = {order: pounds(values) for order, values in signals.flow_kg_s.items()}
    time_ax.plot(
        signals.time_s[rows], flow[0][rows], color=MEASURED, lw=0.9, label="(1) unfiltered"
    )
    for order in ORDERS:
        colour, dashes = FILTERED[order]
        time_ax.plot(
            signals.time_s[rows],
            flow[order][rows],
            color=colour,
            linestyle=dashes,
            lw=1.4,
            label=f"({order}) filter of order {order}",
        )
    time_ax.axhline(0.0, color=INK, lw=0.6)
    time_ax.set_xlim(*_zoom(signals))
    time_ax.set_ylabel("local corrected flow [lbm/s]")
    time_ax.set_xlabel("(a)  time [s]")
    secondary_y(time_ax, LBM_KG, "[kg/s]")
    spectra = {order: signals.spectrum(values) for order, values in flow.items()}
    plain = spectra[0][1]
    _three_spectra(ax, spectra)
    mark_time(ax, signals.cutoff_hz, f"cut-off, {signals.cutoff_hz:g} Hz", colour=INK)
    ax.set_ylim(1e-6 * plain.max(), 6.0 * plain.max())
    ax.set_ylabel("density [(lbm/s)²/Hz]")
    ax.set_xlabel("(b)  frequency [Hz]")
    legend_above(figure, time_ax)
    figure.align_ylabels([time_ax, ax])
    before, after = _cell_rms(signals, flow[0]), _cell_rms(signals, flow[3])
    caption = (
        f"Local corrected flow from the {PROBE_WORDS}, (a) in time and (b) as spectra; the scan's "
        "caption speaks of inlet airflow, the text of a local one, which is drawn. The third-order "
        f"filter takes the cells between {CELL_BAND_HZ[0]:g} and {CELL_BAND_HZ[1]:g} Hz from "
        f"{before:.1f} to {after:.1f} lbm/s rms. It acts on the pressures, and the flow is nearly "
        "their square root, so above the cut-off the flow keeps harmonics of the surge that the "
        "pressures of Fig 5 have lost; and it delays: flow reversals come later than they were."
    )
    return PaperFigure(
        6,
        "Inlet airflow from unfiltered and filtered pressures, 90 % speed",
        figure,
        caption,
        "(a) A Comparison of Inlet Airflow Calculated from Unfiltered and Filtered Pressure "
        "Measurements, 90% Nc Instability. (b) Power Spectra of Inlet Airflow Calculated from "
        "Unfiltered and Filtered Pressure Measurements, 90% Nc Instability.",
    )


def _three_spectra(ax: Axes, spectra: dict[int, tuple[FloatArray, FloatArray]]) -> None:
    for order, (frequency, density) in spectra.items():
        colour, dashes = FILTERED.get(order, (MEASURED, "-"))
        word = "(1) unfiltered" if order == 0 else f"({order}) filter of order {order}"
        ax.semilogy(frequency[1:], density[1:], color=colour, linestyle=dashes, lw=1.2, label=word)
    ax.set_xlim(0.0, SHOWN_HZ)


def _density_label(ax: Axes) -> None:
    ax.set_xlabel("frequency [Hz]")
    ax.set_ylabel("power spectral density [psi²/Hz]")
    secondary_y(ax, (1e-3 * PSI_PA) ** 2, "[kPa²/Hz]")


def _zoom(signals: InletSignals) -> tuple[float, float]:
    begin = float(signals.time_s[signals.window][0])
    return begin, begin + ZOOM_S


def _cell_rms(signals: InletSignals, values: FloatArray) -> float:
    """Return the rms of a signal in the band of the stall cells, over the window."""
    frequency, density = signals.spectrum(values)
    inside = (frequency >= CELL_BAND_HZ[0]) & (frequency <= CELL_BAND_HZ[1])
    return float(np.sqrt(density[inside].sum() * (frequency[1] - frequency[0])))
