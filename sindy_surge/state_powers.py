"""Which power of ψ' a structure holds: what a search in centred ψ' cannot tell."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sindy_surge.lag_fit import StructureFit, fit_structure, linearise
from sindy_surge.lag_problem import LagProblem
from sindy_surge.linear_problem import Support, least_squares

__all__ = ["PowerChoice", "choose_power"]

# As between any two structures of one size.
_TIE = 4.0


class PowerChoice(NamedTuple):
    """The power of ψ' that fits best, in its library, and the other's structure if as good."""

    problem: LagProblem
    fit: StructureFit
    rival: Support | None


def choose_power(problem: LagProblem, fit: StructureFit) -> PowerChoice:
    """Try ψ'² and ψ'³ themselves in the place of each other.

    About its centre c, ψ'³ is 3c ψ'² - 3c² ψ' + c³ and a small cubic rest: the search in
    z = (ψ' - c)/s finds z² for either. The two models part only in the rest, and in τ, for
    each leaves another share of ψ' to the lag.
    """
    states = problem.terms.states
    same = PowerChoice(problem, fit, None)
    if states is None or states.centre == 0.0:
        return same
    names = [problem.terms.names[i] for i in problem.columns]
    powers = [names.index(states.names[i]) for i in (0, 1) if states.names[i] in names]
    held = [i for i in powers if i in fit.support]
    if len(powers) != 2 or len(held) != 1 or "1" not in names:
        return same
    plain = replace(problem, terms=problem.terms.physical())
    fits = {i: _refitted(plain, fit, held[0], i, names.index("1")) for i in powers}
    best = min(fits, key=lambda i: fits[i].chi2)
    other = powers[1 - powers.index(best)]
    if best == held[0] or fits[best].chi2 > fit.chi2 - _TIE:
        near = fits[powers[1 - powers.index(held[0])]]
        return PowerChoice(problem, fit, near.support if near.chi2 < fit.chi2 + _TIE else None)
    rival = fits[other].support if fits[other].chi2 < fits[best].chi2 + _TIE else None
    return PowerChoice(plain, fits[best], rival)


def _refitted(
    plain: LagProblem, fit: StructureFit, held: int, wanted: int, constant: int
) -> StructureFit:
    """Fit a structure with one power of ψ' in the place of the other."""
    support = tuple(sorted({wanted if i == held else i for i in fit.support} | {constant}))
    # About the fit without its own power: its state is all that the terms need.
    rest = tuple(i for i in fit.support if i != held)
    kept = [fit.support.index(i) for i in rest]
    point = replace(fit.point, coefficients=fit.coefficients[kept])
    linear = linearise(plain, replace(fit, support=rest, point=point))
    chosen = list(support)
    beta = least_squares(linear.columns[:, chosen], linear.target) / linear.norms[chosen]
    return fit_structure(plain, support, fit.time_constant_s, np.asarray(beta), near=fit)
