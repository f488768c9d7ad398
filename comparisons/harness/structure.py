"""What an estimator that chooses its own terms says of the choice."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

__all__ = ["StructureChoice", "structure_of"]


@dataclass(frozen=True)
class StructureChoice:
    """How sure a structure is.

    Parameters
    ----------
    n_candidates : int
        Terms that were searched.
    rivals : tuple of tuple of str
        Structures that the data cannot tell from the chosen one.
    aliases : dict of str to str
        Terms left out because they are sums of others on this record, and what they equal.
    inclusion_probability : dict of str to float
        Share of resampled records whose structure holds a term; empty where it was not asked.
    path : tuple of (int, tuple of str, float)
        The best structure of each size: size, terms and held-out rms (NaN where unknown).
    """

    n_candidates: int
    rivals: tuple[tuple[str, ...], ...]
    aliases: dict[str, str]
    inclusion_probability: dict[str, float]
    path: tuple[tuple[int, tuple[str, ...], float], ...]

    def to_json(self) -> dict[str, Any]:
        """Return the choice as plain JSON types."""
        return {
            "n_candidates": self.n_candidates,
            "rivals": [list(terms) for terms in self.rivals],
            "aliases": dict(self.aliases),
            "inclusion_probability": dict(self.inclusion_probability),
            "path": [
                {"size": size, "terms": list(terms), "held_out_rms": rms}
                for size, terms, rms in self.path
            ],
        }


def structure_of(estimator: Any) -> StructureChoice | None:
    """Take the choice out of a fitted estimator; None of one whose terms were given.

    Parameters
    ----------
    estimator : object
        Fitted; one that searches has ``candidate_terms_`` and ``path_``.
    """
    if not hasattr(estimator, "candidate_terms_"):
        return None
    best: dict[int, Any] = {}
    for row in getattr(estimator, "path_", ()):
        kept = best.get(row.size)
        if (
            kept is None
            or (row.chosen and not kept.chosen)
            or (not kept.chosen and _error(row) < _error(kept))
        ):
            best[row.size] = row
    return StructureChoice(
        len(estimator.candidate_terms_),
        tuple(tuple(terms) for terms in getattr(estimator, "rivals_", ())),
        dict(getattr(estimator, "aliases_", {})),
        dict(getattr(estimator, "inclusion_probability_", {})),
        tuple((n, tuple(best[n].terms), float(best[n].held_out_rms)) for n in sorted(best)),
    )


def _error(row: Any) -> float:
    return float(row.held_out_rms) if math.isfinite(row.held_out_rms) else math.inf
