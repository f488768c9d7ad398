"""The spectrum of a residual over that of its floor: density, bands, background."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from surge_core.types import BoolArray, FloatArray

# Sine tapers (Riedel and Sidorenko, IEEE Trans. Signal Process. 43 (1995), 188): three of them
# use 86 % of the rows and leak as 1/f⁴, so that a slow drift stays in its band.
TAPERS = 3
FEWEST_ROWS, MOST_PADDING = 10, 64
BANDS = 24
QUIET_QUANTILE_Z, QUIET_SHARE = -0.6745, 0.25
# The floor's power is itself an estimate, and so is the shape of an autoregression's spectrum.
FLOOR_UNCERTAINTY = 0.05


@dataclass(frozen=True)
class Power:
    """A one-sided power density, averaged over runs and tapers, in the squared unit a hertz.

    Degrees of freedom are those of one value and of a mean over a hertz; the resolution is the
    narrowest band that the typical run can tell.
    """

    frequency_hz: FloatArray
    density: FloatArray
    bin_freedom: float
    per_hz: float
    resolution_hz: float

    def background(self, ratio: FloatArray) -> float:
        """Return the rms of the quietest quarter of a ratio to the floor, over white noise's."""
        quiet = float(np.quantile(ratio, QUIET_SHARE))
        return math.sqrt(quiet / power_bound(QUIET_QUANTILE_Z, self.bin_freedom, known=True))


def tapered_power(
    values: FloatArray,
    scored: BoolArray,
    runs: tuple[slice, ...],
    period_s: float,
    *,
    bridged: bool,
) -> Power:
    """Return the power density of a signal less its mean; no taper straddles two runs.

    Rows that are not scored are joined by straight lines (``bridged``), or left out.
    """
    # Short runs say little beside long ones, and each costs as much.
    least = max(FEWEST_ROWS, max(run.stop - run.start for run in runs) // MOST_PADDING)
    pieces = [run for run in runs if np.count_nonzero(scored[run]) >= least] or runs[:1]
    size = 1 << max(max(run.stop - run.start for run in pieces) - 1, 1).bit_length()
    level = float(np.mean(values[scored]))
    total, weight = np.zeros(size // 2 + 1), 0.0
    squares = products = 0.0
    for piece in pieces:
        there = np.flatnonzero(scored[piece])
        n = piece.stop - piece.start
        own = np.interp(np.arange(n), there, values[piece][there]) - level
        rows = np.arange(1.0, n + 1.0)
        order = np.arange(1.0, TAPERS + 1.0)[:, None]
        tapers = math.sqrt(2.0 / (n + 1.0)) * np.sin(np.pi * order * rows / (n + 1.0))
        if not bridged:
            tapers = tapers * scored[piece]
        share = float(np.mean(np.sum(tapers**2, axis=1)))
        total += n * np.mean(np.abs(np.fft.rfft(tapers * own, size, axis=1)) ** 2, axis=0)
        weight += n * share
        # Gaps leave the tapers less than orthogonal.
        squares += n**2 * share
        products += n**2 * float(np.sum(np.mean(tapers**2, axis=0) ** 2))
    if not (weight > 0.0 and np.all(np.isfinite(total))):
        total[:], weight = math.nan, 1.0
    density = 2.0 * period_s * total / weight
    density[0] *= 0.5
    lengths = np.sort([piece.stop - piece.start for piece in pieces])
    typical = float(lengths[np.searchsorted(np.cumsum(lengths), 0.5 * lengths.sum())])
    freedom = 2.0 * TAPERS * weight**2 / max(squares, 1e-300)
    per_hz = 2.0 * period_s * weight**2 / max(products, 1e-300)
    frequency = np.asarray(np.fft.rfftfreq(size, period_s), dtype=np.float64)
    return Power(frequency, density, freedom, per_hz, (TAPERS + 1) / (typical * period_s))


def floor_density(
    frequency_hz: FloatArray, rms: float, ar: FloatArray, period_s: float
) -> FloatArray:
    """Return the power density of noise e[k] = Σ aᵢ e[k−i] + white of some rms."""
    turn = np.exp(-2j * np.pi * period_s * np.outer(frequency_hz, np.arange(1, ar.size + 1)))
    shape = 1.0 / np.abs(1.0 - turn @ ar) ** 2
    mean = float(np.trapezoid(shape, frequency_hz)) * 2.0 * period_s
    return np.asarray(2.0 * period_s * rms**2 * shape / mean)


def log_bands(
    frequency_hz: FloatArray, resolution_hz: float
) -> list[tuple[float, float, BoolArray]]:
    """Return bands that widen by a factor each, none narrower than the resolution."""
    step, highest = float(frequency_hz[1]), float(frequency_hz[-1])
    wanted = np.geomspace(1.5 * step, highest, BANDS)
    kept = [0.0]
    for edge in ((np.floor(wanted / step) + 0.5) * step).tolist():
        if min(edge - kept[-1], highest - edge) >= max(resolution_hz, step):
            kept.append(edge)
    return [
        (low, high, (frequency_hz >= low) & (frequency_hz <= high))
        for low, high in pairwise([*kept, highest])
    ]


def power_z(ratio: float, freedom: float, *, known: bool = False) -> float:
    """Return z of a mean power over its expectation, χ²_ν/ν, by Wilson and Hilferty (1931).

    ``known`` says whether the expectation is known exactly; else it is to 5 %.
    """
    width = _width(freedom, known=known)
    return (math.cbrt(max(ratio, 0.0)) - (1.0 - width)) / math.sqrt(width)


def power_bound(z: float, freedom: float, *, known: bool = False) -> float:
    """Return the ratio whose z is the one given; see :func:`power_z`."""
    width = _width(freedom, known=known)
    return max(1.0 - width + z * math.sqrt(width), 0.0) ** 3


def _width(freedom: float, *, known: bool) -> float:
    return 2.0 / 9.0 * (1.0 / freedom + (0.0 if known else 0.5 * FLOOR_UNCERTAINTY**2))
