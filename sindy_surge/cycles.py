"""Surge cycles seen in φ: their period, and blocks of rows that hold whole cycles."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from sindy_surge.covariance import block_slices
from sindy_surge.free_run import Segments
from surge_core.types import FloatArray, IndexArray

__all__ = ["cycle_blocks", "surge_period_s"]


# The range of φ without spikes. The band of the hysteresis is its middle third: about a standard
# deviation of a surge wave, more than rotating stall and noise make from peak to peak.
_RANGE = (0.02, 0.98)
_BAND = 1 / 3
# Surge repeats: of cycles that wander from 5 to 7 Hz all lie within 20 % of their median. The
# crossings of a random excitation spread over a decade, and 30-60 % of them lie within 30 %.
_NEAR_MEDIAN = 0.3
_SHARE_NEAR = 0.75
# With fewer rows within cycles, what was seen is flutter about the band.
_LEAST_COVERED = 0.05
_MOST_BLOCKS = 60


def surge_period_s(phi: FloatArray, segments: Segments, sample_period_s: float) -> float | None:
    """Return the median period of the surge cycles that φ shows.

    A cycle runs from one rise of φ through the middle third of its range to the next in the same
    segment.

    Parameters
    ----------
    phi : ndarray of shape (n_rows,) or (n_rows, n_inputs)
        φ; of several inputs the first.
    segments : Segments
        The runs of rows.
    sample_period_s : float
        Sample period in seconds.

    Returns
    -------
    float or None
        Period in seconds; None if no two cycles are seen, or what is seen does not repeat (a
        random excitation).
    """
    samples = _period(_rises(_first(phi), segments), segments)
    return None if samples is None else samples * sample_period_s


def cycle_blocks(
    phi: FloatArray, segments: Segments, sample_period_s: float, shortest: int
) -> list[slice]:
    """Cut the rows at whole surge cycles, for resampling or leaving out.

    Segments without a whole cycle stay whole; what shows no cycle for longer than two periods is
    cut evenly into about one period each. Beyond sixty blocks, adjacent ones of a segment are
    joined.

    Parameters
    ----------
    phi : ndarray of shape (n_rows,) or (n_rows, n_inputs)
        φ; of several inputs the first.
    segments : Segments
        The runs of rows.
    sample_period_s : float
        Sample period in seconds.
    shortest : int
        A shorter piece is joined to its neighbour in the segment.

    Returns
    -------
    list of slice
        The blocks in order; together all rows, none across two segments. Without cycles those
        of `block_slices`.
    """
    rises = _rises(_first(phi), segments)
    period = _period(rises, segments)
    if period is None:
        return block_slices(segments, shortest)
    edges = []
    for rows in segments.slices():
        inside = rises[(rises > rows.start) & (rises < rows.stop)]
        cuts = inside.tolist() if inside.size > 1 else []
        pieces = _filled([rows.start, *cuts, rows.stop], period)
        edges.append(_merged(pieces, shortest))
    together = -(-sum(len(e) - 1 for e in edges) // _MOST_BLOCKS)
    return [slice(a, b) for e in edges for a, b in pairwise(_joined(e, together))]


def _first(phi: FloatArray) -> FloatArray:
    return phi if phi.ndim == 1 else phi[:, 0]


def _rises(phi: FloatArray, segments: Segments) -> IndexArray:
    """Return the rows at which φ leaves the band upwards, having come from below it."""
    low, high = np.quantile(phi, _RANGE)
    middle, half = (low + high) / 2, _BAND * (high - low) / 2
    side = (phi > middle + half).astype(int) - (phi < middle - half).astype(int)
    outside = np.flatnonzero(side)
    home = _home(outside, segments)
    risen = (side[outside[1:]] > side[outside[:-1]]) & (home[1:] == home[:-1])
    found: IndexArray = outside[1:][risen]
    return found


def _home(rows: IndexArray, segments: Segments) -> IndexArray:
    """Return the number of each row's segment."""
    return np.searchsorted(segments.starts, rows, side="right").astype(np.intp)


def _period(rises: IndexArray, segments: Segments) -> float | None:
    home = _home(rises, segments)
    lengths = np.diff(rises)[home[1:] == home[:-1]]
    if lengths.size < 2:
        return None
    median = float(np.median(lengths))
    near = np.abs(lengths - median) <= _NEAR_MEDIAN * median
    covered = lengths.sum() >= _LEAST_COVERED * segments.n_rows
    return median if covered and near.mean() >= _SHARE_NEAR else None


def _filled(edges: list[int], period: float) -> list[int]:
    """Cut stretches longer than two periods evenly."""
    result = edges[:1]
    for start, stop in pairwise(edges):
        parts = round((stop - start) / period) if stop - start > 2 * period else 1
        result += np.linspace(start, stop, parts + 1)[1:].astype(int).tolist()
    return result


def _merged(edges: list[int], shortest: int) -> list[int]:
    """Drop the edges that would leave a piece shorter than allowed."""
    start, *inner, stop = edges
    kept = [start]
    for edge in inner:
        if edge - kept[-1] >= shortest and stop - edge >= shortest:
            kept.append(edge)
    return [*kept, stop]


def _joined(edges: list[int], together: int) -> list[int]:
    """Join so many adjacent pieces, evenly over the segment."""
    pieces = len(edges) - 1
    parts = -(-pieces // together)
    return [edges[i] for i in np.linspace(0, pieces, parts + 1).round().astype(int)]
