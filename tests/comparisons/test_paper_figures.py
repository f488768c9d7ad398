"""The counterparts of the paper's figures: they show the data they claim to show."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.transforms import BboxBase
from numpy.testing import assert_allclose
from paper_runs import paper_runs

from classic_ml.filters import butterworth_gain
from classic_ml.flow import LBM_KG
from classic_ml.spectra import peak_frequency_hz
from comparisons.paper.figures import PaperFigure, draw_figures
from comparisons.paper.figures_instrument import draw_instrument_figures
from comparisons.paper.figures_truth import (
    in_stall_psi,
    in_stall_psi_p,
    phi_of_flow,
    pressure_ratio,
    reverse_flow_psi_p,
    stall_point,
    temperature_K,
    unstalled_psi_p,
)
from comparisons.paper.instabilities import Instabilities
from comparisons.rig import gas

NUMBERS = range(3, 28)
PSI_PA = 6894.757293
SCHEMATIC = (1, 2, 10)


@pytest.fixture(scope="module")
def runs() -> Instabilities:
    return paper_runs("90", "985", "75-stall")


@pytest.fixture(scope="module")
def figures(runs: Instabilities) -> Mapping[int, PaperFigure]:
    return {figure.number: figure for figure in draw_figures(runs)}


@dataclass(frozen=True)
class Page:
    """What is left of a figure once it was drawn, which is the slow part."""

    width_in: float
    ink: float
    words: tuple[BboxBase, ...]
    size: BboxBase


@pytest.fixture(scope="module")
def pages(figures: Mapping[int, PaperFigure], runs: Instabilities) -> Mapping[int, Page]:
    every = (*figures.values(), *draw_instrument_figures(runs["985"]))
    return {one.number: page(one.figure) for one in every}


def page(figure: Figure) -> Page:
    # Matplotlib's canvas carries no types.
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    ink = np.mean(np.any(np.asarray(canvas.buffer_rgba())[:, :, :3] < 215, axis=2))
    texts = [text for ax in figure.axes for text in ax.texts if text.get_text()]
    words = [text.get_window_extent() for text in texts]
    words += [legend.get_window_extent() for legend in figure.legends]
    return Page(float(figure.get_size_inches()[0]), float(ink), tuple(words), figure.bbox)


def data_axes(figure: PaperFigure) -> list[Axes]:
    return [ax for ax in figure.figure.axes if ax.axison and ax.get_label() != "<colorbar>"]


def line(ax: Axes, label: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the data of the one line whose label begins so."""
    found = [one for one in ax.get_lines() if str(one.get_label()).startswith(label)]
    assert len(found) == 1, [str(one.get_label()) for one in ax.get_lines()]
    return np.asarray(found[0].get_xdata(), float), np.asarray(found[0].get_ydata(), float)


def inside(values: np.ndarray, time_s: np.ndarray, span: tuple[float, float]) -> np.ndarray:
    return values[(time_s >= span[0]) & (time_s <= span[1])]


def test_each_figure_of_the_paper_is_there_once_and_in_order(runs: Instabilities) -> None:
    assert [figure.number for figure in draw_figures(runs)] == list(NUMBERS)
    assert [f.number for f in draw_instrument_figures(runs["985"])] == [1, 2]


def test_captions_say_something_of_their_own(figures: Mapping[int, PaperFigure]) -> None:
    for words in ("title", "caption", "paper_caption"):
        texts = [getattr(figure, words) for figure in figures.values()]
        assert len(set(texts)) == len(NUMBERS)
        assert all(len(text) > 10 and "nan" not in text for text in texts)
    for number, figure in figures.items():
        assert figure.caption.endswith(".")
        assert re.search(r"\d", figure.caption), number


def test_every_picture_has_one_width_and_shows_something(pages: Mapping[int, Page]) -> None:
    assert set(pages) == {1, 2, *NUMBERS}
    for number, page in pages.items():
        assert page.width_in == pytest.approx(9.0)
        assert 0.01 < page.ink < 0.4, number


def test_every_axis_is_labelled(figures: Mapping[int, PaperFigure]) -> None:
    for number, figure in figures.items():
        for ax in data_axes(figure):
            assert "[" in ax.get_ylabel() or "rows" in ax.get_ylabel(), number
            # The upper of two panels over one enlarged clock shares the label below it.
            assert "[" in ax.get_xlabel() or number == 3, number
        assert len(data_axes(figure)) >= 1 or number in SCHEMATIC


def test_no_words_run_into_each_other_or_leave_the_page(pages: Mapping[int, Page]) -> None:
    for number, page in pages.items():
        for i, box in enumerate(page.words):
            for other in page.words[i + 1 :]:
                assert not box.shrunk(0.98, 0.98).overlaps(other.shrunk(0.98, 0.98)), number
        for box in page.words:
            assert min(box.x0, box.y0) >= -1.0, number
            assert box.x1 <= page.size.x1 + 1.0, number
            assert box.y1 <= page.size.y1 + 1.0, number


def test_figure_3_shows_the_probe_before_any_filter(
    figures: Mapping[int, PaperFigure], runs: Instabilities
) -> None:
    whole = figures[3].figure.axes[0]
    time_s, psia = (np.asarray(v, float) for v in whole.get_lines()[0].get_data())
    truth = runs["90"].rig.truth
    assert time_s.size == truth.n_samples
    before = time_s < 0.2
    assert_allclose(psia[before].mean() * PSI_PA, truth["P25_Pa"][before].mean(), rtol=2e-3)
    unfiltered = runs["90"].paper.record["P25_unfiltered_Pa"] / PSI_PA
    # One tip probe swings more than the average of hub and tip, around the same level.
    window = (time_s > 2.0) & (time_s < 3.9)
    assert_allclose(psia[window].mean(), unfiltered[window].mean(), rtol=2e-2)
    assert psia[window].std() > unfiltered[window].std()


def test_figure_4_peaks_at_the_cells_of_the_rig(
    figures: Mapping[int, PaperFigure], runs: Instabilities
) -> None:
    frequency, density = figures[4].figure.axes[0].get_lines()[0].get_data()
    frequency, density = np.asarray(frequency, float), np.asarray(density, float)
    cells = runs["90"].rig.truth_parameters["case"]["cell_frequency_hz"]
    bin_hz = frequency[1] - frequency[0]
    assert frequency[np.argmax(density)] == pytest.approx(cells, abs=bin_hz)
    assert peak_frequency_hz(frequency, density, 145.0, 185.0) == pytest.approx(2 * cells, abs=0.3)
    assert f"{cells:.1f} Hz" in figures[4].caption


def test_figure_5_attenuates_the_cells_as_a_butterworth_filter_must(
    figures: Mapping[int, PaperFigure],
) -> None:
    ax = figures[5].figure.axes[0]
    frequency, plain = line(ax, "(1)")
    at = int(np.argmin(np.abs(frequency - 82.5)))
    for order in (3, 5):
        _, density = line(ax, f"({order})")
        gain = butterworth_gain(frequency[[at]], 1000.0, order=order, cutoff_hz=48.0)[0]
        assert 10 * np.log10(density[at] / plain[at]) == pytest.approx(20 * np.log10(gain), abs=1.0)
        slow = (frequency > 5.0) & (frequency < 10.0)
        assert_allclose(density[slow].sum(), plain[slow].sum(), rtol=0.05)


def test_figure_6_is_the_local_flow_of_the_reduction(
    figures: Mapping[int, PaperFigure], runs: Instabilities
) -> None:
    time_s, flow = line(figures[6].figure.axes[0], "(3)")
    record = runs["90"].paper.record
    expected = np.interp(time_s, record.time_s, record["Wc25_A_tip_kg_s"]) / LBM_KG
    assert_allclose(flow, expected, atol=1e-9)


@pytest.mark.parametrize(
    ("number", "channel", "unit"),
    [
        (7, "pressure_ratio", 1.0),
        (8, "Wc25_kg_s", 1.0 / LBM_KG),
        (12, "T25_K", 1.8),
        (13, "Nc_frac", 100.0),
        (16, "Wc25_kg_s", 1.0 / LBM_KG),
        (17, "P25_Pa", 1.0 / PSI_PA),
        (18, "P31_Pa", 1.0 / PSI_PA),
        (19, "T25_K", 1.8),
    ],
)
def test_figures_over_time_show_the_paper_s_reduction_and_the_truth(
    figures: Mapping[int, PaperFigure],
    runs: Instabilities,
    number: int,
    channel: str,
    unit: float,
) -> None:
    ax = figures[number].figure.axes[0]
    time_s, shown = line(ax, "reduced as in the paper")
    record, truth = runs["985"].paper.record, runs["985"].rig.truth
    rows = np.round(1000.0 * time_s).astype(int)
    assert_allclose(shown, unit * record[channel][rows])
    clock, true = line(ax, "truth of the rig")
    if channel == "pressure_ratio":
        assert_allclose(true, truth["P31_Pa"] / truth["P25_Pa"])
    else:
        rows = np.round(1000.0 * clock).astype(int)
        assert_allclose(true, unit * truth[channel][rows])
    if number >= 16:
        assert ax.get_xlim() == pytest.approx((1.8, 3.6))


def test_si_on_the_right_is_the_same_quantity(
    figures: Mapping[int, PaperFigure], pages: Mapping[int, Page]
) -> None:
    for number, factor in ((3, PSI_PA / 1e3), (8, LBM_KG), (12, 1 / 1.8), (17, PSI_PA / 1e3)):
        assert number in pages
        ax = figures[number].figure.axes[0]
        (right,) = ax.child_axes
        assert_allclose(right.get_ylim(), factor * np.asarray(ax.get_ylim()), rtol=1e-6)


def test_figure_9_runs_from_the_stall_point_in_time(
    figures: Mapping[int, PaperFigure], runs: Instabilities
) -> None:
    ax = figures[9].figure.axes[0]
    (path,) = [c for c in ax.collections if isinstance(c, LineCollection)]
    times = np.asarray(path.get_array())
    assert times.size == len(path.get_segments())
    assert np.all(np.diff(times) > 0.0)
    x, y = line(ax, "stall inception")
    record = runs["985"].paper.record
    before = record["pressure_ratio"][record.time_s < 0.3]
    # The reading flickers by its noise; the star sits before the collapse, near the peak.
    assert y[0] == pytest.approx(before.max(), rel=0.01)
    assert x[0] > 100.0


def test_figure_11_lies_inside_the_rig_s_own_speed_line(
    figures: Mapping[int, PaperFigure],
) -> None:
    ax = figures[11].figure.axes[0]
    flow, ratio = line(ax, "rig, speed line")
    star_x, star_y = line(ax, "its stall point")
    assert_allclose([flow[0], ratio[0]], [star_x[0], star_y[0]], rtol=0.01)
    unstalled, _ = line(ax, "unstalled")
    stalled, _ = line(ax, "in stall")
    assert np.nanmin(unstalled) > 40.0
    assert np.nanmax(unstalled) < flow[-1]
    assert np.nanmax(stalled) < 60.0


def test_figures_14_and_15_share_axes_and_the_tip_reverses_further(
    figures: Mapping[int, PaperFigure],
) -> None:
    tip, hub = figures[14].figure.axes[0], figures[15].figure.axes[0]
    assert tip.get_xlim() == hub.get_xlim()
    assert tip.get_ylim() == hub.get_ylim()
    share = []
    for ax in (tip, hub):
        (path,) = [c for c in ax.collections if isinstance(c, LineCollection)]
        flow = np.array([piece[0, 0] for piece in path.get_segments()])
        share.append(np.mean(flow < 0.0))
    assert share[0] > 2.0 * share[1]


def test_figure_20_ends_on_the_steady_characteristic(
    figures: Mapping[int, PaperFigure], runs: Instabilities
) -> None:
    phi, psi_p = line(figures[20].figure.axes[0], "stall of")
    steady = runs["75-stall"]
    assert psi_p[-1] == pytest.approx(float(in_stall_psi_p(steady, phi[-1])), abs=0.08)
    assert psi_p[0] == pytest.approx(float(unstalled_psi_p(steady, phi[0], 0.75)), abs=0.05)


def test_figure_21_draws_one_whole_cycle(figures: Mapping[int, PaperFigure]) -> None:
    ax = figures[21].figure.axes[0]
    phi, psi_p = line(ax, "one surge cycle")
    assert phi.min() < 0.0
    assert phi.max() > 0.2
    assert np.hypot(phi[-1] - phi[0], psi_p[-1] - psi_p[0]) < 0.1


def test_figure_22_is_the_sum_of_its_inputs(
    figures: Mapping[int, PaperFigure], runs: Instabilities
) -> None:
    model, inputs = figures[22].figure.axes[:2]
    phi, value = (np.asarray(v, float) for v in model.get_lines()[0].get_data())
    known = runs["90"].rig.truth_parameters
    total = np.full(phi.size, known["psi_intercept"])
    for number, slope in enumerate(known["psi_slopes"], start=2):
        _, column = line(inputs, f"$s_{number}")
        total += slope * column
    assert_allclose(total, value, atol=1e-12)


def test_figure_23_shows_estimate_truth_and_steady_points(
    figures: Mapping[int, PaperFigure], runs: Instabilities
) -> None:
    ax = figures[23].figure.axes[0]
    phi, psi_p = line(ax, "estimate")
    known = np.isfinite(phi)
    assert_allclose(psi_p[known], runs["985"].fits["psi_p"].quasi_steady(phi[known]))
    assert (phi[known].min(), phi[known].max()) == pytest.approx((-0.025, 0.175), abs=2e-3)
    (points,) = ax.containers
    steady_phi, steady_psi_p = (np.asarray(v, float) for v in points[0].get_data())
    truth = in_stall_psi_p(runs["75-stall"], steady_phi)
    assert_allclose(steady_psi_p, truth, atol=0.15)
    assert np.all(steady_psi_p > runs["985"].fits["psi_p"].quasi_steady(steady_phi))


@pytest.mark.parametrize(("number", "case"), [(24, "985"), (26, "90")])
def test_histograms_hold_every_row_that_is_fitted(
    figures: Mapping[int, PaperFigure], runs: Instabilities, number: int, case: str
) -> None:
    series = runs[case].paper.series
    bars = figures[number].figure.axes[0].containers[0]
    assert sum(bar.get_height() for bar in bars) == np.count_nonzero(series.scored)
    assert f"{np.count_nonzero(series.scored)} " in figures[number].caption
    reversed_rows = sum(bar.get_height() for bar in bars if bar.get_x() + bar.get_width() <= 1e-9)
    assert reversed_rows == np.count_nonzero(series.phi[series.scored] < 0.0)


def test_figure_25_draws_both_estimates(
    figures: Mapping[int, PaperFigure], runs: Instabilities
) -> None:
    ax = figures[25].figure.axes[0]
    for target, label in (("psi_p", r"estimated $\psi'"), ("psi", r"estimated $\psi_")):
        phi, value = line(ax, label)
        known = np.isfinite(phi)
        assert_allclose(value[known], runs["90"].fits[target].quasi_steady(phi[known]))


def test_figure_27_is_close_with_18_ms_and_not_with_243(
    figures: Mapping[int, PaperFigure], runs: Instabilities
) -> None:
    ax, trial = figures[27].figure.axes[:2]
    _, actual = line(ax, "actual")
    series = runs["90"].paper.series
    assert_allclose(actual[np.isfinite(actual)], series.psi_p[series.scored])
    errors = [
        np.sqrt(np.nanmean((actual - line(ax, f"reconstructed, τ = {ms} ms")[1]) ** 2))
        for ms in (18, 243)
    ]
    assert errors[0] < 0.5 * errors[1]
    (curve,) = [one for one in trial.get_lines() if len(np.atleast_1d(one.get_xdata())) > 2]
    tried, rms = (np.asarray(v, float) for v in curve.get_data())
    assert np.interp(18.0, tried, rms) == pytest.approx(errors[0], rel=0.02)
    assert 12.0 < tried[np.argmin(rms)] < 27.0


def test_steady_record_work_and_held_fits_may_be_missing(runs: Instabilities) -> None:
    low = runs["90"]
    paper = replace(
        low.paper,
        series=replace(low.paper.series, psi=None),
        record=low.paper.record.after(
            low.paper.record.history[-1], drop=("psi", "W31_kg_s", "T31_K")
        ),
    )
    bare = replace(low, paper=paper, fits={"psi_p": low.fits["psi_p"]})
    figures = {f.number: f for f in draw_figures(Instabilities({"90": bare, "985": runs["985"]}))}
    assert list(figures) == list(NUMBERS)
    assert "sketch" in figures[20].caption
    assert not figures[23].figure.axes[0].containers
    assert "could not be had" in figures[25].caption
    for number in (20, 23, 25, 26, 27):
        assert page(figures[number].figure).ink > 0.01


def test_curves_of_the_truth_are_those_of_the_rig(runs: Instabilities) -> None:
    high, steady = runs["985"], runs["75-stall"]
    truth = steady.rig.truth
    rows = (truth.time_s > 1.0) & (truth["stall_blend"] > 1.0 - 1e-9)
    assert np.count_nonzero(rows) > 1000
    assert_allclose(truth["psi_p_qs"][rows], in_stall_psi_p(steady, truth["phi"][rows]), rtol=1e-6)
    assert_allclose(truth["psi_qs"][rows], in_stall_psi(steady, truth["phi"][rows]), rtol=1e-6)
    for run in (high, steady):
        at_rest = run.rig.truth
        speed = float(at_rest["Nc_frac"][0])
        assert unstalled_psi_p(run, at_rest["phi"][0], speed) == pytest.approx(
            at_rest["psi_p_qs"][0], rel=1e-6
        )
    truth = high.rig.truth
    back = truth["phi"] < -0.01
    added = truth["psi_p"][back] - truth["psi_p_lagged"][back]
    phi = truth["phi"][back]
    expected = reverse_flow_psi_p(high, phi) - in_stall_psi_p(high, phi)
    # The rig takes the loss at the pressure before the inlet duct's inertia, the curve at P25.
    assert np.corrcoef(added, expected)[0, 1] > 0.99


def test_flow_and_pressure_ratio_follow_the_rig_s_gas(runs: Instabilities) -> None:
    high = runs["985"]
    speed = 0.75
    inlet_K = temperature_K(high, speed)
    assert inlet_K == pytest.approx(255.0 * (0.985 / 0.75) ** 2)
    flow = np.array([-10.0, 0.0, 20.0, 50.0])
    case = high.rig.truth_parameters["case"]
    phi = gas.flow_coefficient(
        LBM_KG * flow,
        inlet_K,
        area_m2=case["inlet_area_m2"],
        rotor_velocity_m_s=high.rig.truth_parameters["rotor_velocity_m_s"],
    )
    assert_allclose(phi_of_flow(high, flow, inlet_K), phi, rtol=1e-6, atol=1e-9)
    assert stall_point(high, 0.75) == pytest.approx((0.272, 4.2))
    velocity = high.rig.truth_parameters["rotor_velocity_m_s"]
    expected = (1.0 + 4.2 * velocity**2 / (2.0 * gas.CP_J_KG_K * inlet_K)) ** 3.5
    assert float(pressure_ratio(high, 4.2, inlet_K)) == pytest.approx(expected, rel=1e-4)
