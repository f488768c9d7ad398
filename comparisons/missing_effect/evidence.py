"""Evidence for one model over another: likelihood, later time, another record, and the search.

Nothing here knows what a compressor is: a candidate brings its whitened errors on all rows, how
many numbers it fitted, and how long it searched.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comparisons.missing_effect.lag_data import LATER, OTHER, TRAIN
from surge_core.types import FloatArray

# Accepted only below this chance of so large a gain anywhere in the search.
LARGEST_P = 1e-4
LEAST_Z = 2.5
# A block that wins this much is no chance; three of them, thirty in all, make up for a small z.
LOUD_BLOCK = 5.0
LEAST_LOUD = 3
LOUD_SUM = 30.0
# Two models this close in log-units are not separated by these rows, whatever their order; the
# share covers what the rounding of the simulation does to large gains.
LEAST_GAP = 12.0
LEAST_GAP_SHARE = 0.004
# Blocks over which errors are compared: at least so many in the held-out rows.
MOST_BLOCKS = 40
LEAST_BLOCK_ROWS = 20


@dataclass(frozen=True)
class Tie:
    """When rows do not tell two models apart.

    They are as close as ``gap`` in log-units or as ``share`` of the better one's; or the better one
    is ahead by fewer standard errors than ``z``, block by block, and both correct the model without
    them at this cosine or more.
    """

    gap: float
    share: float
    z: float = -np.inf
    cosine: float = 1.0


ALIAS = Tie(LEAST_GAP, LEAST_GAP_SHARE, 2.33, 0.7)


@dataclass(frozen=True)
class Rows:
    """Which rows count, which part each is of, and its block; no block lies in two parts."""

    part: NDArray[np.int8]
    valid: NDArray[np.bool_]
    block: NDArray[np.int64]

    @classmethod
    def of(cls, part: NDArray[np.int8], valid: NDArray[np.bool_], block_rows: int) -> Rows:
        """Cut each part into blocks of about so many rows."""
        block = np.full(part.size, -1, dtype=np.int64)
        count = 0
        for value in (TRAIN, LATER, OTHER):
            rows = np.flatnonzero((part == value) & valid)
            if rows.size:
                n = max(2, rows.size // block_rows)
                block[rows] = count + np.minimum(np.arange(rows.size) * n // rows.size, n - 1)
                count += n
        return cls(part, valid, block)

    def of_part(self, *parts: int) -> NDArray[np.bool_]:
        """Return the rows that count, of some parts."""
        return self.valid & np.isin(self.part, parts)

    @property
    def n_fitted(self) -> int:
        """Number of rows fitted."""
        return int(np.count_nonzero(self.of_part(TRAIN)))

    @property
    def has_other(self) -> bool:
        """Whether there is a record that is not fitted."""
        return bool(np.any(self.of_part(OTHER)))


@dataclass(frozen=True)
class Evidence:
    """What speaks for a candidate against the model without it; gains in log-units.

    Parameters
    ----------
    train, later, other : float
        Gain on the rows fitted, on later time, on the other record (NaN without one).
    z, p_value : float
        Mean gain of the held-out blocks over its standard error; chance of the fitted gain without
        the effect, times all that was searched.
    score : float
        Fitted gain less half log n a number, plus the held-out gain.
    share, least_share : float
        Share of the squared errors of all rows that it explains, where model error rules, not
        noise; what it must reach there, in place of the chance and of z.
    many_blocks, one_sided : bool
        Whether several held-out blocks speak for it by themselves, and hardly one against it;
        whether those that lose are next to nothing beside those that win.
    chance : float
        Log-units that the best of all that is searched wins by chance.
    at_end : bool
        Whether the fit ended where no name stands on it: τ at the end of its search, a number
        where the effect is none, a run that grows from small changes.
    """

    train: float
    later: float
    other: float
    z: float
    p_value: float
    score: float
    share: float = float("nan")
    least_share: float = float("nan")
    many_blocks: bool = False
    one_sided: bool = False
    chance: float = 0.0
    at_end: bool = False

    @property
    def stands(self) -> bool:
        """Whether likelihood, later time and the other record all speak for it."""
        if self.at_end:
            return False
        held_out = self.later > 0.0 and not self.other <= 0.0
        if self.least_share == self.least_share:
            return held_out and self.share >= self.least_share
        return held_out and self.p_value < LARGEST_P and self.consistent

    @property
    def consistent(self) -> bool:
        """Whether the held-out blocks agree: a mean gain that is none of a few of them."""
        return self.z > LEAST_Z or self.many_blocks or self.one_sided

    @property
    def accepted(self) -> bool:
        """Whether it stands, and wins more than the best of all does by chance."""
        return self.stands and self.train + self.later > self.chance

    @property
    def refused_on(self) -> tuple[str, ...]:
        """On which rows it falls short; empty where it does on none."""
        if self.at_end:
            return ("end of the search",)
        by_share = self.least_share == self.least_share
        short = {
            "share": by_share and not self.share >= self.least_share,
            "fitted rows": not by_share and not self.p_value < LARGEST_P,
            "later time": not self.later > 0.0,
            "other record": self.other <= 0.0,
        }
        rows = tuple(name for name, is_short in short.items() if is_short)
        return rows if rows or by_share or self.consistent else ("held-out blocks",)


# Of what promised too little to be fitted.
NOT_FITTED = Evidence(np.nan, np.nan, np.nan, np.nan, np.nan, np.nan)


def evidence_of(
    rows: Rows,
    before: FloatArray,
    after: FloatArray,
    *,
    added: int,
    searched: float,
    episodes: tuple[float, float] = (0.0, 0.0),
    one_sided: float = 0.0,
) -> Evidence:
    """Weigh a candidate against the model without it, by whitened errors of fits to fitted rows.

    ``added`` numbers were fitted in addition, and the search was worth ``searched`` trials;
    ``episodes`` is what phases fitted on later time and on the other record cost. Where the effect
    may act in episodes alone, held-out blocks may lose the share ``one_sided`` of what the others
    win.
    """
    from scipy.stats import chi2

    gain = 0.5 * (before**2 - after**2)
    train = float(gain[rows.of_part(TRAIN)].sum())
    later = float(gain[rows.of_part(LATER)].sum()) - episodes[0]
    other = float(gain[rows.of_part(OTHER)].sum()) - episodes[1] if rows.has_other else float("nan")
    p_value = float(min(1.0, chi2.sf(2.0 * max(train, 0.0), max(added, 1)) * searched))
    held = later + (other if rows.has_other else 0.0)
    score = train - 0.5 * added * float(np.log(max(rows.n_fitted, 2))) + held
    z = paired_z(gain, rows, LATER, OTHER)
    sums = block_sums(gain, rows, LATER, OTHER)
    against, for_it = -float(sums[sums < 0.0].sum()), float(sums[sums > 0.0].sum())
    return Evidence(
        train,
        later,
        other,
        z,
        p_value,
        score,
        many_blocks=speak_for_themselves(sums),
        one_sided=against < one_sided * for_it,
    )


def speak_for_themselves(sums: FloatArray) -> bool:
    """Tell whether several held-out blocks win much, where the mean is ruled by a few of them.

    An effect that acts in a few cycles only, such as a branch in reversed flow that φ seldom
    reaches, wins thousands of log-units there and nothing elsewhere: its z is small.
    """
    loud = int(np.count_nonzero(sums > LOUD_BLOCK))
    against = int(np.count_nonzero(sums < -LOUD_BLOCK))
    return loud >= LEAST_LOUD and loud >= LEAST_LOUD * against and sums.sum() > LOUD_SUM


def block_sums(gain: FloatArray, rows: Rows, *parts: int) -> FloatArray:
    """Return the log-units that each block of some parts wins."""
    here = rows.of_part(*parts)
    sums = np.bincount(rows.block[here], gain[here])
    return np.asarray(sums[np.bincount(rows.block[here]) > 0], dtype=np.float64)


def paired_z(gain: FloatArray, rows: Rows, *parts: int) -> float:
    """Return the mean gain of the blocks of some parts over its standard error."""
    sums = block_sums(gain, rows, *parts)
    if sums.size < 2:
        return 0.0
    spread = float(np.std(sums, ddof=1)) * np.sqrt(sums.size)
    return float(sums.sum()) / spread if spread > 0.0 else 0.0


def are_alike(
    rows: Rows,
    base: FloatArray,
    errors: tuple[FloatArray, FloatArray],
    scores: tuple[float, float],
    tie: Tie = ALIAS,
) -> bool:
    """Tell whether these rows cannot tell a candidate from the best, by errors and scores of both.

    ``base`` are the whitened errors of the model without any.
    """
    (one, best), (score, most) = errors, scores
    if most - score < max(tie.gap, tie.share * most):
        return True
    if tie.z == -np.inf:
        return False
    z = paired_z(0.5 * (one**2 - best**2), rows, TRAIN, LATER, OTHER)
    return z < tie.z and cosine_of(rows, base, one, best) > tie.cosine


def cosine_of(rows: Rows, base: FloatArray, one: FloatArray, other: FloatArray) -> float:
    """Return how alike two models correct one without either: the cosine of their corrections."""
    first, second = (base - one)[rows.valid], (base - other)[rows.valid]
    size = float(np.linalg.norm(first) * np.linalg.norm(second))
    return float(first @ second) / size if size > 0.0 else 0.0
