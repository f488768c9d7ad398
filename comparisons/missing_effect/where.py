"""Where the residual of a free run stands out: time, frequency, flow, cycle phase, regime.

Every number is a weighted sum or a power of the residual whose law under the floor's noise is
known, coloured noise included, and one bound that counts how many were looked at holds for all.
Outliers are held back before anything is judged, so that heavy tails are not taken for
structure; the means and rms values that are stated are those of the residual as it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from comparisons.missing_effect.where_cycles import Blocks, Cycles, blocks_of, cycles_of, falls
from comparisons.missing_effect.where_noise import (
    FloorNoise,
    SlowPart,
    floor_noise,
    held_back,
    power_bound,
    power_z,
    tolerant,
)
from comparisons.missing_effect.where_rows import (
    FlowRow,
    FrequencyRow,
    Line,
    PhaseRow,
    RegimeRow,
    ResidualRuns,
    TimeRow,
    Where,
)
from comparisons.missing_effect.where_spectrum import (
    HARMONICS,
    Spectrum,
    band_edges,
    floor_spectra,
    narrow_line,
)
from comparisons.missing_effect.where_words import describe
from surge_core.errors import InputError
from surge_core.types import BoolArray, FloatArray
from surge_core.validation import positive

__all__ = ["ResidualRuns", "Where", "localise"]

# Chance that anything at all is said to stand out of pure noise.
FALSE_ALARM = 0.005
FEWEST_ROWS = 10
FEWEST_SCORED = 40
OCTILES = 8
PHASES = 12
# Of a mean in which nothing is left once the slow part is out.
NOTHING_LEFT = 1e-3
CLOCK_TOLERANCE = 0.05


def localise(
    data: ResidualRuns,
    floor_rms: float,
    *,
    whitening: FloatArray | None = None,
    block_s: float | None = None,
    cells_hz: float | None = None,
) -> Where:
    """Return where a residual stands out of the measurement noise.

    Parameters
    ----------
    data : ResidualRuns
        The residual of the free run.
    floor_rms : float
        rms of the measurement noise, in the unit of the residual.
    whitening : ndarray of shape (p,), optional
        Coefficients a of the noise, e[k] = Σ aᵢ e[k−i] + white; without it the noise is white.
    block_s : float, optional
        Length of a block of time, in seconds; else two surge cycles or a twelfth of the longest
        record, whichever is longer.
    cells_hz : float, optional
        Frequency of the rotating-stall cells, where known.

    Returns
    -------
    Where
        Rows of each panel, and words. z of a mean w·e is w·e / √(wᵀ Γ w) with Γ the covariance
        of the floor's noise; z of a power is that of a χ². Flow and phase are looked at without
        what is slower than a block, so that a drift is not taken for them. The bound on all z is
        Bonferroni's, at a false alarm of 0.5 % for the whole.

    Raises
    ------
    InputError
        When arrays do not match, fewer than 40 rows are scored, the floor is not positive, the
        noise is not stationary, or every record is shorter than a block.
    """
    positive("floor_rms", floor_rms)
    for name, value in (("block_s", block_s), ("cells_hz", cells_hz)):
        if value is not None:
            positive(name, value)
    inside = _checked(data)
    scored = data.scored & inside
    noise = floor_noise(floor_rms, whitening, data.runs, data.residual.size)
    cycles = tuple(cycles_of(data, inside, r) for r in range(len(data.record_names)))
    blocks = blocks_of(data, scored, cycles, block_s)
    slow = SlowPart.over(blocks.rows, blocks.block, data.time_s[blocks.rows], blocks.record)
    residual = np.where(scored, data.residual, 0.0)
    held = held_back(residual, scored, floor_rms)
    innovations, known = _innovations(noise, held, scored)
    fast, _ = _innovations(noise, slow.without(held), scored)
    spectra = floor_spectra(
        (innovations, fast), known, data.runs, noise.innovation_rms, data.sample_rate_hz
    )
    background = max(spectra[1].background, 1.0)
    judge = _Judge(
        residual, held, innovations, known, noise, slow, background, _spread(innovations[known])
    )
    surge_hz = np.array([c.frequency_hz for c in cycles if math.isfinite(c.frequency_hz)])
    edges = _edges(data, surge_hz, blocks)
    time = _time_rows(data, judge, blocks, floor_rms)
    flow, split = _flow_rows(data, judge, scored, falls(data, cycles))
    phase = _phase_rows(judge, scored, cycles)
    regime = _regime_rows(data, judge, cycles, scored, floor_rms)
    line = narrow_line(spectra[1], edges, surge_hz)
    judged = [z for row in time for z in (row.z_mean, row.z_variance)]
    judged += [*(row.z for row in flow), split.z, *(row.z for row in phase)]
    if len(regime) > 1:
        judged += [z for row in regime for z in (row.z_mean, row.z_variance)]
    looks = int(np.count_nonzero(np.isfinite(judged))) + edges.size - 1 + (line is not None)
    bound = _bound(looks)
    lines = _lines(data, surge_hz, cells_hz, line if line and line.z > bound else None)
    where = Where(
        time=time,
        frequency=_frequency_rows(spectra, edges, background, lines, bound),
        flow=flow,
        phase=phase,
        regime=regime,
        lines=lines,
        spectrum_hz=spectra[0].frequency_hz,
        spectrum_ratio=np.where(
            spectra[0].frequency_hz < edges[1], spectra[0].ratio, spectra[1].ratio
        ),
        direction_means=split.means,
        direction_z=split.z,
        floor_rms=float(floor_rms),
        background=math.sqrt(spectra[1].background),
        effective_share=noise.effective_share,
        looks=looks,
        bound_z=bound,
    )
    return replace(where, words=describe(where))


@dataclass(frozen=True)
class _Split:
    """Mean residual while φ falls and while it rises, and z of their difference."""

    means: tuple[float, float]
    z: float


@dataclass(frozen=True)
class _Judge:
    """A residual, and the law that its means and powers follow by chance.

    Parameters
    ----------
    residual, held : ndarray of shape (n,)
        As it is, and with outliers held back; 0 in rows that are not scored.
    innovations : ndarray of shape (n,)
        What the floor's autoregression leaves of it.
    known : ndarray of bool, shape (n,)
        Rows with innovations.
    noise : FloorNoise
        The floor's noise.
    slow : SlowPart
        What is slower than a block.
    background : float
        Power of the noise over that of the floor, at least 1.
    spread : float
        Variance of a squared innovation over its mean squared: 2 if normal, more if not.
    """

    residual: FloatArray
    held: FloatArray
    innovations: FloatArray
    known: BoolArray
    noise: FloorNoise
    slow: SlowPart
    background: float
    spread: float

    def weighted(self, weights: FloatArray) -> tuple[float, float, float]:
        """Return a weighted sum of the residual, its standard error and z."""
        variance = self.background * self.noise.sum_variance(weights)
        if not variance > 0.0:
            return math.nan, math.nan, math.nan
        stderr = math.sqrt(variance)
        return (
            float(weights @ self.residual),
            stderr,
            float(weights @ self.held) / stderr,
        )

    def mean(self, cell: BoolArray) -> tuple[float, float, float, int]:
        """Return mean, standard error, z and rows of a cell, the slow part out."""
        n = int(np.count_nonzero(cell))
        weights = self.slow.weights(cell.astype(np.float64)) if n >= FEWEST_ROWS else np.zeros(0)
        if n < FEWEST_ROWS or float(weights @ weights) < NOTHING_LEFT * n:
            return math.nan, math.nan, math.nan, n
        return (*self.weighted(weights / n), n)

    def contrast(self, one: BoolArray, other: BoolArray) -> _Split:
        """Return the means of two sets of rows, the slow part out, and z of their difference."""
        first, second = self.mean(one), self.mean(other)
        if not math.isfinite(first[2]) or not math.isfinite(second[2]):
            return _Split((first[0], second[0]), math.nan)
        weights = self.slow.weights(one / first[3] - other / second[3])
        return _Split((first[0], second[0]), self.weighted(weights)[2])

    def mean_z(self, cell: BoolArray) -> float:
        """Return z of the mean of some rows, the slow part in."""
        return self.weighted(cell.astype(np.float64))[2]

    def variance_z(self, cell: BoolArray) -> float:
        """Return z of the innovations' variance about their mean against the noise's."""
        own = self.innovations[cell & self.known]
        if own.size < FEWEST_ROWS:
            return math.nan
        ratio = float(np.var(own, ddof=1)) / (self.background * self.noise.innovation_rms**2)
        return power_z(ratio, tolerant((own.size - 1) * 2.0 / self.spread))


def _innovations(
    noise: FloorNoise, values: FloatArray, scored: BoolArray
) -> tuple[FloatArray, BoolArray]:
    left, known = noise.innovations(values, scored)
    return held_back(left, known, noise.innovation_rms), known


def _time_rows(
    data: ResidualRuns, judge: _Judge, blocks: Blocks, floor_rms: float
) -> tuple[TimeRow, ...]:
    rows = []
    for number, record in enumerate(blocks.record.tolist()):
        cell = np.zeros(data.residual.size, dtype=bool)
        cell[blocks.rows[blocks.block == number]] = True
        rms = _rms(judge.residual[cell])
        rows.append(
            TimeRow(
                data.record_names[record],
                float(blocks.from_s[number]),
                float(blocks.to_s[number]),
                int(np.count_nonzero(cell)),
                float(np.mean(judge.residual[cell])),
                rms,
                math.sqrt(max(rms**2 - floor_rms**2, 0.0)),
                judge.mean_z(cell),
                judge.variance_z(cell),
            )
        )
    return tuple(rows)


def _frequency_rows(
    spectra: tuple[Spectrum, ...],
    edges: FloatArray,
    background: float,
    lines: tuple[Line, ...],
    bound: float,
) -> tuple[FrequencyRow, ...]:
    # The slowest band is the slow part's; it is out of the others, where gaps would spread it.
    found = [
        spectra[min(number, 1)].band(low, high)
        for number, (low, high) in enumerate(pairwise(edges.tolist()))
    ]
    excess = [
        max(ratio - 1.0, 0.0) * width
        for (ratio, _), width in zip(found, np.diff(edges), strict=True)
    ]
    rows = []
    for number, (ratio, exact) in enumerate(found):
        low, high = float(edges[number]), float(edges[number + 1])
        freedom = tolerant(exact)
        held = {line.name for line in lines if low <= line.frequency_hz < high}
        rows.append(
            FrequencyRow(
                low,
                high,
                ratio,
                background * power_bound(bound, freedom),
                float(excess[number] / max(sum(excess), 1e-300)),
                power_z(ratio / background, freedom),
                tuple(sorted(held, reverse=True)),
            )
        )
    return tuple(rows)


def _flow_rows(
    data: ResidualRuns, judge: _Judge, scored: BoolArray, falling: BoolArray
) -> tuple[tuple[FlowRow, ...], _Split]:
    edges = np.quantile(data.phi[scored], np.linspace(0.0, 1.0, OCTILES + 1))
    octile = np.clip(np.searchsorted(edges, data.phi, side="right") - 1, 0, OCTILES - 1)
    ways = (("falling", scored & falling), ("rising", scored & ~falling))
    rows = tuple(
        FlowRow(
            float(edges[number]),
            float(edges[number + 1]),
            way,
            *judge.mean(travelling & (octile == number)),
        )
        for way, travelling in ways
        for number in range(OCTILES)
    )
    return rows, judge.contrast(ways[0][1], ways[1][1])


def _phase_rows(
    judge: _Judge, scored: BoolArray, cycles: tuple[Cycles, ...]
) -> tuple[PhaseRow, ...]:
    if not any(math.isfinite(c.frequency_hz) for c in cycles):
        return ()
    part = np.full(scored.size, -1)
    for own in cycles:
        seen = scored & np.isfinite(own.phase)
        part[seen] = np.minimum((own.phase[seen] * PHASES).astype(int), PHASES - 1)
    return tuple(
        PhaseRow(number / PHASES, (number + 1) / PHASES, *judge.mean(part == number))
        for number in range(PHASES)
    )


def _regime_rows(
    data: ResidualRuns,
    judge: _Judge,
    cycles: tuple[Cycles, ...],
    scored: BoolArray,
    floor_rms: float,
) -> tuple[RegimeRow, ...]:
    rows = []
    for number, name in enumerate(data.record_names):
        cell = scored & (data.record == number)
        if not cell.any():
            continue
        phi, rms = data.phi[cell], _rms(judge.residual[cell])
        rows.append(
            RegimeRow(
                name,
                float(np.mean(phi)),
                math.sqrt(2.0) * float(np.std(phi)),
                cycles[number].frequency_hz,
                float(np.mean(judge.residual[cell])),
                rms,
                rms / floor_rms,
                judge.mean_z(cell),
                judge.variance_z(cell),
            )
        )
    return tuple(rows)


def _lines(
    data: ResidualRuns, surge_hz: FloatArray, cells_hz: float | None, found: Line | None
) -> tuple[Line, ...]:
    highest = 0.5 * data.sample_rate_hz
    lines = [
        Line("surge", float(harmonic * frequency), "flow", harmonic)
        for frequency in surge_hz
        for harmonic in range(1, HARMONICS + 1)
        if harmonic * frequency < highest
    ]
    if cells_hz is not None:
        lines.append(Line("stall cells", float(cells_hz), "given"))
    return tuple(lines if found is None else [*lines, found])


def _edges(data: ResidualRuns, surge_hz: FloatArray, blocks: Blocks) -> FloatArray:
    lengths = np.sort([run.stop - run.start for run in data.runs])
    # The run in which the median row lies.
    typical = lengths[np.searchsorted(np.cumsum(lengths), 0.5 * lengths.sum())]
    slow_hz = 1.0 / float(np.median(blocks.to_s - blocks.from_s))
    return band_edges(data.sample_rate_hz, surge_hz, slow_hz, float(typical) / data.sample_rate_hz)


def _bound(looks: int) -> float:
    from scipy.special import ndtri

    return -float(ndtri(0.5 * FALSE_ALARM / looks))


def _spread(innovations: FloatArray) -> float:
    squares = innovations**2
    mean = float(np.mean(squares))
    return max(float(np.var(squares)) / mean**2, 2.0) if mean > 0.0 else 2.0


def _rms(values: FloatArray) -> float:
    return math.sqrt(float(np.mean(values**2)))


def _checked(data: ResidualRuns) -> BoolArray:
    """Return the rows that belong to a run, or refuse the data."""
    positive("sample_rate_hz", data.sample_rate_hz)
    n = data.residual.size
    for name in ("residual", "phi", "time_s", "record", "scored"):
        shape = np.shape(getattr(data, name))
        if shape != (n,):
            raise InputError(name, expected=f"one value for each of {n} rows", found=f"{shape}")
    for name, kind, word in (("scored", "b", "booleans"), ("record", "iu", "whole numbers")):
        found = np.asarray(getattr(data, name)).dtype
        if found.kind not in kind:
            raise InputError(name, expected=word, found=f"{found}")
    inside = np.zeros(n, dtype=bool)
    last = 0
    for run in data.runs:
        if not last <= run.start < run.stop <= n:
            raise InputError(
                "runs", expected=f"slices of {n} rows, in order, none empty", found=f"{run}"
            )
        inside[run], last = True, run.stop
        if np.ptp(data.record[run]) or not 0 <= data.record[run.start] < len(data.record_names):
            raise InputError(
                "record",
                expected=f"one number below {len(data.record_names)} in each run",
                found=f"others in {run}",
            )
    if not data.runs:
        raise InputError("runs", expected="at least one", found="none")
    scored = int(np.count_nonzero(data.scored & inside))
    if scored < FEWEST_SCORED:
        raise InputError(
            "scored",
            expected=f"at least {FEWEST_SCORED} scored rows",
            found=f"{scored}",
            remedy="give a longer record",
        )
    for name, values, rows in (
        ("residual", data.residual, data.scored & inside),
        ("phi", data.phi, inside),
        ("time_s", data.time_s, inside),
    ):
        if not np.all(np.isfinite(values[rows])):
            raise InputError(
                name, expected="finite values where rows count", found="some that are not"
            )
    _check_clock(data, inside)
    return inside


def _check_clock(data: ResidualRuns, inside: BoolArray) -> None:
    for run in data.runs:
        steps = np.diff(data.time_s[run]) * data.sample_rate_hz
        if steps.size and float(np.max(np.abs(steps - 1.0))) > CLOCK_TOLERANCE:
            raise InputError(
                "time_s",
                expected=f"steps of 1/{data.sample_rate_hz:g} s within a run",
                found=f"{np.min(steps):.3g} to {np.max(steps):.3g} times that",
                remedy="cut runs at gaps",
            )
    for number, name in enumerate(data.record_names):
        if np.any(np.diff(data.time_s[inside & (data.record == number)]) <= 0.0):
            raise InputError(
                "time_s", expected="a clock that runs on from run to run", found=f"not in {name}"
            )
