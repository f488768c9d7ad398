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

# More than this is no missing effect any more but another model.
MOST_EFFECTS_ASKED = 6
DEFAULT_EFFECTS = 4
EXIT_DONE, EXIT_UNUSABLE, EXIT_INTERRUPTED = 0, 2, 130


def run_script(
    diagnoses: Mapping[str, Case],
    argv: Sequence[str] | None = None,
    most_effects: int = DEFAULT_EFFECTS,
) -> int:
    """Run diagnoses as a script: print them, and write what its options ask for.

    Parameters
    ----------
    diagnoses : mapping of str to (Model, fit experiments, check experiments)
        By name; the document of the first is the top level of the JSON.
    argv : sequence of str, optional
        Options ``--json FILE``, ``--report FILE.html``, ``--max-effects N``; those of the process
        without it.
    most_effects : int
        Add at most so many to each model where ``--max-effects`` does not say.

    Returns
    -------
    int
        0: done, whatever the verdicts; 2: unusable input, said in one sentence on stderr; 130:
        interrupted.
    """
    parser = _parser(most_effects)
    arguments = parser.parse_args(argv)
    try:
        _run(diagnoses, arguments, parser.prog, argv)
        sys.stdout.flush()
    except InputError as error:
        sys.stderr.write(f"{parser.prog}: {error}\n")
        return EXIT_UNUSABLE
    except KeyboardInterrupt:
        sys.stderr.write(f"{parser.prog}: interrupted; files that were finished are whole\n")
        return EXIT_INTERRUPTED
    except OSError as error:
        sys.stderr.write(f"{parser.prog}: {error.filename or 'output'}: {error.strerror}\n")
        return EXIT_UNUSABLE
    return EXIT_DONE


def contents_of(
    diagnoses: Mapping[str, SystemDiagnosis],
    command: str,
    json: Path | None,
    report: Path | None,
) -> list[tuple[str, Path, str]]:
    """Return all that is to be written, before anything is: what it is, where, and the text.

    Parameters
    ----------
    diagnoses : mapping of str to SystemDiagnosis
        By name.
    command : str
        What was typed.
    json, report : path or None
        Targets.
    """
    out = []
    if json:
        from surge_core.files import to_strict_json

        out.append(("numbers", json, to_strict_json(_document(diagnoses))))
    if report:
        from comparisons.missing_effect.report import diagnosis_report

        out.append(("report", report, diagnosis_report(diagnoses, command)))
    return out


def steps_of(most_effects: int) -> int:
    """Return how often a diagnosis tells its progress at most: two fits beside the rounds."""
    return most_effects + 2


def _run(
    cases: Mapping[str, Case],
    arguments: argparse.Namespace,
    prog: str,
    argv: Sequence[str] | None,
) -> None:
    from comparisons.missing_effect.systems.diagnosis import diagnose_model
    from comparisons.missing_effect.terminal import diagnosis_text
    from surge_core.files import check_apart, check_target, write_whole

    if not cases:
        raise InputError("diagnoses", expected="at least one", found="none")
    targets = [path for path in (arguments.json, arguments.report) if path]
    for path in targets:
        check_target(path, (".html", ".htm") if path is arguments.report else ())
    check_apart([], targets)
    found: dict[str, SystemDiagnosis] = {}
    with shown_steps(len(cases) * steps_of(arguments.max_effects)) as listed:
        for name, (model, fit, check) in cases.items():
            found[name] = diagnose_model(
                model,
                fit,
                check,
                most_effects=arguments.max_effects,
                progress=lambda words, name=name: listed(f"{name}: {words}"),  # type: ignore[misc]
            )
    command = " ".join([prog, *(sys.argv[1:] if argv is None else argv)])
    contents = contents_of(found, command, arguments.json, arguments.report)
    for _, path, content in contents:
        write_whole(path, content)
    several = len(found) > 1
    texts = [
        f"{name}\n\n{diagnosis_text(d)}" if several else diagnosis_text(d)
        for name, d in found.items()
    ]
    lines = [*texts, *(f"{label}: {path}" for label, path, _ in contents)]
    sys.stdout.write("\n\n".join(lines) + "\n")


def _document(diagnoses: Mapping[str, SystemDiagnosis]) -> dict[str, Any]:
    from comparisons.missing_effect.document import diagnosis_document, merged_test_rmse

    documents = {name: diagnosis_document(d) for name, d in diagnoses.items()}
    first = dict(next(iter(documents.values())))
    if len(documents) > 1:
        first["test_rmse"] = merged_test_rmse(diagnoses)
        first["diagnoses"] = documents
    return first


def _parser(most_effects: int) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description="Diagnose what a model lacks against its measured records."
    )
    add = parser.add_argument
    add("--json", type=Path, metavar="FILE", help="write the numbers as JSON")
    add("--report", type=Path, metavar="FILE.html", help="write the report")
    add(
        "--max-effects",
        type=int,
        choices=range(1, MOST_EFFECTS_ASKED + 1),
        default=most_effects,
        metavar="N",
        help=f"add at most so many effects (default: {most_effects})",
    )
    return parser
