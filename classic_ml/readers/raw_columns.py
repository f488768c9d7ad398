"""Vectors of a file with groups: which of them are the record, and how they are read as rows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from classic_ml.readers.raw_table import Columns, RawFile, Sampling, check_unique, in_one_line
from classic_ml.readers.test_description import FileLayout
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["Vector", "as_columns", "made_clock", "one_line"]

# How many groups or sizes a sentence names.
NAMED = 6
LONGEST_CAUSE = 160
# Times that were computed twice differ in their last digits, which near zero are those of a step.
SAME_CLOCK = 1e-9
SAME_STEP = 1e-6
# How the words for a clock begin that was a date.
FROM_DATE = "seconds from the first sample"

Path = tuple[str, ...]


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
        ``read(handle, start, stop)`` returns some of them, with the file that `as_columns` opens.
    unit : str
        Unit that the file states; empty without.
    clock : str
        For times that the reader has made or converted, what they count from.
    own_clock : Vector, optional
        Times that lie beside this channel alone; they must be those of the others.
    sampling : Sampling, optional
        When it was sampled, where the file states that instead.
    """

    path: Path
    size: int
    read: Callable[[Any, int, int], NDArray[Any]]
    unit: str = ""
    clock: str = ""
    own_clock: Vector | None = None
    sampling: Sampling | None = None


def as_columns(
    source: str,
    vectors: Sequence[Vector],
    layout: FileLayout,
    opened: Callable[[], AbstractContextManager[Any]],
    left_aside: Mapping[Path, str] | None = None,
) -> RawFile:
    """Return the vectors of one length in one group as the columns of a record.

    Parameters
    ----------
    source : str
        The file.
    vectors : sequence of Vector
        All that it holds.
    layout : FileLayout
        The group to take, and the name of the clock: its length is that of the record; without it
        the length that most vectors share.
    opened : callable
        Opens the file for `Vector.read`.
    left_aside : mapping, optional
        By path, what is no vector of numbers, and what it is instead.

    Raises
    ------
    InputError
        When the group is not there, holds nothing, or several hold channels and none is named.
    """
    inside, base = _in_group(source, vectors, layout)
    size = _record_size(inside, layout)
    taken = [vector for vector in inside if vector.size == size]
    if layout.group is None:
        base = _only_group(source, taken)
    names = tuple("/".join(vector.path[len(base) :]) for vector in taken)
    check_unique(source, names)
    unusable, other_groups = _left_out(vectors, base, size)
    for path, why in (left_aside or {}).items():
        if path[: len(base)] == base:
            unusable[_relative(path, base)] = why

    def columns(rows: int) -> Iterator[Columns]:
        with opened() as handle:
            for start in range(0, size, rows):
                stop = min(start + rows, size)
                yield _rows(source, taken, handle, start, stop)

    return RawFile(
        source,
        names,
        columns,
        {n: in_one_line(v.unit) for n, v in zip(names, taken, strict=True) if v.unit.strip()},
        size,
        next((v.clock for n, v in zip(names, taken, strict=True) if n == layout.time), ""),
        unusable,
        stamps={
            n: v.clock for n, v in zip(names, taken, strict=True) if v.clock.startswith(FROM_DATE)
        },
        sampled={
            n: v.sampling for n, v in zip(names, taken, strict=True) if v.sampling is not None
        },
        # Who names a group knows of the others.
        other_groups=other_groups if layout.group is None else {},
    )


def _left_out(
    vectors: Sequence[Vector], base: Path, size: int
) -> tuple[dict[str, str], dict[str, str]]:
    """Return why vectors are no columns, by name, and what the groups hold that give none."""
    unusable: dict[str, str] = {}
    groups: dict[Path, list[Vector]] = {}
    given = {vector.path[:-1] for vector in vectors if vector.size == size}
    for vector in vectors:
        if vector.clock and vector.sampling is not None and vector.size != size:
            # It is made here, and nobody misses it.
            continue
        inside = vector.path[: len(base)] == base
        if vector.size != size and inside:
            why = f"{vector.size} values where the record has {size}"
            unusable[_relative(vector.path, base)] = why
        elif not inside:
            why = f"in the group '{'/'.join(vector.path[:-1])}', {vector.size} values where the "
            unusable["/".join(vector.path)] = f"{why}record has {size}"
        if vector.path[:-1] and (not inside or vector.path[:-1] not in given):
            groups.setdefault(vector.path[:-1], []).append(vector)
    return unusable, {"/".join(path): _contents(held) for path, held in groups.items()}


def _contents(held: Sequence[Vector]) -> str:
    sizes = sorted({vector.size for vector in held})
    steps_s = {vector.sampling.step_s for vector in held if vector.sampling is not None}
    n = len(held)
    text = f"{n} channel{'s' if n > 1 else ''} of {' or '.join(map(str, sizes[:NAMED]))} values"
    return f"{text}, {1.0 / steps_s.pop():g} a second" if len(steps_s) == 1 else text


def made_clock(path: Path, size: int, sampling: Sampling, clock: str) -> Vector:
    """Return the times of a file that states its first time and its step alone.

    Parameters
    ----------
    path : tuple of str
        What to call it.
    size : int
        Number of rows.
    sampling : Sampling
        Its first time and its step.
    clock : str
        Where they are from.
    """
    start_s, step_s = sampling.offset_s, sampling.step_s
    rate_hz = 1.0 / step_s

    def read(_: Any, start: int, stop: int) -> FloatArray:
        rows = np.arange(start, stop, dtype=np.float64)
        # A step of 1e-3 is no double; its rate is, and gives the times of a printed clock.
        return start_s + (rows / rate_hz if rate_hz == round(rate_hz) else rows * step_s)

    return Vector(path, size, read, "s", clock, sampling=sampling)


def _rows(source: str, columns: Sequence[Vector], handle: Any, start: int, stop: int) -> Columns:
    read: list[NDArray[Any]] = []
    times: tuple[Vector, FloatArray] | None = None
    slack_s = 0.0
    for vector in columns:
        try:
            read.append(_numbers(vector.read(handle, start, stop), stop - start))
            own = vector.own_clock
            own_s = None if own is None else np.asarray(own.read(handle, start, stop), np.float64)
            if own is not None and times is None:
                slack_s = SAME_STEP * _first_step(own, handle)
        except Exception as error:
            # The readers of binary formats raise whatever they stumble over.
            raise InputError(
                f"{source}: column {vector.path[-1]}",
                expected=f"rows {start + 1} to {stop} that can be read",
                found=one_line(error),
                remedy="the file was cut short or spoiled",
            ) from None
        if own_s is None:
            continue
        if times is None:
            times = vector, own_s
        elif not np.allclose(times[1], own_s, rtol=SAME_CLOCK, atol=slack_s, equal_nan=True):
            raise InputError(
                f"{source}: channels {times[0].path[-1]} and {vector.path[-1]}",
                expected="the same times for both",
                found=f"others between rows {start + 1} and {stop}",
                remedy="resample them to one clock",
            )
    return tuple(read)


def _numbers(values: ArrayLike, n_rows: int) -> NDArray[Any]:
    """Return values as whole numbers of this machine or as float64."""
    numbers = np.asarray(values)
    if numbers.dtype.kind not in "iu" or not numbers.dtype.isnative:
        numbers = numbers.astype(np.float64)
    if numbers.shape != (n_rows,):
        raise ValueError(f"{numbers.shape} values")
    return numbers


def _first_step(clock: Vector, handle: Any) -> float:
    """Return the step of a clock, whichever of its rows are looked at; 0 where it has none."""
    first = np.asarray(clock.read(handle, 0, 2), dtype=np.float64)
    step = float(abs(first[-1] - first[0]))
    return step if np.isfinite(step) else 0.0


def one_line(error: BaseException) -> str:
    """Return what an exception of a reader says, on one line."""
    return (" ".join(str(error).split()) or type(error).__name__)[:LONGEST_CAUSE]


def _relative(path: Path, base: Path) -> str:
    return "/".join(path[len(base) :])


def _in_group(
    source: str, vectors: Sequence[Vector], layout: FileLayout
) -> tuple[list[Vector], Path]:
    if not vectors:
        raise InputError(source, expected="channels", found="no vector of numbers in it")
    if layout.group is None or layout.group.strip("/") == "":
        return list(vectors), ()
    wanted = layout.group.strip("/")
    for depth in range(1, max(len(vector.path) for vector in vectors)):
        base = {vector.path[:depth] for vector in vectors if len(vector.path) > depth}
        for candidate in sorted(base):
            if "/".join(candidate) == wanted:
                return [v for v in vectors if v.path[:depth] == candidate], candidate
    groups = sorted({"/".join(vector.path[:-1]) for vector in vectors})
    raise InputError(
        f"{source}: group {layout.group}",
        expected="it in the file, as [file] group says",
        found="only " + ", ".join(f"'{name or '/'}'" for name in groups[:NAMED]),
    )


def _record_size(vectors: Sequence[Vector], layout: FileLayout) -> int:
    clocks = {v.size for v in vectors if v.path[-1] == layout.time or layout.time in _names(v)}
    if len(clocks) == 1:
        return clocks.pop()
    shares = Counter(vector.size for vector in vectors)
    return max(shares, key=lambda size: (shares[size], size))


def _names(vector: Vector) -> set[str]:
    return {"/".join(vector.path[depth:]) for depth in range(len(vector.path))}


def _only_group(source: str, columns: Sequence[Vector]) -> Path:
    groups = list(dict.fromkeys(vector.path[:-1] for vector in columns))
    if len(groups) > 1:
        names = [f"'{'/'.join(path) or '/'}'" for path in groups]
        more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
        raise InputError(
            source,
            expected="the channels in one group",
            found=f"channels in {', '.join(names[:NAMED])}{more}",
            remedy=f'write group = "{"/".join(groups[-1])}" in [file] of test.toml for one of '
            'them, or group = "/" for all, their columns named as "group/name"',
        )
    return groups[0]
