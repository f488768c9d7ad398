from __future__ import annotations

import numpy as np
import pytest

from comparisons.rig_distributed.euler import CELL, _machine
from comparisons.rig_distributed.machine import Machine
from comparisons.rig_distributed.plant import constants, lay_out

MACHINE = Machine(distortion=0.0, cell_share=0.2, valley=0.01)
FLOWS = MACHINE.valley + MACHINE.span * np.array([0.3, 0.8, 1.0, 1.5, 1.9])
ANGLES = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)


def cubic(phi: np.ndarray) -> np.ndarray:
    y = (phi - MACHINE.valley) / MACHINE.span - 1.0
    return MACHINE.level + MACHINE.rise * (1.0 + 1.5 * y - 0.5 * y**3)


@pytest.mark.parametrize("phi", FLOWS)
def test_in_equilibrium_no_part_of_the_pressure_is_in_phase_with_the_cell(phi: float) -> None:
    amplitude = MACHINE.cell_amplitude(np.array(phi))
    round_the_annulus = cubic(phi + amplitude * np.sin(ANGLES))
    assert np.mean(round_the_annulus * np.sin(ANGLES)) == pytest.approx(0.0, abs=1e-12)
    share = MACHINE.cell_share
    mean = share * np.mean(round_the_annulus) + (1.0 - share) * cubic(np.array(phi))
    assert MACHINE.steady_psi_p(np.array(phi)) == pytest.approx(mean, rel=1e-12)


@pytest.mark.parametrize("phi", FLOWS)
def test_the_amplitude_of_the_loop_comes_to_its_equilibrium(phi: float) -> None:
    c = constants(MACHINE, lay_out(MACHINE), 0.1, 400.0)
    own, rates, out = np.array([2.0, 3.0, 0.02, 1.0]), np.empty(4), np.empty(21)
    step_s = 0.02 / MACHINE.growth_per_s
    for _ in range(4000):
        _machine(c, 0.0, phi, own, 0.0, rates, out)
        own[CELL] += step_s * rates[CELL]
    assert own[CELL] == pytest.approx(float(MACHINE.cell_amplitude(np.array(phi))), rel=1e-3)
    # What the blading then tends to is the true in-stall characteristic.
    assert out[3] == pytest.approx(float(MACHINE.steady_psi_p(np.array(phi))), rel=1e-3)


def test_the_cell_grows_and_decays_at_the_rate_of_the_linear_mode() -> None:
    c = constants(MACHINE, lay_out(MACHINE), 0.1, 400.0)
    rates, out = np.empty(4), np.empty(21)
    small = np.array([2.0, 3.0, 1e-6, 1.0])
    for y, expected in ((0.0, 0.5), (1.0, 0.0), (1.5, -0.625)):
        _machine(c, 0.0, MACHINE.valley + (1.0 + y) * MACHINE.span, small, 0.0, rates, out)
        found = rates[CELL] / 1e-6 / MACHINE.growth_per_s
        assert found == pytest.approx(expected, abs=1e-6)
