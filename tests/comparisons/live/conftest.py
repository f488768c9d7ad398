"""One record of the rig for all tests of a live session."""

from __future__ import annotations

import pytest
from live_records import LiveRecord, made_record


@pytest.fixture(scope="session")
def record(tmp_path_factory: pytest.TempPathFactory) -> LiveRecord:
    return made_record(tmp_path_factory.mktemp("live") / "985")
