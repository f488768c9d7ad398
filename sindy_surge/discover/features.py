"""The candidate terms of a pysindy library, with their derivatives with respect to the states."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from sindy_surge.candidate_terms import fitted_library
from sindy_surge.library import monomials
from surge_core.errors import InputError
from surge_core.types import FloatArray, IntArray

# Central differences: the cube root of the rounding error, as a share of each state's size.
_STEP = 6e-6


@dataclass(frozen=True)
class Features:
    """The terms s_i(x, u) of a library."""

    library: Any  # Fitted to states and inputs together
    names: tuple[str, ...]  # Names of its terms, as pysindy writes them
    size: FloatArray  # (n_states,): Size of each state, for the steps of numerical derivatives

    @classmethod
    def of(cls, library: Any, names: Sequence[str], x: FloatArray, u: FloatArray) -> Features:
        """Fit a copy of a library to states and inputs of these names, or refuse its bad terms."""
        size = np.maximum(np.sqrt(np.mean(x**2, axis=0)), 1e-300)
        with np.errstate(all="ignore"):
            found = cls(*fitted_library(library, np.column_stack((x, u)), names), size)
            bad = np.flatnonzero(~np.isfinite(found.values(x, u)).all(axis=0))
        if bad.size:
            raise InputError(
                "library",
                expected="terms that are finite on the whole record",
                found=f"{found.names[bad[0]]}, which is not",
                remedy="leave the term out, or write it so that noise cannot leave its domain",
            )
        return found

    @cached_property
    def _powers(self) -> IntArray | None:
        """Exponents (n_terms, n_columns) of a polynomial library, None for another."""
        from pysindy import PolynomialLibrary

        # Not of a subclass, whose terms may be others.
        plain = type(self.library) is PolynomialLibrary
        return np.asarray(self.library.powers_) if plain else None

    def values(self, x: FloatArray, u: FloatArray) -> FloatArray:
        """Return the terms (n_rows, n_terms) at states and inputs (n_rows, …)."""
        z = np.column_stack((x, u))
        if self._powers is not None:
            return monomials(z, self._powers)
        return np.asarray(self.library.transform(z), dtype=np.float64)

    def derivatives(self, x: FloatArray, u: FloatArray) -> FloatArray:
        """Return ∂s_i/∂x_j of shape (n_rows, n_terms, n_states)."""
        z = np.column_stack((x, u))
        found = []
        for j in range(x.shape[1]):
            if self._powers is not None:
                lower = self._powers.copy()
                lower[:, j] = np.maximum(lower[:, j] - 1, 0)
                found.append(self._powers[:, j] * monomials(z, lower))
                continue
            step = np.zeros(z.shape[1])
            step[j] = _STEP * self.size[j]
            ahead, behind = (self.library.transform(z + s * step) for s in (1.0, -1.0))
            found.append(np.asarray(ahead - behind) / (2.0 * step[j]))
        return np.stack(found, axis=2)

    def index(self, name: str) -> int:
        """Return the place of a term, or refuse one that the library has not."""
        plain = re.sub(r"\s*\*\s*", " ", name.strip())
        if plain not in self.names:
            raise InputError(
                "known",
                expected="terms of the library: " + ", ".join(self.names),
                found=name,
                remedy="write it as the library does",
            )
        return self.names.index(plain)
