"""What a call costs: processor seconds, and by how much resident memory grows at its peak.

Memory is the kernel's high-water mark of the resident set (VmHWM, started afresh by
/proc/self/clear_refs) less what was resident before, so that what numpy, a compiled kernel or a
solver takes is in it, which tracemalloc does not see all of. Linux alone tells it.
"""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


@dataclass(frozen=True)
class Cost:
    """One call.

    Parameters
    ----------
    result : object
        What it returned.
    seconds : float
        Processor time of the process.
    peak_bytes : int or None
        Growth of resident memory at its peak; None where the system does not tell.
    """

    result: Any
    seconds: float
    peak_bytes: int | None


def cost(call: Callable[[], Any]) -> Cost:
    """Call once, with free memory given back to the system before."""
    before = _reset_peak_bytes()
    begun = time.process_time()
    result = call()
    seconds = time.process_time() - begun
    peak = _status_bytes("VmHWM") if before is not None else None
    grown = peak - before if before is not None and peak is not None else None
    return Cost(result, seconds, grown)


def _reset_peak_bytes() -> int | None:
    """Give free memory back and start the kernel's high-water mark afresh."""
    try:
        ctypes.CDLL("libc.so.6").malloc_trim(0)
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return None
    return _status_bytes("VmRSS")


def _status_bytes(field: str) -> int | None:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(field + ":"):
            return 1024 * int(line.split()[1])
    return None
