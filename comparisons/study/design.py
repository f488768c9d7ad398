"""The cells of a study: points of its design, keys of what they share, and tasks."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from comparisons.study.spec import Method, Range, Scalar, StudySpec

__all__ = ["Point", "Task", "count_cells", "count_points", "points_of", "tasks_of"]

# Cells of one task: enough to share a record among many estimators, few enough that little is
# unfinished at any time.
CELLS_A_TASK = 24


@dataclass(frozen=True)
class Point:
    """One record, how it is reduced, and how the fits are set.

    Parameters
    ----------
    number : int
        Position in the design; its cells are ``number * n_methods`` and on.
    source : str
        Where the record comes from.
    seed : int
        Of the record.
    settings : tuple of tuple of str and value
        Every setting that was given, by dotted name, in the order of the specification.
    """

    number: int
    source: str
    seed: int
    settings: tuple[tuple[str, Scalar], ...]

    def table(self, name: str) -> dict[str, Scalar]:
        """Return the settings of one table, by their names within it."""
        head = f"{name}."
        return {key[len(head) :]: value for key, value in self.settings if key.startswith(head)}

    @property
    def record(self) -> str:
        """Key of the record: the same key is the very same record."""
        seed = None if self.source == "files" else self.seed
        return "r-" + _key([self.source, seed, self.table("record")])

    @property
    def draw(self) -> str:
        """What is independent of other records: a file; of simulated ones the seed.

        Records of one seed at other settings have the same compressor, flow and noise.
        """
        return self.record if self.source == "files" else f"s-{self.seed}"

    @property
    def reduction(self) -> str:
        """Key of what was done to the record before any fit."""
        return "d-" + _key([self.table("reduction"), self.table("series")])


@dataclass(frozen=True)
class Task:
    """Cells that share a record, worked off by one worker.

    Parameters
    ----------
    number : int
        Position among the tasks.
    cells : tuple of tuple of int, Point and Method
        Number, point and method of each, those of one reduction side by side.
    """

    number: int
    cells: tuple[tuple[int, Point, Method], ...]


def _key(value: object) -> str:
    text = json.dumps(value, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def count_points(spec: StudySpec) -> int:
    """Return the number of points, seeds counted."""
    return sum(1 for _ in _combinations(spec)) * len(spec.seeds)


def count_cells(spec: StudySpec) -> int:
    """Return the number of cells."""
    return count_points(spec) * len(spec.methods)


def points_of(spec: StudySpec) -> Iterator[Point]:
    """Yield the points of a study, always in the same order; records vary slowest.

    Parameters
    ----------
    spec : StudySpec
        The study.
    """
    names = sorted(spec.settings, key=lambda name: not name.startswith("record."))
    number = 0
    for combination in _combinations(spec):
        ordered = tuple((name, combination[name]) for name in names)
        for seed in spec.seeds:
            yield Point(number, spec.source, seed, ordered)
            number += 1


def _combinations(spec: StudySpec) -> Iterator[Mapping[str, Scalar]]:
    names = sorted(spec.settings, key=lambda name: not name.startswith("record."))
    if spec.design.kind == "random":
        rng = np.random.default_rng(spec.design.seed)
        drawn = [
            {name: _drawn(spec.settings[name], rng) for name in names}
            for _ in range(spec.design.points)
        ]
        # From lists the same point may be drawn twice; and points of one record go together.
        distinct = {tuple(point.items()): point for point in drawn}
        order: dict[tuple[Scalar, ...], int] = {}
        for point in distinct.values():
            order.setdefault(_record_values(point), len(order))
        yield from sorted(distinct.values(), key=lambda point: order[_record_values(point)])
        return
    values = [v.values() if isinstance(v, Range) else v for v in (spec.settings[n] for n in names)]
    for combination in itertools.product(*values):
        yield dict(zip(names, combination, strict=True))


def _record_values(point: Mapping[str, Scalar]) -> tuple[Scalar, ...]:
    return tuple(value for name, value in point.items() if name.startswith("record."))


def _drawn(values: tuple[Scalar, ...] | Range, rng: np.random.Generator) -> Scalar:
    if isinstance(values, Range):
        return values.at(float(rng.random()))
    return values[int(rng.integers(len(values)))]


def tasks_of(
    spec: StudySpec, finished: frozenset[int] = frozenset(), workers: int = 1
) -> Iterator[Task]:
    """Yield tasks that cover the cells that are not finished.

    A record is made again for another task only where there are too few to keep all workers busy.

    Parameters
    ----------
    spec : StudySpec
        The study.
    finished : frozenset of int
        Numbers of cells that need not be run.
    workers : int
        Who waits for them.
    """
    left = count_cells(spec) - len(finished)
    most = max(1, min(CELLS_A_TASK, -(-left // (2 * workers))))
    held: list[tuple[int, Point, Method]] = []
    number, key = 0, ""
    for group in _by_record(spec):
        for cell in group:
            if cell[0] in finished:
                continue
            if held and (cell[1].record != key or len(held) >= most):
                yield Task(number, tuple(held))
                number, held = number + 1, []
            key = cell[1].record
            held.append(cell)
    if held:
        yield Task(number, tuple(held))


def _by_record(spec: StudySpec) -> Iterator[list[tuple[int, Point, Method]]]:
    """Yield the cells of the points that share their record's settings, record by record."""

    def settings(point: Point) -> tuple[tuple[str, Scalar], ...]:
        return tuple(point.table("record").items())

    for _, points in itertools.groupby(points_of(spec), key=settings):
        cells = [
            (point.number * len(spec.methods) + m, point, method)
            for point in points
            for m, method in enumerate(spec.methods)
        ]
        order: dict[str, int] = {}
        for _, point, _ in cells:
            order.setdefault(point.record, len(order))
        cells.sort(key=lambda cell: (order[cell[1].record], cell[0]))
        yield cells
