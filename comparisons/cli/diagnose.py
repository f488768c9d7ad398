"""The command `sindy-surge diagnose`: which physical effect a model of the records lacks."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from comparisons.cli.shared import (
    Commands,
    add_series,
    add_targets,
    check_files,
    command_line,
    read_records,
    whole,
    write_all,
)
from surge_core.errors import InputError
from surge_core.files import to_strict_json
from surge_core.progress import shown_over, shown_steps

if TYPE_CHECKING:
    from classic_ml.series import CoefficientSeries
    from comparisons.missing_effect.diagnosis import Diagnosis
    from comparisons.missing_effect.where import Where

__all__ = ["add_parser", "run"]

HIGHEST_DEGREE, DEFAULT_DEGREE = 8, 2
# More is no missing effect any more but another model.
MOST_EFFECTS = 3
DEFAULT_MODEL_EFFECTS, MOST_MODEL_EFFECTS = 4, 6
# Options that only the compressor's diagnosis knows.
COMPRESSOR_OPTIONS = ("degree", "base", "limits", "separate", "save")


def add_parser(commands: Commands) -> None:
    """Add the command.

    Parameters
    ----------
    commands : argparse sub-parsers
        Those of `sindy-surge`.
    """
    parser = commands.add_parser(
        "diagnose",
        help="find where a model and the records part, and name what is missing",
        description="Fit the lag model, find where its free run and the measurement part, name the "
        "physical effect that is missing, add it, and show on rows that were held out how far the "
        "gap shrinks; or say that nothing is missing, that several names fit alike, or that "
        "something is there without a name. Several records show more than one: the last is never "
        "fitted. With --model the same is asked of a simulation model of your own, of any system: "
        "the file is executed, the records of --fit are fitted, and those of --check are only "
        "simulated.",
    )
    add_series(parser, nargs="*")
    add = parser.add_argument
    add("--model", type=Path, metavar="model.py", help="your own model, a Python file; executed")
    record: dict[str, Any] = {"type": Path, "nargs": "+", "default": [], "metavar": "RECORD"}
    add("--fit", help="records for --model (.csv, .mat, .npz, .nc) that are fitted", **record)
    add("--check", help="records for --model that are only simulated", **record)
    add_targets(parser, "json", "report")
    add("--save", type=Path, metavar="MODEL", help="save the model with what was added")
    add(
        "--degree",
        type=whole(1, HIGHEST_DEGREE),
        metavar="N",
        help=f"degree of the base characteristic (default: {DEFAULT_DEGREE})",
    )
    add(
        "--base",
        choices=("polynomial", "sindy"),
        help="base terms: powers of φ up to --degree, or those that the sparse regression "
        "discovers on the fitted rows (default: polynomial)",
    )
    add(
        "--limits",
        action="store_true",
        help="plant each effect into these records and say how small it may be and still be named; "
        "takes minutes",
    )
    add(
        "--separate",
        action="store_true",
        help="say which further measurement would separate the names of an alias set",
    )
    add(
        "--max-effects",
        type=whole(1),
        metavar="N",
        help=f"add at most so many effects (default and most: {MOST_EFFECTS}; with --model "
        f"{DEFAULT_MODEL_EFFECTS}, at most {MOST_MODEL_EFFECTS})",
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Diagnose series of a compressor, or the records of a user's own model.

    Parameters
    ----------
    arguments : argparse.Namespace
        Of the command.

    Raises
    ------
    InputError
        When an input or an option cannot be used; nothing is written then.
    """
    most = MOST_EFFECTS if arguments.model is None else MOST_MODEL_EFFECTS
    if (arguments.max_effects or 0) > most:
        raise InputError(
            "--max-effects",
            expected=f"a whole number from 1 to {most}",
            found=f"{arguments.max_effects}",
        )
    if arguments.model is None:
        _check_compressor(arguments)
        lines = _compressor(arguments)
    else:
        _check_model(arguments)
        lines = _model(arguments)
    print("\n".join(lines))


def _compressor(arguments: argparse.Namespace) -> list[str]:
    """Diagnose series and return what is printed."""
    from comparisons.missing_effect import diagnose
    from comparisons.missing_effect.document import diagnosis_document
    from comparisons.missing_effect.terminal import diagnosis_text
    from comparisons.show.diagnose_report import diagnosis_report

    steps = 4 + (arguments.base == "sindy") + arguments.limits + arguments.separate
    with shown_steps(steps) as begin:
        begin("reading")
        # Each once: the last record is held out whole, and its double would be fitted.
        records = read_records(arguments.series)
        terms, base, remarks = _base(arguments, records, begin)
        begin("trying effects")
        d = diagnose(
            records,
            arguments.degree or DEFAULT_DEGREE,
            terms=terms,
            most_effects=arguments.max_effects or MOST_EFFECTS,
        )
        begin("looking where")
        before, why = _where(d, d.before)
        after, _ = _where(d, d.after) if d.missing else (before, "")
        remarks += [f"Where was not looked at: {why}."] if why else []
        more = _asked_beyond(arguments, d, begin)
        begin("writing")

        def document() -> str:
            return to_strict_json(diagnosis_document(d, before, **more, base=base))

        def page() -> str:
            return diagnosis_report(d, before, after, **more, command=command_line())

        written = write_all(
            [("numbers", arguments.json, document), ("report", arguments.report, page)]
        )
        if arguments.save:
            written.append(f"model: {_saved(d, arguments.save)}")
    return [diagnosis_text(d, before, **more), *remarks, *([""] if written else []), *written]


def _base(
    arguments: argparse.Namespace,
    records: Sequence[CoefficientSeries],
    begin: Callable[[str], None],
) -> tuple[Any, dict[str, Any], list[str]]:
    """Return the base terms, what the document says of them, and what is printed of them."""
    if arguments.base != "sindy":
        degree = arguments.degree or DEFAULT_DEGREE
        return None, {"source": "polynomial", "degree": degree}, []
    from comparisons.missing_effect.base_terms import discovered_terms

    begin("discovering terms")
    found = discovered_terms(records)
    names = ", ".join(found.dropped)
    words = f"Left out of the base, since their form is not known here: {names}."
    base = {"source": "sindy", "dropped": list(found.dropped)}
    return found.terms, base, [words] if names else []


def _asked_beyond(
    arguments: argparse.Namespace, d: Diagnosis, begin: Callable[[str], None]
) -> dict[str, Any]:
    """Return what --limits and --separate found; None for what was not asked for."""
    limits = separation = None
    if arguments.limits:
        from comparisons.missing_effect.catalogue import CATALOGUE
        from comparisons.missing_effect.limits import planted_limits

        begin("planting effects")
        n = len(CATALOGUE)
        limits = planted_limits(d, progress=lambda r: shown_over(r, unit="effect", total=n))
    if arguments.separate:
        from comparisons.missing_effect.separate import separating_measurements

        begin("simulating measurements")
        separation = separating_measurements(d)
    return {"limits": limits, "separation": separation}


def _where(d: Diagnosis, fit: Any) -> tuple[Where | None, str]:
    """Return where a residual stands out, or why that is not known."""
    from comparisons.missing_effect.shown import where_of

    try:
        return where_of(d, fit), ""
    except InputError as error:
        return None, str(error)


def _saved(d: Diagnosis, path: Path) -> str:
    """Save the model after; a verdict of which none can be made is no error of the user's."""
    from comparisons.missing_effect.extended_file import save_extended
    from comparisons.missing_effect.extended_refit import value_of

    try:
        model = value_of(d)
    except InputError as error:
        return f"not saved: {error}"
    save_extended({model.estimator: model}, path)
    return str(path)


def _model(arguments: argparse.Namespace) -> list[str]:
    """Diagnose a user's own model, whose file is executed, and return what is printed."""
    from comparisons.missing_effect.systems.diagnosis import diagnose_model
    from comparisons.missing_effect.systems.files import load_model, read_experiment
    from comparisons.missing_effect.systems.script import contents_of, steps_of
    from comparisons.missing_effect.systems.terminal import system_text
    from surge_core.files import write_whole

    most = arguments.max_effects or DEFAULT_MODEL_EFFECTS
    with shown_steps(steps_of(most) + 2) as begin:
        begin("reading")
        model = load_model(arguments.model)
        fit = [read_experiment(path, model) for path in arguments.fit]
        check = [read_experiment(path, model) for path in arguments.check]
        found = diagnose_model(model, fit, check, most_effects=most, progress=begin)
        begin("writing")
        contents = contents_of(
            {model.name: found}, command_line(), arguments.json, arguments.report
        )
        for _, path, content in contents:
            write_whole(path, content)
    written = [f"{label}: {path}" for label, path, _ in contents]
    return [system_text(found), *([""] if written else []), *written]


def _check_compressor(arguments: argparse.Namespace) -> None:
    for option in ("fit", "check"):
        if getattr(arguments, option):
            raise InputError(f"--{option}", expected="a --model that it is for", found="no --model")
    if not arguments.series:
        raise InputError(
            "diagnose",
            expected="SERIES of a compressor, or --model model.py --fit RECORD…",
            found="neither",
        )
    if arguments.base == "sindy" and arguments.degree is not None:
        raise InputError(
            "--degree",
            expected="no degree with --base sindy, which finds the terms itself",
            found=f"{arguments.degree}",
        )
    targets = {name: getattr(arguments, name) for name in ("json", "report", "save")}
    check_files(arguments.series, **targets)


def _check_model(arguments: argparse.Namespace) -> None:
    if arguments.series:
        raise InputError(
            str(arguments.series[0]),
            expected="records after --fit or --check with --model",
            found="a record without an option",
        )
    for option in COMPRESSOR_OPTIONS:
        if getattr(arguments, option):
            raise InputError(
                f"--{option}",
                expected="no option of the compressor's diagnosis with --model",
                found=f"--{option}",
            )
    if not arguments.fit:
        raise InputError("--fit", expected="at least one record with --model", found="none")
    records = [*arguments.fit, *arguments.check]
    resolved = [path.resolve() for path in records]
    for number, path in enumerate(resolved):
        if path in resolved[:number]:
            # A check record that is fitted checks nothing.
            raise InputError(str(records[number]), expected="each record once", found="twice")
    check_files([arguments.model, *records], json=arguments.json, report=arguments.report)
