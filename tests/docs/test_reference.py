"""Commands and scripts that the documentation names exist, with the options that it names."""

from __future__ import annotations

import argparse
import re
from pathlib import Path

from comparisons.cli.parser import build_parser

ROOT = Path(__file__).parents[2]
PROSE = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "benchmarks" / "README.md",
    *sorted(p for p in (ROOT / "docs").rglob("*.md") if "_build" not in p.parts),
]
SCRIPT = re.compile(r"python ((?:benchmarks|docs|examples)/[\w/]+\.py)([^`\n]*)")
COMMAND = re.compile(r"sindy-surge ([a-z-]+)([^`\n]*)")
OPTION = re.compile(r"(?<=\s)--[a-z][a-z-]*")


def test_scripts_that_are_named_exist_with_their_options() -> None:
    for page in PROSE:
        for script, rest in SCRIPT.findall(page.read_text("utf-8")):
            file = ROOT / script
            assert file.is_file(), f"{page.name}: {script}"
            # Options may be declared in a module beside the script.
            source = "".join(f.read_text("utf-8") for f in file.parent.glob("*.py"))
            source += (ROOT / "comparisons/missing_effect/script.py").read_text("utf-8")
            for option in OPTION.findall(rest.partition("#")[0]):
                assert option in source, f"{page.name}: {script} {option}"


def test_commands_that_are_named_exist_with_their_options() -> None:
    actions = build_parser()._actions
    known = next(a.choices for a in actions if isinstance(a, argparse._SubParsersAction))
    seen = 0
    for page in PROSE:
        for command, rest in COMMAND.findall(page.read_text("utf-8")):
            asked = OPTION.findall(rest.partition("#")[0].partition(" | ")[0])
            if command not in known:
                # Prose such as "sindy-surge finds", or a general COMMAND.
                assert not asked, f"{page.name}: sindy-surge {command}"
                continue
            options = {o for action in known[command]._actions for o in action.option_strings}
            seen += len(asked)
            assert set(asked) <= options, f"{page.name}: sindy-surge {command} {asked}"
    assert seen > 20
