"""Structures tried on what is left out of the fit, and the ladder and lists they come from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from sindy_surge.linear_problem import LinearProblem, Support, unit_norms
from sindy_surge.selection import PathRow
from surge_core.leave_out import leave_out
from surge_core.types import FloatArray, IndexArray

__all__ = [
    "FEWEST_BLOCKS",
    "Equations",
    "Trials",
    "best_of_each_size",
    "climb",
    "pays",
    "polynomial_ladder",
    "special_structures",
    "with_held_out",
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


@dataclass
class Trials:
    """Held-out errors of the structures tried.

    Parameters
    ----------
    equations : Equations
        What is fitted.
    blocks : list of tuple of two ndarray of int
        What is left out in turn: the equations that any row of a block enters, and those on which
        the fit without them is scored.
    most_leverage : float
        A block that holds more than this share of the information on some parameter is not
        scored: without it the parameter would be a guess. From 0 to 1; 1 scores all.
    errors : dict
        Mean square error of each block's equations, NaN where not scored, by structure.
    lags : dict
        τ in seconds, by structure.
    """

    equations: Equations
    blocks: list[tuple[IndexArray, IndexArray]]
    most_leverage: float = 1.0
    errors: dict[Support, FloatArray] = field(default_factory=dict)
    lags: dict[Support, float] = field(default_factory=dict)

    def error(self, support: Support) -> FloatArray:
        """Return the mean square error of each block's equations, fitted without that block."""
        if support not in self.errors:
            parameters, design, residual = self.equations.fit(support)
            moves = leave_out(-design, residual, [touched for touched, _ in self.blocks]).moves
            own_errors = np.empty(len(self.blocks))
            for number, (touched, own) in enumerate(self.blocks):
                error = residual[own] - design[own] @ moves[number]
                own_errors[number] = np.mean(error**2)
                if self.most_leverage < 1.0 and _leverage(design, touched) > self.most_leverage:
                    own_errors[number] = np.nan
            self.lags[support], self.errors[support] = float(parameters[-1]), own_errors
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


def _leverage(design: FloatArray, rows: IndexArray) -> float:
    """Return the largest share of the information on any parameter that some rows hold."""
    basis, values, _ = np.linalg.svd(design / unit_norms(design), full_matrices=False)
    within = basis[np.ix_(rows, values > 1e-10 * values[0])]
    return float(np.linalg.norm(within, 2) ** 2)


def polynomial_ladder(degrees: Sequence[int | None], max_terms: int) -> list[Support]:
    """Return the complete polynomials from degree 1 up to a cubic, smallest first.

    Parameters
    ----------
    degrees : sequence of int or None
        Total degree of each usable term; None for a term that is no polynomial.
    max_terms : int
        Largest structure considered.
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
    """Return whether the other leaves less by more than a standard error of the differences."""
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
    """Return the structures off the ladder, and no larger, that leave little of the error.

    With the share each leaves of the held-out error of the chosen one, below `share_left`.
    """
    largest = max(len(rung) for rung in ladder)
    others = [s for s in proposed if s not in ladder and len(s) <= largest]
    found = {}
    for support in sorted(others, key=linear.chi2)[:_MOST_SPECIAL]:
        own, reference = trials.pair(support, chosen)
        if own.size >= FEWEST_BLOCKS and own.mean() / reference.mean() < share_left:
            found[support] = float(own.mean() / reference.mean())
    return found


def with_held_out(
    path: Sequence[PathRow], trials: Trials, chosen: Support, names: Sequence[str]
) -> tuple[PathRow, ...]:
    """Add the structures tried on rows left out, with their rms there, to a table."""
    rows = {row.terms: replace(row, chosen=False, consistent=False) for row in path}
    for support, tau in trials.lags.items():
        terms = tuple(names[i] for i in support)
        none = PathRow(len(support), terms, np.nan, np.nan, np.nan, False, False, False)
        rows[terms] = replace(
            rows.get(terms, none),
            time_constant_s=tau,
            refitted=True,
            chosen=support == chosen,
            held_out_rms=trials.mean(support) ** 0.5,
        )

    def order(row: PathRow) -> tuple[int, float]:
        return row.size, row.held_out_rms if np.isfinite(row.held_out_rms) else np.inf

    return tuple(sorted(rows.values(), key=order))
