"""The command `sindy-surge work`: the work characteristic ψ_QS from raw counts."""

from __future__ import annotations

import argparse
from collections.abc import Iterable

from comparisons.cli.shared import (
    Commands,
    add_raw,
    add_targets,
    check_files,
    fitting,
    number,
    time_constant,
    write_all,
)
from surge_core.errors import InputError
from surge_core.files import to_strict_json
from surge_core.progress import shown_steps

__all__ = ["add_parser", "run"]


def add_parser(commands: Commands) -> None:
    """Add the command.

    Parameters
    ----------
    commands : argparse sub-parsers
        Those of `sindy-surge`.
    """
    parser = commands.add_parser(
        "work",
        help="fit the work characteristic ψ_QS to a raw record with T31",
        description="Reduce a raw record without a low-pass, undo the lag of the thermocouples and "
        "fit the piecewise-linear work characteristic of Fig 22 to the power that the blading "
        "delivers, with rows near zero flow weighted down.",
    )
    add_raw(parser)
    parser.add_argument(
        "--breakpoints",
        type=number,
        nargs=2,
        metavar=("D1", "D2"),
        help="φ at which the slope changes (default: searched)",
    )
    parser.add_argument("--tau", type=time_constant, metavar="TAU", help="hold τ, as 18ms")
    add_targets(parser, "json")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Fit the work characteristic of a raw record.

    Parameters
    ----------
    arguments : argparse.Namespace
        Of the command.
    """
    from classic_ml.readers import read_raw
    from comparisons.harness.work_fit import fit_work
    from comparisons.show.work_output import work_document, work_table

    check_files([arguments.raw, arguments.test], json=arguments.json)
    breakpoints = _pair(arguments.breakpoints)
    with shown_steps(2) as begin:
        begin("reading")
        record, test = read_raw(arguments.raw, arguments.test)
        begin("reducing and fitting")
        fit = fit_work(
            record,
            test,
            breakpoints=breakpoints,
            time_constant_s=arguments.tau,
            progress=fitting,
        )
    document = work_document(fit, str(arguments.raw))
    written = write_all([("numbers", arguments.json, lambda: to_strict_json(document))])
    for line in (work_table(fit, searched=breakpoints is None), *written):
        print(line)


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
