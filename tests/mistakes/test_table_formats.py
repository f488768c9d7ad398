"""Binary raw records that are spoiled, through `sindy-surge reduce`."""

from __future__ import annotations

from pathlib import Path

import pytest
from mistake import Mistake
from mistake_checks import check
from mistake_desk import hand_in
from mistakes_formats import FORMATS


@pytest.mark.parametrize("mistake", FORMATS, ids=lambda row: row.id)
def test_a_spoiled_binary_record_is_told_of(mistake: Mistake, clean: Path, tmp_path: Path) -> None:
    check(mistake, hand_in(mistake, clean, tmp_path), clean, tmp_path)
