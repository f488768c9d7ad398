"""The cells of a study: points of its design, keys of what they share, and tasks."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from comparisons.study.spec import Method, Range, Scalar, StudySpec

# Cells of one task: enough to share a record among many estimators, few enough that little is
# unfinished at any time.
CELLS_A_TASK = 24


@dataclass(frozen=True)
class Point:
    """One record, how it is reduced, and how the fits are set."""

    source: str  # Where the record comes from
    seed: int  # Of the record
    settings: tuple[tuple[str, Scalar], ...]  # Every one that was given, by dotted name

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

        Records of one seed at other settings have the same compressor, flow and noise; machines of
        two rigs have nothing in common.
        """
        return self.record if self.source in ("files", "machines") else f"s-{self.seed}"

    @property
    def reduction(self) -> str:
        """Key of what was done to the record before any fit."""
        return "d-" + _key(self.table("reduction"))


@dataclass(frozen=True)
class Cell:
    """One fit: its position in the study, what is fitted, and the estimator."""

    number: int
    point: Point
    method: Method

    @property
    def key(self) -> str:
        """What the numbers of the cell depend on, and nothing else: not its place in a study."""
        method = [self.method.name, self.method.import_path, self.method.parameters]
        fit = self.point.table("fit")
        return "c-" + _key([self.point.record, self.point.reduction, fit, method])


def _key(value: object) -> str:
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def cells_of(spec: StudySpec) -> list[Cell]:
    """Return the cells of a study, always in the same order."""
    both = itertools.product(points_of(spec), spec.method)
    return [Cell(number, point, method) for number, (point, method) in enumerate(both)]


def points_of(spec: StudySpec) -> list[Point]:
    """Return the points of a study, of a random design each once; records vary slowest."""
    settings = spec.settings
    if spec.design is None:
        values = [v for v in settings.values() if not isinstance(v, Range)]
        drawn = list(itertools.product(*values))
    else:
        rng = np.random.default_rng(spec.design.seed)
        drawn = [
            tuple(
                v.at(float(rng.random())) if isinstance(v, Range) else v[int(rng.integers(len(v)))]
                for v in settings.values()
            )
            for _ in range(spec.design.random)
        ]
    points = [
        Point(spec.source, seed, tuple(zip(settings, values, strict=True)))
        for values in dict.fromkeys(drawn)
        for seed in spec.seeds
    ]
    order = {record: i for i, record in enumerate(dict.fromkeys(p.record for p in points))}
    return sorted(points, key=lambda point: order[point.record])


def tasks_of(cells: Sequence[Cell]) -> list[list[Cell]]:
    """Return cells in tasks, each of one record and those of one reduction side by side."""
    by_record: dict[str, list[Cell]] = {}
    for cell in cells:
        by_record.setdefault(cell.point.record, []).append(cell)
    return [
        several[start : start + CELLS_A_TASK]
        for several in by_record.values()
        for start in range(0, len(several), CELLS_A_TASK)
    ]
