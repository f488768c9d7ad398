"""The lag model fitted with whole matrices by scipy: plain, slow, and sharing no code with ours.

Every unknown but τ and C stands as a dense column (terms, hats of the drift, starts), and
``scipy.optimize.least_squares`` searches over the rest with derivatives by differences.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter


@dataclass(frozen=True)
class Dense:
    """The record and the model."""

    phi: np.ndarray
    y: np.ndarray
    period_s: float
    noise: str
    hold: str
    order: int = 0
    exact_start: bool = True
    segments: np.ndarray | None = None
    weight: np.ndarray | None = None
    knot_spacing_s: float | None = None
    powers: tuple[int, ...] = (0, 1, 2)

    def runs(self) -> list[np.ndarray]:
        labels = np.zeros(self.y.size) if self.segments is None else self.segments
        cuts = np.flatnonzero(np.diff(labels)) + 1
        return np.split(np.arange(self.y.size), cuts)

    def weights(self) -> np.ndarray:
        return np.ones(self.y.size) if self.weight is None else self.weight

    def hats(self) -> np.ndarray:
        """Hats of a broken line in each segment, of zero weighted mean, the last left out."""
        if self.knot_spacing_s is None:
            return np.zeros((self.y.size, 0))
        columns = []
        for run in self.runs():
            n = round((run.size - 1) * self.period_s / self.knot_spacing_s)
            for knot in range(n + 1):
                column = np.zeros(self.y.size)
                column[run] = np.maximum(0.0, 1.0 - np.abs(np.linspace(0, n, run.size) - knot))
                columns.append(column)
        table, w = np.column_stack(columns), self.weights()
        return (table - w @ table / w.sum())[:, :-1]

    def problem(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
        """Target, dense columns (terms, hats, starts) and errors of each stretch, weighted."""
        tau, c = np.exp(theta[0]), self.c(theta)
        a, h = np.exp(-self.period_s / tau), self.period_s
        now = 0.0 if self.hold == "zero" else 1.0 - (1.0 - a) * tau / h
        before = 1.0 - a - now
        terms, hats = self.phi[:, None] ** np.array(self.powers), self.hats()
        blocks, stretches = [], []
        for run in self.runs():
            if self.noise == "output-error":
                s = terms[run]
                x, _ = lfilter([now, before], [1.0, -a], s, axis=0, zi=s[:1] * (1.0 - now))
                start = a ** np.arange(run.size)
                both = np.column_stack([self.y[run], x, hats[run], start])
                blocks.append((both * np.sqrt(self.weights()[run])[:, None], 1))
                stretches.append(np.flatnonzero(self.weights()[run]))
                continue
            scored = np.split(run, np.flatnonzero(np.diff(self.weights()[run] > 0)) + 1)
            for piece in scored:
                if piece.size < 2 or self.weights()[piece[0]] == 0.0:
                    continue
                y, s, g = self.y[piece], terms[piece], hats[piece]
                both = np.column_stack(
                    [y[1:] - a * y[:-1], now * s[1:] + before * s[:-1], g[1:] - a * g[:-1]]
                )
                both = lfilter([1.0], [1.0, *c], both, axis=0)
                w = self.weights()[piece][1:]
                ahead = self.order if self.exact_start else 0
                if ahead:
                    # e[k] for k before the stretch: scored rows and columns of their own.
                    own = np.concatenate([np.eye(ahead), -self._carried(c, both.shape[0])])
                    both = np.concatenate([np.zeros((ahead, both.shape[1])), both])
                    both, w = np.column_stack([both, own]), np.r_[np.full(ahead, w[0]), w]
                blocks.append((both * np.sqrt(w)[:, None], ahead))
                stretches.append(np.arange(both.shape[0]))
        n_shared = terms.shape[1] + hats.shape[1]
        starts = sum(n for _, n in blocks)
        rows = [np.zeros((b.shape[0], 1 + n_shared + starts)) for b, _ in blocks]
        at = 1 + n_shared
        for row, (block, n) in zip(rows, blocks, strict=True):
            row[:, : 1 + n_shared] = block[:, : 1 + n_shared]
            row[:, at : at + n] = block[:, 1 + n_shared :]
            at += n
        kept = [row[s] for row, s in zip(rows, stretches, strict=True)]
        whole = np.concatenate(kept)
        return whole[:, 0], whole[:, 1:], [np.zeros(k.shape[0]) for k in kept]

    def c(self, theta: np.ndarray) -> np.ndarray:
        """C from partial coefficients, inside the unit circle."""
        kappa = np.tanh(theta[1:])
        return kappa if kappa.size < 2 else np.array([kappa[0] * (1 + kappa[1]), kappa[1]])

    @staticmethod
    def _carried(c: np.ndarray, n: int) -> np.ndarray:
        """What the errors before a stretch, the newest last, add to its whitened equations."""
        drive = np.zeros((n, c.size))
        for row, column in ((k, j) for k in range(c.size) for j in range(k, c.size)):
            drive[row, column] = c[c.size - 1 + row - column]
        return lfilter([1.0], [1.0, *c], drive, axis=0)

    def errors(self, theta: np.ndarray) -> np.ndarray:
        target, columns, _ = self.problem(theta)
        return target - columns @ np.linalg.lstsq(columns, target)[0]

    def fit(self, start: np.ndarray) -> DenseFit:
        """Search from a start, and return all that ours is compared with."""
        found = least_squares(
            self.errors, start, method="lm", jac="3-point", xtol=1e-15, ftol=1e-15, gtol=1e-15
        )
        target, columns, pieces = self.problem(found.x)
        coef = np.linalg.lstsq(columns, target)[0]
        slopes = []
        for i in range(found.x.size):
            sides = []
            for sign in (1.0, -1.0):
                theta = found.x.copy()
                theta[i] += sign * 1e-5
                t, cols, _ = self.problem(theta)
                sides.append(t - cols @ coef)
            slopes.append((sides[0] - sides[1]) / 2e-5)
        jacobian = np.column_stack([*slopes, -columns])
        lengths = [piece.size for piece in pieces]
        return DenseFit(self, found.x, coef, target - columns @ coef, jacobian, lengths)


@dataclass(frozen=True)
class DenseFit:
    """A finished fit."""

    model: Dense
    theta: np.ndarray
    coef: np.ndarray
    errors: np.ndarray
    jacobian: np.ndarray
    lengths: list[int]

    @property
    def cost(self) -> float:
        return float(self.errors @ self.errors)

    def covariance_of_shape(self, blocks: list[np.ndarray]) -> np.ndarray:
        """The delete-one-block jackknife of (log τ, ρ), each refit linear."""
        n = self.theta.size + len(self.model.powers) + self.model.hats().shape[1]
        basis, _ = np.linalg.qr(self.jacobian[:, n:])
        # A start is that of the whole fit: seen past its block it would be hardly known.
        shared = self.jacobian[:, :n] - basis @ (basis.T @ self.jacobian[:, :n])
        size = np.linalg.norm(shared, axis=0)
        scaled = shared / np.where(size > 0.0, size, 1.0)
        moves = []
        for block in blocks:
            keep = np.setdiff1d(np.arange(self.errors.size), block)
            move = np.linalg.lstsq(scaled[keep], -self.errors[keep], rcond=1e-9)[0]
            moves.append((move / np.where(size > 0.0, size, 1.0))[: self.theta.size])
        spread = np.asarray(moves) - np.mean(moves, axis=0)
        return (len(moves) - 1) / len(moves) * spread.T @ spread
