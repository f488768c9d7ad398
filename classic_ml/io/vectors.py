"""Files with groups: which of their vectors are the record, and how they are read as rows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from classic_ml.description import FileLayout
from classic_ml.io.table import Columns, RawFile, Sampling, check_unique
from surge_core.errors import InputError

__all__ = ["Found", "Leaf", "Vector", "as_table", "found_in"]

# How many groups or sizes a sentence names.
NAMED = 6
_UNIT_KEYS = frozenset(("unit", "units"))

Place = tuple[str, ...]


@dataclass(frozen=True)
class Leaf:
    """An array of numbers in a tree of groups.

    Parameters
    ----------
    shape : tuple of int
        Its shape.
    get : callable
        ``get(handle, index)`` returns a part of it, from the open file.
    unit : str
        Unit that is attached to it.
    columns : tuple of str
        Names that are attached to its columns.
    """

    shape: tuple[int, ...]
    get: Callable[[Any, tuple[Any, ...]], NDArray[Any]]
    unit: str = ""
    columns: tuple[str, ...] = ()


@dataclass(frozen=True)
class Vector:
    """A vector of numbers in a file.

    Parameters
    ----------
    path : tuple of str
        Its groups and its name.
    size : int
        Number of values.
    read : callable
        ``read(handle, start, stop)`` returns some of them, from the open file.
    unit : str
        Unit that the file states; empty without.
    stamp : str
        For a date that the reader has converted, what its seconds count from.
    sampling : Sampling, optional
        When it was sampled, where the file states that beside it.
    made : bool
        Whether it is a clock that the reader has made from that.
    """

    path: Place
    size: int
    read: Callable[[Any, int, int], NDArray[Any]]
    unit: str = ""
    stamp: str = ""
    sampling: Sampling | None = None
    made: bool = False


@dataclass
class Found:
    """The vectors of a file, and by place what is none and what it is instead."""

    vectors: list[Vector] = field(default_factory=list)
    aside: dict[Place, str] = field(default_factory=dict)


def found_in(tree: Mapping[str, Any], path: Place = ()) -> Found:
    """Return the vectors of numbers in a tree of groups.

    These are vectors, either way up, and the columns of a matrix beside which lie as many names.

    Parameters
    ----------
    tree : mapping
        Groups as mappings, arrays as `Leaf`, lists of texts; a text says what else is there.
    path : tuple of str
        Where in the file the tree stands.
    """
    found = Found()
    units = {
        name: text
        for key, node in tree.items()
        if key.lower() in _UNIT_KEYS and isinstance(node, Mapping)
        for name, text in node.items()
        if isinstance(text, str)
    }
    for name, node in tree.items():
        place = (*path, name)
        if isinstance(node, Mapping):
            inner = found_in(node, place)
            found.vectors += inner.vectors
            found.aside |= inner.aside
        elif isinstance(node, Leaf):
            _add(found, place, node, tree, units.get(name, ""))
        elif isinstance(node, str):
            found.aside[place] = node
    return found


def _add(found: Found, place: Place, leaf: Leaf, tree: Mapping[str, Any], unit: str) -> None:
    """Add the vector that an array is, or those of its named columns."""
    long = [axis for axis, size in enumerate(leaf.shape) if size > 1]
    if len(long) == 1:
        found.vectors.append(_along(place, leaf, long[0], {}, leaf.unit or unit))
        return
    lists = {key: node for key, node in tree.items() if isinstance(node, list)}
    for across, along in (long, long[::-1]) if len(long) == 2 else ():
        width = leaf.shape[across]
        names = [n for k, n in lists.items() if len(n) == width and k.lower() not in _UNIT_KEYS]
        names = [list(leaf.columns)] if len(leaf.columns) == width else names
        units = [u for k, u in lists.items() if len(u) == width and k.lower() in _UNIT_KEYS]
        if len(names) == 1:
            for number, name in enumerate(names[0]):
                label = units[0][number] if units else ""
                here = (*place[:-1], str(name).strip())
                found.vectors.append(_along(here, leaf, along, {across: number}, label))
            return
    shape = " by ".join(map(str, leaf.shape))
    found.aside[place] = (
        f"an array of {shape} without names for its columns" if long else "a single number"
    )


def _along(place: Place, leaf: Leaf, axis: int, at: Mapping[int, int], unit: str) -> Vector:
    """Return the vector along one axis of an array, at one place of the others."""

    def read(handle: Any, start: int, stop: int) -> NDArray[Any]:
        index = (slice(start, stop) if n == axis else at.get(n, 0) for n in range(len(leaf.shape)))
        return leaf.get(handle, tuple(index))

    return Vector(place, leaf.shape[axis], read, unit)


def as_table(
    source: str,
    found: Found,
    layout: FileLayout,
    opened: Callable[[], AbstractContextManager[Any]],
) -> RawFile:
    """Return the vectors of one length in one group as the columns of a record.

    Parameters
    ----------
    source : str
        The file.
    found : Found
        All that it holds.
    layout : FileLayout
        The group to take, and the name of the clock: its length is that of the record; without it
        the length that most vectors share.
    opened : callable
        Opens the file for `Vector.read`.

    Raises
    ------
    InputError
        When the group is not there, holds nothing, or several hold channels and none is named.
    """
    base = _named_group(source, found.vectors, layout)
    inside = [vector for vector in found.vectors if vector.path[: len(base)] == base]
    if not inside:
        raise InputError(source, expected="channels", found="no vector of numbers in it")
    size = _record_size(inside, layout)
    taken = [vector for vector in inside if vector.size == size]
    if layout.group is None:
        base = _only_group(source, taken)
    vectors = {_relative(vector.path, base): vector for vector in taken}
    check_unique(source, tuple(_relative(vector.path, base) for vector in taken))

    def read(names: tuple[str, ...], rows: int) -> Iterator[Columns]:
        with opened() as handle:
            for start in range(0, size, rows):
                stop = min(start + rows, size)
                yield tuple(_real(vectors[name].read(handle, start, stop)) for name in names)

    unusable = {_relative(path, base): why for path, why in found.aside.items() if _in(path, base)}
    groups: dict[Place, list[Vector]] = {}
    for vector in (one for one in found.vectors if not one.made):
        if vector.size != size:
            why = f"{vector.size} values where the record has {size}"
            if _in(vector.path, base):
                unusable[_relative(vector.path, base)] = why
            else:
                unusable[_full(vector.path)] = f"in the group '{_full(vector.path[:-1])}', {why}"
        if vector.path[:-1] not in {one.path[:-1] for one in taken}:
            groups.setdefault(vector.path[:-1], []).append(vector)
    stamps = {name: vector.stamp for name, vector in vectors.items() if vector.stamp}
    return RawFile(
        source,
        tuple(vectors),
        read,
        {name: " ".join(v.unit.split()) for name, v in vectors.items() if v.unit.strip()},
        size,
        stamps.get(layout.time, ""),
        unusable,
        stamps,
        {name: v.sampling for name, v in vectors.items() if v.sampling is not None},
        # With a group named, the user knows of the others.
        {_full(path): _contents(held) for path, held in groups.items()}
        if layout.group is None
        else {},
    )


def _real(values: Any) -> NDArray[Any]:
    """Return values as whole numbers of this machine or as float64."""
    numbers = np.asarray(values)
    whole = numbers.dtype.kind in "iu" and numbers.dtype.isnative
    return numbers if whole else numbers.astype(np.float64, copy=False)


def _in(path: Place, base: Place) -> bool:
    return path[: len(base)] == base


def _relative(path: Place, base: Place) -> str:
    return "/".join(path[len(base) :])


def _full(path: Place) -> str:
    return "/".join(path)


def _contents(held: Sequence[Vector]) -> str:
    sizes = sorted({vector.size for vector in held})
    steps_s = {vector.sampling.step_s for vector in held if vector.sampling is not None}
    n = len(held)
    text = f"{n} channel{'s' if n > 1 else ''} of {' or '.join(map(str, sizes[:NAMED]))} values"
    return f"{text}, {1.0 / steps_s.pop():g} a second" if len(steps_s) == 1 else text


def _named_group(source: str, vectors: Sequence[Vector], layout: FileLayout) -> Place:
    """Return the group that the layout names; the top of the file without."""
    wanted = (layout.group or "").strip("/")
    if not wanted:
        return ()
    for vector in vectors:
        for depth in range(1, len(vector.path)):
            if _full(vector.path[:depth]) == wanted:
                return vector.path[:depth]
    groups = sorted({_full(vector.path[:-1]) for vector in vectors})
    raise InputError(
        f"{source}: group {layout.group}",
        expected="it in the file, as [file] group says",
        found="only " + ", ".join(f"'{name or '/'}'" for name in groups[:NAMED]),
    )


def _record_size(vectors: Sequence[Vector], layout: FileLayout) -> int:
    clocks = {v.size for v in vectors if f"/{_full(v.path)}".endswith(f"/{layout.time}")}
    if len(clocks) == 1:
        return clocks.pop()
    shares = Counter(vector.size for vector in vectors)
    return max(shares, key=lambda size: (shares[size], size))


def _only_group(source: str, columns: Sequence[Vector]) -> Place:
    groups = list(dict.fromkeys(vector.path[:-1] for vector in columns))
    if len(groups) > 1:
        names = [f"'{_full(path) or '/'}'" for path in groups]
        more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
        raise InputError(
            source,
            expected="the channels in one group",
            found=f"channels in {', '.join(names[:NAMED])}{more}",
            remedy=f'write group = "{_full(groups[-1])}" in [file] of test.toml for one of '
            'them, or group = "/" for all, their columns named as "group/name"',
        )
    return groups[0]
