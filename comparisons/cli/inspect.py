"""The command `sindy-surge inspect`: what is in a file, and what reduce would make of it."""

from __future__ import annotations

import argparse
from collections.abc import Iterable

from comparisons.cli.command import Command, write_asked
from comparisons.cli.options import argument, reads, writes
from surge_core.errors import InputError
from surge_core.progress import shown_steps


def _run(given: argparse.Namespace) -> Iterable[str]:
    from classic_ml.inspect import draft_test_toml, inspect_file, match_test
    from classic_ml.io import read_test_description
    from comparisons.show.inspection import inspect_document, inspect_text

    _check_options(given)
    test = None if given.test is None else read_test_description(given.test)
    match = None
    with shown_steps([0.3] if test is None else [0.3, 1.5]) as begin:
        begin("looking through the file")
        layout = None if test is None else test.file
        inspection = inspect_file(given.file, layout, group=given.group)
        if test is not None:
            begin("setting it beside the test and reducing it")
            match = match_test(given.file, test, inspection)
    # The files first: a reader of the text may go away after its first lines.
    written = write_asked(
        given,
        json=lambda: inspect_document(inspection, match),
        draft=lambda: draft_test_toml(inspection, group=given.group, units=given.units),
    )
    return ["\n\n".join([inspect_text(inspection, match), *written])]


def _check_options(given: argparse.Namespace) -> None:
    if given.draft is not None and given.draft.exists():
        raise InputError(
            str(given.draft),
            expected="a new file for the draft",
            found="a file",
            remedy="nothing was overwritten; choose another name",
        )
    if given.group is not None and given.test is not None:
        raise InputError(
            "--group",
            expected="it without --test",
            found="both",
            remedy=f'write group = "{given.group}" in [file] of {given.test}',
        )


def _units(text: str) -> tuple[str, ...]:
    from classic_ml.units import kind_of_unit

    units = tuple(part.strip() for part in text.split(","))
    kinds = [kind_of_unit(unit) for unit in units]
    if len(set(kinds)) < len(kinds) or not {"pressure", "temperature"}.issuperset(kinds):
        raise argparse.ArgumentTypeError(
            f"expected a unit of pressure and one of temperature, as psia,degF, found '{text}'"
        )
    return units


COMMAND = Command(
    "inspect",
    help="show what is in a raw record or a series, and draft its test.toml",
    description="Show the channels of a file (CSV, MAT, netCDF, HDF5, TDMS, Parquet) with units, "
    "rate, gaps, ranges and saturation; with --test also which column feeds which channel, the "
    "ranges in SI and what reduce would make of the record.",
    arguments=(
        reads("file", metavar="FILE", help="raw record or series"),
        reads("--test", metavar="TEST.toml", help="description of its test"),
        argument(
            "--group", metavar="NAME", help="group, struct or table to look into, without --test"
        ),
        writes(
            "--draft",
            metavar="TEST.toml",
            help="write a test.toml to begin with; a file that exists is left alone",
        ),
        argument(
            "--units",
            type=_units,
            default=(),
            metavar="UNIT,UNIT",
            help="units of pressure and temperature, as psia,degF, that --draft writes for columns "
            "without one",
        ),
        writes("--json", metavar="FILE", help="write the findings as JSON"),
    ),
    run=_run,
)
