"""What every peer's process does: fit each record, and time and weigh it.

A script of a peer calls :func:`serve` with its way of fitting. The process is given a file of
records and a file for its results, writes one line of JSON for each fit as soon as it ends,
begins no fit behind its cap of CPU seconds and is ended at its limit. It runs in the peer's own
environment: numpy and scipy alone.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import io
import json
import resource
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

FloatArray = NDArray[np.float64]
Fit = Callable[[FloatArray, FloatArray], Sequence[float]]

PERIOD_S = 1e-3
WARM_UP_ROWS = 500
LFILTER_TIMING_S = 0.02
LFILTER_REPEATS = 7


def lag_parameters(a: float, b: Sequence[float]) -> list[float]:
    """Return (τ in seconds, β...) of y[k+1] = a y[k] + Σ b_i s_i[k] (paper, Eq 10, 11).

    Parameters
    ----------
    a : float
        Pole; nan for τ when it is not that of a lag.
    b : sequence of float
        Coefficients of the terms.
    """
    tau_s = -PERIOD_S / np.log(a) if 0.0 < a < 1.0 else float("nan")
    return [float(tau_s), *(float(value / (1.0 - a)) for value in b)]


def with_level(y: FloatArray, terms: FloatArray, parameters: Sequence[float]) -> list[float]:
    """Put β0 in by the means, for a peer that takes no constant or doubles it.

    Parameters
    ----------
    y : ndarray of shape (n,)
        ψ'.
    terms : ndarray of shape (n, q)
        Terms without the constant.
    parameters : sequence of float
        (τ, β1, ..., βq).
    """
    tau_s, *beta = parameters
    level = y[1:].mean() - terms[:-1].mean(axis=0) @ np.asarray(beta)
    # In the mean y[k] - a y[k-1] = (1 - a) y up to what the two ends of the record differ by.
    a = np.exp(-PERIOD_S / tau_s)
    level += a / (1.0 - a) * (y[-1] - y[0]) / (y.size - 1)
    return [tau_s, float(level), *beta]


def serve(fit: Fit) -> None:
    """Fit all records of a job.

    Parameters
    ----------
    fit : callable
        Takes φ and ψ' of shape (n,), returns (τ in seconds, β0, β1, β2).
    """
    parser = argparse.ArgumentParser()
    parser.add_argument("records", type=Path)
    parser.add_argument("results", type=Path)
    parser.add_argument("--cap-s", type=float, required=True)
    parser.add_argument("--end-s", type=int, required=True)
    options = parser.parse_args()
    # A fit cannot be interrupted from within: the kernel ends the process.
    resource.setrlimit(resource.RLIMIT_CPU, (options.end_s, resource.RLIM_INFINITY))
    warnings.simplefilter("ignore")
    with np.load(options.records) as records:
        phi, y = records["phi"], records["y"]
    # Imports within the first fit, and compilation that is kept, count for nobody.
    _attempt(fit, phi[0, :WARM_UP_ROWS], y[0, :WARM_UP_ROWS])
    with options.results.open("w", encoding="utf-8") as out:
        _write(out, {"lfilter_s": _lfilter_seconds(y[0])})
        begun = time.process_time()
        for row in range(y.shape[0]):
            if time.process_time() - begun > options.cap_s:
                break
            _write(out, _attempt(fit, phi[row], y[row]))


def _attempt(fit: Fit, phi: FloatArray, y: FloatArray) -> dict[str, object]:
    before = _reset_peak_bytes()
    begun = time.process_time()
    try:
        # SystemExit: there are libraries that leave by sys.exit for a bad argument.
        with contextlib.redirect_stdout(io.StringIO()):
            parameters = [float(value) for value in fit(phi, y)]
        failure = None if np.all(np.isfinite(parameters)) else "no lag in what was fitted"
    except (Exception, SystemExit) as error:
        parameters, failure = [], f"{type(error).__name__}: {error}"
    seconds = time.process_time() - begun
    peak = _peak_bytes()
    grown = peak - before if peak is not None and before is not None else None
    return {"parameters": parameters, "failure": failure, "cpu_s": seconds, "peak_bytes": grown}


def _write(out: io.TextIOBase, row: dict[str, object]) -> None:
    out.write(json.dumps(row) + "\n")
    out.flush()


def _lfilter_seconds(y: FloatArray) -> float:
    """Return the CPU time of one first-order pass over y, the least of some repeats."""
    best = float("inf")
    for _ in range(LFILTER_REPEATS):
        begun = time.process_time()
        passes = 0
        while (spent := time.process_time() - begun) < LFILTER_TIMING_S:
            lfilter([1.0], [1.0, -0.95], y)
            passes += 1
        best = min(best, spent / passes)
    return best


def _reset_peak_bytes() -> int | None:
    """Give free memory back, start the kernel's high-water mark afresh; resident bytes now."""
    try:
        ctypes.CDLL("libc.so.6").malloc_trim(0)
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return None
    return _status_bytes("VmRSS")


def _peak_bytes() -> int | None:
    try:
        return _status_bytes("VmHWM")
    except OSError:
        return None


def _status_bytes(field: str) -> int:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(field + ":"):
            return 1024 * int(line.split()[1])
    raise OSError(f"no {field} in /proc/self/status")
