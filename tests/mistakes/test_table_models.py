"""Saved models, model files with their records, studies and facilities that are spoiled."""

from __future__ import annotations

from pathlib import Path

import pytest
from mistake import Mistake
from mistake_checks import check
from mistake_desk import hand_in
from mistakes_models import EXPERIMENTS, FACILITIES, MODELS, STUDIES

ROWS = (*MODELS, *EXPERIMENTS, *STUDIES, *FACILITIES)


@pytest.mark.parametrize("mistake", ROWS, ids=lambda row: row.id)
def test_a_spoiled_model_or_study_is_told_of(mistake: Mistake, clean: Path, tmp_path: Path) -> None:
    check(mistake, hand_in(mistake, clean, tmp_path), clean, tmp_path)
