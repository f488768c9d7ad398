"""Raw records that are spoiled, through `sindy-surge reduce`."""

from __future__ import annotations

from pathlib import Path

import pytest
from mistake import Mistake
from mistake_checks import check
from mistake_desk import hand_in
from mistakes_clocks import CLOCKS, TESTS
from mistakes_raw_files import RAW_FILES
from mistakes_raw_readings import PROBES
from mistakes_test_toml import CALIBRATIONS, MACHINES
from mistakes_toml_types import TYPES

ROWS = (*RAW_FILES, *CLOCKS, *PROBES, *TESTS, *CALIBRATIONS, *MACHINES, *TYPES)


@pytest.mark.parametrize("mistake", ROWS, ids=lambda row: row.id)
def test_a_spoiled_raw_record_is_told_of(mistake: Mistake, clean: Path, tmp_path: Path) -> None:
    check(mistake, hand_in(mistake, clean, tmp_path), clean, tmp_path)
