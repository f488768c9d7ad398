"""Spikes, splices and copied columns: found where they were made, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest
from classic_ml.faults.odd_readings import copied_columns, spike_rows, spikes, splice_rows, splices

from classic_ml.records import Record
from comparisons.rig import simulate

RANGE = (0.0, 4095.0)


@pytest.fixture(scope="module")
def rig() -> Record:
    """Codes of a surging machine with stall cells, of which none is wrong."""
    return simulate("985", seed=11, duration_s=2.5).raw


def of_plane(record: Record, plane: int, facing: str = "") -> dict[str, tuple[float, float]]:
    return {n: RANGE for n in record.channels if n.startswith(f"P{plane}") and facing in n}


@pytest.mark.parametrize("facing", ["forward", "aft"])
@pytest.mark.parametrize("plane", [25, 31])
def test_a_surging_machine_has_no_spikes(rig: Record, plane: int, facing: str) -> None:
    assert spike_rows(rig, of_plane(rig, plane, facing)) == {}


def test_a_surging_machine_does_not_jump(rig: Record) -> None:
    assert splice_rows(rig, of_plane(rig, 31)).size == 0


def changed(record: Record, name: str, values: np.ndarray) -> Record:
    arrays = {n: (c.values, c.unit) for n, c in record.channels.items()}
    arrays[name] = (values, "count")
    return Record.from_arrays(arrays, sample_rate_hz=record.sample_rate_hz)


def test_a_flipped_bit_is_found_where_it_is(rig: Record) -> None:
    ranges = of_plane(rig, 31, "aft")
    name = next(iter(ranges))
    rng = np.random.default_rng(2)
    rows = np.sort(rng.choice(np.arange(900, 2300, 60), 12, replace=False))
    codes = rig[name].copy()
    codes[rows] = (codes[rows].astype(int) ^ 1024).astype(float)
    found = spike_rows(changed(rig, name, codes), ranges)
    assert set(found) == {name}
    assert set(found[name]) == set(rows)


def test_single_wrong_codes_among_stall_cells_are_mostly_found(rig: Record) -> None:
    """At plane 25 the cells are as jagged as a spike of a sixth of the range is high."""
    ranges = of_plane(rig, 25, "forward")
    rng = np.random.default_rng(6)
    hits = 0
    for row in rng.integers(900, 2400, 60).tolist():
        name = list(ranges)[row % 4]
        codes = rig[name].copy()
        codes[row] += 700.0 if codes[row] < 2048.0 else -700.0
        hits += row in spike_rows(changed(rig, name, codes), ranges).get(name, [])
    assert hits >= 42


def test_a_spike_that_all_see_is_none() -> None:
    rng = np.random.default_rng(3)
    values = rng.normal(0.5, 1e-3, (4, 400))
    values[:, 200] += 0.2
    assert not spikes(values).any()
    values[1:, 200] -= 0.2
    assert np.argwhere(spikes(values)).tolist() == [[0, 200]]


def test_what_is_found_does_not_depend_on_the_blocks(
    rig: Record, monkeypatch: pytest.MonkeyPatch
) -> None:
    ranges = of_plane(rig, 25, "aft")
    name = next(iter(ranges))
    codes = rig[name].copy()
    codes[[640, 1279, 1280, 1900]] += 900.0
    spoiled = changed(rig, name, np.clip(codes, 0, 4095))
    cut = Record.from_arrays(
        {n: (np.delete(c.values, np.s_[1270:1310]), "count") for n, c in rig.channels.items()},
        sample_rate_hz=rig.sample_rate_hz,
    )
    whole = spike_rows(spoiled, ranges), splice_rows(cut, of_plane(cut, 31))
    monkeypatch.setattr("classic_ml.columns.workspace.BLOCK_ROWS", 640)
    pieces = spike_rows(spoiled, ranges), splice_rows(cut, of_plane(cut, 31))
    np.testing.assert_array_equal(whole[0][name], pieces[0][name])
    np.testing.assert_array_equal(whole[1], pieces[1])


def test_rows_cut_out_of_a_cycle_are_found(rig: Record) -> None:
    codes = np.array([rig[n] for n in of_plane(rig, 31)]) / 4095.0
    rng = np.random.default_rng(4)
    starts = rng.integers(900, 2300, 200)
    found = np.zeros(starts.size, dtype=bool)
    for i, start in enumerate(starts):
        cut = np.delete(codes[:, start - 60 : start + 85], np.s_[60:85], axis=1)
        found[i] = 60 in splices(cut)
    # Where the pressure turns, 25 rows less are no jump.
    assert 0.75 < found.mean() < 0.99


def test_columns_that_were_copied_are_named(rig: Record) -> None:
    names = list(of_plane(rig, 25))
    assert copied_columns(rig, names) == []
    again = changed(rig, names[3], rig[names[1]])
    assert copied_columns(again, names) == [(names[1], names[3])]
    still = changed(again, names[3], np.full(rig.n_samples, 7.0))
    assert copied_columns(changed(still, names[1], np.full(rig.n_samples, 7.0)), names) == []
