"""Channels that were recorded at a lower rate and held: each value stands for several rows.

Where the columns of two loggers were merged on the clock of the faster one, every value of the
slower repeats until the next one comes, and is late by half of that on average. It shows in two
ways, of which no signal has either by itself:

- a channel that moves by many steps of its resolution at once stands still right behind such a step
  again and again;
- all changes are so many rows apart, or a multiple of that, however small they are.

A channel that is slow or coarse stands still too, but not like that.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from classic_ml.columns.compiled_as_written import as_written
from classic_ml.columns.workspace import blocks
from classic_ml.description import TestDescription
from classic_ml.faults.standstill import Tally
from classic_ml.records import Record
from surge_core.errors import InputError
from surge_core.types import FloatArray, IntArray

__all__ = ["HeldSearch", "check_held", "held_channels", "held_in_chunks", "times_held"]


# In steps of the resolution, and half a one, so that no rounding decides. Two readings of a noise
# that makes such a step are alike by chance in one case of fourteen at most.
LARGE_STEPS = 8.5
# A value that is arrived at and left like that stands for two rows or more in so many cases: in 7 %
# at most on 28 records of three rigs, in 16 % and more where 800 values a second make 1000 rows.
HELD_SHARE = 0.15
FEWEST_VALUES = 50
# Of values held for one and a half rows each, half stand for one.
SINGLE_SHARE = 0.55
# A logger that is slower by more than that shows in no surge.
LONGEST_ROWS = 64
# Of a channel that is held a fifth of the rows and more repeat the one before; of the pressures of
# those records 13 % at most, but for those of a machine that never surges.
STILL_SHARE = 0.15
# A factor is a whole number where nearly all values stand for so many rows.
WHOLE_SHARE = 0.9
# Where plane 31 is later than plane 25 by 0.5, 1 and 1.5 ms, τ of 18 ms comes out 3 to 4, 6 to 9
# and 9 to 14 ms too large on three records; where all pressures are late alike it moves by its
# standard error at most. This much moves it by a twentieth.
LATE_S = 0.15e-3
# Averages of one logger differ by nearly as much, where few values move by large steps.
LATE_ROWS = 0.48


class HeldSearch:
    """The search in one channel, block by block.

    Parameters
    ----------
    least_step : float
        Least change from row to row that is one: the resolution of the channel.
    """

    def __init__(self, least_step: float) -> None:
        self._least = LARGE_STEPS * least_step
        self._lengths = np.zeros(LONGEST_ROWS + 1, dtype=np.int64)
        self._carried = np.array([1, 0, 0, 0, 0])

    def follow(self, values: FloatArray) -> None:
        """Go on with further rows, of which the first is the last one of those before.

        Parameters
        ----------
        values : ndarray of shape (m,)
            Rows of the channel; NaN without a reading.
        """
        _follow(values, self._least, self._lengths, self._carried)

    @property
    def rows(self) -> float | None:
        """Rows that a value stands for, on average where it is no whole number; None unknown."""
        _, _, n_changes, apart, n_single = self._carried.tolist()
        if n_changes >= FEWEST_VALUES and apart > 1:
            return float(apart)
        n = int(self._lengths.sum())
        if n < FEWEST_VALUES:
            # Small steps: many changes from one row to the next are none of a held channel.
            moves = n_changes >= FEWEST_VALUES and n_single > SINGLE_SHARE * n_changes
            return 1.0 if moves else None
        share = float(self._lengths[2:].sum()) / n
        if 0.5 * HELD_SHARE <= share < HELD_SHARE:
            return None
        if share < HELD_SHARE:
            return 1.0
        usual = int(np.argmax(self._lengths))
        if usual > 1 and self._lengths[usual::usual].sum() >= WHOLE_SHARE * n:
            return float(usual)
        return float(self._lengths @ np.arange(self._lengths.size)) / n


@as_written
def _follow(values: FloatArray, least: float, lengths: IntArray, carried: IntArray) -> None:
    """Count how many rows the values stand for that are arrived at and left by large steps.

    Parameters
    ----------
    values : ndarray of shape (m,)
        As for :meth:`HeldSearch.follow`.
    least : float
        A step is large above this.
    lengths : ndarray of int64
        Where they are counted by their rows, the longer ones at the end.
    carried : ndarray of int64, shape (5,)
        How many rows the last value stands for so far, whether a large step led to it, how many
        changes there were, the largest number that all rows between them are multiples of, and
        how many values stood for one row.
    """
    length, arrived, changes, apart, single = carried
    singles = 0
    for row in range(1, values.size):
        step = abs(values[row] - values[row - 1])
        if step == 0.0:
            length += 1
            continue
        large = 1 if step > least else 0
        if length == 1:
            single += 1
            singles += large & arrived
        else:
            lengths[min(length, lengths.size - 1)] += large & arrived
        if apart != 1 and changes > 0:
            rest = length
            while rest:
                apart, rest = rest, apart % rest
        # Before the first change nobody knows when the value began.
        changes += 1
        length, arrived = 1, large
    lengths[1] += singles
    carried[0], carried[1], carried[2], carried[3], carried[4] = (
        length,
        arrived,
        changes,
        apart,
        single,
    )


def held_channels(
    record: Record, names: Iterable[str], found: Mapping[str, Tally]
) -> dict[str, float]:
    """Return how many rows each value of a channel stands for.

    Parameters
    ----------
    record : Record
        As read.
    names : iterable of str
        Its channels to be looked at.
    found : mapping of str to Tally
        Of these channels.

    Returns
    -------
    dict of str to float
        By channel: 1 for one that is not held; without those that move too little to tell.
    """
    names, n_rows = tuple(names), record.n_samples
    held: dict[str, float | None] = dict.fromkeys(names, 1.0)
    searches = {
        name: HeldSearch(found[name].least_step)
        for name in names
        if found[name].still_rows > STILL_SHARE * n_rows or n_rows <= FEWEST_VALUES
    }
    # Without any there is nothing to be read.
    for rows in blocks(n_rows) if searches else ():
        for name, search in searches.items():
            search.follow(record[name][max(0, rows.start - 1) : rows.stop])
        record.workspace.release()
    held |= {name: search.rows for name, search in searches.items()}
    return {name: rows for name, rows in held.items() if rows is not None}


def held_in_chunks(
    chunks: Iterable[FloatArray], least_steps: Mapping[int, float]
) -> dict[int, float]:
    """Return how many rows each value of some columns of a file stands for.

    Parameters
    ----------
    chunks : iterable of ndarray of shape (m, n_columns)
        The rows of the file, one chunk after the other; NaN without a reading.
    least_steps : mapping of int to float
        The columns to be looked at, and the least change from row to row of each.

    Returns
    -------
    dict of int to float
        By column; 1 for one that is not held, or moves too little to tell.
    """
    searches = {number: HeldSearch(step) for number, step in least_steps.items()}
    last: FloatArray | None = None
    for chunk in chunks:
        rows = chunk if last is None else np.concatenate((last, chunk))
        for number, search in searches.items():
            search.follow(np.ascontiguousarray(rows[:, number]))
        last = rows[-1:]
    return {number: search.rows or 1.0 for number, search in searches.items()}


def check_held(record: Record, test: TestDescription, found: Mapping[str, Tally]) -> list[str]:
    """Refuse pressures that were held for different times.

    Parameters
    ----------
    record : Record
        As read.
    test : TestDescription
        Its channels.
    found : mapping of str to Tally
        Of all channels.

    Returns
    -------
    list of str
        A flag for pressures that are held alike, and one for thermocouples.

    Raises
    ------
    InputError
        When one pressure is later than another by so much that τ would be wrong.
    """
    held = held_channels(record, test.channel_names, found)
    pressures = {p.name: held[p.name] for p in test.pressures if p.name in held}
    couples = {c.name: held[c.name] for c in test.temperatures if held.get(c.name, 1.0) > 1.0}
    flags = []
    if pressures and max(pressures.values()) > 1.0:
        late = max(pressures, key=pressures.__getitem__)
        early = min(pressures, key=pressures.__getitem__)
        later = pressures[late] - pressures[early]
        later_s = 0.5 * later / record.sample_rate_hz
        together = _of_one_logger(list(pressures.values()))
        if later_s > LATE_S and later > LATE_ROWS and not together:
            raise _refusal(record, pressures, late, early)
        so = "every row counts as a reading of its own"
        if not together:
            so = f"they are {1e3 * later_s:.2g} ms later than {early}"
        flags.append(_flag(record, {n: r for n, r in pressures.items() if r > 1.0}, so))
    if couples:
        flags.append(_flag(record, couples, "the temperatures are late by half of that"))
    return flags


def _of_one_logger(rows: Sequence[float]) -> bool:
    """Tell whether all values stand for the same number of rows."""
    # A value that is followed by the same one counts as one that stands longer, on average.
    whole = any(r == round(r) for r in rows)
    return min(rows) == max(rows) or (not whole and max(rows) < 1.3 * min(rows))


def _flag(record: Record, held: Mapping[str, float], so: str) -> str:
    name = max(held, key=held.__getitem__)
    return (
        f"{_names(list(held))}: each value is there {times_held(held[name])}: recorded at "
        f"{record.sample_rate_hz / held[name]:.3g} samples a second and held? {so}: keep the rows "
        "alone in which there is a new value"
    )


def _refusal(record: Record, held: Mapping[str, float], late: str, early: str) -> InputError:
    most = [name for name, rows in held.items() if rows == held[late]]
    return InputError(
        f"{record.source}: {_names(most)}",
        expected="pressures that were recorded at one rate",
        found=f"each value {times_held(held[late])} there, {times_held(held[early])} in {early}: "
        "recorded at a lower rate and held",
        remedy="what is held is late, which makes τ wrong: keep the rows alone in which it has a "
        "new value, or leave its pair out of test.toml",
    )


def _names(names: Sequence[str]) -> str:
    more = f" and {len(names) - 1} more" if len(names) > 1 else ""
    return f"channel {names[0]}{more}"


def times_held(rows: float) -> str:
    """Return in words how often each value is there.

    Parameters
    ----------
    rows : float
        From :func:`held_channels`.
    """
    if rows == round(rows):
        return "once" if rows == 1.0 else f"{rows:.0f} times"
    return f"{rows:.3g} times on average"
