"""Raw records as TDMS, the format of LabVIEW and DIAdem."""

from __future__ import annotations

import logging
from collections import Counter
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from classic_ml.description import FileLayout
from classic_ml.io.table import RawFile, Sampling
from classic_ml.io.vectors import Found, Vector, as_table
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["open_tdms"]

_UNIT_PROPERTIES = ("unit_string", "NI_UnitDescription", "Unit", "unit", "Units", "units")


def open_tdms(file: Path, layout: FileLayout, lenient: bool = False) -> RawFile:
    """Open a TDMS file; its rows are read slice by slice, scaled as the file says.

    Parameters
    ----------
    file : path
        An existing file. Without a channel of the clock's name, ``wf_start_offset`` and
        ``wf_increment`` of the channels are the clock; with ``wf_start_time`` they say which
        channels were sampled together; ``unit_string`` states a unit.
    layout : FileLayout
        The group to take.
    lenient : bool
        Take a file that was cut short as far as it goes.

    Raises
    ------
    InputError
        When npTDMS is missing, the file was cut short, or it is open which group is meant.
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
    opened = partial(TdmsFile.open, file)
    found = Found()
    with opened() as handle:
        if handle.file_status.incomplete_final_segment and not lenient:
            raise InputError(
                str(file),
                expected="a whole TDMS file",
                found="its last segment cut short",
                remedy="copy it again from the logger, or export the part that is whole; "
                "`sindy-surge inspect` shows it",
            )
        dates = [
            start
            for group in handle.groups()
            for channel in group.channels()
            if isinstance(start := channel.properties.get("wf_start_time"), np.datetime64)
        ]
        for group in handle.groups():
            channels = group.channels()
            for channel in channels:
                _add(found, (group.name, channel.name), channel, dates)
            if layout.clock == "column" and layout.time not in {c.name for c in channels}:
                found.vectors += _clocks(group.name, found.vectors, layout)
    return as_table(str(file), found, layout, opened)


def _add(found: Found, path: tuple[str, str], channel: Any, dates: list[Any]) -> None:
    """Add one channel, or what it is instead of one."""
    kind, size = np.dtype(channel.dtype).kind, len(channel)
    if not size or kind not in "iufbM":
        found.aside[path] = "no real numbers" if size else "no values in it"
        return
    first = channel[0] if kind == "M" else None

    def read(handle: Any, start: int, stop: int) -> NDArray[Any]:
        values = handle[path[0]][path[1]].read_data(start, stop - start)
        return np.asarray(values if first is None else (values - first) / np.timedelta64(1, "s"))

    stated = channel.properties
    unit = next((str(stated[key]) for key in _UNIT_PROPERTIES if key in stated), "")
    stamp = "" if first is None else f"seconds from the first sample at {first}"
    step_s = float(stated.get("wf_increment") or 0.0)
    sampling = None
    if step_s > 0.0:
        start = stated.get("wf_start_time")
        # The difference first: a date in nanoseconds is no double.
        later = (start - dates[0]) / np.timedelta64(1, "s") if start in dates else 0.0
        offset_s = float(stated.get("wf_start_offset") or 0.0)
        sampling = Sampling(float(later) + offset_s, step_s)
    found.vectors.append(Vector(path, size, read, "s" if stamp else unit, stamp, sampling))


def _clocks(group: str, vectors: list[Vector], layout: FileLayout) -> list[Vector]:
    """Return the clocks that the properties of the channels of a group state, if they do.

    Where channels of one length state several, it is that of most; those that differ are refused
    where they are read.
    """
    stated: dict[int, Counter[Sampling]] = {}
    for vector in vectors:
        if vector.path[0] == group and vector.sampling is not None:
            stated.setdefault(vector.size, Counter())[vector.sampling] += 1
    clocks = []
    for size, counted in stated.items():
        ((sampling, _),) = counted.most_common(1)
        times = partial(_times, sampling)
        clocks.append(Vector((group, layout.time), size, times, "s", "", sampling, made=True))
    return clocks


def _times(sampling: Sampling, _: Any, start: int, stop: int) -> FloatArray:
    rows = np.arange(start, stop, dtype=np.float64)
    rate_hz = 1.0 / sampling.step_s
    # A step of 1e-3 is no double; its rate is, and gives the times of a printed clock.
    even = abs(rate_hz - round(rate_hz)) < 1e-9 * rate_hz
    since_first = rows / round(rate_hz) if even and round(rate_hz) else rows * sampling.step_s
    return np.asarray(sampling.start_s + since_first)
