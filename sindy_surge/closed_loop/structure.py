"""Which terms each of the three equations has: proposed in the weak form, tested in simulation."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain, combinations

import numpy as np

from sindy_surge.closed_loop.fit import (
    JointFit,
    fit_jointly,
    library_equations,
)
from sindy_surge.closed_loop.terms import STATES, StateTerms
from sindy_surge.closed_loop.windows import Supports, Windows
from sindy_surge.linear_problem import LinearProblem, Support, without_nuisances
from sindy_surge.segments import Segments
from sindy_surge.selection import information_penalty
from sindy_surge.sparse_paths import proposals
from sindy_surge.weak import WeakEquations
from surge_core.types import FloatArray

__all__ = ["StructureRow", "WeakStructure", "settle_structure", "weak_structure"]


# The trapezoid sums of the test functions are no better than this share of the derivative.
_QUADRATURE = 1e-3
# Differences of the score below this do not decide (in units of χ²).
_TIE = 4.0
_MOST_REFITS = 8


@dataclass(frozen=True)
class StructureRow:
    """One line of the table of structures.

    Parameters
    ----------
    stage : str
        "weak" for one equation in the weak form, "simulated" for all three fitted together.
    equation : str
        "phi", "psi_p" or "plenum"; "all" for the three together.
    terms : tuple of str
        Names of the terms.
    score : float
        Extended BIC; the lower the better, within one stage and equation.
    chosen : bool
        Whether it was taken.
    """

    stage: str
    equation: str
    terms: tuple[str, ...]
    score: float
    chosen: bool


@dataclass(frozen=True)
class WeakStructure:
    """The terms of one equation and their coefficients.

    Parameters
    ----------
    support : tuple of int
        Positions of the terms within the library.
    coefficients : ndarray of shape (n_support,)
        First estimates.
    rows : tuple of StructureRow
        The best structure of every size.
    """

    support: Support
    coefficients: FloatArray
    rows: tuple[StructureRow, ...]


def weak_structure(
    record: FloatArray,
    library: StateTerms,
    allowed: tuple[int, ...],
    equation: int,
    half_width: int,
    sample_period_s: float,
    max_terms: int,
) -> WeakStructure:
    """Choose the terms of one equation by sparse regression in the weak form.

    ∫ w dx/dt dt = Σ c_j ∫ w s_j dt with sliding w: nothing is differentiated. pysindy's SSR and
    a beam search propose supports of every size; the least extended BIC wins, with as many
    equations counted as half widths fit into the record, since the test functions overlap.

    Parameters
    ----------
    record : ndarray of shape (n_rows, 3)
        φ, ψ' and Ψ.
    sample_period_s : float
        Sample period in seconds.
    """
    terms = library.subset(allowed)
    whole = Segments.from_labels(None, len(record))
    weak = WeakEquations.integrate(
        record[:, equation], terms.values(record), whole, half_width, sample_period_s
    )
    change = weak.derivative
    linear = without_nuisances(weak.columns[:, :0], weak.columns, change)
    n_independent = len(record) / half_width
    penalty = information_penalty(round(n_independent), len(terms))
    floor = _QUADRATURE**2 * float(change @ change)
    best: dict[int, tuple[float, Support]] = {}
    for support in proposals(linear, "SSR", max_terms):
        chi2 = linear.chi2(support) + floor
        score = n_independent * float(np.log(chi2 / change.size)) + penalty * len(support)
        if len(support) not in best or score < best[len(support)][0]:
            best[len(support)] = score, support
    score, chosen = min(best.values())
    names = terms.names
    rows = tuple(
        StructureRow("weak", STATES[equation], tuple(names[i] for i in s), value, s == chosen)
        for value, s in best.values()
    )
    return WeakStructure(tuple(allowed[i] for i in chosen), linear.coefficients(chosen), rows)


def settle_structure(
    windows: Windows, library: StateTerms, allowed: Supports, fit: JointFit, max_terms: int
) -> tuple[JointFit, tuple[StructureRow, ...], bool]:
    """Test the three equations together against their neighbours, by simulation.

    All candidate terms enter the sensitivities of the simulation about the fit; supports that
    differ by up to two terms dropped and one added are scored there. The best is fitted, and
    taken if its extended BIC is less indeed.

    Returns
    -------
    fit : JointFit
        The structure that stands.
    rows : tuple of StructureRow
        What was fitted on the way.
    settled : bool
        False if the number of refits was used up, or the simulation broke off.
    """
    search = _Neighbourhood(allowed, windows.hidden_plenum, max_terms, len(library))
    tried = {fit.supports: search.score(fit.chi2, fit.supports, fit.residual.size)}
    settled = False
    for _ in range(_MOST_REFITS):
        linear = library_equations(windows, library, allowed, fit)
        if linear is None:
            break
        rival = search.best(linear, fit.supports, set(tried))
        if rival is None:
            settled = True
            break
        supports, free = rival
        coefficients = windows.tie(supports) @ free
        trial = fit_jointly(windows, library, supports, coefficients, fit.starts)
        tried[supports] = search.score(trial.chi2, supports, trial.residual.size)
        if tried[supports] < tried[fit.supports]:
            fit = trial
    names = library.names
    rows = tuple(
        StructureRow(
            "simulated",
            "all",
            tuple(f"d{STATES[k]}/dt: {names[i]}" for k, s in enumerate(supports) for i in s),
            score,
            supports == fit.supports,
        )
        for supports, score in tried.items()
    )
    return fit, rows, settled


@dataclass(frozen=True)
class _Neighbourhood:
    """The structures near one of the three equations, and their scores.

    Parameters
    ----------
    allowed : tuple of three tuples of int
        Positions of the terms that each equation may have.
    hidden_plenum : bool
        Whether dφ/dt = a (ψ' - Ψ) is fixed, with one free coefficient.
    max_terms : int
        Largest number of terms of one equation.
    n_library : int
        Number of candidate terms.
    """

    allowed: Supports
    hidden_plenum: bool
    max_terms: int
    n_library: int

    @property
    def labels(self) -> list[tuple[int, int]]:
        """Equation and term of each free coefficient."""
        labels = [(k, i) for k, s in enumerate(self.allowed) for i in s]
        return labels[:1] + labels[2:] if self.hidden_plenum else labels

    def score(self, chi2: float, supports: Supports, n_equations: int) -> float:
        """Return the extended BIC, with the noise unknown but no less than was assumed."""
        if not np.isfinite(chi2):
            return np.inf
        n_free = sum(len(s) for s in supports) - self.hidden_plenum
        penalty = information_penalty(n_equations, self.n_library)
        share = chi2 / n_equations
        # Two log likelihoods that meet at 1: noise of the size assumed, and of the size found.
        misfit = share - 1 if share < 1 else float(np.log(share))
        return n_equations * misfit + penalty * n_free

    def best(
        self, linear: LinearProblem, own: Supports, tried: set[Supports]
    ) -> tuple[Supports, FloatArray] | None:
        """Return the best untried neighbour and its free coefficients, if it beats `own`."""
        labels = self.labels
        support = tuple(n for n, (k, i) in enumerate(labels) if i in own[k])
        n = linear.n_equations
        least = self.score(linear.chi2(support), own, n) - _TIE
        best: tuple[Supports, Support] | None = None
        for other in _neighbours(support, len(labels)):
            grouped = self._grouped([labels[n] for n in other])
            if grouped in tried or not all(grouped) or self._too_large(grouped):
                continue
            score = self.score(linear.chi2(other), grouped, n)
            if score < least:
                least, best = score, (grouped, other)
        if best is None:
            return None
        return best[0], linear.coefficients(best[1])

    def _too_large(self, supports: Supports) -> bool:
        """Whether an equation has too many terms; that of a hidden plenum's duct is fixed."""
        return max(len(s) for s in supports[self.hidden_plenum :]) > self.max_terms

    def _grouped(self, labels: list[tuple[int, int]]) -> Supports:
        flow, lag, plenum = (tuple(i for k, i in labels if k == number) for number in range(3))
        return (self.allowed[0] if self.hidden_plenum and flow else flow), lag, plenum


def _neighbours(own: Support, n_labels: int) -> Iterator[Support]:
    """Yield supports with up to two terms dropped and up to one added."""
    others = [i for i in range(n_labels) if i not in own]
    for dropped in chain.from_iterable(combinations(own, k) for k in range(3)):
        rest = tuple(i for i in own if i not in dropped)
        if dropped:
            yield rest
        for added in others:
            yield tuple(sorted((*rest, added)))
