from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pysindy.feature_library import PolynomialLibrary
from scipy.signal import lfilter

from sindy_surge.candidate_terms import CandidateTerms
from sindy_surge.lag_fit import fit_structure
from sindy_surge.lag_problem import LagProblem
from sindy_surge.noise import NoiseLevels
from sindy_surge.segments import Segments, cycle_blocks
from sindy_surge.uncertainty import held_out_rms

from .conftest import CURVES, PERIOD_S, TAU_S

SHORTEST = 36
QUADRATIC = (0, 1, 2)


def _problem(
    phi: np.ndarray,
    psi_p: np.ndarray,
    noise_phi: float,
    noise_psi_p: float,
    labels: np.ndarray | None = None,
    colour: tuple[float, ...] = (),
) -> LagProblem:
    inputs = phi[:, None]
    terms = CandidateTerms(PolynomialLibrary(5), inputs, ["phi"])
    noise = NoiseLevels(noise_psi_p, np.array([noise_phi]), np.array(colour))
    segments = Segments.from_labels(labels, phi.size)
    return LagProblem(inputs, psi_p, segments, PERIOD_S, "first", terms, np.arange(6), noise)


def _noisy(record: Any, noise: float, curve: str = "quadratic") -> tuple[LagProblem, float]:
    """Return the problem and the noise of ψ' beside a free run from the measured φ."""
    at_phi, at_psi_p = noise * record.clean_phi.std(), noise * record.clean_psi_p.std()
    step = 1e-5
    rise = CURVES[curve](record.clean_phi + step) - CURVES[curve](record.clean_phi - step)
    pole = np.exp(-PERIOD_S / TAU_S)
    carried = at_phi**2 * np.mean((rise / (2 * step)) ** 2) * (1 - pole) / (1 + pole)
    problem = _problem(record.phi, record.psi_p, at_phi, at_psi_p)
    return problem, float(np.sqrt(at_psi_p**2 + carried))


def _run(
    problem: LagProblem,
    support: tuple[int, ...] = QUADRATIC,
) -> float:
    return held_out_rms(problem, fit_structure(problem, support, TAU_S), _blocks(problem))


def _blocks(problem: LagProblem) -> list[slice]:
    return cycle_blocks(problem.inputs[:, 0], problem.segments, SHORTEST)


@pytest.mark.parametrize(("curve", "support"), [("quadratic", QUADRATIC), ("cubic", (0, 1, 2, 3))])
def test_true_structure_leaves_the_noise(
    surge: Callable[..., Any], curve: str, support: tuple[int, ...]
) -> None:
    ratios = []
    for seed in range(3):
        for noise in (0.01, 0.05):
            problem, expected = _noisy(surge(curve, noise, seed), noise, curve)
            ratios.append(_run(problem, support) / expected)
    assert np.max(np.abs(np.subtract(ratios, 1))) < 0.05
    assert abs(np.mean(ratios) - 1) < 0.015


@pytest.mark.parametrize("missing", QUADRATIC)
def test_a_missing_term_shows(surge: Callable[..., Any], missing: int) -> None:
    problem, expected = _noisy(surge("quadratic", 0.02, 1), 0.02)
    assert _run(problem, tuple(i for i in QUADRATIC if i != missing)) > 2 * expected


def test_agrees_with_refits_without_the_fold(surge: Callable[..., Any]) -> None:
    problem, _ = _noisy(surge("quadratic", 0.02, 3), 0.02)
    blocks = _blocks(problem)
    found = _run(problem)
    again = np.empty(len(blocks))
    for fold in range(5):
        kept = np.ones(problem.output.size, dtype=bool)
        for block in blocks[fold::5]:
            kept[block] = False
        labels = np.cumsum(np.diff(kept, prepend=False))[kept]
        part = replace(
            problem,
            inputs=problem.inputs[kept],
            output=problem.output[kept],
            segments=Segments.from_labels(labels, labels.size),
        )
        fit = fit_structure(part, QUADRATIC, TAU_S)
        # By a design matrix and not by the package's own run: the lag of each term from zero
        # and the decay of the initial state.
        pole = np.exp(-PERIOD_S / fit.time_constant_s)
        ratio = (1 - pole) * fit.time_constant_s / PERIOD_S
        for number in range(fold, len(blocks), 5):
            phi = problem.inputs[blocks[number], 0]
            forcing = np.polynomial.polynomial.polyval(phi, fit.coefficients)
            drive = (1 - ratio) * forcing[1:] + (ratio - pole) * forcing[:-1]
            states = np.concatenate(([0.0], lfilter([1.0], [1.0, -pole], drive)))
            rest = problem.output[blocks[number]] - states
            decay = (pole ** np.arange(phi.size))[:, None]
            squares = np.linalg.lstsq(decay, rest)[1]
            again[number] = float(squares[0]) / (phi.size - 1)
    freedom = np.array([block.stop - block.start - 1 for block in blocks])
    assert found == pytest.approx(np.sqrt(again @ freedom / freedom.sum()), rel=1e-3)
