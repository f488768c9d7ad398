"""The record of the closed loop: checked, and completed where the plenum was not measured."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from sindy_surge.closed_loop.cycles import Cycles, measure_cycles
from surge_core.errors import InputError
from surge_core.types import FloatArray
from surge_core.validation import positive

__all__ = ["FEWEST_CYCLES", "half_width_samples", "hidden_plenum", "read_record", "record_cycles"]


FEWEST_CYCLES = 4
# A period of fewer samples leaves too few to a jump from one branch to the other.
_FEWEST_SAMPLES = 30
# A surge cycle takes from some ten milliseconds (turbochargers) to several seconds (pipelines);
# well beyond on either side a unit is mistaken.
_SHORTEST_S, _LONGEST_S = 1e-3, 60.0
# Half widths are at most an eighth of a period, well below the quarter beyond which the weak form
# loses what it is to find.
_MOST_SHARE = 8
_LEAST_HALF_WIDTH = 4


def read_record(
    phi: ArrayLike, psi_p: ArrayLike, plenum: ArrayLike | None, sample_period_s: float
) -> tuple[FloatArray, float]:
    """Check the channels and put them side by side.

    Parameters
    ----------
    phi, psi_p : array-like of shape (n_rows,)
        Flow coefficient and compressor pressure coefficient.
    plenum : array-like of shape (n_rows,) or None
        Plenum pressure.
    sample_period_s : float
        Sample period in seconds.

    Returns
    -------
    record : ndarray of shape (n_rows, 2 or 3)
        The channels.
    sample_period_s : float
        The sample period in seconds.

    Raises
    ------
    InputError
        If a channel cannot be used.
    """
    positive("sample_period_s", sample_period_s)
    channels = {"phi": phi, "psi_p": psi_p}
    if plenum is not None:
        channels["plenum"] = plenum
    columns: list[FloatArray] = []
    for name, values in channels.items():
        try:
            column = np.asarray(values, dtype=np.float64)
        except (TypeError, ValueError):
            raise InputError(name, expected="numbers", found=f"{type(values).__name__}") from None
        n_rows = columns[0].size if columns else column.size
        if column.shape != (n_rows,):
            raise InputError(
                name,
                expected=f"one value for each of {n_rows} samples, as phi",
                found=f"an array of shape {column.shape}",
                remedy="cut the channels to the same rows",
            )
        bad = np.flatnonzero(~np.isfinite(column))
        if bad.size:
            raise InputError(
                name,
                expected="finite values",
                found=f"{bad.size} NaN or infinite, the first in row {bad[0]}",
                remedy="cut the record there; a gap cannot be simulated across",
            )
        if n_rows < 2 or not np.ptp(column) > 1e-9 * np.max(np.abs(column)):
            raise InputError(
                name,
                expected="a signal that changes with the surge cycles",
                found=f"a constant over {n_rows} samples",
                remedy="choose a part of the record that surges",
            )
        columns.append(column)
    return np.column_stack(columns), float(sample_period_s)


def record_cycles(record: FloatArray, sample_period_s: float) -> Cycles:
    """Measure the record's cycles and refuse what no model can be discovered from.

    Parameters
    ----------
    record : ndarray of shape (n_rows, n_channels)
        φ first.
    sample_period_s : float
        Sample period in seconds.

    Raises
    ------
    InputError
        If there are too few cycles, too few samples in one, or a period that no machine has.
    """
    cycles = measure_cycles(record, sample_period_s)
    if cycles is None or cycles.n_cycles < FEWEST_CYCLES:
        found = 0 if cycles is None else cycles.n_cycles
        raise InputError(
            "phi",
            expected=f"at least {FEWEST_CYCLES} whole surge cycles",
            found=f"{found} in {len(record)} samples",
            remedy="use a longer record",
        )
    samples = cycles.period_s / sample_period_s
    if samples < _FEWEST_SAMPLES:
        raise InputError(
            "phi",
            expected=f"surge cycles of at least {_FEWEST_SAMPLES} samples",
            found=f"{samples:.1f} samples between two rises through the middle of the range",
            remedy="sample faster, or reduce the noise if these are not cycles at all",
        )
    if not _SHORTEST_S < cycles.period_s < _LONGEST_S:
        raise InputError(
            "sample_period_s",
            expected="the sample period in seconds",
            found=f"{sample_period_s:g}, which makes surge cycles of {cycles.period_s:g} s",
            remedy="give seconds, neither milliseconds nor a rate in Hz",
        )
    return cycles


def half_width_samples(phi: FloatArray, period_samples: float) -> int:
    """Return the half width of the test functions: the time of half a jump of φ.

    The least lag at which φ changes by half its range, and at most an eighth of a period: about
    that for mild surge, much less for deep surge, which jumps between its branches.

    Parameters
    ----------
    phi : ndarray of shape (n_rows,)
        Flow coefficient.
    """
    most = max(round(period_samples / _MOST_SHARE), _LEAST_HALF_WIDTH)
    half = np.ptp(phi) / 2
    for lag in range(_LEAST_HALF_WIDTH, most):
        if np.max(np.abs(phi[lag:] - phi[:-lag])) >= half:
            return lag
    return most


def hidden_plenum(
    record: FloatArray, sample_period_s: float, half_width: int
) -> tuple[FloatArray, float]:
    """Estimate a plenum pressure that was not measured, from the duct.

    dφ/dt = a (ψ' - Ψ) gives Ψ = ψ' - (dφ/dt)/a. Differentiated once more and with the throttle
    drawn as a straight line, d²φ/dt² = a dψ'/dt + terms in 1, φ, ψ' and dφ/dt: in the weak form
    the coefficient of dψ'/dt is a.

    Parameters
    ----------
    record : ndarray of shape (n_rows, 2)
        φ and ψ'.
    sample_period_s : float
        Sample period in seconds.

    Returns
    -------
    plenum : ndarray of shape (n_rows,)
        Ψ in the unit of ψ', smoothed.
    gain_per_s : float
        a.

    Raises
    ------
    InputError
        If ψ' does not drive φ as a duct would have it.
    """
    from scipy.signal import savgol_filter

    # φ is differentiated twice, which takes wider test functions.
    gain = _duct_gain(record, sample_period_s, 2 * half_width)
    if not gain > 0:
        raise InputError(
            "plenum",
            expected="φ to rise with ψ', as through a duct, when no plenum pressure is given",
            found=f"dφ/dt = {gain:.3g} (ψ' - Ψ)",
            remedy="give the plenum pressure, or check the sign and timing of φ and ψ'",
        )
    width = 2 * max(round(2 / 3 * half_width), 2) + 1
    slope = savgol_filter(record[:, 0], width, 3, deriv=1, delta=sample_period_s)
    level = savgol_filter(record[:, 1], width, 3)
    return level - slope / gain, gain


def _duct_gain(record: FloatArray, sample_period_s: float, half_width: int) -> float:
    z = np.arange(-half_width, half_width + 1) / half_width
    step = half_width * sample_period_s
    weight = (1 - z**2) ** 4
    # By parts, a derivative of the signal becomes one of w; a convolution flips the odd one.
    slope = -8 * z * (1 - z**2) ** 3 / step
    bend = (48 * z**2 * (1 - z**2) ** 2 - 8 * (1 - z**2) ** 3) / step**2
    phi, psi_p = record[:, 0], record[:, 1]

    def integrated(signal: FloatArray, kernel: FloatArray) -> FloatArray:
        return np.convolve(signal, kernel / weight.sum(), "valid")

    rest = [integrated(phi, weight), integrated(psi_p, weight), integrated(phi, slope)]
    design = np.column_stack((integrated(psi_p, slope), np.ones_like(rest[0]), *rest))
    sizes = np.linalg.norm(design, axis=0)
    solution = np.linalg.lstsq(design / sizes, integrated(phi, bend))[0]
    return float(solution[0] / sizes[0])
