"""A record and the lag model that is to predict it: stretches, drift, nearly orthogonal terms.

And what the fit takes the error of ψ' to be: arx, armax or output error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from surge_core.errors import InputError
from surge_core.lag import FirstOrderLag, Hold
from surge_core.segments import scored_pieces
from surge_core.types import BoolArray, FloatArray, IntArray

NoiseKind = Literal["arx", "armax", "output-error"]
NOISE_KINDS: tuple[NoiseKind, ...] = ("arx", "armax", "output-error")
MAXIMUM_ORDER = 2


@dataclass(frozen=True)
class MovingAverage:
    """The polynomial C(q) = 1 + c₁q⁻¹ + c₂q⁻² of an armax error, invertible by construction.

    The partial coefficients are κ = tanh ρ, and c₁ = κ₁(1 + κ₂), c₂ = κ₂ (Barndorff-Nielsen and
    Schou 1973), so that every ρ gives roots inside the unit circle and the whitening filter 1/C
    never blows up.
    """

    free: FloatArray  # (order,): Unbounded parameters ρ

    @classmethod
    def from_coefficients(cls, c: FloatArray) -> MovingAverage:
        """Build from c₁ (and c₂), clipped to the invertible region."""
        c = np.asarray(c, dtype=np.float64)
        # tanh(3) = 0.995: a start closer to the unit circle has no gradient left to move by.
        limit = np.tanh(3.0)
        partial = c.copy()
        if c.size == MAXIMUM_ORDER:
            partial[1] = np.clip(c[1], -limit, limit)
            partial[0] = c[0] / (1.0 + partial[1])
        return cls(np.arctanh(np.clip(partial, -limit, limit)))

    @property
    def order(self) -> int:
        """Degree of C."""
        return int(self.free.size)

    @property
    def coefficients(self) -> FloatArray:
        """c₁ … c_order."""
        partial = np.tanh(self.free)
        if self.order == MAXIMUM_ORDER:
            return np.array([partial[0] * (1.0 + partial[1]), partial[1]])
        return np.asarray(partial, dtype=np.float64)

    @property
    def jacobian(self) -> FloatArray:
        """∂c/∂ρ, of shape (order, order)."""
        partial = np.tanh(self.free)
        slope = 1.0 - partial**2
        if self.order == MAXIMUM_ORDER:
            upper = [slope[0] * (1.0 + partial[1]), partial[0] * slope[1]]
            return np.array([upper, [0.0, slope[1]]])
        return np.diag(slope)

    @property
    def largest_root(self) -> float:
        """Largest modulus of the roots of C: how fast the filter 1/C forgets."""
        return float(np.max(np.abs(np.roots([1.0, *self.coefficients])), initial=0.0))

    def whiten(self, rows: FloatArray) -> FloatArray:
        """Return C(q)⁻¹ of the equation errors of one stretch, of shape (n,) or (n, p)."""
        if self.order == 0 or rows.shape[0] == 0:
            return rows
        from scipy.signal import lfilter

        return np.asarray(lfilter([1.0], [1.0, *self.coefficients], rows, axis=0))

    def reach(self, n_rows: int) -> FloatArray:
        """Return what the errors before a stretch add to its equations, the oldest error first.

        e[0] adds c₁ to the first equation and c₂ to the second, e[-1] adds c₂ to the first.
        """
        from scipy.linalg import toeplitz

        newest_last = self.coefficients[::-1]
        first = np.zeros(n_rows)
        first[:1] = newest_last[:1]
        return np.asarray(toeplitz(first, newest_last))


# A knot every other row leaves nothing for the lag to explain.
FEWEST_ROWS_A_KNOT = 4
# Up to here the eigenvectors of the Gram matrix keep half of all digits; beyond, QR is called.
MILD = 1e-8
# Values of the hats at all rows: 0.8 GB.
MOST_VALUES = 100_000_000


@dataclass(frozen=True)
class Terms:
    """Combinations of the terms of a characteristic, of mean square one, no two alike.

    ``columns`` of shape (n, r) are ``terms @ back``; ``back`` of shape (q, r) turns their
    coefficients into those of the terms.
    """

    columns: FloatArray
    back: FloatArray

    @property
    def deficient(self) -> bool:
        """Whether some terms are copies of others within rounding."""
        return bool(self.back.shape[1] < self.back.shape[0])


def nearly_orthogonal(terms: FloatArray) -> Terms:
    """Return nearly orthogonal combinations of the terms, so that inner products keep digits."""
    n, q = terms.shape
    gram = terms.T @ terms
    scale = np.sqrt(np.diag(gram))
    scale[scale == 0.0] = 1.0
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    kept = np.ones(q, dtype=np.bool_)
    if q and values[0] < MILD * max(values[-1], 1e-300):
        triangle = np.linalg.qr(terms / scale, mode="r")
        _, singular, right = np.linalg.svd(triangle)
        kept = singular > max(max(n, 1000) * np.finfo(np.float64).eps * singular[0], 1e-300)
        vectors, values = right[: singular.size].T, singular**2
    back = vectors[:, kept] / np.sqrt(values[kept]) / scale[:, None] * np.sqrt(n)
    # Transposed, so that each column lies in one piece of memory.
    return Terms((back.T @ terms.T).T, back)


def drift_of_runs(
    runs: Sequence[slice], weight: FloatArray, sample_period_s: float, knot_spacing_s: float
) -> FloatArray:
    """Return the columns of a continuous piecewise-linear drift of zero weighted mean.

    A hat at each knot of each run but the last, less its mean: the coefficients are the levels at
    the knots above that at the last. The time between two runs is not known, so each drifts on its
    own: as a spline where it is longer than the knots are apart, else as one level. Knots 0.25 to
    2 s apart serve equally well where the lag is tens of milliseconds.
    """
    from scipy.linalg import block_diag

    if knot_spacing_s < FEWEST_ROWS_A_KNOT * sample_period_s:
        raise InputError(
            "knot_spacing_s",
            expected=f"at least {FEWEST_ROWS_A_KNOT} sample periods of {sample_period_s:g} s",
            found=f"{knot_spacing_s:g} s",
            remedy="raise knot_spacing_s to many times the time constant",
        )
    lengths = [run.stop - run.start for run in runs]
    intervals = [round((n - 1) * sample_period_s / knot_spacing_s) for n in lengths]
    n_knots = sum(intervals) + len(runs)
    if n_knots * weight.size > MOST_VALUES:
        raise InputError(
            "knot_spacing_s",
            expected=f"at most {MOST_VALUES // weight.size} knots over {weight.size} rows",
            found=f"{n_knots}",
            remedy="raise knot_spacing_s or shorten the record",
        )
    parts = []
    for n, count in zip(lengths, intervals, strict=True):
        place = np.arange(n) * (count / max(n - 1, 1))
        parts.append(np.maximum(1.0 - np.abs(place[:, None] - np.arange(count + 1)), 0.0))
    hats = block_diag(*parts)
    return np.asarray((hats - weight @ hats / weight.sum())[:, :-1])


@dataclass(frozen=True)
class Piece:
    """Rows predicted as one, and the place of their errors, those ahead of the piece included."""

    rows: slice
    errors: slice


@dataclass(frozen=True)
class LagData:
    """A record and the model that is to predict it, as the parameters of `LagRegressor` say.

    ``y`` of shape (n,) is ψ' as measured, ``terms`` of shape (n, r) the terms of the
    characteristic. Rows of ``weight`` 0 are simulated through, not scored; no equation straddles
    two ``runs``. ``order`` is the degree of C; ``held_log_tau`` is log τ where it is not fitted.
    With ``knot_spacing_s`` there is a slow drift of zero mean: the constant belongs to the
    characteristic.
    """

    y: FloatArray
    terms: FloatArray
    weight: FloatArray
    runs: tuple[slice, ...]
    sample_period_s: float
    hold: Hold
    noise: NoiseKind
    order: int = 0
    exact_start: bool = True
    held_log_tau: float | None = None
    knot_spacing_s: float | None = None

    @cached_property
    def drift(self) -> FloatArray:
        """Columns of the drift, of shape (n, d); none without one."""
        if self.knot_spacing_s is None:
            return np.zeros((self.y.size, 0))
        return drift_of_runs(self.runs, self.weight, self.sample_period_s, self.knot_spacing_s)

    @property
    def is_output_error(self) -> bool:
        """Whether the free run is fitted."""
        return self.noise == "output-error"

    @property
    def ahead(self) -> int:
        """Scored errors before each stretch."""
        return 0 if self.is_output_error or not self.exact_start else self.order

    @cached_property
    def free(self) -> BoolArray:
        """Which of [log τ, ρ] are fitted."""
        moves = [self.held_log_tau is None, *[True] * self.order]
        return np.array(moves, dtype=np.bool_)

    @property
    def log_tau_bounds(self) -> tuple[float, float]:
        """Range of log τ that is searched."""
        longest = max(run.stop - run.start for run in self.runs)
        low = 0.02 * self.sample_period_s
        return float(np.log(low)), float(np.log(20.0 * longest * self.sample_period_s))

    @cached_property
    def pieces(self) -> tuple[Piece, ...]:
        """The stretches that are predicted as one.

        For output error a stretch is a run; an equation looks one row back, so that a row of
        weight 0 ends a stretch and the next begins one row behind it.
        """
        found: list[Piece] = []
        at = 0
        for run in self.runs:
            if self.is_output_error:
                stretches = [run] if np.any(self.weight[run] > 0.0) else []
            else:
                stretches = [slice(s.start + 1, s.stop) for s in scored_pieces(self.weight, run)]
            for rows in stretches:
                stop = at + self.ahead + rows.stop - rows.start
                found.append(Piece(rows, slice(at, stop)))
                at = stop
        return tuple(found)

    @cached_property
    def rows_of_errors(self) -> IntArray:
        """Row of each error; that of the first behind it for errors ahead of a piece."""
        ahead = [np.full(self.ahead, piece.rows.start) for piece in self.pieces]
        rows = [np.arange(piece.rows.start, piece.rows.stop) for piece in self.pieces]
        parts = [part for pair in zip(ahead, rows, strict=True) for part in pair]
        return np.concatenate([*parts, np.zeros(0, dtype=np.int64)]).astype(np.int64)

    @cached_property
    def ahead_places(self) -> IntArray:
        """Places of the errors ahead of the pieces."""
        begins = [piece.errors.start for piece in self.pieces]
        return np.add.outer(begins, np.arange(self.ahead)).astype(np.int64).ravel()

    @cached_property
    def root(self) -> FloatArray:
        """Square root of the weight of each error."""
        return np.asarray(np.sqrt(self.weight[self.rows_of_errors]))

    @cached_property
    def scored(self) -> IntArray:
        """Places of the errors that count."""
        return np.flatnonzero(self.root > 0.0)

    @property
    def piece_lengths(self) -> IntArray:
        """Scored errors of each piece."""
        ends = [0, *(piece.errors.stop for piece in self.pieces)]
        return np.diff(np.searchsorted(self.scored, ends)).astype(np.int64)

    def n_parameters(self, n_terms: int) -> int:
        """Return the number of fitted parameters with so many terms, starts of pieces included."""
        starts = (1 if self.is_output_error else self.ahead) * len(self.pieces)
        return int(self.free.sum() + n_terms + self.drift.shape[1] + starts)

    def lag(self, log_tau: float) -> FirstOrderLag:
        """Return the lag of a trial time constant."""
        return FirstOrderLag(float(np.exp(log_tau)), self.sample_period_s, self.hold)
