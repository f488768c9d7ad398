"""Which terms each of the three equations has: proposed in the weak form, tested in simulation."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain, combinations

import numpy as np

from sindy_surge.closed_loop.shooting import (
    JointFit,
    Linearised,
    Windows,
    fit_jointly,
)
from sindy_surge.linear_problem import Support, without_nuisances
from sindy_surge.segments import Segments
from sindy_surge.selection import information_penalty
from sindy_surge.sparse_paths import proposals
from sindy_surge.weak import WeakEquations
from surge_core.types import FloatArray

__all__ = ["proposed_structure", "settle_structure"]


# The trapezoid sums of the test functions are no better than this share of the derivative.
_QUADRATURE = 1e-3
# Differences of the score below this do not decide (in units of χ²).
_TIE = 4.0
_MOST_REFITS = 8


def proposed_structure(
    windows: Windows, half_width: int, max_terms: int
) -> tuple[Support, FloatArray]:
    """Choose the terms of each equation by sparse regression in the weak form.

    ∫ w dx/dt dt = Σ c_j ∫ w s_j dt with sliding w: nothing is differentiated. pysindy's SSR and
    a beam search propose supports of every size; the least extended BIC wins, with as many
    equations counted as half widths fit into the record, since the test functions overlap.

    Parameters
    ----------
    windows : Windows
        The record.
    half_width : int
        Half width of the test functions in samples.
    max_terms : int
        Largest number of terms of one equation.

    Returns
    -------
    support : tuple of int
        The terms among the candidates.
    coefficients : ndarray of shape (n_support,)
        First estimates.
    """
    record = windows.states.reshape(-1, windows.states.shape[-1])
    values = windows.library.values(record) @ windows.weights.T
    whole = Segments.from_labels(None, len(record))
    n_independent = len(record) / half_width
    support: list[int] = []
    coefficients: list[float] = []
    for equation in range(record.shape[1]):
        own = np.flatnonzero(windows.equation == equation)
        weak = WeakEquations.integrate(
            record[:, equation], values[:, own], whole, half_width, windows.sample_period_s
        )
        change = weak.derivative
        linear = without_nuisances(weak.columns[:, :0], weak.columns, change)
        penalty = information_penalty(round(n_independent), own.size)
        floor = _QUADRATURE**2 * float(change @ change)
        scores = {
            chosen: n_independent * float(np.log((linear.chi2(chosen) + floor) / change.size))
            + penalty * len(chosen)
            for chosen in proposals(linear, "SSR", max_terms)
        }
        best = min(scores, key=lambda chosen: (scores[chosen], chosen))
        support += own[list(best)].tolist()
        coefficients += linear.coefficients(best).tolist()
    return tuple(support), np.array(coefficients)


def settle_structure(windows: Windows, fit: JointFit, max_terms: int) -> tuple[JointFit, bool]:
    """Test the three equations together against their neighbours, by simulation.

    All candidate terms enter the sensitivities of the simulation about the fit; supports that
    differ by up to two terms dropped and one added are scored there. The best is fitted, and
    taken if its extended BIC is less indeed.

    Parameters
    ----------
    windows : Windows
        The record.
    fit : JointFit
        Where to begin.
    max_terms : int
        Largest number of terms of one equation.

    Returns
    -------
    fit : JointFit
        The structure that stands.
    settled : bool
        False if the number of refits was used up, or the simulation broke off.
    """
    n_candidates = windows.equation.size
    everything = tuple(range(n_candidates))
    n_equations = fit.residual.size
    penalty = information_penalty(n_equations, len(windows.library))

    def score(chi2: float, support: Support) -> float:
        if not np.isfinite(chi2):
            return np.inf
        share = chi2 / n_equations
        # Two log likelihoods that meet at 1: noise of the size assumed, and of the size found.
        misfit = share - 1 if share < 1 else float(np.log(share))
        return n_equations * misfit + penalty * len(support)

    def allowed(support: Support) -> bool:
        sizes = np.bincount(windows.equation[list(support)], minlength=windows.states.shape[-1])
        return bool(np.all((sizes > 0) & (sizes <= max_terms)))

    tried = {fit.support: score(fit.chi2, fit.support)}
    for _ in range(_MOST_REFITS):
        about = Linearised.about(windows, fit, everything)
        if about is None:
            return fit, False
        linear = about.linear_problem(everything)
        least, best = score(linear.chi2(fit.support), fit.support) - _TIE, None
        for other in _neighbours(fit.support, n_candidates):
            if other in tried or not allowed(other):
                continue
            if (value := score(linear.chi2(other), other)) < least:
                least, best = value, other
        if best is None:
            return fit, True
        trial = fit_jointly(windows, best, linear.coefficients(best), fit.starts)
        tried[best] = score(trial.chi2, best)
        if tried[best] < tried[fit.support]:
            fit = trial
    return fit, False


def _neighbours(own: Support, n_candidates: int) -> Iterator[Support]:
    """Yield supports with up to two terms dropped and up to one added."""
    others = [i for i in range(n_candidates) if i not in own]
    for dropped in chain.from_iterable(combinations(own, k) for k in range(3)):
        rest = tuple(i for i in own if i not in dropped)
        if dropped:
            yield rest
        for added in others:
            yield tuple(sorted((*rest, added)))
