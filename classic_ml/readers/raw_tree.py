"""A file as a tree of arrays and texts: where in it the vectors are, and what they are called."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from classic_ml.readers.raw_columns import Path, Vector

__all__ = ["Leaf", "Tree", "Unreadable", "array_leaf", "vectors"]

_UNIT_KEYS = frozenset(("unit", "units"))
_TIME_KEYS = frozenset(("time", "t", "time_s"))
_DATA_KEYS = frozenset(("data", "values", "value", "y"))
_NAME_KEYS = ("label", "name", "signalname")


@dataclass(frozen=True)
class Leaf:
    """An array of numbers.

    Parameters
    ----------
    shape : tuple of int
        Its shape.
    get : callable
        ``get(handle, index)`` returns the part of it at a tuple of slices and numbers.
    unit : str
        Unit that is attached to it.
    columns : tuple of str
        Names that are attached to its columns.
    clock : str
        For times that `get` has converted, what they count from.
    """

    shape: tuple[int, ...]
    get: Callable[[Any, tuple[Any, ...]], NDArray[Any]]
    unit: str = ""
    columns: tuple[str, ...] = ()
    clock: str = ""


@dataclass(frozen=True)
class Unreadable:
    """What is no array of numbers.

    Parameters
    ----------
    what : str
        What it is, in words.
    """

    what: str


Tree: TypeAlias = dict[str, "Node"]
Node: TypeAlias = "Leaf | Unreadable | str | list[str] | list[Tree] | Tree"


def array_leaf(values: NDArray[Any], unit: str = "") -> Leaf | Unreadable:
    """Return an array in memory as a leaf, if it holds real numbers."""
    if values.dtype.kind not in "iufb":
        return Unreadable("complex numbers" if values.dtype.kind == "c" else "no numbers")
    return Leaf(values.shape, lambda _, index: np.asarray(values[index]), unit)


@dataclass
class _Found:
    vectors: list[Vector] = field(default_factory=list)
    left_aside: dict[Path, str] = field(default_factory=dict)


def vectors(tree: Tree) -> tuple[list[Vector], dict[Path, str]]:
    """Return the vectors of numbers in a tree.

    These are: vectors, either way up; the columns of a matrix beside which lie as many names;
    groups of a time and data (a ``timeseries`` taken apart), which are one channel each; the
    signals of Simulink's structure with time.

    Parameters
    ----------
    tree : dict
        Groups as dicts, arrays as `Leaf`, texts and lists of texts; a list of dicts for an array
        of structs.

    Returns
    -------
    list of Vector
        In file order.
    dict of tuple to str
        By path, what is none, and what it is instead.
    """
    found = _Found()
    _walk(tree, (), found)
    return found.vectors, found.left_aside


def _walk(tree: Tree, path: Path, found: _Found) -> None:
    units = _units(tree)
    clocks: list[Vector] = []
    for name, node in tree.items():
        here = (*path, name)
        if isinstance(node, Leaf):
            _leaf(here, node, tree, units, found)
        elif isinstance(node, Unreadable):
            found.left_aside[here] = node.what
        elif isinstance(node, Mapping):
            channel = _channel(here, node)
            if channel is None:
                _walk(node, here, found)
            else:
                found.vectors.append(channel[0])
                clocks.append(channel[1])
        elif isinstance(node, str):
            found.left_aside[here] = "a text"
        elif node and isinstance(node[0], Mapping):
            found.vectors += _signals(path, name, node, found)
    taken = {vector.path for vector in found.vectors}
    found.vectors += [clock for clock in clocks[:1] if clock.path not in taken]


def _units(tree: Tree) -> Mapping[str, str]:
    """Return the units that a group states for what lies in it, by name."""
    for name, node in tree.items():
        if name.lower() in _UNIT_KEYS and isinstance(node, Mapping):
            return {key: text for key, text in node.items() if isinstance(text, str)}
    return {}


def _leaf(path: Path, leaf: Leaf, tree: Tree, units: Mapping[str, str], found: _Found) -> None:
    long = [axis for axis, size in enumerate(leaf.shape) if size > 1]
    if len(long) == 1:
        unit = leaf.unit or units.get(path[-1], "")
        found.vectors.append(_vector(path, leaf, long[0], {}, unit))
        return
    if len(long) == 2:
        named = _named_columns(leaf, long, tree)
        if named is not None:
            axis, names, column_units = named
            other = long[0] if axis == long[1] else long[1]
            for number, name in enumerate(names):
                vector = _vector(
                    (*path[:-1], name), leaf, axis, {other: number}, column_units[number]
                )
                found.vectors.append(vector)
            return
    if long:
        shape = " by ".join(str(size) for size in leaf.shape)
        found.left_aside[path] = f"an array of {shape} without names for its columns"
    else:
        found.left_aside[path] = "a single number" if leaf.shape.count(0) == 0 else "nothing in it"


def _vector(path: Path, leaf: Leaf, axis: int, at: Mapping[int, int], unit: str) -> Vector:
    """Return the vector along one axis of an array, at one place of the others."""

    def read(handle: Any, start: int, stop: int) -> NDArray[Any]:
        index = tuple(
            slice(start, stop) if n == axis else at.get(n, 0) for n in range(len(leaf.shape))
        )
        return leaf.get(handle, index)

    return Vector(path, leaf.shape[axis], read, unit, leaf.clock)


def _named_columns(
    leaf: Leaf, axes: Sequence[int], tree: Tree
) -> tuple[int, Sequence[str], Sequence[str]] | None:
    """Return along which axis a matrix runs, and names and units of its columns."""
    lists = {n: v for n, v in tree.items() if isinstance(v, list) and v and isinstance(v[0], str)}
    named = [v for n, v in lists.items() if n.lower() not in _UNIT_KEYS]
    stated = [v for n, v in lists.items() if n.lower() in _UNIT_KEYS]
    by_length = sorted(axes, key=lambda axis: leaf.shape[axis])
    for short, long in (by_length, by_length[::-1]):
        k = leaf.shape[short]
        fitting = [leaf.columns] if len(leaf.columns) == k else [v for v in named if len(v) == k]
        if len(fitting) == 1:
            units = next((v for v in stated if len(v) == k), [""] * k)
            return long, [str(n).strip() for n in fitting[0]], [str(u).strip() for u in units]
    return None


def _channel(path: Path, tree: Tree) -> tuple[Vector, Vector] | None:
    """Return data and clock of a group that is one channel with its own time."""
    by_key = {name.lower(): node for name, node in tree.items()}
    times = [n for n in tree if n.lower() in _TIME_KEYS and _is_vector(tree[n])]
    data = [n for n in tree if n.lower() in _DATA_KEYS and _is_vector(tree[n])]
    n_vectors = sum(_is_vector(node) for node in tree.values())
    if len(times) != 1 or len(data) != 1 or n_vectors != 2:
        return None
    found = _Found()
    unit = next((v for k, v in by_key.items() if k in _UNIT_KEYS and isinstance(v, str)), "")
    for key in ("datainfo", "dataunits"):
        node = by_key.get(key)
        if isinstance(node, Mapping):
            unit = unit or next(
                (v for k, v in node.items() if k.lower() in _UNIT_KEYS and isinstance(v, str)), ""
            )
        elif isinstance(node, str):
            unit = unit or node
    _leaf(path, _as_leaf(tree[data[0]]), {}, {path[-1]: unit}, found)
    _leaf((*path[:-1], times[0]), _as_leaf(tree[times[0]]), {}, {}, found)
    values, clock = found.vectors
    return replace(values, own_clock=clock), clock


def _is_vector(node: Node) -> bool:
    return isinstance(node, Leaf) and sum(size > 1 for size in node.shape) == 1


def _as_leaf(node: Node) -> Leaf:
    assert isinstance(node, Leaf)
    return node


def _signals(path: Path, name: str, parts: Sequence[Any], found: _Found) -> Iterator[Vector]:
    """Yield one vector for each struct of an array of structs: label and values."""
    for number, part in enumerate(parts, start=1):
        if not isinstance(part, Mapping):
            continue
        label = next(
            (str(v) for k in _NAME_KEYS for n, v in part.items() if n.lower() == k and v), ""
        )
        unit = next((str(v) for n, v in part.items() if n.lower() in _UNIT_KEYS), "")
        where = (*path, label or f"{name}{number}")
        data = [v for n, v in part.items() if n.lower() in _DATA_KEYS and _is_vector(v)]
        if len(data) != 1:
            found.left_aside[where] = "no vector of values"
            continue
        inner = _Found()
        _leaf(where, _as_leaf(data[0]), {}, {where[-1]: unit}, inner)
        yield from inner.vectors
