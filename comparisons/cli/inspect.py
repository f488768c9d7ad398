"""The command `sindy-surge inspect`: what is in a file, and what reduce would make of it."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from comparisons.cli.shared import Commands, check_files, write_all
from surge_core.errors import InputError
from surge_core.files import to_strict_json
from surge_core.progress import shown_steps

__all__ = ["add_parser", "run"]

SERIES_COLUMNS = frozenset(("time_s", "phi", "psi_p"))


def add_parser(commands: Commands) -> None:
    """Add the command.

    Parameters
    ----------
    commands : argparse sub-parsers
        Those of `sindy-surge`.
    """
    parser = commands.add_parser(
        "inspect",
        help="show what is in a raw record or a series, and draft its test.toml",
        description="Show the channels of a file (CSV, MAT, netCDF, HDF5, TDMS, Parquet) with "
        "units, rate, gaps, ranges and saturation; with --test also which column feeds which "
        "channel, the ranges in SI and what reduce would make of the record. A file that is "
        "broken is shown as far as it goes.",
    )
    parser.add_argument("file", type=Path, metavar="FILE", help="raw record or series")
    parser.add_argument("--test", type=Path, metavar="TEST.toml", help="description of its test")
    parser.add_argument(
        "--group", metavar="NAME", help="group, struct or table to look into, without --test"
    )
    parser.add_argument(
        "--draft",
        type=Path,
        metavar="TEST.toml",
        help="write a test.toml to begin with; a file that exists is left alone",
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the findings as JSON")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Look through a file and print what is in it.

    Parameters
    ----------
    arguments : argparse.Namespace
        Of the command.

    Raises
    ------
    InputError
        When the file or its test.toml cannot be used, or an option contradicts another.
    """
    from classic_ml.inspect import draft_test_toml, inspect_file, match_test
    from classic_ml.io import read_test_description
    from comparisons.show.inspection import inspect_document, inspect_text

    _check_draft(arguments)
    check_files([arguments.file, arguments.test], json=arguments.json, draft=arguments.draft)
    test = None if arguments.test is None else read_test_description(arguments.test)
    match, remarks = None, tuple[str, ...]()
    with shown_steps(1 if test is None else 2) as begin:
        begin("looking through the file")
        layout = None if test is None else test.file
        inspection = inspect_file(arguments.file, layout, group=arguments.group)
        if test is not None:
            begin("setting it beside the test and reducing it")
            match = match_test(arguments.file, test, inspection)
    if test is None and {channel.name for channel in inspection.channels} >= SERIES_COLUMNS:
        remarks = (_series_remark(arguments.file),)
    found: dict[str, Any] = {"match": match, "remarks": remarks}
    # The files first: a reader of the text may go away after its first lines.
    written = write_all(
        [
            (
                "findings",
                arguments.json,
                lambda: to_strict_json(inspect_document(inspection, **found)),
            ),
            (
                "draft",
                arguments.draft,
                lambda: draft_test_toml(inspection, group=arguments.group),
            ),
        ]
    )
    print("\n\n".join([inspect_text(inspection, **found), *written]))


def _check_draft(arguments: argparse.Namespace) -> None:

    if arguments.draft is not None and arguments.draft.exists():
        raise InputError(
            str(arguments.draft),
            expected="a new file for the draft",
            found="a file",
            remedy="nothing was overwritten; choose another name",
        )
    if arguments.group is not None and arguments.test is not None:
        raise InputError(
            "--group",
            expected="it without --test",
            found="both",
            remedy=f'write group = "{arguments.group}" in [file] of {arguments.test}',
        )


def _series_remark(file: Path) -> str:
    from classic_ml.io.series import read_series

    try:
        series = read_series(file)
    except InputError as error:
        return f"a series that cannot be used: {error}"
    n = len(set(series.segment.tolist()) - {0})
    return (
        f"a series of φ and ψ', ready for compare: {n} segment{'' if n == 1 else 's'}, "
        f"{int((series.segment > 0).sum())} of {series.segment.size} rows in them"
    )
