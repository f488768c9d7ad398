"""Files of records: one thin module a format, all of them giving the same table."""

from __future__ import annotations

from classic_ml.description import TestDescription
from classic_ml.io.description_file import read_test_description
from classic_ml.io.raw import read_raw

__all__ = ["TestDescription", "read_raw", "read_test_description"]
