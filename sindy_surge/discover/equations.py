"""Terms of discovered equations, and the models that rival them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Term:
    """A term of one equation.

    Parameters
    ----------
    name : str
        As pysindy writes it.
    coefficient, stderr : float
        In the units of the data; the error is 0 for a coefficient that was given.
    """

    name: str
    coefficient: float
    stderr: float


@dataclass(frozen=True)
class Rival:
    """Another model that the data cannot separate from the chosen one.

    Parameters
    ----------
    equations : tuple of tuple of Term
        Its terms, equation by equation.
    behind : float
        How far its score is behind, in log-likelihood.
    """

    equations: tuple[tuple[Term, ...], ...]
    behind: float
