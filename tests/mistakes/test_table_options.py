"""Options that contradict, and results that cannot or must not go where they are sent."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from mistake import Mistake
from mistake_checks import check
from mistake_desk import hand_in
from mistakes_options import OPTIONS, TARGETS

IS_ROOT = hasattr(os, "geteuid") and os.geteuid() == 0


@pytest.mark.parametrize("mistake", [*OPTIONS, *TARGETS], ids=lambda row: row.id)
def test_a_wrong_option_is_told_of(mistake: Mistake, clean: Path, tmp_path: Path) -> None:
    if mistake.id == "target-shut" and IS_ROOT:
        pytest.skip("root may write anywhere")
    check(mistake, hand_in(mistake, clean, tmp_path), clean, tmp_path)
