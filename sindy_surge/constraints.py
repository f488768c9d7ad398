"""What is known of the terms beforehand, and whether it binds against the data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sindy_surge.candidate_terms import PhysicalForm
from surge_core.errors import InputError
from surge_core.rounding import bracketed
from surge_core.terms import pretty_term
from surge_core.types import FloatArray, IndexArray

_WORDS = ("required", "forbidden", "positive", "negative")
# Standard errors that a coefficient may lie on the wrong side: 5 %, one-sided for a sign.
LIMITS = {"positive": 1.645, "negative": 1.645, "forbidden": 1.96}


@dataclass(frozen=True)
class Constraints:
    """Prior knowledge by position among the usable terms."""

    required: tuple[int, ...]  # Terms that every structure holds
    signs: FloatArray  # (n_columns,): +1 or -1 where only that sign is possible, else 0

    def allow(self, support: Sequence[int], coefficients: FloatArray) -> bool:
        """Return whether the coefficients of a structure have the signs asked for."""
        return bool(np.all(self.signs[list(support)] * coefficients >= 0.0))


def constraints_of(
    wishes: Mapping[str, str] | None, names: Sequence[str], usable: IndexArray
) -> tuple[IndexArray, Constraints]:
    """Read a user's constraints: the usable terms without the forbidden ones, and what binds them.

    ``wishes`` hold for the name of a term one or two of "required", "forbidden", "positive",
    "negative", separated by a space; ``usable`` are the positions among ``names`` that the data can
    separate. Refused are an unknown term or word, a contradiction, and a required term that the
    data cannot separate from others.
    """
    asked = {name: set(str(text).split()) for name, text in dict(wishes or {}).items()}
    for name, words in asked.items():
        clash = {"required", "forbidden"} <= words or {"positive", "negative"} <= words
        if name not in names or not words or not words <= set(_WORDS) or clash:
            raise InputError(
                f"constraints[{name!r}]",
                expected=f"for a term among {', '.join(names)} one of {', '.join(_WORDS)}, or two "
                "that agree",
                found=" ".join(sorted(words)) or "nothing",
            )
    forbidden = {names.index(name) for name, words in asked.items() if "forbidden" in words}
    columns = np.array([i for i in usable if int(i) not in forbidden], dtype=np.intp)
    position = {names[int(i)]: number for number, i in enumerate(columns)}
    required, signs = [], np.zeros(columns.size)
    for name, words in asked.items():
        if name in position:
            required += [position[name]] * ("required" in words)
            signs[position[name]] = ("positive" in words) - float("negative" in words)
        elif "required" in words:
            raise InputError(
                "constraints",
                expected=f"{name!r} to be separable from the other terms by the data",
                found="a term that is zero or a sum of others over this record",
                remedy="forbid one of those, or leave the requirement out",
            )
    return columns, Constraints(tuple(sorted(required)), signs)


@dataclass(frozen=True)
class Binding:
    """A constraint that what is found without it breaks by more than its standard error allows."""

    term: str  # The term, and "forbidden", "positive" or "negative"
    constraint: str
    coefficient: float  # Of the term in the structure that is found without any constraint
    stderr: float
    time_constant_s: float  # τ of that structure, in seconds

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
