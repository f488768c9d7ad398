"""The reference lists each public name once, and commands that are named exist."""

from __future__ import annotations

import argparse
import importlib
import re
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from comparisons.cli.parser import build_parser

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
sys.path.insert(0, str(DOCS / "_ext"))

import public  # noqa: E402

# Modules all of whose names are public; those behind them are the inside of the house.
PUBLIC = (
    "classic_ml",
    "classic_ml.inspection",
    "classic_ml.inspection_with_test",
    "classic_ml.orders",
    "classic_ml.readers",
    "classic_ml.records",
    "classic_ml.reduction",
    "classic_ml.checks",
    "classic_ml.units",
    "classic_ml.whole_run",
    "classic_ml.work.coefficient",
    "comparisons.harness.compare",
    "comparisons.harness.estimators",
    "comparisons.harness.fit_quality",
    "comparisons.harness.lag_value",
    "comparisons.live.columns",
    "comparisons.live.detection",
    "comparisons.live.estimate",
    "comparisons.live.frames",
    "comparisons.live.near_stall",
    "comparisons.live.operating_point",
    "comparisons.missing_effect",
    "comparisons.missing_effect.extended_file",
    "comparisons.missing_effect.extended_lag",
    "comparisons.missing_effect.limits",
    "comparisons.missing_effect.separate",
    "comparisons.harness.reconstruction",
    "comparisons.show.report",
    "comparisons.rig",
    "comparisons.rig.coefficient_tests",
    "comparisons.harness.structure_fit",
    "comparisons.study.comparison",
    "comparisons.study.report",
    "comparisons.study.run",
    "comparisons.study.spec",
    "comparisons.show.table",
    "comparisons.total_system",
    "sindy_surge",
    "sindy_surge.closed_loop",
)


def same_thing(full_name: str) -> object:
    """An object by its own path, since a name may be public in two places."""
    home, _, name = full_name.rpartition(".")
    thing = getattr(importlib.import_module(home), name)
    own = getattr(thing, "__module__", None), getattr(thing, "__qualname__", None)
    return ".".join(own) if all(own) else full_name


def test_each_public_name_is_documented_once() -> None:
    wanted = {
        same_thing(f"{module}.{name}")
        for module in PUBLIC
        for name in importlib.import_module(module).__all__
    }
    listed = Counter(same_thing(name) for name in public.documented())
    assert {name for name, count in listed.items() if count > 1} == set()
    assert wanted == set(listed)


def test_the_reference_lists_its_pages() -> None:
    index = (DOCS / "api" / "index.rst").read_text("utf-8")
    for page in (DOCS / "api").glob("*.rst"):
        assert page.stem == "index" or f"   {page.stem}\n" in index


PROSE = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "benchmarks" / "README.md",
    ROOT / "examples" / "measured" / "README.md",
    *sorted(p for p in DOCS.rglob("*.md") if "_build" not in p.parts),
]
_SCRIPT = re.compile(r"python ((?:benchmarks|docs|examples)/[\w/]+\.py)([^`\n]*)")
_COMMAND = re.compile(r"sindy-surge ([a-z-]+)([^`\n]*)")
_OPTION = re.compile(r"(?<=\s)--[a-z][a-z-]*")


def subcommands() -> dict[str, argparse.ArgumentParser]:
    actions = build_parser()._actions
    return dict(next(a.choices for a in actions if isinstance(a, argparse._SubParsersAction)))


def named(pattern: re.Pattern[str]) -> Iterator[tuple[str, str, str]]:
    for page in PROSE:
        for found in pattern.finditer(page.read_text("utf-8")):
            yield page.relative_to(ROOT).as_posix(), found[1], found[2].partition("#")[0]


def test_scripts_that_are_named_exist_with_their_options() -> None:
    seen = 0
    for page, script, rest in named(_SCRIPT):
        file = ROOT / script
        assert file.is_file(), f"{page}: {script}"
        # Options may be declared in a module beside the script.
        source = "".join(f.read_text("utf-8") for f in file.parent.glob("*.py"))
        if script.startswith("examples/measured"):
            source += (ROOT / "comparisons/missing_effect/systems/script.py").read_text("utf-8")
        for option in _OPTION.findall(rest):
            seen += 1
            assert f'"{option}"' in source, f"{page}: {script} {option}"
    assert seen > 10


def test_commands_that_are_named_exist_with_their_options() -> None:
    known = subcommands()
    seen = 0
    for page, command, rest in named(_COMMAND):
        if command not in known:
            # Prose such as "sindy-surge finds", or a general COMMAND.
            assert not _OPTION.search(rest), f"{page}: sindy-surge {command}"
            continue
        options = {o for action in known[command]._actions for o in action.option_strings}
        for option in _OPTION.findall(rest.partition(" | ")[0]):
            seen += 1
            assert option in options, f"{page}: sindy-surge {command} {option}"
    assert seen > 20


# A measured figure: a number with a unit of a result, or a row of a table of numbers.
_FIGURE = re.compile(r"\d(?:\.\d+)?\s?(?:%|ms\b|σ|times\b|seconds\b|s\b(?! of))")
_NAMES_COMMAND = re.compile(
    r"(?:python (?:benchmarks|docs|examples)/|sindy-surge [a-z]|make [a-z])"
)
# Paragraphs with figures that nothing of ours measured, by how they begin.
NOT_MEASURED_HERE = {
    "The paper's own estimate": "the paper's figures",
    "Equation-error models share": "the paper's figures",
}


def sections(text: str) -> list[str]:
    """Sections of a page; a command counts for the paragraphs of its own section."""
    return re.split(r"^(?=#+ )", text, flags=re.MULTILINE)


# Pages whose every session is run (test_sessions.py) print their figures themselves.
QUOTING = [
    ROOT / "README.md",
    DOCS / "index.md",
    DOCS / "mathematics.md",
    DOCS / "effects" / "index.md",
    DOCS / "effects" / "systems" / "index.md",
]


def test_figures_have_their_command() -> None:
    """In the same paragraph, or within the two before it or behind it, of the same section."""
    assert [line for page in QUOTING for line in figures_without_command(page)] == []
    starts = tuple(NOT_MEASURED_HERE)
    texts = [page.read_text("utf-8") for page in QUOTING]
    assert all(any(f"\n\n{start}" in text for text in texts) for start in starts)


def figures_without_command(page: Path) -> list[str]:
    """First lines of the paragraphs that state figures with no command near them."""
    bare = []
    for section in sections(page.read_text("utf-8")):
        paragraphs = [p for p in re.split(r"\n\s*\n", section) if p.strip()]
        for i, paragraph in enumerate(paragraphs):
            if not _FIGURE.search(paragraph) or paragraph.startswith(tuple(NOT_MEASURED_HERE)):
                continue
            near = "\n".join(paragraphs[max(i - 2, 0) : i + 3])
            if not _NAMES_COMMAND.search(near):
                bare.append(paragraph.splitlines()[0])
    return bare
