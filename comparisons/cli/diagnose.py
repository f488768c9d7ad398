"""The command `sindy-surge diagnose`: which physical effect a model of the records lacks."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from joblib import cpu_count

from classic_ml.series import CoefficientSeries
from comparisons.cli.commands_records import (
    DEFAULT_DEGREE,
    DEFAULT_MODEL_EFFECTS,
    MOST_EFFECTS,
    MOST_MODEL_EFFECTS,
)
from comparisons.cli.output import command_line, measuring, read_records, write_asked
from comparisons.harness.cautions import lacks_ledger
from comparisons.missing_effect import diagnose
from comparisons.missing_effect.document import diagnosis_document
from comparisons.missing_effect.lag_result import LagDiagnosis
from comparisons.missing_effect.report import diagnosis_report, diagnosis_text
from comparisons.missing_effect.whole_runs import N_TWINS
from surge_core.errors import InputError
from surge_core.progress import shown_over, shown_steps

# Arguments that only the diagnosis of a compressor knows, and only that of a user's own model.
OF_COMPRESSOR = ("series", "degree", "base", "limits", "separate", "save", "no_twins")
OF_MODEL = ("fit", "check")


def run(given: argparse.Namespace) -> Iterable[str]:
    """Diagnose a compressor, or a model of the user's own."""
    _check_options(given)
    return _compressor(given) if given.model is None else _model(given)


def _check_options(given: argparse.Namespace) -> None:
    """Refuse options that do not go together, and an input that is given twice or not at all."""
    own = given.model is not None
    for name in OF_COMPRESSOR if own else OF_MODEL:
        if getattr(given, name):
            where = "SERIES" if name == "series" else f"--{name.replace('_', '-')}"
            raise InputError(
                where,
                expected=f"it only {'without' if own else 'with'} --model",
                found=f"{where} {'beside' if own else 'without'} --model",
                remedy="records of a model go behind --fit or --check" if name == "series" else "",
            )
    if not (given.fit if own else given.series):
        raise InputError(
            "diagnose",
            expected="SERIES of a compressor, or --model model.py --fit RECORD…",
            found="no record",
        )
    most = MOST_MODEL_EFFECTS if own else MOST_EFFECTS
    if given.max_effects is not None and not 1 <= given.max_effects <= most:
        raise InputError(
            "--max-effects",
            expected=f"a whole number from 1 to {most}",
            found=f"{given.max_effects}",
        )
    if given.base == "sindy" and given.degree is not None:
        raise InputError(
            "--degree",
            expected="no degree with --base sindy, which finds the terms itself",
            found=f"{given.degree}",
        )
    records = [*given.fit, *given.check]
    for number, path in enumerate(records):
        # A check record that is fitted checks nothing.
        if path.resolve() in [other.resolve() for other in records[:number]]:
            raise InputError(str(path), expected="each record once", found="twice")


def _compressor(given: argparse.Namespace) -> list[str]:
    """Diagnose series and return what is printed."""
    # How long each lasts as a rule, in seconds, on a record of four seconds.
    searched = [3.0] * (given.base == "sindy")
    beyond = [100.0] * (given.limits + given.separate)
    with shown_steps([1.0, *searched, 15.0, *beyond, 1.0]) as begin:
        begin("reading")
        # Each once: the last record is held out whole, and its double would be fitted.
        records = read_records(given.series)
        for record in filter(lacks_ledger, records):
            raise InputError(
                record.source,
                expected="the ledger that `sindy-surge reduce` wrote beside it",
                found="unfiltered columns without it",
                remedy="copy its .ledger.json too, or reduce the record again",
            )
        terms, base, remarks = _base(given, records, begin)
        begin("trying effects")
        d = diagnose(
            records,
            given.degree or DEFAULT_DEGREE,
            terms=terms,
            most_effects=given.max_effects or MOST_EFFECTS,
            n_twins=0 if given.no_twins else N_TWINS,
            progress=measuring,
        )
        more = _asked_beyond(given, d, begin)
        begin("writing")
        written = write_asked(
            given,
            json=lambda: diagnosis_document(d, **more, base=base),
            report=lambda: diagnosis_report({d.title: d}, command_line(), **more),
        )
        if given.save:
            written.append(f"model: {_saved(d, given.save)}")
    return [diagnosis_text(d, **more), *remarks, *([""] if written else []), *written]


def _base(
    given: argparse.Namespace,
    records: Sequence[CoefficientSeries],
    begin: Callable[[str], None],
) -> tuple[Any, dict[str, Any], list[str]]:
    """Return the base terms, what the document says of them, and what is printed of them."""
    if given.base != "sindy":
        degree = given.degree or DEFAULT_DEGREE
        return None, {"source": "polynomial", "degree": degree}, []
    from comparisons.missing_effect.base_terms import discovered_terms

    begin("discovering terms")
    terms, dropped = discovered_terms(records)
    names = ", ".join(dropped)
    words = f"Left out of the base, since their form is not known here: {names}."
    base = {"source": "sindy", "dropped": dropped}
    return terms, base, [words] if names else []


def _asked_beyond(
    given: argparse.Namespace, d: LagDiagnosis, begin: Callable[[str], None]
) -> dict[str, Any]:
    """Return what --limits and --separate found; None for what was not asked for."""
    limits = separation = None
    if given.limits:
        from comparisons.missing_effect.limits import planted_limits

        begin("planting effects")
        n = len(d.catalogue)
        limits = planted_limits(
            d, jobs=cpu_count(), progress=lambda r: shown_over(r, unit="effect", total=n)
        )
    if given.separate:
        from comparisons.missing_effect.separate import separating_measurements

        begin("simulating measurements")
        separation = separating_measurements(d)
    return {"limits": limits, "separation": separation}


def _saved(d: LagDiagnosis, path: Path) -> str:
    """Save the model after; a verdict of which none can be made is no error of the user's."""
    from comparisons.missing_effect.extended_file import save_extended
    from comparisons.missing_effect.extended_refit import value_of

    try:
        model = value_of(d)
    except InputError as error:
        return f"not saved: {error}"
    save_extended({model.estimator: model}, path)
    return str(path)


def _model(given: argparse.Namespace) -> list[str]:
    """Diagnose a user's own model, whose file is executed, and return what is printed."""
    from comparisons.missing_effect.script import FITS
    from comparisons.missing_effect.systems.diagnosis import diagnose_model
    from comparisons.missing_effect.systems.files import load_model, read_experiment

    most = given.max_effects or DEFAULT_MODEL_EFFECTS
    with shown_steps(most + FITS + 2) as begin:
        begin("reading")
        model = load_model(given.model)
        fit = [read_experiment(path, model) for path in given.fit]
        check = [read_experiment(path, model) for path in given.check]
        d = diagnose_model(model, fit, check, most_effects=most, progress=begin)
        begin("writing")
        written = write_asked(
            given,
            json=lambda: diagnosis_document(d),
            report=lambda: diagnosis_report({d.title: d}, command_line()),
        )
    return [diagnosis_text(d), *([""] if written else []), *written]
