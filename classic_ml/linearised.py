"""A fitted lag model, linearised: its errors, their derivatives, and the fit without one cycle."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from classic_ml.lag_data import LagData, Terms
from classic_ml.likelihood import profile
from surge_core.leave_out import leave_out
from surge_core.segments import runs_of
from surge_core.types import FloatArray, IntArray

# Fewer segments are cut, so that the others can say what is usual: with six, clean records raise
# an alarm in 5 to 20 % of the cases instead of 1 to 3 %.
FEWEST_CYCLES = 10
PIECES = 12


@dataclass(frozen=True)
class LinearisedFit:
    """The errors of a fit and their derivatives."""

    errors: FloatArray  # (n,): Of the scored rows, times the root of their weights
    # (n, p): ∂e/∂θ, θ = (τ in seconds, coefficients of nearly orthogonal terms, drift, C)
    jacobian: FloatArray
    back: FloatArray  # (q, r): What turns those coefficients into β
    rows: IntArray  # (n,): Row of the data that each error belongs to
    pieces: tuple[slice, ...]  # Stretches of errors that follow each other without a gap
    segment: IntArray  # (n,): Number of the segment, from 0, of each error


def linearised(data: LagData, terms: Terms, shape: FloatArray, beta: FloatArray) -> LinearisedFit:
    """Linearise about given parameters; starts and drift are the best for these."""
    at = profile(data, shape, beta)
    both, n_shape = at.jacobian, at.n_shape
    # ∂e/∂τ from ∂e/∂log τ; a held τ does not move.
    fitted = int(data.held_log_tau is None)
    tau = both[:, :1] / np.exp(shape[0]) if fitted else np.zeros((both.shape[0], 1))
    keep = data.scored
    rows = data.rows_of_errors[keep]
    lengths = [run.stop - run.start for run in data.runs]
    segment = np.repeat(np.arange(len(lengths)), lengths)[rows]
    # Rows that follow each other within a segment have one such label.
    pieces = runs_of(rows - np.arange(rows.size) + 2 * segment * data.y.size, rows.size)
    return LinearisedFit(
        at.errors[keep],
        np.column_stack([tau, both[:, n_shape:], both[:, fitted:n_shape]])[keep],
        terms.back,
        rows,
        tuple(pieces),
        segment,
    )


@dataclass(frozen=True)
class CycleShifts:
    """How far each parameter of a linearised fit moves without each cycle.

    ``shift`` of shape (n_cycles, p) is θ without the cycle minus θ, ``spread`` its covariance for
    white errors of unit variance, (J'J - A_g)⁻¹ - (J'J)⁻¹; ``edges`` are the first and the last row
    of each cycle.
    """

    shift: FloatArray
    spread: FloatArray
    edges: IntArray

    def studentised(self, contrasts: FloatArray) -> FloatArray:
        """Return each shift over what shifts of the other cycles make usual.

        ``contrasts`` of shape (k, p) are linear functions of θ, e.g. τ alone or the curve at one φ.
        The result, of shape (n_cycles, k), is Student's t with ``n_cycles - 2`` degrees of freedom
        where all cycles are alike. The shift is scaled by what the cycle's share of the information
        predicts, so that a long cycle may move more than a short one; the common scale is that of
        the other cycles (externally studentised), so that coloured errors do not count against one.
        """
        moved = self.shift @ contrasts.T
        variance = np.einsum("ki,gij,kj->gk", contrasts, self.spread, contrasts)
        scaled = moved / np.sqrt(np.maximum(variance, np.finfo(np.float64).tiny))
        n = len(scaled)
        power = np.sum(scaled**2, axis=0)
        # One direction of the shifts is spent on the estimate itself: they add up to nothing.
        share = scaled**2 * n / (n - 1.0) / np.maximum(power, np.finfo(np.float64).tiny)
        left = np.maximum(1.0 - share, 1e-12)
        return np.asarray(np.sign(scaled) * np.sqrt(share * (n - 2.0) / left))


def cycle_shifts(fit: LinearisedFit) -> CycleShifts:
    """Leave out one cycle at a time: a segment each, but fewer than ten are cut into a dozen."""
    cycles = runs_of(fit.segment, fit.segment.size)
    if len(cycles) < FEWEST_CYCLES:
        parts = [max(1, round(PIECES * (c.stop - c.start) / fit.errors.size)) for c in cycles]
        cuts = [
            np.linspace(cycle.start, cycle.stop, n + 1).astype(int)
            for cycle, n in zip(cycles, parts, strict=True)
        ]
        cycles = [slice(*ends) for edges in cuts for ends in pairwise(edges) if ends[1] > ends[0]]
    rest = leave_out(fit.jacobian, fit.errors, cycles)
    nothing = leave_out(fit.jacobian, fit.errors, [slice(0, 0)])
    edges = fit.rows[[[cycle.start, cycle.stop - 1] for cycle in cycles]]
    return CycleShifts(rest.moves, rest.inverse - nothing.inverse, edges)
