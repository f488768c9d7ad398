"""Single wrong readings: found where they were made, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest

from classic_ml.faults.search import spike_rows
from classic_ml.records import Record
from comparisons.rig import simulate


@pytest.fixture(scope="module")
def rig() -> Record:
    """Codes of a surging machine with stall cells, of which none is wrong."""
    return simulate("985", seed=11, duration_s=2.5).raw


def of_plane(record: Record, plane: int, facing: str) -> dict[str, np.ndarray]:
    names = [n for n in record.channels if n.startswith(f"P{plane}") and facing in n]
    return {name: record[name].copy() for name in names}


def found_in(channels: dict[str, np.ndarray], width: float = 4095.0) -> dict[str, np.ndarray]:
    return spike_rows(channels, dict.fromkeys(channels, width))


@pytest.mark.parametrize("facing", ["forward", "aft"])
@pytest.mark.parametrize("plane", [25, 31])
def test_a_surging_machine_has_no_spikes(rig: Record, plane: int, facing: str) -> None:
    assert found_in(of_plane(rig, plane, facing)) == {}


def test_a_flipped_bit_is_found_where_it_is(rig: Record) -> None:
    channels = of_plane(rig, 31, "aft")
    name = next(iter(channels))
    rows = np.sort(np.random.default_rng(2).choice(np.arange(900, 2300, 60), 12, replace=False))
    channels[name][rows] = (channels[name][rows].astype(int) ^ 1024).astype(float)
    found = found_in(channels)
    assert set(found) == {name}
    assert set(found[name]) == set(rows)


def test_single_wrong_codes_among_stall_cells_are_mostly_found(rig: Record) -> None:
    """At plane 25 the cells are as jagged as a spike of a sixth of the range is high."""
    plain = of_plane(rig, 25, "forward")
    hits = 0
    for row in np.random.default_rng(6).integers(900, 2400, 60).tolist():
        name = list(plain)[row % 4]
        codes = plain[name].copy()
        codes[row] += 700.0 if codes[row] < 2048.0 else -700.0
        hits += row in found_in({**plain, name: codes}).get(name, [])
    assert hits >= 42


def test_a_spike_that_all_see_is_none() -> None:
    values = np.random.default_rng(3).normal(0.5, 1e-3, (4, 400))
    values[:, 200] += 0.2
    channels = {f"P{k}": row for k, row in enumerate(values)}
    assert found_in(channels, 1.0) == {}
    values[1:, 200] -= 0.2
    found = found_in(channels, 1.0)
    assert {name: rows.tolist() for name, rows in found.items()} == {"P0": [200]}
