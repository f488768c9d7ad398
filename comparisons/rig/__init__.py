"""The simulated compressor test rig, whose truth is known.

It makes raw records as a surge test would leave them, and it shares no equation with the code that
reduces them: of `classic_ml` it imports the record container alone.
"""

from __future__ import annotations

from comparisons.rig.cases import CASES, RigCase
from comparisons.rig.hidden import HIDEABLE, Hideable
from comparisons.rig.sensors import SensorSettings
from comparisons.rig.simulation import RigRun, simulate, write_run

__all__ = [
    "CASES",
    "HIDEABLE",
    "Hideable",
    "RigCase",
    "RigRun",
    "SensorSettings",
    "simulate",
    "write_run",
]
