"""The spectrum of a residual over that of the floor: bands, background, narrow lines."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from comparisons.missing_effect.where_noise import power_bound, power_z, tolerant
from comparisons.missing_effect.where_rows import Line
from surge_core.errors import InputError
from surge_core.types import BoolArray, FloatArray

__all__ = ["HARMONICS", "Spectrum", "band_edges", "floor_spectra", "narrow_line"]

# Sine tapers (Riedel and Sidorenko, IEEE Trans. Signal Process. 43 (1995), 188): three of them
# use 86 % of the rows and leak as 1/f⁴, so that a slow drift stays in its band.
TAPERS = 3
FEWEST_ROWS = 10
# Zeros after short runs may take so many times the memory of the rows.
MOST_PADDING = 8
SLOWER, SURGING, HARMONIC = 0.4, 1.5, 4.5
HARMONICS = 4
BAND_FACTOR = 1.9
QUIET_QUANTILE_Z = -0.6745
QUIET_SHARE = 0.25
NEIGHBOURS = 64
LINE_BINS = (1, 4, 16, 64)
# Harmonics of surge reach some ten times its frequency. What jumps once a cycle has a spectrum
# that falls as 1/f² and no slower, so that a line must stand above that of what lies below.
FAR_ABOVE = 10.0
JUMP_MARGIN = 3.0
CERTAIN_Z = 4.0
# Where a line is: the centre of what stands above a quarter of its height.
LINE_FOOT = 0.25


@dataclass(frozen=True)
class Spectrum:
    """Power over that of the floor, averaged over runs and tapers.

    Parameters
    ----------
    frequency_hz, ratio : ndarray of shape (m,)
        From zero to half the sample rate; the expectation of the floor's noise is 1.
    bin_freedom : float
        Degrees of freedom of one value.
    freedom_per_hz : float
        Degrees of freedom of a mean over a hertz.
    """

    frequency_hz: FloatArray
    ratio: FloatArray
    bin_freedom: float
    freedom_per_hz: float

    @property
    def background(self) -> float:
        """Power of the quietest quarter, as that of white noise of the same lower quartile."""
        quiet = float(np.quantile(self.ratio, QUIET_SHARE))
        return quiet / power_bound(QUIET_QUANTILE_Z, self.bin_freedom)

    def band(self, low_hz: float, high_hz: float) -> tuple[float, float]:
        """Return the mean ratio of a band and its degrees of freedom.

        Parameters
        ----------
        low_hz, high_hz : float
            Edges; the upper one belongs to the next band.
        """
        last = self.frequency_hz[-1]
        upper = self.frequency_hz <= high_hz if high_hz >= last else self.frequency_hz < high_hz
        inside = np.flatnonzero((self.frequency_hz >= low_hz) & upper)
        # At zero and at half the sample rate one value stands for both sides of the spectrum.
        weight = np.where(np.isin(inside, (0, self.frequency_hz.size - 1)), 0.5, 1.0)
        ratio = float(weight @ self.ratio[inside] / weight.sum())
        least = 0.5 * self.bin_freedom if low_hz == 0.0 else self.bin_freedom
        return ratio, max(self.freedom_per_hz * (high_hz - low_hz), least)


def floor_spectra(
    signals: tuple[FloatArray, ...],
    known: BoolArray,
    runs: tuple[slice, ...],
    rms: float,
    sample_rate_hz: float,
) -> tuple[Spectrum, ...]:
    """Return the spectra of signals over that of white noise.

    Parameters
    ----------
    signals : tuple of ndarray of shape (n,)
        Whitened signals, 0 where they are not known.
    known : ndarray of bool, shape (n,)
        Rows in which they are known.
    runs : tuple of slice
        Runs; no taper straddles two.
    rms : float
        rms of the white noise.
    sample_rate_hz : float
        Samples a second.

    Raises
    ------
    InputError
        When no run has ten known rows.
    """
    pieces, size = _pieces(runs, known)
    lengths = np.array([piece.stop - piece.start for piece in pieces])
    taken = np.concatenate([np.arange(piece.start, piece.stop) for piece in pieces])
    inside = np.arange(size) < lengths[:, None]
    there = np.zeros(inside.shape)
    there[inside] = known[taken]
    stacked = np.zeros((len(signals), *inside.shape))
    for place, signal in enumerate(signals):
        stacked[place][inside] = signal[taken]
    order = np.arange(1.0, TAPERS + 1.0)[:, None, None]
    angle = np.pi * (np.arange(size) + 1.0) / (lengths[:, None] + 1.0)
    scale = np.sqrt(2.0 * lengths / ((lengths + 1.0) * TAPERS))[:, None]
    tapers = np.where(inside, scale * np.sin(order * angle), 0.0) * there
    power = np.zeros((len(signals), size // 2 + 1))
    for taper in tapers:
        power += np.sum(np.abs(np.fft.rfft(stacked * taper, axis=-1)) ** 2, axis=1)
    weight = np.sum(tapers**2, axis=0)
    whole = float(weight.sum())
    # Gaps leave the tapers less than orthogonal: their products count against the freedom.
    products = np.einsum("ipt,jpt->pij", tapers, tapers)
    bin_freedom = 2.0 * whole**2 / float(np.sum(products**2))
    per_hz = 2.0 * whole**2 / float(np.sum(weight**2)) / sample_rate_hz
    frequency = np.asarray(np.fft.rfftfreq(size, 1.0 / sample_rate_hz), dtype=np.float64)
    return tuple(Spectrum(frequency, p / (rms**2 * whole), bin_freedom, per_hz) for p in power)


def band_edges(
    sample_rate_hz: float, surge_hz: FloatArray, slow_hz: float, run_s: float
) -> FloatArray:
    """Return the edges of bands: slower than surge, surge, its harmonics, and on by factors.

    Parameters
    ----------
    sample_rate_hz : float
        Samples a second.
    surge_hz : ndarray
        Surge frequencies of the records, those that are known.
    slow_hz : float
        What counts as slow where none is.
    run_s : float
        Length of the typical run; a band is at least as wide as it can tell.
    """
    highest = 0.5 * sample_rate_hz
    inner = [slow_hz]
    if surge_hz.size:
        least, most = float(surge_hz.min()), float(surge_hz.max())
        inner = [SLOWER * least, SURGING * most, HARMONIC * most]
    inner = [edge for edge in inner if edge < highest / math.sqrt(BAND_FACTOR)]
    if inner:
        count = max(round(math.log(highest / inner[-1]) / math.log(BAND_FACTOR)), 1)
        inner = [*inner[:-1], *np.geomspace(inner[-1], highest, count + 1)[:-1].tolist()]
    narrowest = (TAPERS + 1) / run_s
    kept = [0.0]
    for edge in inner:
        rounded = float(f"{edge:.2g}")
        if min(rounded - kept[-1], highest - rounded) >= narrowest:
            kept.append(rounded)
    return np.array([*kept, highest])


def narrow_line(spectrum: Spectrum, edges: FloatArray, surge_hz: FloatArray) -> Line | None:
    """Return the line far above surge that stands highest over its neighbourhood.

    Lines of several widths are looked for: the cells begin in another phase in every episode of
    stall, which spreads their line over the inverse of its duration.

    Parameters
    ----------
    spectrum : Spectrum
        Of the residual without its slow part.
    edges : ndarray
        Edges of the bands.
    surge_hz : ndarray
        Surge frequencies; below ten times those a line may be a harmonic.

    Returns
    -------
    Line or None
        Its z counts all frequencies and widths that were looked at; None where there are too few
        or where a jump in each cycle would do.
    """
    lowest = FAR_ABOVE * float(surge_hz.max()) if surge_hz.size else float(edges[-2])
    if not surge_hz.size and edges.size > 2:
        lowest = float(edges[1])
    first = int(np.searchsorted(spectrum.frequency_hz, lowest))
    ratio = spectrum.ratio[first:-1]
    if ratio.size < NEIGHBOURS // 4:
        return None
    step_hz = float(spectrum.frequency_hz[1])
    widths = [width for width in LINE_BINS if width == 1 or 8 * width <= ratio.size]
    found = []
    for width in widths:
        total = np.concatenate([[0.0], np.cumsum(ratio)])
        power = (total[width:] - total[:-width]) / width
        exact = max(spectrum.bin_freedom, spectrum.freedom_per_hz * width * step_hz)
        over = power / _neighbourhood(power, max(NEIGHBOURS, 8 * width), exact, spectrum)
        top = int(np.argmax(over))
        z = _counted(power_z(float(over[top]), tolerant(exact)), power.size * len(widths))
        found.append((z, width, top, float(power[top])))
    z, width, top, power_top = max(found)
    own = slice(max(first + top - 1, 0), first + top + width + 1)
    weight = np.maximum(spectrum.ratio[own] - LINE_FOOT * float(spectrum.ratio[own].max()), 0.0)
    frequency_hz = float(weight @ spectrum.frequency_hz[own] / max(float(weight.sum()), 1e-300))
    below = slice(1, first)
    certain = np.maximum(spectrum.ratio[below] - power_bound(CERTAIN_Z, spectrum.bin_freedom), 0.0)
    jump = float(np.max(certain * spectrum.frequency_hz[below] ** 2, initial=0.0))
    if (power_top - 1.0) * frequency_hz**2 < JUMP_MARGIN * jump:
        return None
    return Line("stall cells", frequency_hz, "residual", 1, z, width * step_hz)


def _counted(z: float, looks: int) -> float:
    """Return the z of the largest of so many looks, by Bonferroni's bound."""
    from scipy.special import log_ndtr, ndtri_exp

    return float(-ndtri_exp(min(float(log_ndtr(-z)) + math.log(looks), -1e-12)))


def _neighbourhood(power: FloatArray, bins: int, freedom: float, spectrum: Spectrum) -> FloatArray:
    """Return the level that a line stands on: medians of its neighbours, joined by lines."""
    parts = np.array_split(np.arange(power.size), max(power.size // bins, 1))
    level = np.interp(
        np.arange(power.size),
        [float(part.mean()) for part in parts],
        [float(np.median(power[part])) for part in parts],
    )
    return np.maximum(level / power_bound(0.0, freedom), max(spectrum.background, 1.0))


def _pieces(runs: tuple[slice, ...], known: BoolArray) -> tuple[list[slice], int]:
    """Return runs cut so that zeros after the short ones do not outgrow the data."""
    rows = sum(run.stop - run.start for run in runs)
    longest = max(run.stop - run.start for run in runs)
    size = 1 << max(longest - 1, 1).bit_length()
    while True:
        pieces = [
            slice(start, min(start + size, run.stop))
            for run in runs
            for start in range(run.start, run.stop, size)
        ]
        if len(pieces) * size <= MOST_PADDING * rows or size <= 2 * FEWEST_ROWS:
            break
        size //= 2
    pieces = [piece for piece in pieces if np.count_nonzero(known[piece]) >= FEWEST_ROWS]
    if not pieces:
        raise InputError(
            "scored",
            expected=f"a run with at least {FEWEST_ROWS} scored rows",
            found="none",
            remedy="give longer runs",
        )
    return pieces, size
