"""A second simulated rig, of another kind, with which a method can be tried that fits the first.

Its ducts are distributed: the Euler equations in one dimension from the mouth of the inlet to the
throttle, the blading as a force on the gas within. Its stall cell has an amplitude of its own after
Moore and Greitzer. Gas, probes, instruments and their calibration are its own; the probes have no
jump at zero flow. With the first rig, and with what reduces its records, it shares the format of
the files alone.
"""

from __future__ import annotations

from comparisons.rig_distributed.instruments import Instruments, draw_instruments
from comparisons.rig_distributed.machine import Machine, draw
from comparisons.rig_distributed.record import (
    DistributedRun,
    draw_record,
    draw_run,
    simulate,
    write_run,
)

__all__ = [
    "DistributedRun",
    "Instruments",
    "Machine",
    "draw",
    "draw_instruments",
    "draw_record",
    "draw_run",
    "simulate",
    "write_run",
]
