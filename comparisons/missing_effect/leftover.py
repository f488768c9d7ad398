"""What a lag model leaves: a score test of all open terms and all effects in its errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comparisons.missing_effect.effect import Effect
from comparisons.missing_effect.lag_data import TRAIN
from comparisons.missing_effect.probes import Prober
from comparisons.missing_effect.quantities import chance

# The chance below which what a model leaves is called structure, and not chance.
LEFTOVER_P = 1e-4
# A name is firm only while no test of what it leaves comes below this; tests of one term at a
# time are weaker.
DOUBTFUL_P = 1e-3
DOUBTFUL_ALONE_P = 5e-3
LARGEST_UNEVENNESS = 5.0
# An effect whose start is searched this widely is tested apart from the others.
MANY_TRIALS = 20.0


@dataclass(frozen=True)
class Leftover:
    """What a score test of all open terms and all effects finds in a model's errors.

    Parameters
    ----------
    gain : float
        Log-units that they would win together, or the best of them where each is tested alone.
    degrees : int
        Columns.
    p_value : float
        Of that gain, or of a ripple or a branch where they say more.
    alone : bool
        Whether each was tested alone.
    unevenness : float
        By how many standard errors the rows that were held out are left noisier than the others.
    """

    gain: float
    degrees: int
    p_value: float
    alone: bool = False
    unevenness: float = 0.0

    @property
    def structured(self) -> bool:
        """Whether the errors hold more than noise that the model's inputs explain."""
        return self.p_value < LEFTOVER_P

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why a name that leaves this is not firm: a stricter bound, and even errors."""
        out, p = [], chance(self.p_value)
        if self.structured:
            out.append(
                "the model with it still leaves structure in its errors (what else was tested "
                f"would win {self.gain:.0f} log-units together, p {p})"
            )
        elif self.p_value < (DOUBTFUL_ALONE_P if self.alone else DOUBTFUL_P):
            out.append(f"what the model with it leaves is hardly chance (p {p})")
        if self.unevenness > LARGEST_UNEVENNESS:
            out.append("it leaves the rows that were held out noisier than those fitted")
        return tuple(out)


def leftover_of(
    prober: Prober,
    part: NDArray[np.int8],
    effects: Sequence[Effect],
    open_terms: Sequence[Effect],
) -> Leftover:
    """Test the errors of a model for anything that open terms and effects could still explain.

    The prober's model is fitted to all rows; ``part`` says which were fitted and held out before.
    """
    present = set(prober.fit.structure.names)
    probes = [
        prober.probe(effect) for effect in (*effects, *open_terms) if effect.name not in present
    ]
    searched = [p for p in probes if p.effect.searched >= MANY_TRIALS and p.degrees]
    few = [p for p in probes if p.effect.searched < MANY_TRIALS and p.columns.shape[1]]
    uneven = _unevenness(prober, part)
    apart = min((p.chance for p in searched), default=1.0)
    if prober.metric.flow is not None and few:
        # Many smooth terms together make up the difference between a noisy φ and a smooth one,
        # which is the noise itself: here each is tested alone.
        best = min(few, key=lambda p: p.chance)
        p_value = min(1.0, len(few) * best.chance, 2.0 * apart)
        return Leftover(best.gain, best.degrees, p_value, True, uneven)
    gain, basis = prober.joint([p.columns for p in few]) if few else (0.0, np.zeros((0, 0)))
    together = _chi2(gain, basis.shape[1])
    return Leftover(gain, basis.shape[1], min(1.0, 2.0 * together, 2.0 * apart), False, uneven)


def _chi2(gain: float, degrees: int) -> float:
    from scipy.stats import chi2

    return float(chi2.sf(2.0 * gain, degrees)) if degrees else 1.0


def _unevenness(prober: Prober, part: NDArray[np.int8]) -> float:
    """Return by how many standard errors held-out rows are noisier, by a fit to all."""
    errors = prober.fit.errors(prober.data, prober.metric)
    valid = prober.metric.rows(prober.data) > 0.0
    fitted, held = errors[valid & (part == TRAIN)] ** 2, errors[valid & (part != TRAIN)] ** 2
    if min(fitted.size, held.size) < 2:
        return 0.0
    spread = np.hypot(np.std(fitted) / np.sqrt(fitted.size), np.std(held) / np.sqrt(held.size))
    return float((held.mean() - fitted.mean()) / max(spread, 1e-300))
