"""What every reader of raw records gives: named columns of numbers, block by block."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from classic_ml.description import FileLayout
from surge_core.errors import InputError

# Rows that a reader takes at once: 40 MB of 20 channels.
BLOCK_ROWS = 1 << 18
# What states the unit of a column, in small letters, in the order in which they are believed.
UNIT_NAMES = ("unit_string", "units", "unit", "ni_unitdescription", "engineering_units")
NOT_FINITE_REMEDY = (
    "cut the record there, or repair the channel; of a raw record a probe and its mate can be left "
    'out of test.toml, with other_columns = "ignore" in [file]'
)
# How many groups a sentence names.
NAMED = 6

# Some rows of a table, one array of numbers a column.
Columns = tuple[NDArray[Any], ...]


@dataclass(frozen=True)
class StoredTable:
    """A raw record on disk.

    ``names`` are those of its columns, that of the clock among them; ``read(names)`` yields some of
    them block by block from the first row on, a tuple of one array a column. ``units`` are what the
    file itself states by column, ``left_aside`` what else is in it, and why that is no column of
    numbers: text, another length; ``step_s`` is the step that it states, NaN where it states none.
    """

    source: str
    names: tuple[str, ...]
    read: Callable[[tuple[str, ...]], Iterator[Columns]]
    units: Mapping[str, str] = field(default_factory=dict)
    left_aside: Mapping[str, str] = field(default_factory=dict)
    step_s: float = math.nan

    def __post_init__(self) -> None:
        for name, count in Counter(self.names).items():
            if not name or count > 1:
                raise InputError(
                    f"{self.source}: column {name}",
                    expected="each column once, under a name",
                    found=f"it {count} times" if name else "one without a name",
                    remedy=""
                    if name
                    else "does every row end with a comma, or a line stand above the names?",
                )

    def blocks(self, names: tuple[str, ...]) -> Iterator[Columns]:
        """Yield columns of the file block by block, whole numbers as they are, else as float64."""
        try:
            for block in self.read(names):
                yield tuple(
                    v if v.dtype.kind in "iu" and v.dtype.isnative else v.astype(float, copy=False)
                    for v in block
                )
        except Exception as error:
            raise fault_of(error, self.source, "rows that can be read") from None


def fault_of(error: Exception, source: str, what: str) -> Exception:
    """Return the refusal of a file over which the library that reads such files stumbles.

    An InputError says already what is wrong; ``what`` is what the file should be.
    """
    if isinstance(error, InputError | MemoryError):
        return error
    cause = " ".join(str(error).split()) or type(error).__name__
    return InputError(
        source,
        expected=what,
        found=f"what cannot be read ({cause[:160]})",
        remedy="was it cut short? copy it again from where it was recorded",
    )


@dataclass(frozen=True)
class Vector:
    """A vector of numbers in a file: its groups and its name, and what the file states of it.

    The values have a length, and give some of them when they are sliced.
    """

    path: tuple[str, ...]
    values: Any
    unit: str = ""
    step_s: float = math.nan


def stated_unit(attributes: Mapping[Any, Any]) -> str:
    """Return the unit among the attributes of a column, as the formats and their writers name it.

    Capitals are no matter; a text may be of bytes, or stand alone in an array.
    """
    known = {_text(name).lower(): value for name, value in attributes.items()}
    for name in UNIT_NAMES:
        values = np.ravel(np.asarray(known.get(name, ()), dtype=object))
        if values.size:
            return _text(values[0])
    return ""


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


class _Along:
    """An array of which one axis is longer than 1, sliced along that axis."""

    def __init__(self, array: Any, axis: int) -> None:
        self._array, self._axis = array, axis

    def __len__(self) -> int:
        return int(self._array.shape[self._axis])

    def __getitem__(self, rows: slice) -> NDArray[Any]:
        axes = range(len(self._array.shape))
        return np.asarray(self._array[tuple(rows if k == self._axis else 0 for k in axes)])


def along(array: Any) -> Any:
    """Return an array of any shape as a vector, or None where it is none."""
    long = [axis for axis, size in enumerate(array.shape) if size > 1]
    return _Along(array, long[0]) if len(long) == 1 else None


def grouped(
    source: str, vectors: Sequence[Vector], layout: FileLayout, left_aside: Mapping[str, str]
) -> StoredTable:
    """Return the vectors of one length in one group of a file as the columns of a record.

    The layout names the group, and the clock, whose length is that of the record; without a clock
    it is the length that most vectors share. Refused is a group that is not there or holds nothing,
    and a file of which several hold channels where none is named.
    """
    wanted = (layout.group or "").strip("/")
    named = (v.path[:k] for v in vectors for k in range(len(v.path)))
    base = next((path for path in named if "/".join(path) == wanted), None)
    if base is None:
        # The names of all, of a file with many groups the first.
        groups = f"the groups {_listed(vectors)}" if vectors else "no vector of numbers"
        also = "".join(f"; {name} is {why}" for name, why in list(left_aside.items())[:1])
        expected = f"the group {wanted}, as [file] group says" if wanted else "channels"
        raise InputError(source, expected=expected, found=groups + ("" if vectors else also))
    inside = [vector for vector in vectors if vector.path[: len(base)] == base]
    shares = Counter(len(vector.values) for vector in inside)
    clocks = {len(v.values) for v in inside if v.path[-1] == layout.time}
    size = clocks.pop() if len(clocks) == 1 else max(shares, key=lambda n: (shares[n], n))
    taken = [vector for vector in inside if len(vector.values) == size]
    if layout.group is None:
        base = taken[0].path[:-1]
        if any(vector.path[:-1] != base for vector in taken):
            raise InputError(
                source,
                expected="the channels in one group",
                found=f"channels in {_listed(taken)}",
                remedy=f'write group = "{"/".join(base)}" in [file] of test.toml for one of them, '
                'or group = "/" for all, their columns named as "group/name"',
            )
    columns = {"/".join(vector.path[len(base) :]): vector for vector in taken}

    def read(names: tuple[str, ...]) -> Iterator[Columns]:
        for start in range(0, size, BLOCK_ROWS):
            rows = slice(start, min(start + BLOCK_ROWS, size))
            yield tuple(np.asarray(columns[name].values[rows]) for name in names)

    others = {
        "/".join(v.path): f"{len(v.values)} values where the record has {size}"
        for v in vectors
        if len(v.values) != size
    }
    units = {name: " ".join(v.unit.split()) for name, v in columns.items() if v.unit.strip()}
    aside = {**left_aside, **others}
    return StoredTable(source, tuple(columns), read, units, aside, taken[0].step_s)


def _listed(vectors: Sequence[Vector]) -> str:
    groups = list(dict.fromkeys("/".join(vector.path[:-1]) for vector in vectors))
    more = f" and {len(groups) - NAMED} more" if len(groups) > NAMED else ""
    return ", ".join(f"'{name or '/'}'" for name in groups[:NAMED]) + more
