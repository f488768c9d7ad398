"""The counterparts of the paper's figures show the data they claim to show."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.axes import Axes
from numpy.testing import assert_allclose
from paper_runs import paper_runs

from classic_ml.flow import LBM_KG
from comparisons.page.blocks import Picture
from comparisons.paper.figures import draw_figures
from comparisons.paper.instabilities import Instabilities
from comparisons.paper.truth import (
    in_stall_psi,
    in_stall_psi_p,
    phi_of_flow,
    pressure_ratio,
    stall_point,
    temperature_K,
    unstalled_psi_p,
)
from comparisons.rig import gas
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


def test_the_migration_lies_inside_the_rigs_own_speed_line(
    figures: tuple[Picture, ...],
) -> None:
    ax = figures[1].figure.axes[0]
    flow, ratio = line(ax, "rig, speed line")
    star = line(ax, "its stall point")
    assert_allclose([flow[0], ratio[0]], [star[0][0], star[1][0]], rtol=0.01)
    assert np.nanmin(line(ax, "unstalled")[0]) > 40.0
    assert np.nanmax(line(ax, "unstalled")[0]) < flow[-1]


def test_the_characteristic_lies_on_the_truth_and_below_the_steady_points(
    figures: tuple[Picture, ...], runs: Instabilities
) -> None:
    ax = figures[2].figure.axes[0]
    phi, psi_p = line(ax, "estimate")
    known = np.isfinite(phi)
    assert (phi[known].min(), phi[known].max()) == pytest.approx((-0.025, 0.175), abs=2e-3)
    assert_allclose(psi_p[known], in_stall_psi_p(runs["985"], phi[known]), atol=0.15)
    steady_phi, steady = (np.asarray(v, float) for v in ax.containers[0][0].get_data())
    assert_allclose(steady, in_stall_psi_p(runs["75-stall"], steady_phi), atol=0.15)
    assert np.all(steady > runs["985"].fits["psi_p"].quasi_steady(steady_phi))


def test_curves_of_the_truth_are_those_of_the_rig(runs: Instabilities) -> None:
    high, steady = runs["985"], runs["75-stall"]
    truth = steady.rig.truth
    rows = (truth.time_s > 1.0) & (truth["stall_blend"] > 1.0 - 1e-9)
    assert np.count_nonzero(rows) > 1000
    assert_allclose(truth["psi_p_qs"][rows], in_stall_psi_p(steady, truth["phi"][rows]), rtol=1e-6)
    assert_allclose(truth["psi_qs"][rows], in_stall_psi(steady, truth["phi"][rows]), rtol=1e-6)
    for run in (high, steady):
        begin = run.rig.truth
        speed = float(begin["Nc_frac"][0])
        found = unstalled_psi_p(run, begin["phi"][0], speed)
        assert found == pytest.approx(begin["psi_p_qs"][0], rel=1e-6)


def test_flow_and_pressure_ratio_follow_the_rigs_gas(runs: Instabilities) -> None:
    high = runs["985"]
    truth, velocity = high.rig.truth, high.rig.truth_parameters["rotor_velocity_m_s"]
    inlet_K = temperature_K(high, 0.75)
    assert inlet_K == pytest.approx(255.0 * (0.985 / 0.75) ** 2)
    for row in (0, 2000, 2600):
        flow = truth["Wc25_kg_s"][row] / LBM_KG
        phi = phi_of_flow(high, flow, float(truth["T25_K"][row]))
        assert phi == pytest.approx(truth["phi"][row], rel=1e-6, abs=1e-9)
    assert stall_point(high, 0.75) == pytest.approx((0.272, 4.2))
    expected = (1.0 + 4.2 * velocity**2 / (2.0 * gas.CP_J_KG_K * inlet_K)) ** 3.5
    assert float(pressure_ratio(high, 4.2, inlet_K)) == pytest.approx(expected, rel=1e-4)
