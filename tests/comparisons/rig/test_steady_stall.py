"""The rig's low-speed rotating stall."""

from __future__ import annotations

import numpy as np
import pytest
from rig_records import rig_run

from comparisons.rig import CASES

WINDOW = slice(1_000, 3_901)


def curve(name: str, phi: np.ndarray) -> np.ndarray:
    return np.polynomial.polynomial.polyval(phi, CASES[name].pressure_terms)


def test_the_machine_sits_in_stall_while_the_throttle_moves() -> None:
    run = rig_run("75-stall")
    onset = int(np.flatnonzero(run.truth["in_stall"])[0])
    assert np.all(run.truth["in_stall"][onset:] == 1.0)
    assert run.truth_parameters["recovery_times_s"] == []
    # Rotating stall, not surge: no reversed flow, and both ways of the sweep in the window.
    phi = run.truth["phi"][WINDOW]
    assert run.truth["phi"].min() > 0.0
    assert phi.min() < 0.03
    assert phi.max() > 0.14
    assert np.any(np.diff(phi) < 0.0)
    assert np.any(np.diff(phi) > 0.0)
    assert run.truth["cell_amplitude"][WINDOW].min() > 0.99
    assert 0.73 < run.truth["Nc_frac"][WINDOW].min() <= run.truth["Nc_frac"].max() <= 0.7501


def test_it_is_steady() -> None:
    truth = rig_run("75-stall").truth
    off = truth["psi_p"][WINDOW] - truth["psi_p_qs"][WINDOW]
    assert np.max(np.abs(off)) < 0.02
    assert truth["psi_p_qs"][WINDOW] == pytest.approx(curve("75-stall", truth["phi"][WINDOW]))
    # The same curve on the way out and on the way back, but for twice that.
    slope = np.gradient(truth["phi"])[WINDOW]
    phi, value = truth["phi"][WINDOW], truth["psi_p"][WINDOW]
    back, out = (np.argsort(phi[way]) for way in (slope < 0.0, slope > 0.0))
    grid = np.linspace(0.04, 0.13, 20)
    down = np.interp(grid, phi[slope < 0.0][back], value[slope < 0.0][back])
    up = np.interp(grid, phi[slope > 0.0][out], value[slope > 0.0][out])
    assert down == pytest.approx(up, abs=0.04)
