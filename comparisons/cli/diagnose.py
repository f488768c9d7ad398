"""The command `sindy-surge diagnose`: which physical effect a model of the records lacks."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from comparisons.cli.progress import shown_over, shown_steps
from surge_core.errors import InputError

if TYPE_CHECKING:
    from classic_ml.series import CoefficientSeries
    from comparisons.missing_effect.diagnosis import Diagnosis
    from comparisons.missing_effect.where import Where

__all__ = ["add_diagnose_parser", "run_diagnose"]

HIGHEST_DEGREE = 8
DEFAULT_DEGREE = 2
MOST_EFFECTS = 3
# With --model; `comparisons.missing_effect.systems.script` says the same of scripts.
MOST_MODEL_EFFECTS = 6

_Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"


def add_diagnose_parser(commands: _Commands) -> None:
    """Add the sub-command.

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
        "gap shrinks; or say that nothing is missing, that names cannot be told apart, or that "
        "something is there without a name. Several records tell more than one: the last is never "
        "fitted. With --model the same is asked of a simulation model of your own, of any system: "
        "the file is executed, the records of --fit are fitted, and those of --check are only "
        "simulated.",
    )
    add = parser.add_argument
    add("series", type=Path, nargs="*", metavar="SERIES", help="series (.csv or .nc)")
    add("--model", type=Path, metavar="model.py", help="your own model, a Python file; executed")
    add(
        "--fit",
        type=Path,
        nargs="+",
        default=[],
        metavar="RECORD",
        help="records for --model (.csv, .mat, .npz, .nc) that are fitted",
    )
    add(
        "--check",
        type=Path,
        nargs="+",
        default=[],
        metavar="RECORD",
        help="records for --model that are only simulated",
    )
    add("--json", type=Path, metavar="FILE", help="write the numbers as JSON")
    add("--report", type=Path, metavar="FILE.html", help="write the report")
    add("--save", type=Path, metavar="MODEL", help="save the model with what was added")
    add(
        "--degree",
        type=_whole(1, HIGHEST_DEGREE),
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
        help="say which further measurement would tell the names of an alias set apart",
    )
    add(
        "--max-effects",
        type=_whole(1, MOST_MODEL_EFFECTS),
        metavar="N",
        help=f"add at most so many effects (default and most: {MOST_EFFECTS}; with --model 4, "
        f"at most {MOST_MODEL_EFFECTS})",
    )
    parser.set_defaults(run=run_diagnose, refuse=parser.error)


def run_diagnose(arguments: argparse.Namespace) -> None:
    """Run the command.

    Parameters
    ----------
    arguments : argparse.Namespace
        What the parser of :func:`add_diagnose_parser` gave.

    Raises
    ------
    InputError
        When an input or an option cannot be used; nothing is written then.
    """
    from comparisons.cli.diagnose_model import check_ways, run_model_diagnosis

    check_ways(arguments)
    if arguments.model is not None:
        run_model_diagnosis(arguments)
        return
    if (arguments.max_effects or 0) > MOST_EFFECTS:
        arguments.refuse(
            f"argument --max-effects: expected a whole number from 1 to {MOST_EFFECTS}: "
            f"'{arguments.max_effects}'"
        )
    _run_lag_diagnosis(arguments)


def _run_lag_diagnosis(arguments: argparse.Namespace) -> None:
    from classic_ml.readers.series_files import read_series
    from comparisons.harness.rows import check_once
    from comparisons.missing_effect.terminal import diagnosis_text
    from surge_core.files import write_whole

    _check(arguments)
    steps = 4 + (arguments.base == "sindy") + arguments.limits + arguments.separate
    with shown_steps(steps) as begin:
        begin("reading")
        records = [read_series(path) for path in arguments.series]
        # The last record is held out whole: its double would be fitted.
        check_once(records)
        told = _diagnosed(arguments, records, begin)
        begin("writing")
        contents = _contents(arguments, told)
        written = [(label, str(path)) for label, path, _ in contents]
        for _, path, content in contents:
            write_whole(path, content)
        if arguments.save:
            written.append(("model", _saved(told.diagnosis, arguments.save)))
    text = diagnosis_text(
        told.diagnosis, told.before, limits=told.limits, separation=told.separation
    )
    sys.stdout.write("\n".join([text, *told.remarks, "", *(f"{a}: {b}" for a, b in written)]))
    sys.stdout.write("\n" if written else "")


@dataclass(frozen=True)
class _Told:
    """All that one run of the command found."""

    diagnosis: Diagnosis
    before: Where | None
    after: Where | None
    limits: Any
    separation: Any
    base: dict[str, Any]
    remarks: tuple[str, ...]


def _diagnosed(
    arguments: argparse.Namespace,
    records: Sequence[CoefficientSeries],
    begin: Callable[[str], None],
) -> _Told:
    from comparisons.missing_effect import diagnose

    remarks = []
    terms = None
    degree = DEFAULT_DEGREE if arguments.degree is None else arguments.degree
    base: dict[str, Any] = {"source": "polynomial", "degree": degree}
    if arguments.base == "sindy":
        from comparisons.missing_effect.base_terms import discovered_terms

        begin("discovering terms")
        found = discovered_terms(records)
        terms = found.terms
        base = {"source": "sindy", "dropped": list(found.dropped)}
        if found.dropped:
            names = ", ".join(found.dropped)
            remarks.append(f"Left out of the base, since their form is not known here: {names}.")
    begin("trying effects")
    most_effects = arguments.max_effects or MOST_EFFECTS
    d = diagnose(records, degree, terms=terms, most_effects=most_effects)
    begin("looking where")
    before, why = _where(d, d.before)
    after, _ = _where(d, d.after) if d.missing else (before, "")
    remarks += [f"Where was not looked at: {why}."] if why else []
    limits = separation = None
    if arguments.limits:
        from comparisons.missing_effect.catalogue import CATALOGUE
        from comparisons.missing_effect.limits import planted_limits

        begin("planting effects")
        limits = planted_limits(
            d, progress=lambda rows: shown_over(rows, unit="effect", total=len(CATALOGUE))
        )
    if arguments.separate:
        from comparisons.missing_effect.separate import separating_measurements

        begin("simulating measurements")
        separation = separating_measurements(d)
    return _Told(d, before, after, limits, separation, base, tuple(remarks))


def _where(d: Diagnosis, fit: Any) -> tuple[Where | None, str]:
    """Return where a residual stands out, or why that cannot be told."""
    from comparisons.missing_effect.shown import where_of

    try:
        return where_of(d, fit), ""
    except InputError as error:
        return None, str(error)


def _contents(arguments: argparse.Namespace, told: _Told) -> list[tuple[str, Path, str]]:
    """Make all that is written before anything is."""
    from comparisons.missing_effect.document import diagnosis_document
    from comparisons.show.json_output import to_strict_json

    out = []
    if arguments.json:
        document = diagnosis_document(
            told.diagnosis, told.before, told.limits, told.separation, base=told.base
        )
        out.append(("numbers", arguments.json, to_strict_json(document)))
    if arguments.report:
        from comparisons.show.diagnose_report import diagnosis_report

        page = diagnosis_report(
            told.diagnosis,
            told.before,
            told.after,
            limits=told.limits,
            separation=told.separation,
            command=" ".join(["sindy-surge", *sys.argv[1:]]),
        )
        out.append(("report", arguments.report, page))
    return out


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


def _check(arguments: argparse.Namespace) -> None:
    """Refuse, before any work is done, options that contradict and targets that cannot be."""
    from classic_ml.readers.series_files import ledger_path
    from surge_core.files import check_apart, check_target

    if arguments.base == "sindy" and arguments.degree is not None:
        raise InputError(
            "--degree",
            expected="no degree with --base sindy, which finds the terms itself",
            found=f"{arguments.degree}",
        )
    outputs = [path for path in (arguments.json, arguments.report, arguments.save) if path]
    for path in outputs:
        check_target(path, (".html", ".htm") if path is arguments.report else ())
    check_apart([*arguments.series, *map(ledger_path, arguments.series)], outputs)


def _whole(low: int, high: int) -> Callable[[str], int]:
    def read(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = low - 1
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(
                f"expected a whole number from {low} to {high}: '{text}'"
            )
        return value

    return read
