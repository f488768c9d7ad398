"""The table of mistakes: every bad input that is tried through the command line."""

from __future__ import annotations

from mistake import Mistake
from mistakes_clocks import CLOCKS, TESTS
from mistakes_formats import FORMATS
from mistakes_hostile import HOSTILE
from mistakes_live import LIVE
from mistakes_models import EXPERIMENTS, FACILITIES, MODELS, STUDIES
from mistakes_options import OPTIONS, TARGETS
from mistakes_raw_files import RAW_FILES
from mistakes_raw_readings import PROBES
from mistakes_series import LEDGERS, NETCDF, SERIES
from mistakes_test_toml import CALIBRATIONS, MACHINES
from mistakes_toml_types import TYPES

__all__ = ["MISTAKES", "Mistake"]

MISTAKES: tuple[Mistake, ...] = (
    *RAW_FILES,
    *FORMATS,
    *CLOCKS,
    *PROBES,
    *TESTS,
    *CALIBRATIONS,
    *MACHINES,
    *TYPES,
    *SERIES,
    *LEDGERS,
    *NETCDF,
    *LIVE,
    *MODELS,
    *EXPERIMENTS,
    *STUDIES,
    *FACILITIES,
    *OPTIONS,
    *TARGETS,
    *HOSTILE,
)
