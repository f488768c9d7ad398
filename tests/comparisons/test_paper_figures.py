"""The counterparts of the paper's figures show the data they claim to show."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.axes import Axes
from numpy.testing import assert_allclose
from paper_runs import paper_runs

from comparisons.page.blocks import Picture
from comparisons.paper.figures import draw_figures
from comparisons.paper.instabilities import Instabilities, in_stall_psi, in_stall_psi_p
from surge_core.types import FloatArray


@pytest.fixture(scope="module")
def runs() -> Instabilities:
    """All runs with the rig as it is."""
    return paper_runs()


@pytest.fixture(scope="module")
def figures(runs: Instabilities) -> tuple[Picture, ...]:
    """Draw the pictures."""
    return draw_figures(runs)


def line(ax: Axes, label: str) -> tuple[FloatArray, FloatArray]:
    """Return the points of the line whose label begins so."""
    (found,) = [one for one in ax.get_lines() if str(one.get_label()).startswith(label)]
    x, y = (np.asarray(values, float) for values in found.get_data())
    return x, y


def test_the_characteristic_lies_on_the_truth_and_below_the_steady_points(
    figures: tuple[Picture, ...], runs: Instabilities
) -> None:
    ax = figures[0].figure.axes[0]
    phi, psi_p = line(ax, "estimate")
    known = np.isfinite(phi)
    assert (phi[known].min(), phi[known].max()) == pytest.approx((-0.025, 0.175), abs=2e-3)
    assert_allclose(psi_p[known], in_stall_psi_p(runs["985"], phi[known]), atol=0.15)
    steady_phi, steady = (np.asarray(v, float) for v in ax.containers[0][0].get_data())
    assert_allclose(steady, in_stall_psi_p(runs["75-stall"], steady_phi), atol=0.15)
    assert np.all(steady > runs["985"].fits["psi_p"].quasi_steady(steady_phi))


def test_curves_of_the_truth_are_those_of_the_rig(runs: Instabilities) -> None:
    steady = runs["75-stall"]
    truth = steady.rig.truth
    rows = (truth.time_s > 1.0) & (truth["stall_blend"] > 1.0 - 1e-9)
    assert np.count_nonzero(rows) > 1000
    assert_allclose(truth["psi_p_qs"][rows], in_stall_psi_p(steady, truth["phi"][rows]), rtol=1e-6)
    assert_allclose(truth["psi_qs"][rows], in_stall_psi(steady, truth["phi"][rows]), rtol=1e-6)
