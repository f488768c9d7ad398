"""Raw records with nothing wrong: simulated rigs, the made-up test, and one that others simulated.

What looks for faults must find none in them, and each that is made in them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import shared_data
from raw_data import make_test
from rig_records import rig_record

from classic_ml.io import TestDescription, read_raw
from classic_ml.records import Channel, Record
from comparisons.rig import CASES
from surge_core.types import FloatArray

INDEPENDENT = "independent"
# Case and seed; seed and noise in counts.
_RIGS = (*(f"{case}/1" for case in CASES), "985/2", "90/3", "blowdown/2")
_MADE = ("made/0/0", "made/1/1", "made/2/5")
CLEAN = (*_RIGS, *_MADE, INDEPENDENT)
# The cases with surge cycles, at all speeds.
SURGES = tuple(name for name in CLEAN if not name.startswith("75-stall"))


def clean_record(name: str) -> tuple[Record, TestDescription]:
    """Return a clean record of `CLEAN` with its description."""
    if name == INDEPENDENT and not (shared_data.INDEPENDENT / "raw.csv").is_file():
        pytest.skip("the shared data folder is not beside the repository (../shared/data)")
    return _loaded(name)


@cache
def _loaded(name: str) -> tuple[Record, TestDescription]:
    if name == INDEPENDENT:
        return read_raw(shared_data.INDEPENDENT / "raw.csv", shared_data.INDEPENDENT / "test.toml")
    if name.startswith("made/"):
        _, seed, noise = name.split("/")
        cells = 6.0 if float(noise) else 0.0
        made = make_test(seed=int(seed), seconds=3.0, noise_counts=float(noise), cells_lbm_s=cells)
        return made.load()
    case, seed = name.split("/")
    return rig_record(case, int(seed))


def with_channels(
    record: Record, change: Callable[[FloatArray], FloatArray], *starts: str
) -> Record:
    """Change the channels whose names begin so."""
    channels = {
        name: Channel(name, change(np.array(c.values)), c.unit)
        for name, c in record.channels.items()
        if name.startswith(starts)
    }
    return replace(record, channels={**record.channels, **channels})
