"""The command `sindy-surge inspect`: what is in a file, and what reduce would make of it."""

from __future__ import annotations

import argparse
from collections.abc import Iterable

from classic_ml.inspect import draft_test_toml, inspect_file, match_test
from classic_ml.io import read_test_description
from comparisons.cli.output import write_asked
from comparisons.show.inspection import inspect_document, inspect_text
from surge_core.errors import InputError
from surge_core.progress import shown_steps


def run(given: argparse.Namespace) -> Iterable[str]:
    """Look through a file, and beside its test where one is named."""
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
