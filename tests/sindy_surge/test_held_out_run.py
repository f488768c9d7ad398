from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pysindy.feature_library import PolynomialLibrary
from scipy.signal import lfilter

from sindy_surge import InputError
from sindy_surge.candidate_terms import CandidateTerms
from sindy_surge.held_out_run import HeldOutRun, held_out_rms, paired_difference
from sindy_surge.lag_fit import fit_structure
from sindy_surge.lag_problem import LagProblem
from sindy_surge.segments import Segments, cycle_blocks
from sindy_surge.whitening import NoiseLevels

from .conftest import CURVES, PERIOD_S, TAU_S, lag

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


def _run(problem: LagProblem, support: tuple[int, ...] = QUADRATIC, folds: int = 5) -> HeldOutRun:
    return held_out_rms(problem, fit_structure(problem, support, TAU_S), _blocks(problem), folds)


def _blocks(problem: LagProblem) -> list[slice]:
    return cycle_blocks(problem.inputs[:, 0], problem.segments, SHORTEST)


def _inside(problem: LagProblem, support: tuple[int, ...] = QUADRATIC) -> HeldOutRun:
    """Return the error within the sample: with sensitivities so large, no parameter moves."""
    fit = fit_structure(problem, support, TAU_S)
    still = replace(fit, sensitivity=1e9 * fit.sensitivity)
    return held_out_rms(problem, still, _blocks(problem))


@pytest.mark.parametrize(("curve", "support"), [("quadratic", QUADRATIC), ("cubic", (0, 1, 2, 3))])
def test_true_structure_leaves_the_noise(
    surge: Callable[..., Any], curve: str, support: tuple[int, ...]
) -> None:
    ratios = []
    for seed in range(5):
        for noise in (0.01, 0.05):
            problem, expected = _noisy(surge(curve, noise, seed), noise, curve)
            ratios.append(_run(problem, support).rms / expected)
    assert np.max(np.abs(np.subtract(ratios, 1))) < 0.05
    assert abs(np.mean(ratios) - 1) < 0.015


def test_noise_of_psi_p_alone_comes_out_unbiased(surge: Callable[..., Any]) -> None:
    # One degree of freedom a cycle goes into the initial state; without allowing for it the
    # blocks of 36 rows used here would give 1.4 % less.
    ratios = []
    for seed in range(8):
        record = surge("quadratic", 0.0, seed)
        level = 0.02 * record.clean_psi_p.std()
        white = np.random.default_rng(seed).standard_normal(record.phi.size)
        problem = _problem(record.phi, record.psi_p + level * white, 1e-6, level)
        blocks = [slice(k, min(k + 36, record.phi.size)) for k in range(0, record.phi.size, 36)]
        fit = fit_structure(problem, QUADRATIC, TAU_S)
        ratios.append(held_out_rms(problem, fit, blocks).rms / level)
    assert abs(np.mean(ratios) - 1) < 4 * 1 / np.sqrt(2 * 8 * 4000)


@pytest.mark.parametrize("missing", QUADRATIC)
def test_a_missing_term_shows(surge: Callable[..., Any], missing: int) -> None:
    problem, expected = _noisy(surge("quadratic", 0.02, 1), 0.02)
    whole = _run(problem)
    lacking = _run(problem, tuple(i for i in QUADRATIC if i != missing))
    assert lacking.rms > 2 * expected
    mean, stderr = paired_difference(lacking, whole)
    assert mean > 5 * stderr > 0
    assert mean == pytest.approx(lacking.rms**2 - whole.rms**2)
    assert paired_difference(whole, lacking) == pytest.approx((-mean, stderr))


def test_terms_too_many_do_not_help(surge: Callable[..., Any]) -> None:
    scores = []
    for seed in range(8):
        problem, _ = _noisy(surge("quadratic", 0.02, seed), 0.02)
        mean, stderr = paired_difference(_run(problem), _run(problem, (0, 1, 2, 3, 4)))
        scores.append(mean / stderr)
    assert max(scores) < 3
    assert np.mean(scores) < 3 / np.sqrt(8)


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
    np.testing.assert_allclose(found.per_block, again, rtol=0.02)
    weighted = float(again @ found.freedom) / found.freedom.sum()
    assert found.rms == pytest.approx(np.sqrt(weighted), rel=1e-3)
    # One step makes nine tenths of the way from the error within the sample.
    far = np.linalg.norm(_inside(problem).per_block - again)
    assert np.linalg.norm(found.per_block - again) < 0.25 * far


def test_the_lag_moves_with_the_fold(surge: Callable[..., Any]) -> None:
    # The second half is slower than the first: each is predicted with the lag of the other.
    record = surge("quadratic", 0.0, 2)
    half = record.phi.size // 2
    slow = lag(CURVES["quadratic"](record.clean_phi[half:]), PERIOD_S * TAU_S / 0.02)
    psi_p = np.concatenate((record.clean_psi_p[:half], slow))
    level = 0.01 * psi_p.std()
    psi_p += level * np.random.default_rng(0).standard_normal(psi_p.size)
    labels = np.repeat([0, 1], half)
    problem = _problem(record.phi, psi_p, 1e-6, level, labels)
    halves = [slice(0, half), slice(half, 2 * half)]
    found = held_out_rms(problem, fit_structure(problem, QUADRATIC, TAU_S), halves).per_block
    for own, other in ((0, 1), (1, 0)):
        alone = _problem(record.phi[halves[other]], psi_p[halves[other]], 1e-6, level)
        fit = fit_structure(alone, QUADRATIC, TAU_S)
        forcing = np.polynomial.polynomial.polyval(record.phi[halves[own]], fit.coefficients)
        step = PERIOD_S * TAU_S / fit.time_constant_s
        error = psi_p[halves[own]] - lag(forcing, step, start=float(psi_p[halves[own]][0]))
        # Past the start, where the state is known but for noise.
        assert found[own] == pytest.approx(np.mean(error[100:] ** 2), rel=0.15)
        assert found[own] > 2 * level**2


def test_leaving_out_costs_what_the_parameters_cost(surge: Callable[..., Any]) -> None:
    # In the sample the error is less by p/N and out of it more by p/N of the variance.
    gains = []
    for seed in range(12):
        record = surge("cubic", 0.0, seed, 900)
        level = 0.05 * record.clean_psi_p.std()
        white = np.random.default_rng(seed).standard_normal(900)
        problem = _problem(record.phi, record.psi_p + level * white, 1e-6, level)
        support = (0, 1, 2, 3)
        honest, inside = _run(problem, support, folds=100), _inside(problem, support)
        gains.append((honest.rms**2 - inside.rms**2) / level**2)
    assert 0.5 < np.mean(gains) / (2 * 5 / 900) < 2


def test_segments_may_be_renamed_and_reordered(surge: Callable[..., Any]) -> None:
    record = surge("quadratic", 0.02, 5)
    at_phi, at_psi_p = 0.02 * record.phi.std(), 0.02 * record.psi_p.std()
    labels = np.repeat([0, 1, 2], [1000, 1700, 1300])
    plain = _problem(record.phi, record.psi_p, at_phi, at_psi_p, labels)
    renamed = _problem(record.phi, record.psi_p, at_phi, at_psi_p, 7 - 3 * labels)
    order = np.argsort(-labels, kind="stable")
    turned = _problem(record.phi[order], record.psi_p[order], at_phi, at_psi_p, labels[order])
    first = _run(plain, folds=100)
    again = _run(renamed, folds=100)
    np.testing.assert_array_equal(again.per_block, first.per_block)
    other = _run(turned, folds=100)
    assert other.rms == pytest.approx(first.rms, rel=1e-6)
    np.testing.assert_allclose(np.sort(other.per_block), np.sort(first.per_block), rtol=1e-5)


def test_in_stall_segments(surge: Callable[..., Any]) -> None:
    record = surge("quadratic", 0.02, 6)
    inside = record.clean_phi < 0.27
    labels = np.cumsum(np.diff(inside, prepend=False))[inside]
    level = 0.02 * record.clean_psi_p.std()
    problem = _problem(
        record.phi[inside], record.psi_p[inside], 0.02 * record.clean_phi.std(), level, labels
    )
    found = _run(problem)
    assert found.per_block.size == problem.segments.starts.size
    # In stall the curve is steepest, so φ brings more noise than on the whole record.
    assert level < found.rms < 1.6 * level


def test_coloured_noise_drops_the_first_rows_of_each_segment() -> None:
    n, level = 3000, 0.004
    rng = np.random.default_rng(2)
    phi = 0.2 + 0.25 * np.sin(2 * np.pi * 6 * PERIOD_S * np.arange(n))
    fine = 0.2 + 0.25 * np.sin(2 * np.pi * 6 * PERIOD_S / 8 * np.arange(8 * n))
    clean = lag(CURVES["quadratic"](fine), PERIOD_S / 8)[::8]
    coloured = lfilter([1.0], [1.0, -0.8], level * rng.standard_normal(n))
    labels = np.repeat([0, 1, 2], [1400, 3, 1597])
    problem = _problem(phi, clean + coloured, 1e-6, level, labels, (0.8,))
    fit = fit_structure(problem, QUADRATIC, TAU_S)
    assert fit.residual.size == n - 2 * 3
    blocks = _blocks(problem)
    found = held_out_rms(problem, fit, blocks)
    assert found.rms == pytest.approx(coloured.std(), rel=0.12)
    np.testing.assert_array_equal(fit.rows, np.flatnonzero(problem.segments.offsets() > 1))


def test_a_lag_moved_beyond_its_bounds_is_kept_within(surge: Callable[..., Any]) -> None:
    problem, _ = _noisy(surge("quadratic", 0.02, 1), 0.02)
    fit = fit_structure(problem, QUADRATIC, TAU_S)
    blocks = _blocks(problem)
    # Without some folds the step goes below zero from here, and a run with τ < 0 explodes.
    short = replace(fit, point=replace(fit.point, time_constant_s=1e-6))
    found = held_out_rms(problem, short, blocks)
    static = np.polynomial.polynomial.polyval(problem.inputs[:, 0], fit.coefficients)
    assert found.rms == pytest.approx(np.sqrt(np.mean((problem.output - static) ** 2)), rel=0.05)


def test_nothing_to_leave_out(surge: Callable[..., Any]) -> None:
    problem, _ = _noisy(surge("quadratic", 0.02, 1), 0.02)
    fit = fit_structure(problem, QUADRATIC, TAU_S)
    alone = held_out_rms(problem, fit, [slice(0, problem.output.size)])
    assert np.isnan(alone.rms)
    with pytest.raises(InputError, match="folds"):
        held_out_rms(problem, fit, _blocks(problem), folds=1)


def test_blocks_of_one_row_count_for_nothing(surge: Callable[..., Any]) -> None:
    problem, expected = _noisy(surge("quadratic", 0.02, 1), 0.02)
    fit = fit_structure(problem, QUADRATIC, TAU_S)
    first, *others = _blocks(problem)
    single = [slice(first.start, first.stop - 1), slice(first.stop - 1, first.stop), *others]
    found = held_out_rms(problem, fit, single)
    assert found.per_block[1] == 0.0
    assert found.freedom[1] == 0
    assert found.rms == pytest.approx(expected, rel=0.05)


def test_only_like_blocks_are_compared(surge: Callable[..., Any]) -> None:
    problem, _ = _noisy(surge("quadratic", 0.02, 1), 0.02)
    fit = fit_structure(problem, QUADRATIC, TAU_S)
    blocks = _blocks(problem)
    with pytest.raises(InputError, match="blocks"):
        paired_difference(
            held_out_rms(problem, fit, blocks), held_out_rms(problem, fit, blocks[:-1])
        )


def test_stderr_of_the_paired_difference_is_that_of_its_mean() -> None:
    rng = np.random.default_rng(0)
    means, errors = [], []
    freedom = rng.integers(50, 200, 40)
    for _ in range(400):
        first, second = rng.chisquare(4, (2, 40))
        a = HeldOutRun(float(np.sqrt(freedom @ first / freedom.sum())), first, freedom)
        b = HeldOutRun(float(np.sqrt(freedom @ second / freedom.sum())), second, freedom)
        mean, stderr = paired_difference(a, b)
        means.append(mean)
        errors.append(stderr)
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(np.std(means), rel=0.1)
