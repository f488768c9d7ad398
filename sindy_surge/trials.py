"""Structures tried on what is left out of the fit, and the ladder and lists they come from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from sindy_surge.leave_out import leave_out_moves, unit_norms
from sindy_surge.linear_problem import LinearProblem, Support
from surge_core.types import FloatArray, IndexArray

__all__ = [
    "FEWEST_BLOCKS",
    "Block",
    "Equations",
    "Trials",
    "best_of_each_size",
    "climb",
    "pays",
    "polynomial_ladder",
    "special_structures",
]


# A characteristic in stall falls, turns and rises: a cubic (Moore & Greitzer 1986) is the
# most that is asked of a polynomial when the data cannot tell a term from an error.
_HIGHEST_DEGREE = 3
_MOST_SPECIAL = 24
# With fewer, a scatter over blocks says nothing.
FEWEST_BLOCKS = 3


class Equations(Protocol):
    """What structures are tried on."""

    def fit(self, support: Support) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return parameters with τ last, derivatives of the fitted values, and the residual."""


@dataclass(frozen=True)
class Block:
    """Equations that are left out together.

    Parameters
    ----------
    touched : ndarray of int
        Equations that any row of the block enters: what has to be left out.
    own : ndarray of int
        Equations on which the fit without it is scored.
    """

    touched: IndexArray
    own: IndexArray


@dataclass
class Trials:
    """Held-out errors of the structures tried.

    Parameters
    ----------
    equations : Equations
        What is fitted.
    blocks : list of Block
        What is left out in turn.
    most_leverage : float
        A block that holds more than this share of the information on some parameter is not
        scored: without it the parameter would be a guess. From 0 to 1; 1 scores all.
    errors : dict
        Mean square error of each block's equations, NaN where not scored, by structure.
    lags : dict
        τ in seconds, by structure.
    """

    equations: Equations
    blocks: list[Block]
    most_leverage: float = 1.0
    errors: dict[Support, FloatArray] = field(default_factory=dict)
    lags: dict[Support, float] = field(default_factory=dict)

    def error(self, support: Support) -> FloatArray:
        """Return the mean square error of each block's equations, fitted without that block."""
        if support not in self.errors:
            parameters, design, residual = self.equations.fit(support)
            moves = leave_out_moves(design, residual, [block.touched for block in self.blocks])
            self.lags[support] = float(parameters[-1])
            self.errors[support] = np.array(
                [
                    float(np.mean((residual[block.own] - design[block.own] @ move) ** 2))
                    for move, block in zip(moves, self.blocks, strict=True)
                ]
            )
            if self.most_leverage < 1.0:
                held = [_leverage(design, block.touched) for block in self.blocks]
                self.errors[support][np.array(held) > self.most_leverage] = np.nan
        return self.errors[support]

    def pair(self, one: Support, other: Support) -> tuple[FloatArray, FloatArray]:
        """Return the errors of two structures on the blocks that are scored for both."""
        first, second = self.error(one), self.error(other)
        both = np.isfinite(first) & np.isfinite(second)
        return first[both], second[both]

    def mean(self, support: Support) -> float:
        """Return the mean over the blocks that are scored."""
        known = self.error(support)
        known = known[np.isfinite(known)]
        return float(np.mean(known)) if known.size else float("nan")

    def tried(self) -> dict[Support, tuple[float, float]]:
        """Return the rms over the blocks and τ of every structure tried."""
        return {s: (self.mean(s) ** 0.5, self.lags[s]) for s in self.errors}


def _leverage(design: FloatArray, rows: IndexArray) -> float:
    """Return the largest share of the information on any parameter that some rows hold."""
    norms = unit_norms(design)
    basis, values, _ = np.linalg.svd(design / norms, full_matrices=False)
    within = basis[np.ix_(rows, values > 1e-10 * values[0])]
    return float(np.linalg.norm(within, 2) ** 2)


def polynomial_ladder(degrees: Sequence[int | None], max_terms: int) -> list[Support]:
    """Return the complete polynomials from degree 1 upwards, up to a cubic.

    Parameters
    ----------
    degrees : sequence of int or None
        Total degree of each usable term; None for a term that is no polynomial.

    Returns
    -------
    list of tuple of int
        Smallest first; empty if the terms hold no straight line.
    """
    known = [degree for degree in degrees if degree is not None]
    if not {0, 1} <= set(known):
        return []
    rungs = [
        tuple(i for i, degree in enumerate(degrees) if degree is not None and degree <= top)
        for top in range(1, min(max(known), _HIGHEST_DEGREE) + 1)
    ]
    return [rung for rung in dict.fromkeys(rungs) if len(rung) <= max_terms]


def best_of_each_size(linear: LinearProblem, proposed: list[Support]) -> list[Support]:
    """Return the structure of least χ² of every size, smallest first."""
    best: dict[int, Support] = {}
    for support in sorted(proposed, key=linear.chi2):
        best.setdefault(len(support), support)
    return [best[size] for size in sorted(best)]


def climb(trials: Trials, ladder: list[Support], start: int = 0) -> Support:
    """Go up a ladder of structures as long as that pays on what is left out, else down."""
    chosen = ladder[start]
    for rung in ladder[start + 1 :]:
        if pays(trials, chosen, rung):
            chosen = rung
    for rung in ladder[:start][::-1] if chosen == ladder[start] else []:
        if pays(trials, chosen, rung):
            chosen = rung
    trials.error(chosen)
    return chosen


def pays(trials: Trials, one: Support, other: Support) -> bool:
    """Tell whether the other leaves less by more than a standard error of the differences."""
    before, after = trials.pair(one, other)
    gain = before - after
    if gain.size < FEWEST_BLOCKS:
        return False
    return bool(gain.mean() > gain.std(ddof=1) / np.sqrt(gain.size))


def special_structures(
    trials: Trials,
    linear: LinearProblem,
    proposed: list[Support],
    chosen: Support,
    ladder: list[Support],
    share_left: float,
) -> dict[Support, float]:
    """Return the structures off the ladder, and no larger, that leave little of the error."""
    largest = max(len(rung) for rung in ladder)
    others = [s for s in proposed if s not in ladder and len(s) <= largest]
    others = sorted(others, key=linear.chi2)[:_MOST_SPECIAL]
    shares = {s: _share(trials, s, chosen) for s in others}
    return {s: share for s, share in shares.items() if share < share_left}


def _share(trials: Trials, support: Support, chosen: Support) -> float:
    """Return what a structure leaves of the held-out error of the chosen one."""
    own, reference = trials.pair(support, chosen)
    return float(own.mean() / reference.mean()) if own.size >= FEWEST_BLOCKS else np.inf
