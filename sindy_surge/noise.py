"""White noise: its level, smoothing by it, and the exact whitening of the lag's equations."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import comb

import numpy as np

from sindy_surge.segments import Segments
from surge_core.autoregression import autoregression
from surge_core.lag import FirstOrderLag
from surge_core.types import FloatArray, IndexArray

_WIDTHS = (5, 7, 9, 11, 13, 15, 17, 21, 25, 31, 37, 45, 51, 71, 101)
_ORDER = 3


def smoothed(signal: FloatArray, noise: float) -> FloatArray:
    """Smooth a signal with white noise by local cubics whose width has the least estimated risk.

    Of a linear smoother S with centre weight s₀, mean (y - S y)² + 2 σ² s₀ - σ² estimates the mean
    squared error without bias (Stein); σ is the standard deviation of the noise.
    """
    from scipy.signal import savgol_coeffs, savgol_filter

    best, least = signal, noise**2
    for width in _WIDTHS:
        if width > signal.size:
            break
        trial = savgol_filter(signal, width, _ORDER)
        centre = float(savgol_coeffs(width, _ORDER)[width // 2])
        risk = float(np.mean((signal - trial) ** 2)) + (2 * centre - 1) * noise**2
        if risk < least:
            best, least = trial, risk
    return best


# The least noise assumed is that of a 12-bit converter whose range is five standard deviations,
# 5 / 4096 / √12: below it, rounding and interpolation would ask for terms.
_RELATIVE_FLOOR = 3.5e-4
_CONTRADICTION = 9.0


@dataclass(frozen=True)
class NoiseLevels:
    """Standard deviations of the white measurement noise and, if any, its colour."""

    output: float  # Noise of ψ'
    inputs: FloatArray  # (n_inputs,): Noise of each input
    # Autoregressive coefficients of what the whitening leaves; empty for white noise
    colour: FloatArray


def difference_noise(signal: FloatArray, segments: Segments, order: int = 4) -> float:
    """Estimate the white noise of a smooth signal from its differences of an even order.

    The median of their absolute values, which passes over jumps. 0 if no segment is longer than
    the order.
    """
    pieces = [np.diff(signal[rows], order) for rows in segments.slices()]
    differences = np.concatenate(pieces) if pieces else np.empty(0)
    if differences.size == 0:
        return 0.0
    size = 0.6745 * np.sqrt(float(comb(2 * order, order)))
    return float(np.median(np.abs(differences)) / size)


class Whitener:
    """Whitens the equations A e = A v - B D n of one fit (v, n white).

    With A e[k] = p[k] e[k] - q[k] e[k-1] (1 and a for a linear lag), and n entering through the
    taps t_i of the hold and the slope d of ψ'_QS, the covariance of A e has the band
    σ_ψ²(p[k]² + q[k]²) + σ_φ² Σ t_i² d[k-i]² on the diagonal, -σ_ψ² p[k] q[k+1] + σ_φ² Σ t_i t_i+1
    d[k-i]² beside it, and for a fraction of a sample of dead time one more. One banded
    Cholesky factor whitens a column in O(N). Leaving out the first row of each run is the
    same as a free initial state.

    ``slopes`` (n_inputs, n_rows) are d along the record, ``rows`` those of the record that are
    usable, in runs ``segments``; ``ahead`` and ``behind`` are p and q of each equation, or of all,
    and ``doubt`` is the standard deviation of what single equations are wrong by beside the noise.
    """

    def __init__(
        self,
        lag: FirstOrderLag,
        slopes: FloatArray,
        noise: NoiseLevels,
        segments: Segments,
        rows: IndexArray,
        ahead: FloatArray | float,
        behind: FloatArray | float,
        doubt: FloatArray | float = 0.0,
    ) -> None:
        from scipy.linalg import cholesky_banded

        later = segments.later
        at = rows[later] - lag.whole_samples
        p, q = np.broadcast_to(ahead, later.size), np.broadcast_to(behind, later.size)
        carried = (noise.inputs[:, None] ** 2 * slopes**2).sum(axis=0)
        # Keeps the factor exact to eight digits even about a wild intermediate characteristic. A
        # hinge that few rows see would otherwise grow with the doubt that it makes of them.
        carried = np.minimum(carried, 1e8 * noise.output**2)
        doubt = np.minimum(doubt, 1e4 * noise.output)
        taps = lag.taps[0] if lag.taps[0, 2] else lag.taps[0, :2]
        band = np.zeros((taps.size, later.size))
        for apart in range(taps.size):
            linked = np.arange(later.size - apart)
            linked = linked[later[linked + apart] - later[linked] == apart]
            for i in range(taps.size - apart):
                band[apart, linked] += taps[i] * taps[i + apart] * carried[at[linked] - i]
        band[0] += noise.output**2 * (p**2 + q**2) + doubt**2
        joined = np.diff(later) == 1
        band[1, :-1] -= np.where(joined, noise.output**2 * p[:-1] * q[1:], 0.0)
        self._factor = cholesky_banded(band, lower=True)
        self._colour = noise.colour
        first = np.flatnonzero(np.concatenate(([True], ~joined)))
        stops = np.append(first[1:], later.size).astype(np.intp)
        self.equation_segments = Segments(first, stops)
        # An autoregression of order q has no residual for the first q rows of a segment.
        self.kept = np.flatnonzero(self.equation_segments.offsets() >= noise.colour.size)

    @property
    def groups(self) -> Segments:
        """The runs of the whitened rows."""
        lengths = np.maximum(self.equation_segments.lengths - self._colour.size, 0)
        stops = np.cumsum(lengths[lengths > 0])
        return Segments(stops - lengths[lengths > 0], stops)

    def __call__(self, columns: FloatArray) -> FloatArray:
        """Whiten vectors over the equations, one a column; fewer rows if the noise is coloured."""
        from scipy.linalg.lapack import dtbtrs

        white = dtbtrs(self._factor, columns, uplo="L")[0].reshape(columns.shape)
        if self._colour.size == 0:
            return np.asarray(white)
        filtered = white.copy()
        for lag, coefficient in enumerate(self._colour, start=1):
            # Rows that would reach into the segment before are dropped below.
            filtered[lag:] -= coefficient * white[:-lag]
        return np.asarray(filtered[self.kept])

    def precision(self, column: FloatArray) -> FloatArray:
        """Apply the inverse covariance of the white part to one vector over the equations."""
        from scipy.linalg import cho_solve_banded

        return np.asarray(cho_solve_banded((self._factor, True), column))

    def log_determinant(self) -> float:
        """Return the logarithm of the determinant of the covariance."""
        return float(2 * np.log(self._factor[0]).sum())


def refine_noise(
    residual: FloatArray,
    lag: FirstOrderLag,
    slopes: FloatArray,
    guess: NoiseLevels,
    segments: Segments,
    rows: IndexArray,
    output_scale: float,
) -> NoiseLevels:
    """Split the residual A e of a fit with all terms between the noise of ψ' and of the inputs.

    Fourth differences count a truly rough signal (a random excitation) as noise; the residual
    does not. So the ratio of the two levels and their common scale maximise the likelihood
    of the residual, and the fourth differences are only the upper limit. See `Whitener` for the
    other parameters; `output_scale` is the standard deviation of ψ'.
    """
    from scipy.optimize import minimize_scalar

    n = residual.size
    tiny = _RELATIVE_FLOOR * output_scale
    unit = NoiseLevels(max(guess.output, tiny), guess.inputs, np.empty(0))

    def level(log_ratio: float) -> tuple[float, float]:
        trial = replace(unit, inputs=unit.inputs * np.exp(log_ratio))
        white = Whitener(lag, slopes, trial, segments, rows, 1.0, lag.a)
        variance = float(np.mean(white(residual) ** 2))
        return n * np.log(max(variance, 1e-300)) + white.log_determinant(), variance

    best = minimize_scalar(
        lambda v: level(v)[0], bounds=(-5.0, 5.0), method="bounded", options={"xatol": 0.05}
    )
    # The residual shows the ratio of the levels to 15 % on a record of 5 s, differences to 3 %:
    # they are believed until the residual contradicts them by three standard errors.
    log_ratio = 0.0 if level(0.0)[0] < best.fun + _CONTRADICTION else float(best.x)
    scale = float(np.sqrt(level(log_ratio)[1]))
    # Twice the sampling error of a median over n correlated differences, about 2/√n.
    top = 1 + 4 / np.sqrt(n)
    inputs = unit.inputs * min(float(np.exp(log_ratio)) * scale, top)
    # Without any noise of ψ' a record whose ψ' is exact makes the covariance singular wherever
    # the characteristic is flat: at least a tenth of what the lag passes of the inputs' noise,
    # whose variance it multiplies by (1 - a)/(1 + a).
    carried = float((inputs[:, None] ** 2 * slopes**2).sum(axis=0).mean())
    passed = carried * (1 - lag.a) / (1 + lag.a)
    output = max(min(scale, top) * unit.output, 0.1 * float(np.sqrt(passed)), tiny)
    return NoiseLevels(output, inputs, np.empty(0))


def colour_of(white: FloatArray, groups: Segments) -> FloatArray:
    """Return the autoregression that BIC finds in whitened residuals of the runs; none if white."""
    pieces = [white[rows] for rows in groups.slices() if rows.stop - rows.start > 1]
    if not pieces:
        return np.empty(0)
    return autoregression(pieces, min(4, int(np.median([p.size for p in pieces])) // 10))[0]
