"""The command `sindy-surge discover`: the equations of any measured system."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pysindy as ps

from classic_ml.description import FileLayout
from classic_ml.io.csv import open_csv
from classic_ml.io.series import read_series
from classic_ml.io.table import NOT_FINITE_REMEDY
from classic_ml.series import CoefficientSeries
from comparisons.cli.output import page, write_asked
from comparisons.show.discover_output import (
    discover_document,
    discover_lines,
    discover_parts,
    loop_document,
    loop_lines,
    loop_parts,
)
from sindy_surge import SparseDynamics, SurgeLoop, discover_loop
from sindy_surge.discover.trajectories import CUT_ROWS
from surge_core.errors import InputError, require
from surge_core.progress import shown_steps
from surge_core.types import FloatArray

TIME = "time_s"
FUNCTIONS: dict[str, Any] = {
    # Noise at zero must not leave the domain of the root; pysindy counts arguments of Python's own.
    "sqrt": lambda x: np.sqrt(abs(x)),
    "sin": lambda x: np.sin(1.0 * x),
    "cos": lambda x: np.cos(1.0 * x),
    "abs": lambda x: abs(1.0 * x),
}
HIGHEST_DEGREE = 6
CUT = "cut the record there and give the parts as files"


def run(given: argparse.Namespace) -> Iterable[str]:
    """Find the equations behind measured states, or the loop behind a series."""
    if given.loop:
        return _loop(given)
    if not given.states:
        with open_csv(given.files[0], FileLayout()) as stored:
            names = ", ".join(name for name in stored.names if name != TIME)
        remedy = f"those of {given.files[0].name} are {names}"
        expected = "the columns that are states, such as --states x,v"
        raise InputError("--states", expected=expected, found="none", remedy=remedy)
    states, inputs = _names("--states", given.states), _names("--inputs", given.inputs)
    clock = TIME in (*states, *inputs)
    require(not clock, "--states", "measured columns", f"the clock, {TIME}")
    hidden = _names("--hidden", given.hidden)
    names = ", ".join(path.name for path in given.files)
    with shown_steps(3) as begin:
        begin("reading")
        tables = [_table(path, (*states, *inputs)) for path in given.files]
        x = [table[:, 1 : 1 + len(states)] for table in tables]
        t = [table[:, 0] for table in tables]
        u = [table[:, 1 + len(states) :] for table in tables] if inputs else None
        begin("choosing terms")
        model = SparseDynamics(
            library=_library(given.library, (*states, *hidden, *inputs)),
            hidden=hidden,
            known=dict(map(_known, given.known)),
        )
        try:
            model.fit(x, t, u, feature_names=(*states, *inputs))
        except InputError as e:
            where, found = (_with_files(words, given.files) for words in (e.where, e.found))
            remedy = e.remedy.replace(CUT_ROWS, CUT)
            raise InputError(where, expected=e.expected, found=found, remedy=remedy) from None
        begin("writing")
        written = write_asked(
            given,
            json=lambda: discover_document(model),
            report=lambda: page(f"Equations of {names}", [(names, discover_parts(model, x, t))]),
        )
    return *discover_lines(model), *written


def _with_files(words: str, files: Sequence[Path]) -> str:
    """Write the files in place of the numbers of trajectories."""
    named = {str(number): str(path) for number, path in enumerate(files)}
    return re.sub(r"([xu] of )?trajectory (\d+)", lambda m: named.get(m[2], m[0]), words)


def _loop(given: argparse.Namespace) -> Iterable[str]:
    require(len(given.files) == 1, "--loop", "one series", f"{len(given.files)} files")
    path = given.files[0]
    with shown_steps(3) as begin:
        begin("reading")
        series = read_series(path)
        plenum = None
        if path.suffix.lower() == ".csv":
            with open_csv(path, FileLayout()) as stored:
                there = "plenum" in stored.names
            plenum = _table(path, ("plenum",))[:, 1] if there else None
        begin("finding branches, levels and lag")
        found = discover_series_loop(series, plenum)
        begin("writing")
        section = path.name, loop_parts(found, path.name)
        written = write_asked(
            given,
            json=lambda: loop_document(found),
            report=lambda: page(f"Surge loop of {path.name}", [section]),
        )
    return *loop_lines(found), *written


def discover_series_loop(series: CoefficientSeries, plenum: FloatArray | None = None) -> SurgeLoop:
    """Discover the loop of a reduced record, from its unfiltered columns where it has them.

    The rows of its free run count where they are marked; a plenum pressure not given is hidden.
    """
    phi, psi_p = series.phi, series.psi_p
    if series.phi_unfiltered is not None and series.psi_p_unfiltered is not None:
        phi, psi_p = series.phi_unfiltered, series.psi_p_unfiltered
    rows = slice(None)
    if series.free_run is not None and np.any(series.free_run > 0):
        inside = np.flatnonzero(series.free_run > 0)
        rows = slice(inside[0], inside[-1] + 1)
    third = None if plenum is None else plenum[rows]
    return discover_loop(phi[rows], psi_p[rows], third, series.sample_period_s)


def _names(option: str, text: str) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(",")) if text else ()
    good = len(set(names)) == len(names) and "" not in names
    require(good, option, "different names, with commas between", text or "nothing")
    return names


def _table(path: Path, columns: Sequence[str]) -> FloatArray:
    """Return time and columns of a CSV file, (n_rows, 1 + n_columns)."""
    wanted = (TIME, *columns)
    with open_csv(path, FileLayout()) as stored:
        missing = [name for name in wanted if name not in stored.names]
        expected, found = "the columns " + ", ".join(wanted), "none called " + ", ".join(missing)
        remedy = "the first line holds the names; here these are " + ", ".join(stored.names)
        require(not missing, str(path), expected, found, remedy)
        try:
            blocks = [np.column_stack(block) for block in stored.blocks(wanted)]
        except InputError as e:
            # What else it advises is for raw records.
            remedy = e.remedy.replace(NOT_FINITE_REMEDY, CUT)
            raise InputError(e.where, expected=e.expected, found=e.found, remedy=remedy) from None
        table = np.concatenate(blocks).astype(np.float64)
    for name, values in zip(wanted, table.T, strict=True):
        odd = ", ".join(f"{value:g}" for value in values[~np.isfinite(values)][:1])
        require(not odd, f"{path}: column {name}", "a finite number in every row", odd, CUT)
    steps, sorted_steps = np.diff(table[:, 0]), np.diff(np.sort(table[:, 0]))
    back = np.flatnonzero(steps <= 0.0)
    if back.size:
        remedy = CUT
        if np.any(steps < 0.0) and np.ptp(sorted_steps) < np.median(sorted_steps):
            remedy = "sort the rows by time"
        elif np.count_nonzero(steps == 0.0) > 1:
            remedy = "write the time with more digits"
        elif steps.min() == 0.0:
            remedy = "leave one of the two rows out"
        found = f"{table[back[0], 0]:g} s followed by {table[back[0] + 1, 0]:g} s"
        where, expected = f"{path}: column time_s", "times that rise"
        raise InputError(where, expected=expected, found=found, remedy=remedy)
    return table


def _library(text: str, names: Sequence[str]) -> Any:
    """Return the library that a specification such as ``poly3+sqrt(psi)`` names."""
    parts, columns = [], []
    # A column may hold spaces, and a sum in brackets.
    for part in re.split(r"\s*\+\s*(?![^(]*\))", text.strip()):
        function, inner = (each.strip() for each in part.removesuffix(")").partition("(")[::2])
        degree = part.removeprefix("poly").strip()
        if part.startswith("poly") and degree.isdigit() and int(degree) <= HIGHEST_DEGREE:
            parts.append(ps.PolynomialLibrary(degree=int(degree)))
            columns.append(list(range(len(names))))
        elif function in FUNCTIONS and inner in names and part.endswith(")"):
            named = [lambda x, word=function: f"{word}({x})"]
            parts.append(ps.CustomLibrary([FUNCTIONS[function]], function_names=named))
            columns.append([list(names).index(inner)])
        else:
            expected = (
                f"poly1 to poly{HIGHEST_DEGREE} and {', '.join(FUNCTIONS)} of a column, joined by +"
            )
            remedy = f"the columns of the fit are {', '.join(names)}"
            raise InputError("--library", expected=expected, found=part or "nothing", remedy=remedy)
    if columns == [list(range(len(names)))]:
        return parts[0]
    return ps.GeneralizedLibrary(parts, inputs_per_library=columns)


def _known(text: str) -> tuple[str, dict[str, float]]:
    """Return state and coefficients of ``phi: psi_c=1.8, psi=-1.8``."""
    state, _, rest = text.partition(":")
    try:
        pairs = [part.split("=") for part in rest.split(",")]
        return state.strip(), {name.strip(): float(value) for name, value in pairs}
    except ValueError:
        expected = "an equation such as 'phi: psi_c=1.8, psi=-1.8'"
        raise InputError("--known", expected=expected, found=text) from None
