"""Raw records as TDMS, the format of LabVIEW and DIAdem."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from classic_ml.readers.optional_package import needed
from classic_ml.readers.raw_columns import Vector, as_columns, made_clock, one_line
from classic_ml.readers.raw_table import RawFile, Sampling, cannot_be_read
from classic_ml.readers.test_description import FileLayout
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["open_tdms", "open_tdms_leniently"]

_UNIT_PROPERTIES = ("unit_string", "NI_UnitDescription", "Unit", "unit", "Units", "units")


def open_tdms(file: Path, layout: FileLayout) -> RawFile:
    """Open a TDMS file; its rows are read slice by slice, scaled as the file says.

    Parameters
    ----------
    file : path
        An existing file. Without a channel of the clock's name, ``wf_start_offset`` and
        ``wf_increment`` of the channels are the clock; with ``wf_start_time`` they say which
        channels were sampled together; ``unit_string`` states a unit.
    layout : FileLayout
        The group to take.

    Returns
    -------
    RawFile
        The channels of one length, with the clock.

    Raises
    ------
    InputError
        When npTDMS is missing, the file is spoiled or cut short, or it is open which group is
        meant.
    """
    return _columns(file, layout, lenient=False)


def open_tdms_leniently(file: Path, layout: FileLayout) -> RawFile:
    """Open a TDMS file to look at it: one that was cut short is shown as far as it goes.

    Parameters
    ----------
    file, layout
        As for :func:`open_tdms`.
    """
    return _columns(file, layout, lenient=True)


def _columns(file: Path, layout: FileLayout, *, lenient: bool) -> RawFile:
    needed("nptdms", "tdms", file)
    vectors: list[Vector] = []
    aside: dict[tuple[str, ...], str] = {}
    with _opened(file) as handle:
        short = _cut_short(handle)
        if short and not any(short.values()):
            raise InputError(
                str(file),
                expected="a whole TDMS file",
                found="it cut short before the first row of all its channels",
                remedy="copy it again from the logger",
            )
        if short and not lenient:
            raise InputError(
                str(file),
                expected="a whole TDMS file",
                found="its last segment cut short",
                remedy="copy it again from the logger, or export the part that is whole; "
                "`sindy-surge inspect` shows it",
            )
        for group in handle.groups():
            channels = group.channels()
            for channel in channels:
                path = (group.name, channel.name)
                node = _vector(path, channel, short.get(channel.path, len(channel)))
                if isinstance(node, Vector):
                    vectors.append(replace(node, sampling=_sampling(channel)))
                else:
                    aside[path] = node
            names = {channel.name for channel in channels}
            if layout.clock == "column" and layout.time not in names:
                vectors += _clock(group.name, channels, short, layout)
    return as_columns(str(file), vectors, layout, lambda: _opened(file), aside)


@contextmanager
def _opened(file: Path) -> Iterator[Any]:
    from nptdms import TdmsFile
    from nptdms.log import log_manager

    # npTDMS tells of a spoiled file on stderr, beside the error.
    loud = [logger for logger in log_manager.loggers.values() if not logger.disabled]
    try:
        for logger in loud:
            logger.disabled = True
        handle = TdmsFile.open(file)
    except Exception as error:
        # npTDMS raises whatever it stumbles over in a spoiled file.
        raise cannot_be_read(file, "a TDMS file", one_line(error)) from None
    finally:
        for logger in loud:
            logger.disabled = False
    with handle:
        yield handle


def _cut_short(handle: Any) -> dict[str, int]:
    """Return, for a file whose last segment is incomplete, the rows that its channels share."""
    status = handle.file_status
    statuses = status.channel_statuses or {}
    if all(part.read_length == part.expected_length for part in statuses.values()):
        return {}
    lengths: dict[int, int] = {}
    whole: dict[str, int] = {}
    for group in handle.groups():
        for channel in group.channels():
            part = statuses.get(channel.path)
            lost = 0 if part is None else part.expected_length - part.read_length
            whole[channel.path] = len(channel) + lost
            known = lengths.get(whole[channel.path], len(channel))
            lengths[whole[channel.path]] = min(known, len(channel))
    return {path: lengths[size] for path, size in whole.items()}


def _vector(path: tuple[str, ...], channel: Any, size: int) -> Vector | str:
    """Return a channel, or what it is instead of one."""
    if size == 0:
        return "no values in it"
    dtype = np.dtype(channel.dtype)
    unit = next(
        (str(channel.properties[k]) for k in _UNIT_PROPERTIES if k in channel.properties), ""
    )
    if dtype.kind == "M":
        first = channel[0]

        def seconds(handle: Any, start: int, stop: int) -> FloatArray:
            stamps = handle[path[0]][path[1]].read_data(start, stop - start)
            return np.asarray((stamps - first) / np.timedelta64(1, "s"), dtype=np.float64)

        return Vector(path, size, seconds, "s", f"seconds from the first sample at {first}")
    if dtype.kind not in "iufb":
        return "no real numbers"

    def read(handle: Any, start: int, stop: int) -> FloatArray:
        values = handle[path[0]][path[1]].read_data(start, stop - start)
        return np.asarray(values, dtype=np.float64)

    return Vector(path, size, read, unit)


def _sampling(channel: Any) -> Sampling | None:
    """Return what the properties of a channel say of when it was sampled."""
    stated = channel.properties
    try:
        step_s = float(stated.get("wf_increment", 0.0) or 0.0)
        offset_s = float(stated.get("wf_start_offset", 0.0) or 0.0)
    except (TypeError, ValueError):
        return None
    if not (step_s > 0.0 and np.isfinite([step_s, offset_s]).all()):
        return None
    start = stated.get("wf_start_time")
    dated = isinstance(start, np.datetime64) and not np.isnat(start)
    start_ns = int(start.astype("datetime64[us]").astype(np.int64)) * 1000 if dated else None
    return Sampling(start_ns, offset_s, step_s)


def _clock(
    group: str, channels: list[Any], short: dict[str, int], layout: FileLayout
) -> list[Vector]:
    """Return the clock that the properties of the channels of a group state, if they do.

    Where they state several it is that of most; whoever reads them compares those he needs.
    """
    stated: dict[int, Counter[Sampling]] = {}
    for channel in channels:
        sampling = _sampling(channel)
        size = short.get(channel.path, len(channel))
        if sampling is not None and size > 0:
            stated.setdefault(size, Counter())[sampling] += 1
    made = []
    for size, clocks in stated.items():
        ((sampling, _),) = clocks.most_common(1)
        words = (
            f"from wf_start_offset {sampling.offset_s:g} s and wf_increment {sampling.step_s:g} s"
        )
        made.append(made_clock((group, layout.time), size, sampling, words))
    return made
