"""Constraints that bind against the data: what the search finds without them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sindy_surge.state_terms import PhysicalForm
from surge_core.rounding import bracketed
from surge_core.terms import pretty_term

# Standard errors that a coefficient may lie on the wrong side: 5 %, one-sided for a sign.
LIMITS = {"positive": 1.645, "negative": 1.645, "forbidden": 1.96}


@dataclass(frozen=True)
class Binding:
    """A constraint that what is found without it breaks by more than its standard error allows.

    Parameters
    ----------
    term, constraint : str
        The term, and "forbidden", "positive" or "negative".
    coefficient, stderr : float
        Of the term in the structure that is found without any constraint.
    time_constant_s : float
        τ of that structure, in seconds.
    """

    term: str
    constraint: str
    coefficient: float
    stderr: float
    time_constant_s: float

    @property
    def text(self) -> str:
        """The sentence."""
        value = bracketed(abs(self.coefficient), self.stderr)
        return (
            f"binding: {pretty_term(self.term)} is {self.constraint} by constraint; the data ask "
            f"for {'-' if self.coefficient < 0.0 else ''}{value}, "
            f"{abs(self.coefficient) / self.stderr:.1f} standard errors from zero, with τ "
            f"{1e3 * self.time_constant_s:.3g} ms"
        )


def binding_constraints(free: PhysicalForm, wishes: Mapping[str, str]) -> tuple[Binding, ...]:
    """Test each constraint by Wald's test on the structure that is found without any."""
    binding = []
    errors = np.sqrt(np.maximum(np.diag(free.covariance), 0.0))
    for name, value, error in zip(free.names, free.coefficients, errors[:-1], strict=True):
        for word in sorted(set(wishes.get(name, "").split()) & LIMITS.keys()):
            against = {"positive": -value, "negative": value, "forbidden": abs(value)}[word]
            if against > LIMITS[word] * error:
                found = float(value), float(error), free.time_constant_s
                binding.append(Binding(name, word, *found))
    return tuple(binding)
