"""Pictures of records and comparisons: what is drawn where, and that the words are its numbers."""

from __future__ import annotations

import base64
import io
import re

import numpy as np
import pytest
from comparison_data import made_comparison, made_series
from PIL import Image
from raw_data import make_test

from classic_ml.reduction import Reduction, reduce_record
from classic_ml.series import CoefficientSeries
from comparisons.harness.reconstruction import reconstruct_record
from comparisons.page.blocks import Picture
from comparisons.page.style import broken, robust_limits
from comparisons.results import Truth
from comparisons.show import plots_curve, plots_record, plots_runs

RATE_HZ = 1000.0
HOSTILE = "p$25_{x}^2 \\frac \U0001f4a5 漢字 <b>"


@pytest.fixture(scope="module")
def reduction() -> Reduction:
    made = make_test(cells_lbm_s=8.0, noise_counts=1.5, lag_thermocouples=True)
    return reduce_record(*made.load())


def swinging(lag_s: float, slope: float = 2.0, surge_hz: float = 5.0) -> CoefficientSeries:
    """ψ' of a straight characteristic behind an exact lag, once its start is forgotten."""
    time_s = np.arange(4000) / RATE_HZ
    omega = 2.0 * np.pi * surge_hz
    phi = 0.1 + 0.08 * np.sin(omega * time_s)
    gain, delay = 1.0 / np.hypot(1.0, omega * lag_s), np.arctan(omega * lag_s)
    psi_p = 1.0 + slope * (0.1 + 0.08 * gain * np.sin(omega * time_s - delay))
    return CoefficientSeries(time_s, phi, psi_p, np.ones(4000, dtype=np.int64), source="s.csv")


def numbers(text: str) -> list[float]:
    return [float(found) for found in re.findall(r"(?<![\w.])[-+]?\d+(?:\.\d+)?", text)]


def found_in(pattern: str, text: str) -> re.Match[str]:
    found = re.search(pattern, text)
    assert found is not None, text
    return found


def test_every_picture_is_a_readable_image_with_labelled_axes(reduction: Reduction) -> None:
    comparison = made_comparison()
    runs = [reconstruct_record(r.model, made_series(5, HOSTILE)) for r in comparison.results]
    pictures = (
        plots_curve.characteristics(comparison),
        plots_runs.reconstruction(comparison),
        plots_runs.validation(runs),
        plots_runs.errors_in_time(comparison),
        plots_record.loops(comparison.records[0]),
        plots_record.operating_points(reduction),
        plots_record.surge_cycles(reduction),
    )
    for picture in pictures:
        assert isinstance(picture, Picture)
        head, data = picture.uri.split(",")
        assert head == "data:image/png;base64"
        Image.open(io.BytesIO(base64.b64decode(data))).verify()
        labels = [ax.get_xlabel() + ax.get_ylabel() for ax in picture.figure.axes]
        assert any("[" in label for label in labels)
        assert picture.alt
        assert picture.reading
    assert pictures[0].uri == pictures[0].uri


def test_the_truth_is_drawn_where_it_is_known_and_said() -> None:
    comparison = made_comparison()
    phi = np.linspace(-1.0, 2.0, 400)
    picture = plots_curve.characteristics(comparison, Truth(0.018, phi, 0.3 + 1.2 * phi, "truth"))
    lines = picture.figure.axes[0].get_lines()
    (line,) = [line for line in lines if line.get_label() == "truth"]
    assert np.asarray(line.get_ydata()) == pytest.approx(0.3 + 1.2 * np.asarray(line.get_xdata()))
    assert np.asarray(line.get_xdata()).max() <= comparison.rows.phi.max()
    low, high = (0.3 + 1.2 * end for end in comparison.valid_phi)
    assert picture.alt.rstrip(".").endswith(f"truth {low:#.3g} and {high:#.3g}")


def test_limits_leave_out_a_stray_row_and_survive_nothing() -> None:
    signal = np.concatenate([np.linspace(0.0, 1.0, 10_000), [1e6, np.nan]])
    low, high = robust_limits(signal)
    assert -0.2 < low < 0.0
    assert 1.0 < high < 1.2
    assert robust_limits(np.full(5, np.nan)) == (0.0, 1.0)
    assert broken(np.zeros(0), np.zeros(0), [])[0].size == 0


@pytest.mark.parametrize("surge_hz", [3.0, 5.0, 11.0])
def test_a_cycle_takes_as_long_as_it_was_made(surge_hz: float) -> None:
    words = plots_record.cycle_words(swinging(0.02, surge_hz=surge_hz).psi_p, RATE_HZ)
    period = float(found_in(r"A cycle takes ([\d.]+) ms", words).group(1))
    assert period == pytest.approx(1e3 / surge_hz, rel=0.01)
