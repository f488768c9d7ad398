"""Raw records as TDMS, the format of LabVIEW and DIAdem."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from classic_ml.description import FileLayout
from classic_ml.io.table import StoredTable, Vector, grouped, stated_unit
from surge_core.errors import InputError


@contextmanager
def open_tdms(file: Path, layout: FileLayout) -> Iterator[StoredTable]:
    """Open a TDMS file; its rows are read slice by slice, scaled as the file says.

    ``unit_string`` states a unit. Waveforms, which have no channel of times, are read with
    ``clock = "from rate"``. Arguments as :func:`classic_ml.io.formats.open_stored` has them.
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
        if handle.file_status.incomplete_final_segment:
            raise InputError(
                str(file),
                expected="a whole TDMS file",
                found="its last segment cut short",
                remedy="copy it again from the logger, or export the part that is whole",
            )
        vectors, left_aside = list[Vector](), dict[str, str]()
        for channel in (channel for group in handle.groups() for channel in group.channels()):
            path = channel.group_name, channel.name
            if not len(channel) or np.dtype(channel.dtype).kind not in "iufb":
                left_aside["/".join(path)] = "no vector of numbers"
            else:
                step_s = float(channel.properties.get("wf_increment", math.nan))
                vectors.append(Vector(path, channel, stated_unit(channel.properties), step_s))
        yield grouped(str(file), vectors, layout, left_aside)
