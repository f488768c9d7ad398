"""The table of mistakes: every bad input that is tried through the command line."""

from __future__ import annotations

from mistake import Mistake
from mistakes_clocks import CLOCKS, TESTS
from mistakes_formats import FORMATS
from mistakes_hostile import HOSTILE
from mistakes_models import EXPERIMENTS, FACILITIES, MODELS, STUDIES
from mistakes_options import OPTIONS, TARGETS
from mistakes_raw_files import RAW_FILES
from mistakes_raw_readings import PROBES
from mistakes_series import LEDGERS, NETCDF, SERIES
from mistakes_test_toml import CALIBRATIONS, MACHINES
from mistakes_toml_types import TYPES

__all__ = ["GROUPS", "MISTAKES", "Mistake"]

GROUPS: dict[str, tuple[Mistake, ...]] = {
    "Raw records: the file": RAW_FILES,
    "Raw records: binary formats": FORMATS,
    "Raw records: the clock": CLOCKS,
    "Raw records: units, names and probes": PROBES,
    "Raw records: what was recorded": TESTS,
    "test.toml: calibrations": CALIBRATIONS,
    "test.toml: the machine and the test": MACHINES,
    "test.toml: how it is written": TYPES,
    "Series files": SERIES,
    "Ledgers": LEDGERS,
    "netCDF series": NETCDF,
    "Saved models": MODELS,
    "Models of your own, and their records": EXPERIMENTS,
    "Studies": STUDIES,
    "Facilities": FACILITIES,
    "The command line": OPTIONS,
    "Where results go": TARGETS,
    "Text that another program would obey": HOSTILE,
}
MISTAKES: tuple[Mistake, ...] = tuple(row for rows in GROUPS.values() for row in rows)
