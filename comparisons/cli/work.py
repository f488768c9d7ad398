"""The command `sindy-surge work`: the work characteristic ψ_QS from raw counts."""

from __future__ import annotations

import argparse
from collections.abc import Iterable

from classic_ml.io import read_raw
from comparisons.cli.output import fitting, write_asked
from comparisons.harness.work_fit import fit_work
from comparisons.show.json_output import work_document
from comparisons.show.table import work_table
from surge_core.errors import InputError
from surge_core.progress import shown_steps


def run(given: argparse.Namespace) -> Iterable[str]:
    """Fit the work characteristic to a raw record."""
    breakpoints = _pair(given.breakpoints)
    with shown_steps([0.3, 3.0]) as begin:
        begin("reading")
        record, test = read_raw(given.raw, given.test)
        begin("reducing and fitting")
        fit = fit_work(
            record, test, breakpoints=breakpoints, time_constant_s=given.tau, progress=fitting
        )
    written = write_asked(given, json=lambda: work_document(fit, str(given.raw)))
    return work_table(fit), *written


def _pair(values: Iterable[float] | None) -> tuple[float, float] | None:
    if values is None:
        return None
    first, second = values
    if not 0.0 < first < second < 1.0:
        raise InputError(
            "--breakpoints",
            expected="two flow coefficients between 0 and 1, the smaller first",
            found=f"{first:g} {second:g}",
        )
    return first, second
