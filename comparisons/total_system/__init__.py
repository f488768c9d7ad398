"""The total-system method: a lumped model of the whole facility fitted to the record.

The comparator of the component method (the idea of the paper's Reference 6). It simulates
compressor, plenums, throttle and supply, and adjusts β and τ until the simulated P31, P25 and W25
agree with the measured ones; so it must know volumes, throttle and supply, and when the surge
began.
"""

from __future__ import annotations

from comparisons.total_system.facility import Facility, facility_toml, read_facility
from comparisons.total_system.fit import fit_total_system
from comparisons.total_system.fitted import TotalSystemFit, TotalSystemSettings, TotalSystemState
from comparisons.total_system.measured import Measured, measured_signals
from comparisons.total_system.model import TotalSystemModel
from comparisons.total_system.sensitivity import sensitivity_rows, sensitivity_table

__all__ = [
    "Facility",
    "Measured",
    "TotalSystemFit",
    "TotalSystemModel",
    "TotalSystemSettings",
    "TotalSystemState",
    "facility_toml",
    "fit_total_system",
    "measured_signals",
    "read_facility",
    "sensitivity_rows",
    "sensitivity_table",
]
