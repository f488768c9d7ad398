"""A channel that is late: found, fitted, in the interval of τ, and not seen where there is none."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from sindy_surge import SparseLagRegressor

from .conftest import CURVES, PERIOD_S, TAU_S, TERMS, lag, relaxation_wave

N = 4000


def _late(curve: str, noise: float, seed: int, samples: float) -> tuple[np.ndarray, np.ndarray]:
    """ψ' late by so many samples (φ, if negative); the fine grid has eight steps a sample."""
    rng = np.random.default_rng(seed)
    fine = relaxation_wave(8 * (N + 16), PERIOD_S / 8, rng)
    psi_p = lag(CURVES[curve](fine), PERIOD_S / 8)
    move = round(8 * samples)
    phi, psi_p = fine[64 : 64 + 8 * N : 8], psi_p[64 - move : 64 - move + 8 * N : 8]
    white = rng.standard_normal((2, N))
    return phi + noise * phi.std() * white[0], psi_p + noise * psi_p.std() * white[1]


@pytest.mark.parametrize(
    ("curve", "noise", "samples"),
    [("quadratic", 0.01, 1.0), ("hinge", 0.02, 2.0), ("reverse", 0.02, -1.0), ("cubic", 0.02, 0.5)],
)
def test_late_channel_is_found_with_its_structure(curve: str, noise: float, samples: float) -> None:
    phi, psi_p = _late(curve, noise, 1, samples)
    model = SparseLagRegressor(n_bootstrap=0).fit(phi[:, None], psi_p)
    assert set(model.terms_) == set(TERMS[curve])
    true = samples * PERIOD_S
    assert abs(model.dead_time_s_ - true) < 4 * model.dead_time_stderr_s_
    assert abs(model.time_constant_s_ - TAU_S) < 4 * model.time_constant_stderr_s_
    assert any("later than" in caution for caution in model.cautions_)


@pytest.mark.parametrize("curve", list(CURVES))
def test_no_delay_is_seen_where_there_is_none(surge: Callable[..., Any], curve: str) -> None:
    record = surge(curve, 0.05, 4)
    model = SparseLagRegressor(n_bootstrap=0).fit(record.phi[:, None], record.psi_p)
    assert model.dead_time_s_ == 0.0
    assert set(model.terms_) == set(TERMS[curve])


@pytest.mark.parametrize("samples", [3, 8])
def test_delay_is_kept_where_no_term_with_psi_p_competes(samples: int) -> None:
    # Colour that a delay leaves behind must not stand in for it; a long one lies beyond a hill.
    phi, psi_p = _late("quadratic", 0.02, 2, 0.0)
    phi, psi_p = phi[samples:], psi_p[:-samples]
    model = SparseLagRegressor(psi_terms=False, n_bootstrap=0).fit(phi[:, None], psi_p)
    assert set(model.terms_) == set(TERMS["quadratic"])
    assert abs(model.dead_time_s_ - samples * PERIOD_S) < 4 * model.dead_time_stderr_s_
    assert abs(model.time_constant_s_ - TAU_S) < 4 * model.time_constant_stderr_s_
