"""Raw records as TDMS, the format of LabVIEW and DIAdem."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from classic_ml.description import FileLayout
from classic_ml.io.table import StoredTable, Vector, grouped
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["open_tdms"]

_UNIT_PROPERTIES = ("unit_string", "NI_UnitDescription", "Unit", "unit", "Units", "units")


@contextmanager
def open_tdms(file: Path, layout: FileLayout, lenient: bool = False) -> Iterator[StoredTable]:
    """Open a TDMS file; its rows are read slice by slice, scaled as the file says.

    Without a channel of the clock's name, ``wf_start_offset`` and ``wf_increment`` of the channels
    are the clock; with ``wf_start_time`` they say which channels were sampled together;
    ``unit_string`` states a unit. Arguments as :func:`classic_ml.io.formats.open_stored` has them.
    """
    if find_spec("nptdms") is None:
        raise InputError(
            str(file),
            expected="the package nptdms, which reads files ending in .tdms",
            found="it is not installed",
            remedy="pip install 'sindy-surge[tdms]'",
        )
    from nptdms import TdmsFile
    from nptdms.log import log_manager

    # It warns of a damaged file on stderr, beside the error.
    log_manager.set_level(logging.ERROR)
    with TdmsFile.open(file) as handle:
        if handle.file_status.incomplete_final_segment and not lenient:
            raise InputError(
                str(file),
                expected="a whole TDMS file",
                found="its last segment cut short",
                remedy="copy it again from the logger, or export the part that is whole",
            )
        vectors, left_aside = list[Vector](), dict[str, str]()
        for group in handle.groups():
            here = list(_vectors(group, left_aside))
            # Where the channels differ, that of the first stands for all, and those that differ
            # are refused when they are read.
            stated = next((v for v in here if v.sampled is not None), None)
            named = any(v.path[1] == layout.time for v in here)
            if stated is not None and not named and layout.clock == "column":
                clock = _Clock(*(stated.sampled or (0.0, 1.0)), len(stated.values))
                here.append(Vector((group.name, layout.time), clock, "s"))
            vectors += here
        yield grouped(str(file), vectors, layout, left_aside)


def _vectors(group: Any, left_aside: dict[str, str]) -> Iterator[Vector]:
    origin = None
    for channel in group.channels():
        if not len(channel) or np.dtype(channel.dtype).kind not in "iufbM":
            left_aside[f"{group.name}/{channel.name}"] = "no vector of numbers"
            continue
        stated = channel.properties
        unit = next((str(stated[name]) for name in _UNIT_PROPERTIES if name in stated), "")
        step_s, start = float(stated.get("wf_increment") or 0.0), stated.get("wf_start_time")
        origin = start if origin is None else origin
        later_s = float(stated.get("wf_start_offset") or 0.0)
        if isinstance(start, np.datetime64) and isinstance(origin, np.datetime64):
            # The difference first: a date in nanoseconds is no double.
            later_s += float((start - origin) / np.timedelta64(1, "s"))
        sampled = (later_s, step_s) if step_s > 0.0 else None
        yield Vector((group.name, channel.name), channel, unit, sampled)


class _Clock:
    """The times of the rows of a channel, from its start and its step in s."""

    def __init__(self, start_s: float, step_s: float, n_rows: int) -> None:
        self._start_s, self._n_rows = start_s, n_rows
        rate_hz = 1.0 / step_s
        # A step of 1e-3 is no double; its rate is, and gives the times of a printed clock.
        whole = abs(rate_hz - round(rate_hz)) < 1e-9 * rate_hz
        self._rate_hz = round(rate_hz) if whole and round(rate_hz) else rate_hz

    def __len__(self) -> int:
        return self._n_rows

    def __getitem__(self, rows: slice) -> FloatArray:
        numbers = np.arange(*rows.indices(self._n_rows), dtype=np.float64)
        return np.asarray(self._start_s + numbers / self._rate_hz)
