"""Measured and foreign records beside the repository, which tests look at where they are."""

from __future__ import annotations

from pathlib import Path

import pytest

SHARED = Path(__file__).resolve().parents[3] / "shared" / "data"
INDEPENDENT, MEASURED = SHARED / "independent_rig_985", SHARED / "measured"
needs_independent = pytest.mark.skipif(
    not INDEPENDENT.is_dir(), reason="the record independent_rig_985 is not beside the repository"
)
needs_measured = pytest.mark.skipif(
    not MEASURED.is_dir(), reason="the measured systems are not beside the repository"
)
