"""Files that hold what another program would execute or obey."""

from __future__ import annotations

from pathlib import Path

import pytest
from mistake import Mistake
from mistake_checks import check
from mistake_desk import hand_in
from mistakes_hostile import HOSTILE


@pytest.mark.parametrize("mistake", HOSTILE, ids=lambda row: row.id)
def test_hostile_text_stays_text(mistake: Mistake, clean: Path, tmp_path: Path) -> None:
    check(mistake, hand_in(mistake, clean, tmp_path), clean, tmp_path)
