"""Is anything missing? Tests whose null comes from the record itself.

"Nothing is missing" is a statement like any other: it is made when three tests, each of which
would have seen a gap, see none. None of them asks for white errors: on real records errors are
coloured by disturbances that no model foretells.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from comparisons.missing_effect.covariance import orthonormal
from surge_core.types import FloatArray

# Both tests together (Fisher), and that of a name's own place, speak below this chance.
LEAST_P = 0.002
# Errors this many times what is new in each of them come from a disturbance or from something
# missing. Complete models under strong coloured noise reach 6.5 (research on eleven systems).
LARGEST_RATIO = 7.0
# So many that one test can speak where the other says nothing.
SURROGATES = 4000


@dataclass(frozen=True)
class Leftover:
    """What a model leaves.

    Parameters
    ----------
    flip_p : float
        Chance of the best first-order gain of all effects, by flips of sign of blocks of errors.
    foretold_p : float
        Chance of how well signals foretell errors on held-out rows, by errors of random phases.
    foretold_share : float
        Share of the squared held-out errors that signals foretell beyond chance.
    ratio : float
        rms error over what is new in each error, of the worst output.
    follows : str
        What the errors follow most; empty where nothing.
    asked : mapping
        By the key of a name found, what its own place asks for beside it.
    """

    flip_p: float
    foretold_p: float
    foretold_share: float
    ratio: float
    follows: str = ""
    asked: Mapping[Hashable, str] = field(default_factory=dict)

    @property
    def structured(self) -> bool:
        """Whether the errors hold something that the inputs bring about."""
        from scipy.stats import chi2

        joined = -2.0 * float(np.log(self.flip_p) + np.log(self.foretold_p))
        return bool(chi2.sf(joined, 4) < LEAST_P)

    @property
    def disturbed(self) -> bool:
        """Whether the errors are so slow that a disturbance, or something missing, is there."""
        return self.ratio > LARGEST_RATIO


def chance_of(found: float, by_chance: FloatArray) -> float:
    """Return the chance of so large a figure, from draws without what it is to show."""
    return (1.0 + float(np.count_nonzero(by_chance >= found))) / (1.0 + by_chance.size)


def foretold(
    errors: Sequence[FloatArray],
    signals: Sequence[FloatArray],
    names: Sequence[str],
    rng: np.random.Generator,
) -> tuple[float, float, str]:
    """Test whether signals foretell errors, against errors of the same spectrum.

    Of each run there are one output's errors, and its inputs and simulated states. Returned are the
    chance of so much foretold, the share of the squared errors foretold beyond chance, and the
    signal, or product of two, that the errors follow most.
    """
    features, labels = _features(np.concatenate(list(signals)), names)
    error = np.concatenate([e - e.mean() for e in errors])
    basis = orthonormal(features)
    total = float(error @ error)
    if not basis.shape[1] or not total > 0.0:
        return 1.0, 0.0, ""
    found = float(np.sum((basis.T @ error) ** 2)) / total
    spectrum = np.fft.rfft(error)

    def by_phases() -> float:
        turned = spectrum * np.exp(2j * np.pi * rng.random(spectrum.size))
        return float(np.sum((np.fft.irfft(turned, error.size) @ basis) ** 2)) / total

    by_chance = np.array([by_phases() for _ in range(SURROGATES)])
    p = chance_of(found, by_chance)
    along = np.abs(features.T @ error) / np.maximum(np.linalg.norm(features, axis=0), 1e-300)
    return p, max(found - float(np.median(by_chance)), 0.0), labels[int(np.argmax(along))]


def _features(signals: FloatArray, names: Sequence[str]) -> tuple[FloatArray, list[str]]:
    """Return signals, their products of two and their sizes, centred."""
    spread = np.std(signals, axis=0)
    kept = np.flatnonzero(spread > 1e-9 * np.max(np.abs(signals), axis=0, initial=1e-300))
    z = (signals[:, kept] - signals[:, kept].mean(axis=0)) / spread[kept]
    columns, labels = [*z.T], [names[int(k)] for k in kept]
    for i in range(z.shape[1]):
        columns.append(np.abs(z[:, i]))
        labels.append(f"the size of {names[int(kept[i])]}")
        for j in range(i, z.shape[1]):
            columns.append(z[:, i] * z[:, j])
            labels.append(f"{names[int(kept[i])]}·{names[int(kept[j])]}")
    if not columns:
        return np.zeros((signals.shape[0], 0)), []
    out = np.column_stack(columns)
    return out - out.mean(axis=0), labels
