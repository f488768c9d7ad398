"""Diagnoses as the whole of a short script: options, progress, text, JSON and report."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from surge_core.errors import InputError
from surge_core.progress import shown_steps

if TYPE_CHECKING:
    from comparisons.missing_effect.systems.experiments import Experiment
    from comparisons.missing_effect.systems.model import Model
    from comparisons.missing_effect.systems.results import SystemDiagnosis

    Case: TypeAlias = tuple[
        Model, Experiment | Sequence[Experiment], Experiment | Sequence[Experiment]
    ]

MOST_EFFECTS, DEFAULT_EFFECTS = 6, 4
# A diagnosis says its progress at most so often beside the rounds: two fits.
FITS = 2


def run_script(diagnoses: Mapping[str, Case]) -> int:
    """Run diagnoses as a script: print them, and write what its options ask for.

    The options are ``--json FILE``, ``--report FILE.html`` and ``--max-effects N``.

    Parameters
    ----------
    diagnoses : mapping of str to (Model, fit experiments, check experiments)
        By name; the document of the first is the top level of the JSON.

    Returns
    -------
    int
        0: done, whatever the verdicts; 2: unusable input, said in one sentence on stderr; 130:
        interrupted.
    """
    parser = argparse.ArgumentParser(
        description="Diagnose what a model lacks against its measured records."
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the numbers as JSON")
    parser.add_argument("--report", type=Path, metavar="FILE.html", help="write the report")
    parser.add_argument(
        "--max-effects",
        type=int,
        choices=range(1, MOST_EFFECTS + 1),
        default=DEFAULT_EFFECTS,
        metavar="N",
        help=f"add at most so many effects (default: {DEFAULT_EFFECTS})",
    )
    given = parser.parse_args()
    code, said = 2, ""
    try:
        _run(diagnoses, given, " ".join([parser.prog, *sys.argv[1:]]))
        return 0
    except InputError as error:
        said = str(error)
    except KeyboardInterrupt:
        code, said = 130, "interrupted; files that were finished are whole"
    except OSError as error:
        said = f"{error.filename or 'output'}: {error.strerror}"
    sys.stderr.write(f"{parser.prog}: {said}\n")
    return code


def _run(cases: Mapping[str, Case], given: argparse.Namespace, command: str) -> None:
    from comparisons.missing_effect.report import diagnosis_report, diagnosis_text
    from comparisons.missing_effect.systems.diagnosis import diagnose_model
    from surge_core.files import check_apart, check_target, to_strict_json, write_whole

    targets = [path for path in (given.json, given.report) if path]
    for path in targets:
        check_target(path, (".html", ".htm") if path is given.report else ())
    check_apart([], targets)
    found: dict[str, SystemDiagnosis] = {}
    with shown_steps(len(cases) * (given.max_effects + FITS)) as listed:
        for name, (model, fit, check) in cases.items():
            found[name] = diagnose_model(
                model,
                fit,
                check,
                most_effects=given.max_effects,
                progress=lambda words, name=name: listed(f"{name}: {words}"),  # type: ignore[misc]
            )
    # All is made before anything is written.
    made = []
    if given.json:
        made.append(("numbers", given.json, to_strict_json(_document(found))))
    if given.report:
        made.append(("report", given.report, diagnosis_report(found, command)))
    for _, path, content in made:
        write_whole(path, content)
    several = len(found) > 1
    lines = [f"{name}\n\n" * several + diagnosis_text(d) for name, d in found.items()]
    lines += [f"{label}: {path}" for label, path, _ in made]
    sys.stdout.write("\n\n".join(lines) + "\n")


def _document(diagnoses: Mapping[str, SystemDiagnosis]) -> dict[str, Any]:
    from comparisons.missing_effect.document import diagnosis_document, merged_test_rmse

    documents = {name: diagnosis_document(d) for name, d in diagnoses.items()}
    first = dict(next(iter(documents.values())))
    if len(documents) > 1:
        first["test_rmse"] = merged_test_rmse(diagnoses)
        first["diagnoses"] = documents
    return first
