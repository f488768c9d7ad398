"""The clean files that every mistake is made in, written once."""

from __future__ import annotations

from pathlib import Path

import pytest
from mistake_desk import clean_files


@pytest.fixture(scope="session")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a raw record, its series, models, studies: all that a user may hold."""
    return clean_files(tmp_path_factory.mktemp("clean"))
