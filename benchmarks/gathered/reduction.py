"""The reduction from counts beside the same equations in a script."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from resident import Cost, cost

from classic_ml.io import read_raw
from classic_ml.reduction import reduce_record
from comparisons.rig import simulate, write_run
from gathered.script_reduction import FloatArray, read, reduce_by_script
from gathered.table import Cell, Line, absent, costs

CASES = ("985", "95", "90")
FIRST_SEED, SEEDS = 60, 2
PERIOD_S = 1e-3
SHORT_S, LONG_S, QUICK_S = 4.0, 40.0, 2.5
TURNS = 5
# Of the range of φ and of ψ' over the record; what is left is the script's table of Mach numbers.
TOLERANCE = 1e-6
NOT_ASKED = "not a question of this block: it fits nothing"
REFERENCE = "what the others are compared with"
OWN, SCRIPT = "reduce_record", "script (pandas, scipy)"
OWN_READING, SCRIPT_READING = "read_raw + reduce_record", "pandas.read_csv + script"


@dataclass
class _Way:
    """What one way of reducing cost and gave."""

    spent: list[Cost] = field(default_factory=list)
    differs: list[float] = field(default_factory=list)


def lines(quick: bool, seeds: int | None) -> list[Line]:
    """Return the lines of each length of record: ours, the script, and both with the file read.

    Parameters
    ----------
    quick : bool
        For its working alone.
    seeds : int, optional
        Records of each speed.
    """
    count = seeds or (1 if quick else SEEDS)
    lengths = (QUICK_S,) if quick else (SHORT_S, LONG_S)
    cases = CASES[:1] if quick else CASES
    found = []
    for duration_s in lengths:
        ways = {name: _Way() for name in (OWN, SCRIPT, OWN_READING, SCRIPT_READING)}
        n_samples = 0
        for case in cases:
            for seed in range(FIRST_SEED, FIRST_SEED + count):
                n_samples = _one_record(case, seed, duration_s, ways)
        found += [_line(f"{n}, {duration_s:g} s", n, ways, n_samples) for n in ways]
    return found


def _one_record(case: str, seed: int, duration_s: float, ways: dict[str, _Way]) -> int:
    """Reduce one record by every way, in turns; return its length."""
    with tempfile.TemporaryDirectory() as parent:
        folder = Path(parent) / "run"
        write_run(simulate(case, seed=seed, duration_s=duration_s), folder)
        raw, test = read_raw(folder / "raw.csv", folder / "test.toml")
        table, told = read(folder)
        calls: dict[str, Callable[[], Any]] = {
            OWN: lambda: reduce_record(raw, test),
            SCRIPT: lambda: reduce_by_script(table, told),
            OWN_READING: lambda: reduce_record(*read_raw(folder / "raw.csv", folder / "test.toml")),
            SCRIPT_READING: lambda: reduce_by_script(*read(folder)),
        }
        for call in calls.values():
            call()
        given: dict[str, tuple[FloatArray, FloatArray]] = {}
        for _ in range(TURNS):
            for name, call in calls.items():
                spent = cost(call)
                given[name] = _both(spent.result)
                # Results are not to be kept beside what the next call's memory is weighed against.
                ways[name].spent.append(Cost(None, spent.seconds, spent.peak_bytes))
    for name in (SCRIPT, OWN_READING, SCRIPT_READING):
        ways[name].differs.append(max(map(_difference, given[OWN], given[name])))
    return raw.n_samples


def _both(result: Any) -> tuple[FloatArray, FloatArray]:
    if isinstance(result, tuple):
        return result
    return result.series.phi, result.series.psi_p


def _difference(one: FloatArray, other: FloatArray) -> float:
    return float(np.max(np.abs(one - other)) / np.ptp(one))


def _line(title: str, name: str, ways: dict[str, _Way], n_samples: int) -> Line:
    way, own = ways[name], ways[OWN]
    seconds = np.array([one.seconds for one in way.spent])
    cells: dict[str, Cell] = {
        **absent(NOT_ASKED, "right_percent", "false_percent"),
        **absent(NOT_ASKED, "tau_error_percent", "error_over_bound", "efficiency"),
        "differs": max(way.differs) if way.differs else REFERENCE,
        **costs(
            seconds,
            np.array([one.seconds for one in own.spent]),
            np.array([one.peak_bytes for one in way.spent if one.peak_bytes is not None]),
            np.full(seconds.size, n_samples),
            PERIOD_S,
        ),
    }
    return Line("reduction", title, len(way.spent) // TURNS, cells, _note(way, name))


def _note(way: _Way, name: str) -> str:
    if name not in (SCRIPT, SCRIPT_READING):
        return ""
    met = max(way.differs) <= TOLERANCE
    return (
        f"phi and psi' {'agree' if met else 'DO NOT agree'} to {TOLERANCE:g} of their ranges; "
        "phi and psi' alone, where reduce_record also looks for faults, finds the window, reduces "
        "a second time without the filter, computes psi, and marks stall and the rows of the free "
        "run"
    )
