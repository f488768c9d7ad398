"""`sindy-surge diagnose --model`: which physical effect a user's own model of any system lacks."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from surge_core.errors import InputError

__all__ = ["check_ways", "run_model_diagnosis"]

DEFAULT_EFFECTS = 4
# Options that only the compressor's diagnosis knows, and their values when they are not given.
COMPRESSOR_OPTIONS = {
    "degree": None,
    "base": None,
    "limits": False,
    "separate": False,
    "save": None,
}


def check_ways(arguments: argparse.Namespace) -> None:
    """Refuse options of both ways to diagnose at once, and neither.

    Parameters
    ----------
    arguments : argparse.Namespace
        What the parser of `diagnose` gave.

    Raises
    ------
    InputError
        Naming the option.
    """
    if arguments.model is None:
        for option in ("fit", "check"):
            if getattr(arguments, option):
                raise InputError(
                    f"--{option}", expected="a --model that it is for", found="no --model"
                )
        if not arguments.series:
            raise InputError(
                "diagnose",
                expected="SERIES of a compressor, or --model model.py --fit RECORD…",
                found="neither",
            )
        return
    if arguments.series:
        raise InputError(
            str(arguments.series[0]),
            expected="records after --fit or --check with --model",
            found="a record without an option",
        )
    for option, absent in COMPRESSOR_OPTIONS.items():
        if getattr(arguments, option) != absent:
            raise InputError(
                f"--{option}",
                expected="no option of the compressor's diagnosis with --model",
                found=f"--{option}",
            )
    if not arguments.fit:
        raise InputError("--fit", expected="at least one record with --model", found="none")


def run_model_diagnosis(arguments: argparse.Namespace) -> None:
    """Run the command with ``--model``; the model file is a program, and is executed.

    Parameters
    ----------
    arguments : argparse.Namespace
        With ``model``, ``fit``, ``check``, ``json``, ``report``, ``max_effects``.

    Raises
    ------
    InputError
        When an input or an option cannot be used; nothing is written then.
    """
    from surge_core.files import write_whole

    _check_files(arguments)
    from comparisons.cli.progress import shown_steps
    from comparisons.missing_effect.systems.diagnosis import diagnose_model
    from comparisons.missing_effect.systems.files import load_model, read_experiment
    from comparisons.missing_effect.systems.script import contents_of, steps_of
    from comparisons.missing_effect.systems.terminal import system_text

    most = DEFAULT_EFFECTS if arguments.max_effects is None else arguments.max_effects
    with shown_steps(steps_of(most) + 2) as told:
        told("reading")
        model = load_model(arguments.model)
        fit = [read_experiment(path, model) for path in arguments.fit]
        check = [read_experiment(path, model) for path in arguments.check]
        found = diagnose_model(model, fit, check, most_effects=most, progress=told)
        told("writing")
        command = " ".join(["sindy-surge", *sys.argv[1:]])
        contents = contents_of({model.name: found}, command, arguments.json, arguments.report)
        for _, path, content in contents:
            write_whole(path, content)
    lines = [
        system_text(found),
        *(["", *(f"{a}: {b}" for a, b, _ in contents)] if contents else []),
    ]
    sys.stdout.write("\n".join(lines) + "\n")


def _check_files(arguments: argparse.Namespace) -> None:
    """Refuse, before any work is done, records given twice and targets that cannot be."""
    from surge_core.files import check_apart, check_target

    seen: set[Path] = set()
    for path in (*arguments.fit, *arguments.check):
        if path.resolve() in seen:
            # A check record that is fitted checks nothing.
            raise InputError(str(path), expected="each record once", found="twice")
        seen.add(path.resolve())
    outputs = [path for path in (arguments.json, arguments.report) if path]
    for path in outputs:
        check_target(path, (".html", ".htm") if path is arguments.report else ())
    check_apart([arguments.model, *arguments.fit, *arguments.check], outputs)
