"""Is anything missing? Tests whose null comes from the record itself.

"Nothing is missing" is a statement like any other: it is made when five tests, each of which
would have seen a gap, see none. None of them asks for white errors: on real records errors are
coloured by disturbances that no model foretells.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.signal import lfilter

from comparisons.missing_effect.covariance import orthonormal
from surge_core.types import FloatArray

# Both tests together (Fisher), each other test, and that of a name's own place, speak below this
# chance.
LEAST_P = 0.002
# Errors this many times what is new in each of them come from a disturbance or from something
# missing. Complete models under strong coloured noise reach 6.5 (research on eleven systems).
LARGEST_RATIO = 7.0
# Above this many times, what is left is more than the noise of each reading, and what is new in
# each sample is asked as well.
COLOURED = 2.0
# Errors before that foretell an error: at 4 what slow errors leave of themselves looked foretold.
MEMORY = 10
# Rows before whose features count; of one row alone a play had chances of 1e-5, of two 1e-13.
BACK = 2
# Plays that say which way a signal moves, in its standard deviations.
PLAYS = (0.1, 0.3, 1.0)
# Rows before whose inputs count one by one, and so many means over longer spans: what dynamics that
# the model lacks make of an input.
REACH, LONGER = 30, 5
# Errors of random phases for that, whose tail is taken as a gamma one.
LATE_SURROGATES = 200
# Errors there are cut at so many robust standard deviations: spikes of a sensor, 1.5 % of its
# readings, made a complete model look late.
MOST_SPIKE = 4.0
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
    new_p : float
        Chance of how well signals foretell what is new in each error of an output whose errors are
        coloured; 1 where none is.
    late_p : float
        Chance of how well inputs of earlier rows foretell what is new in each error.
    idle : bool
        Whether coloured errors of an output are more than what the model explains of it.
    mute : str
        Outputs of which the model explains no more than chance.
    """

    flip_p: float
    foretold_p: float
    foretold_share: float
    ratio: float
    follows: str = ""
    asked: Mapping[Hashable, str] = field(default_factory=dict)
    new_p: float = 1.0
    late_p: float = 1.0
    idle: bool = False
    mute: str = ""

    @property
    def late(self) -> bool:
        """Whether errors follow what the inputs did before, as dynamics that are missing do."""
        return self.late_p < LEAST_P

    @property
    def structured(self) -> bool:
        """Whether the errors hold something that the inputs bring about."""
        from scipy.stats import chi2

        joined = -2.0 * float(np.log(self.flip_p) + np.log(self.foretold_p))
        return bool(chi2.sf(joined, 4) < LEAST_P) or self.new_p < LEAST_P

    @property
    def disturbed(self) -> bool:
        """Whether the errors are so slow that a disturbance, or something missing, is there."""
        return self.ratio > LARGEST_RATIO or self.idle or bool(self.mute)


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


def newly_foretold(errors: Sequence[FloatArray], signals: Sequence[FloatArray]) -> float:
    """Return the chance of how well signals foretell what is new in each error, by an F test.

    Where errors are slow, errors of one spectrum hide much; what is missing acts afresh in each
    sample. Beside the errors before it, features of the rows before count, and the way in which
    each signal moves. A play that was left out left 4 to 6 times the noise, at chances of 0.01 to
    0.2 by the spectrum and below 1e-11 here. Of 2 400 records of noise of four colours, none came
    below 0.003.
    """
    from scipy.stats import f

    whole = np.concatenate(list(signals))
    if not np.isfinite(whole).all():
        return 1.0
    mean, spread = whole.mean(axis=0), np.std(whole, axis=0)
    ways = [_ways((one - mean) / np.where(spread > 0.0, spread, 1.0)) for one in signals]
    features = np.column_stack([_features(whole, [""] * mean.size)[0], np.concatenate(ways)])
    target, before, beside = [], [], []
    ends = np.cumsum([e.size for e in errors])[:-1]
    for one, beside_one in zip(errors, np.split(features, ends), strict=True):
        there = np.flatnonzero(np.isfinite(one))
        e, at = one[there], np.arange(MEMORY, there.size)
        target.append(e[at])
        before.append(np.column_stack([np.ones(at.size), *(e[at - k - 1] for k in range(MEMORY))]))
        beside.append(np.column_stack([beside_one[there[at - k - 1]] for k in range(BACK)]))
    error, basis = np.concatenate(target), orthonormal(np.concatenate(before))
    error -= basis @ (basis.T @ error)
    # Not freed of the errors before: slow features and they would share out what chance wins.
    own = orthonormal(np.concatenate(beside))
    n_own, n_left = own.shape[1], error.size - basis.shape[1] - own.shape[1]
    won = float(np.sum((own.T @ error) ** 2))
    left = float(error @ error) - won
    if n_own == 0 or n_left < n_own or not left > 0.0:
        return 1.0
    return float(f.sf((won / n_own) / (left / n_left), n_own, n_left))


def foretold_late(
    errors: Sequence[FloatArray], inputs: Sequence[FloatArray], rng: np.random.Generator
) -> float:
    """Return the chance of how well inputs of earlier rows foretell what is new in each error.

    States of the model say nothing of dynamics that it lacks: a mode, a second lag, a pipe. They
    answer what an input did before. Errors of the same spectrum say what chance does; where a loop
    lets an input answer errors, the errors before account for it. A third mode of an aircraft's
    wing, 2.6 times what is new in each error, was seen by no other test. Of 378 errors of complete
    models, under noise of three colours, one came below 0.002.
    """
    from scipy.stats import gamma

    # What an input did is how it moved, in its own size: one that rests says nothing.
    moved = [u - u[0] for u in inputs]
    spread = np.std(np.concatenate(moved), axis=0)
    acting = spread > 1e-9 * np.max(np.abs(np.concatenate(list(inputs))), axis=0)
    read = [(e, u, np.flatnonzero(np.isfinite(e))) for e, u in zip(errors, moved, strict=True)]
    # An output that is read seldom may have too few readings in a run.
    long = [(e, u, rows) for e, u, rows in read if rows.size > MEMORY + 1 and np.ptp(e[rows]) > 0.0]
    if not (long and acting.any()):
        return 1.0
    runs = [e[rows] - np.median(e[rows]) for e, _, rows in long]
    most = MOST_SPIKE * 1.4826 * float(np.median(np.abs(np.concatenate(runs))))
    runs = [np.clip(e, -most, most) for e in runs]
    runs = [e - e.mean() for e in runs]
    earlier = [
        _earlier(u[:, acting] / spread[acting])[rows[MEMORY - 1 : -1]] for _, u, rows in long
    ]
    own = orthonormal(np.concatenate([x - x.mean(axis=0) for x in earlier]))
    if own.shape[0] < 2 * (own.shape[1] + MEMORY):
        return 1.0

    def share(ones: Sequence[FloatArray]) -> float:
        target = np.concatenate([e[MEMORY:] for e in ones])
        before = np.concatenate([sliding_window_view(e[:-1], MEMORY) for e in ones])
        target = target - before @ np.linalg.lstsq(before, target)[0]
        return float(np.sum((own.T @ target) ** 2) / max(float(target @ target), 1e-300))

    whole, ends = np.concatenate(runs), np.cumsum([e.size for e in runs])[:-1]
    # Tapered: what the ends leave in the spectrum made slow errors without noise look foretold.
    spectrum = np.fft.rfft(whole * np.hanning(whole.size))
    by_chance = np.empty(LATE_SURROGATES)
    for k in range(LATE_SURROGATES):
        turned = spectrum * np.exp(2j * np.pi * rng.random(spectrum.size))
        by_chance[k] = share(np.split(np.fft.irfft(turned, whole.size), ends))
    scale = float(np.var(by_chance) / np.mean(by_chance))
    return float(gamma.sf(share(runs), float(np.mean(by_chance)) / scale, scale=scale))


def _earlier(z: FloatArray) -> FloatArray:
    """Return signals of rows before, and their means over ever longer spans."""
    rows = len(z)
    spans = np.geomspace(REACH, max(2.0 * REACH, rows / 10.0), LONGER)
    back = [np.pad(z, ((k, 0), (0, 0)))[:rows] for k in range(REACH)]
    means = [lfilter([1.0 / span], [1.0, 1.0 / span - 1.0], z, axis=0) for span in spans]
    return np.column_stack([*back, *means])


def _ways(z: FloatArray) -> FloatArray:
    """Return what plays of several widths take off signals, each in units of its width."""
    widths = np.repeat(PLAYS, z.shape[1])
    driven = np.tile(z, len(PLAYS))
    out, behind = np.empty_like(driven), driven[0]
    for k, row in enumerate(driven):
        behind = np.clip(behind, row - widths, row + widths)
        out[k] = (row - behind) / widths
    return out


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
