"""The command `sindy-surge compare`: the estimators on the same series, side by side."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from classic_ml.series import CoefficientSeries
from classic_ml.whole_record_fit import N_TWINS
from comparisons.cli.output import (
    fitting,
    measuring,
    page,
    read_records,
    take_away,
    write_asked,
)
from comparisons.harness.answer import answer_of
from comparisons.harness.cautions import psi_by_rise
from comparisons.harness.compare import compare_records
from comparisons.harness.estimators import EstimatorSpec, default_estimators, psi_breakpoints
from comparisons.harness.methods import OwnMethod
from comparisons.harness.rows import stack_rows
from comparisons.harness.saved_models import save_models
from comparisons.missing_effect.extended_file import load_extended
from comparisons.missing_effect.extended_refit import extended_specs
from comparisons.results import Comparison
from comparisons.show.json_output import comparison_document
from comparisons.show.report import ReportSection, report_pages
from comparisons.show.table import comparison_table
from surge_core.errors import InputError


def run(given: argparse.Namespace) -> Iterable[str]:
    """Fit the estimators and set them side by side."""
    for method in given.method:
        OwnMethod(method).check()
    records = read_records(given.series)
    by_rise = _by_rise(records)
    comparison, work = _compare(records, given, fit_work=not by_rise)
    title = ", ".join(Path(record.source).name for record in records)

    answer = answer_of(comparison)
    section = ReportSection(title=title, comparison=comparison, work=work, answer=answer)
    pages = report_pages([section]) if given.report or given.figures else []

    def document() -> dict[str, Any]:
        found = comparison_document(comparison, work)
        return {"work_coefficient": None, **found} if by_rise else found

    written = write_asked(
        given, json=document, report=lambda: page(f"Comparison on {title}", pages)
    )
    if given.save:
        models = {name: model for fit in (comparison, work) if fit for name, model in fit.models}
        save_models(models, given.save, comparison.recommended, records)
        written.append(f"models: {given.save}")
    written += take_away(given.figures, pages, answer)
    lines = [
        str(answer),
        "",
        f"Pressure coefficient ψ' of {title}\n\n{comparison_table(comparison)}\n",
    ]
    if work is not None:
        lines.append(f"Work coefficient ψ of {title}\n\n{comparison_table(work)}\n")
    return *lines, *by_rise, *written


def _by_rise(records: Sequence[CoefficientSeries]) -> list[str]:
    """Return the sentence that no ψ_QS is stated; none where ψ is no worse than ψ'."""
    found = [psi_by_rise(record.history) for record in records if record.psi is not None]
    return list(dict.fromkeys(f"{caution.text}\n" for caution in found if caution is not None))


def _compare(
    records: Sequence[CoefficientSeries], given: argparse.Namespace, *, fit_work: bool
) -> tuple[Comparison, Comparison | None]:
    options: dict[str, Any] = {"hold": given.hold, "progress": fitting}
    comparison = compare_records(records, estimators=_specs(given), **options)
    if not fit_work or any(record.psi is None for record in records):
        return comparison, None
    try:
        ends = psi_breakpoints(stack_rows(records, "psi"), given.hold)
        own = default_estimators(hold=given.hold, breakpoints=ends, time_constant_s=given.tau)
        return comparison, compare_records(records, target="psi", estimators=own, **options)
    except InputError as error:
        print(f"ψ was not fitted: {error}", file=sys.stderr)
        return comparison, None


def _specs(given: argparse.Namespace) -> tuple[EstimatorSpec, ...]:
    """Return the default estimators, --model's and --method's."""
    if given.model is not None and given.hold != "first":
        raise InputError(
            "--model",
            expected="--hold first: a model with effects joins the samples of φ",
            found=f"--hold {given.hold}",
        )
    own = default_estimators(
        degree=given.degree,
        hold=given.hold,
        time_constant_s=given.tau,
        n_twins=0 if given.no_twins else N_TWINS,
        measuring=measuring,
    )
    if given.model is not None:
        own += tuple(extended_specs(load_extended(given.model), [spec.name for spec in own]))
    specs = (*own, *(OwnMethod(method).spec() for method in given.method))
    names = [spec.name for spec in specs]
    if len(set(names)) != len(names):
        raise InputError("--method", expected="each name once", found=", ".join(names[len(own) :]))
    return specs
