"""When a gain is evidence: on white noise by simulation, and on gains made for each rule."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from comparisons.missing_effect.evidence import Evidence, Rows, are_alike, evidence_of, paired_z
from comparisons.missing_effect.lag_data import LATER, OTHER, TRAIN

Array = np.ndarray
N_TRAIN, N_LATER, N_OTHER = 900, 600, 750
BLOCK = 50


def parts(*, other: bool = True) -> Array:
    sizes = (N_TRAIN, N_LATER, N_OTHER) if other else (N_TRAIN, N_LATER, 0)
    return np.repeat(np.array([TRAIN, LATER, OTHER], dtype=np.int8), sizes)


def rows_of(part: Array, valid: Array | None = None) -> Rows:
    return Rows.of(part, np.ones(part.size, dtype=bool) if valid is None else valid, BLOCK)


ROWS = rows_of(parts())


def fitted(errors: Array, columns: Array, rows: Rows) -> Array:
    """What is left on all rows of a linear candidate that was fitted to the fitted rows alone."""
    train = rows.of_part(TRAIN)
    coefficients = np.linalg.lstsq(columns[train], errors[train], rcond=None)[0]
    return errors - columns @ coefficients


def block_gains(sums: Array) -> Array:
    """Gains that add up to a given sum in every held-out block."""
    gain = np.zeros(ROWS.part.size)
    held = ROWS.of_part(LATER, OTHER)
    first = int(ROWS.block[held].min())
    count = np.bincount(ROWS.block[held] - first)
    assert count.size == sums.size
    gain[held] = (sums / count)[ROWS.block[held] - first]
    return gain


def weighed(held: Array, train: float = 100.0, **options: float) -> Evidence:
    """Evidence of a candidate with given sums in the held-out blocks."""
    gain = block_gains(held)
    gain[ROWS.of_part(TRAIN)] = train / N_TRAIN
    before = np.full(gain.size, 30.0)
    after = np.sqrt(before**2 - 2.0 * gain)
    return evidence_of(ROWS, before, after, added=1, searched=15.0, **options)  # type: ignore[arg-type]


N_BLOCKS = N_LATER // BLOCK + N_OTHER // BLOCK


def test_blocks_are_whole_and_lie_in_one_part() -> None:
    rng = np.random.default_rng(0)
    valid = rng.random(parts().size) > 0.2
    rows = rows_of(parts(), valid)
    assert np.all((rows.block >= 0) == valid)
    for block in range(rows.block.max() + 1):
        own = rows.block == block
        assert np.unique(rows.part[own]).size == 1
        assert 0.5 * BLOCK < np.count_nonzero(own) < 2.0 * BLOCK
    assert rows.n_fitted == np.count_nonzero(valid[:N_TRAIN])
    assert rows.has_other
    assert not rows_of(parts(other=False)).has_other
    # A part too short for two blocks still has two: nothing is judged by a single number.
    short = Rows.of(np.array([LATER] * 30, dtype=np.int8), np.ones(30, dtype=bool), BLOCK)
    assert short.block.max() == 1


@pytest.mark.parametrize("added", [1, 3])
def test_the_chance_of_a_gain_is_uniform_on_white_noise(added: int) -> None:
    """p without a search is the chance that noise alone wins so much: each decile once in ten."""
    rng = np.random.default_rng(added)
    values = []
    for _ in range(600):
        columns = rng.standard_normal((ROWS.part.size, added))
        errors = rng.standard_normal(ROWS.part.size)
        after = fitted(errors, columns, ROWS)
        values.append(evidence_of(ROWS, errors, after, added=added, searched=1.0).p_value)
    counts = np.histogram(values, bins=10, range=(0.0, 1.0))[0]
    # Binomial(600, 0.1): 60 with a standard deviation of 7.3.
    assert np.all(np.abs(counts - 60) < 4 * 7.4)


def test_noise_is_accepted_by_no_rule() -> None:
    """The best of forty regressors of noise, three hundred times over."""
    rng = np.random.default_rng(7)
    held, accepted = [], 0
    for _ in range(300):
        errors = rng.standard_normal(ROWS.part.size)
        columns = rng.standard_normal((ROWS.part.size, 40))
        train = ROWS.of_part(TRAIN)
        best = int(np.argmax(np.abs(columns[train].T @ errors[train])))
        after = fitted(errors, columns[:, [best]], ROWS)
        evidence = evidence_of(ROWS, errors, after, added=1, searched=40.0)
        accepted += evidence.accepted
        held.append(evidence.later + evidence.other)
    assert accepted == 0
    # What was fitted to noise loses where it was not fitted.
    assert np.mean(held) < -1.0


def test_a_sixteenth_of_the_variance_is_accepted_and_its_search_paid_for() -> None:
    rng = np.random.default_rng(3)
    column = rng.standard_normal((ROWS.part.size, 1))
    errors = rng.standard_normal(ROWS.part.size) + 0.25 * column[:, 0]
    after = fitted(errors, column, ROWS)
    one = evidence_of(ROWS, errors, after, added=1, searched=1.0)
    many = evidence_of(ROWS, errors, after, added=1, searched=7500.0)
    assert one.accepted
    assert many.p_value == pytest.approx(7500.0 * one.p_value)
    assert evidence_of(ROWS, errors, after, added=1, searched=1e9 / one.p_value).p_value == 1.0
    # Half log n a number, and what was won where nothing was fitted.
    expected = one.train - 0.5 * np.log(N_TRAIN) + one.later + one.other
    assert one.score == pytest.approx(expected)
    two = evidence_of(ROWS, errors, after, added=2, searched=1.0)
    assert one.score - two.score == pytest.approx(0.5 * np.log(N_TRAIN))
    assert two.p_value > one.p_value


def test_every_witness_is_needed() -> None:
    good = weighed(np.full(N_BLOCKS, 2.0) + np.tile([0.5, -0.5, 0.0], N_BLOCKS // 3))
    assert good.accepted
    for change in (
        {"later": -0.1},
        {"later": 0.0},
        {"at_end": True},
        {"other": -0.1},
        {"other": 0.0},
        {"p_value": 1e-3},
        {"z": 1.0},
    ):
        assert not replace(good, **{"many_blocks": False, **change}).accepted
    # With one record there is no other to ask.
    assert replace(good, other=float("nan")).accepted


def test_phases_fitted_again_are_paid_for() -> None:
    free = weighed(np.full(N_BLOCKS, 2.0))
    paid = weighed(np.full(N_BLOCKS, 2.0), episodes=(7.0, 9.0))
    assert free.later - paid.later == pytest.approx(7.0)
    assert free.other - paid.other == pytest.approx(9.0)
    assert free.score - paid.score == pytest.approx(16.0)


def test_the_paired_z_of_gains_without_a_mean_is_a_t() -> None:
    rng = np.random.default_rng(11)
    z = [paired_z(rng.standard_normal(ROWS.part.size), ROWS, LATER, OTHER) for _ in range(1000)]
    assert abs(np.mean(z)) < 0.13
    assert 0.9 < np.std(z) < 1.15
    # Correlated gains tell less than their number: the blocks see it.
    gain, level = rng.standard_normal(ROWS.part.size), rng.standard_normal(ROWS.part.size // BLOCK)
    fast, slow = (paired_z(0.3 + g, ROWS, LATER, OTHER) for g in (gain, np.repeat(level, BLOCK)))
    assert slow < 0.5 * fast


def test_a_few_loud_blocks_speak_where_the_mean_cannot() -> None:
    """φ reaches reversed flow in four cycles of 27: thousands of log-units, and z is small."""
    loud = np.zeros(N_BLOCKS)
    loud[[2, 9, 15, 22]] = [4.0, 1.0, 2.0, 0.5]
    loud *= 60.0
    evidence = weighed(loud)
    assert evidence.z < 2.5
    assert evidence.many_blocks
    assert evidence.accepted


@pytest.mark.parametrize(
    "sums",
    [[60.0, 50.0], [6.0, 6.0, 6.0], [60.0, 50.0, 40.0, -20.0, -30.0]],
    ids=["two blocks only", "eighteen log-units", "two against three"],
)
def test_chance_blocks_do_not(sums: list[float]) -> None:
    held = np.full(N_BLOCKS, -0.01)
    held[2 : 2 + 4 * len(sums) : 4] = sums
    evidence = weighed(held)
    assert evidence.later + evidence.other > 0.0
    assert not evidence.many_blocks


def test_where_model_error_rules_the_share_decides() -> None:
    ruled = Evidence(50.0, 5.0, 5.0, 0.5, 0.9, 10.0, share=0.12, least_share=0.1)
    assert ruled.accepted
    assert not replace(ruled, share=0.08).accepted
    assert not replace(ruled, later=-1.0).accepted


def alias_case(
    noise: Array, base: Array, candidates: list[Array], scores: list[float]
) -> list[bool]:
    best = int(np.argmax(scores))
    both = [(c + noise, candidates[best] + noise) for c in candidates]
    pairs = [(score, scores[best]) for score in scores]
    return [are_alike(ROWS, base + noise, *of) for of in zip(both, pairs, strict=True)]


def test_twins_are_aliases_and_strangers_are_not() -> None:
    rng = np.random.default_rng(21)
    noise = rng.standard_normal(ROWS.part.size)
    effect = 0.5 * rng.standard_normal(ROWS.part.size)
    nothing = np.zeros(ROWS.part.size)
    twin = 0.01 * rng.standard_normal(ROWS.part.size)
    # A stranger takes half of the effect away and brings as much of its own.
    stranger = 0.5 * effect + 0.25 * rng.standard_normal(ROWS.part.size)
    found = alias_case(noise, effect, [nothing, twin, stranger], [300.0, 280.0, 120.0])
    assert found == [True, True, False]


def test_names_within_a_few_log_units_are_aliases_whatever_they_correct() -> None:
    rng = np.random.default_rng(22)
    noise = rng.standard_normal(ROWS.part.size)
    effect = 0.5 * rng.standard_normal(ROWS.part.size)
    other = rng.permutation(effect)
    assert alias_case(noise, effect, [np.zeros_like(effect), effect - other], [300.0, 295.0]) == [
        True,
        True,
    ]
    # The rounding of the simulation grows with the gain.
    assert alias_case(noise, effect, [np.zeros_like(effect), other], [50_000.0, 49_900.0])[1]


def test_one_that_is_worse_block_by_block_is_none_even_if_it_corrects_alike() -> None:
    rng = np.random.default_rng(23)
    noise = rng.standard_normal(ROWS.part.size)
    effect = 2.0 * rng.standard_normal(ROWS.part.size)
    found = alias_case(noise, effect, [np.zeros_like(effect), 0.3 * effect], [900.0, 700.0])
    assert found == [True, False]
