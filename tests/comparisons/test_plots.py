"""Pictures: drawn without a global state, not empty, one colour an estimator, any text."""

from __future__ import annotations

import base64
import io
import subprocess
import sys

import numpy as np
import pytest
from comparison_data import LINES, made_comparison, made_series
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from PIL import Image
from raw_data import make_test

from classic_ml.reduction import Reduction, ReductionSettings, reduce_record
from comparisons.harness.reconstruction import reconstruct_record
from comparisons.page.style import broken, estimator_styles, printable, robust_limits
from comparisons.results import Truth
from comparisons.show import plots
from surge_core.errors import InputError
from surge_core.segments import runs_of

HOSTILE = "p$25_{x}^2 \\frac \U0001f4a5 漢字 <b>"


@pytest.fixture(scope="module")
def reduction() -> Reduction:
    made = make_test(cells_lbm_s=8.0, noise_counts=1.5, lag_thermocouples=True)
    return reduce_record(*made.load())


def pixels(figure: Figure) -> np.ndarray:
    """Return the picture as it goes into the report."""
    head, data = plots.figure_to_data_uri(figure).split(",")
    assert head == "data:image/png;base64"
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB"))


def share_of_ink(figure: Figure) -> float:
    return float(np.mean(np.any(pixels(figure) < 250, axis=2)))


def test_pictures_of_a_comparison_show_something() -> None:
    comparison = made_comparison()
    runs = tuple(reconstruct_record(r.model, made_series(5, HOSTILE)) for r in comparison.results)
    for figure in (
        plots.plot_characteristics(comparison).get_figure(),
        plots.plot_reconstruction(comparison),
        plots.plot_residuals(comparison),
        plots.plot_residual_structure(comparison),
        plots.plot_validation(runs),
        plots.plot_loops(comparison.records[0]).get_figure(),
        plots.plot_series(comparison.records[0]),
    ):
        assert 0.02 < share_of_ink(figure) < 0.6


def test_pictures_of_a_reduction_show_something(reduction: Reduction) -> None:
    for figure in (
        plots.plot_operating_points(reduction),
        plots.plot_hub_and_tip(reduction),
        plots.plot_surge_cycles(reduction),
        plots.plot_inlet_spectra(reduction),
        plots.plot_loops(reduction.series, "psi_p").get_figure(),
    ):
        assert figure is not None
        assert 0.02 < share_of_ink(figure) < 0.6


def test_every_axis_has_a_label_with_its_unit(reduction: Reduction) -> None:
    comparison = made_comparison()
    figures = [
        plots.plot_operating_points(reduction),
        plots.plot_surge_cycles(reduction),
        plots.plot_inlet_spectra(reduction),
        plots.plot_characteristics(comparison).get_figure(),
        plots.plot_reconstruction(comparison),
        plots.plot_residual_structure(comparison),
    ]
    for figure in figures:
        lowest = figure.axes[-1] if len(figure.axes) > 1 else figure.axes[0]
        assert any("[" in ax.get_ylabel() for ax in figure.axes)
        assert any("[" in ax.get_xlabel() for ax in (lowest, *figure.axes))


def test_flow_is_also_told_in_pounds(reduction: Reduction) -> None:
    whole = plots.plot_operating_points(reduction).axes[0]
    (secondary,) = whole.child_axes
    whole.figure.draw_without_rendering()
    assert secondary.get_xlabel() == "[lbm/s]"
    ratio = np.asarray(whole.get_xlim()) / np.asarray(secondary.get_xlim())
    assert ratio == pytest.approx(0.45359237)


def test_an_unfiltered_record_shows_no_cut_off() -> None:
    made = make_test(noise_counts=1.5)
    reduction = reduce_record(*made.load(), ReductionSettings(phase="none"))
    figure = plots.plot_inlet_spectra(reduction)
    texts = [text.get_text() for text in figure.axes[0].texts]
    assert texts == ["stall cells, 82.5 Hz"]


def test_an_estimator_keeps_its_colour_in_every_picture() -> None:
    names = [line[0] for line in LINES]
    styles = estimator_styles(names)
    assert len({style.colour for style in styles.values()}) == len(names)
    assert estimator_styles(reversed(names))["sindy"] == styles["sindy"]
    comparison = made_comparison()
    axes = plots.plot_characteristics(comparison)
    drawn = {line.get_label(): to_hex(line.get_color()) for line in axes.get_lines()}
    strips = plots.plot_residuals(comparison).axes
    for result, strip in zip(comparison.results, strips, strict=True):
        expected = styles[result.name].colour.lower()
        assert drawn[printable(result.label)] == expected
        assert expected in {to_hex(line.get_color()) for line in strip.get_lines()}


def test_curves_are_full_only_where_phi_dwells() -> None:
    comparison = made_comparison()
    low, high = comparison.valid_phi
    axes = plots.plot_characteristics(comparison)
    full = [line for line in axes.get_lines() if not line.get_label().startswith("_")]
    assert len(full) == len(LINES)
    for line in full:
        phi = np.asarray(line.get_xdata())[np.isfinite(np.asarray(line.get_ydata()))]
        assert low <= phi.min() <= phi.max() <= high
        assert np.asarray(line.get_xdata()).max() > high  # faint, but drawn


def test_the_truth_is_drawn_where_it_is_known() -> None:
    comparison = made_comparison()
    phi = np.linspace(-1.0, 2.0, 400)
    truth = Truth(0.018, phi, 0.3 + 1.2 * phi, f"true {HOSTILE}")
    axes = plots.plot_characteristics(comparison, truth)
    (line,) = [line for line in axes.get_lines() if line.get_label().startswith("true")]
    assert np.asarray(line.get_ydata()) == pytest.approx(0.3 + 1.2 * np.asarray(line.get_xdata()))
    assert np.asarray(line.get_xdata()).max() <= comparison.rows.phi.max()


def test_axes_that_are_given_are_drawn_on() -> None:
    figure = plots.new_figure()
    axes = figure.add_subplot()
    assert plots.plot_loops(made_series(), ax=axes) is axes
    assert isinstance(plots.plot_characteristics(made_comparison()), Axes)


def test_held_out_cycles_are_shaded_and_segments_are_not_joined() -> None:
    comparison = made_comparison()
    rows = comparison.rows
    upper = plots.plot_reconstruction(comparison).axes[0]
    measured = next(line for line in upper.get_lines() if line.get_label() == "measured")
    gaps = np.isnan(np.asarray(measured.get_ydata()))
    assert gaps.sum() == rows.n_segments
    assert len(upper.patches) == len(runs_of(rows.labels[~rows.train], int(np.sum(~rows.train))))


def test_records_whose_clocks_overlap_are_drawn_one_after_the_other() -> None:
    comparison = made_comparison(made_series(0, "a"), made_series(1, "b"))
    axes = plots.plot_residuals(comparison).axes[-1]
    assert "in a row" in axes.get_xlabel()
    assert axes.get_xlim()[1] == pytest.approx(comparison.rows.phi.size * 1e-3, rel=0.01)
    assert share_of_ink(plots.plot_reconstruction(comparison, 1)) > 0.02


def test_one_long_segment_is_drawn_too() -> None:
    comparison = made_comparison(made_series(n_segments=1))
    assert share_of_ink(plots.plot_reconstruction(comparison)) > 0.02
    assert share_of_ink(plots.plot_residual_structure(comparison)) > 0.02


def test_a_missing_work_coefficient_is_refused() -> None:
    with pytest.raises(InputError, match="a column psi"):
        plots.plot_loops(made_series(), "psi")


def test_any_text_can_be_drawn() -> None:
    figure = plots.new_figure(4.0, 3.0)
    figure.add_subplot().set_title(printable(HOSTILE))
    assert (
        share_of_ink(figure) > 0.01
    )  # a glyph that is missing would warn, and warnings are errors
    assert len(printable("x" * 500)) == 60


def test_the_same_picture_has_the_same_bytes() -> None:
    first, second = (
        plots.figure_to_data_uri(plots.plot_loops(made_series()).get_figure()) for _ in range(2)
    )
    assert first == second


def test_areas_keep_their_exact_shade() -> None:
    figure = plots.new_figure(3.0, 2.0)
    figure.set_layout_engine("none")
    axes = figure.add_axes((0, 0, 1, 1))
    axes.axis("off")
    axes.scatter(*np.random.default_rng(0).random((2, 300)), c=np.linspace(0, 1, 300), cmap="hsv")
    axes.axhspan(0.0, 0.5, color="#0072b2", zorder=9)
    shown = pixels(figure)
    assert tuple(shown[-40, 100]) == (0, 0x72, 0xB2)
    assert tuple(shown[0, 0]) == (255, 255, 255)


def test_a_small_mark_keeps_its_colour() -> None:
    figure = plots.new_figure(3.0, 2.0)
    axes = figure.add_subplot()
    axes.scatter(
        *np.random.default_rng(0).random((2, 4000)), c=np.linspace(0, 1, 4000), cmap="gray"
    )
    axes.plot(0.5, 0.5, marker="s", markersize=3, color="#d55e00", zorder=9)
    off = np.abs(pixels(figure).astype(int) - (0xD5, 0x5E, 0x00)).max(axis=2)
    assert off.min() == 0


def test_limits_leave_out_a_stray_row_and_survive_nothing() -> None:
    signal = np.concatenate([np.linspace(0.0, 1.0, 10_000), [1e6, np.nan]])
    low, high = robust_limits(signal)
    assert -0.2 < low < 0.0
    assert 1.0 < high < 1.2
    assert robust_limits(np.full(5, np.nan)) == (0.0, 1.0)
    assert robust_limits(np.full(5, 3.0))[0] < 3.0
    empty, _ = broken(np.zeros(0), np.zeros(0), [])
    assert empty.size == 0


def test_drawing_leaves_no_global_state_and_no_window() -> None:
    code = """
import sys
from comparisons.show import plots
assert "matplotlib" not in sys.modules
figure = plots.new_figure()
figure.add_subplot()
plots.figure_to_data_uri(figure)
assert "matplotlib.pyplot" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_legend_of_the_characteristics_fits_above_them() -> None:
    phi = np.linspace(-1.0, 2.0, 400)
    axes = plots.plot_characteristics(made_comparison(), Truth(0.018, phi, phi, "truth " * 4))
    axes.figure.draw_without_rendering()
    legend = axes.get_legend()
    assert legend is not None
    width = axes.figure.bbox.width
    assert legend.get_window_extent().x1 <= width
    assert axes.get_window_extent().width > 0.8 * width  # nothing pressed the picture together
