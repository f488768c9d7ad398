"""Run what a page shows: its sessions, scripts and files, in order, in one folder.

    python docs/_ext/sessions.py PAGE...            say where output differs
    python docs/_ext/sessions.py --write PAGE...    put the output found in the place of that shown

A page is Markdown. Of its fenced blocks

- one with a caption that is the name of a file is that file;
- ``console`` holds commands behind ``$`` and what each prints; ``...`` alone in a line stands for
  any lines, and a caption that begins with "not run" says why it is not run;
- ``python`` without a caption is executed, all of a page in one namespace; a ``text`` block right
  behind it is what it prints.

`sindy-surge` and `python` run within this process, everything else in a shell.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import re
import runpy
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

__all__ = ["Block", "Outcome", "agree", "blocks_of", "run_page"]

ROOT = Path(__file__).resolve().parents[2]
_FENCE = re.compile(
    r"^```(?:\{code-block\} *)?(?P<kind>\w+)\n(?P<body>.*?)^```$", re.MULTILINE | re.DOTALL
)
_OPTION = re.compile(r"^:(?P<key>\w+): *(?P<value>.*)\n")
_FILE = re.compile(r"^[\w.-]+\.\w+$")
_NUMBER = re.compile(r"[-+−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
ANY = "..."
# Of the last digit that is shown: another processor may round the other way.
DIGITS = 1.01
# Folders of the repository that commands name from its root.
OWN = ("docs/", "examples/", "benchmarks/")


@dataclass(frozen=True)
class Block:
    """A fenced block of a page.

    Parameters
    ----------
    kind : str
        Language.
    caption : str
        Empty without one.
    text : str
        Without fences and options.
    start, stop : int
        Where the text lies in the page.
    behind : int
        Where the block before ended, if nothing but blank lines lies between; else −1.
    """

    kind: str
    caption: str
    text: str
    start: int
    stop: int
    behind: int = -1


@dataclass(frozen=True)
class Outcome:
    """What a block shows and what was found.

    Parameters
    ----------
    block : Block
        The block.
    found : str
        Its text with the output found.
    """

    block: Block
    found: str

    @property
    def agrees(self) -> bool:
        """Whether the page shows what was found."""
        return agree(self.block.text, self.found)


def blocks_of(page: str) -> list[Block]:
    """Return the fenced blocks of a page.

    Parameters
    ----------
    page : str
        Markdown.
    """
    out: list[Block] = []
    end = -1
    for fence in _FENCE.finditer(page):
        start, caption = fence.start("body"), ""
        while option := _OPTION.match(page[start : fence.end("body")]):
            if option["key"] == "caption":
                caption = option["value"].strip()
            start += option.end()
        text = page[start : fence.end("body")]
        near = end >= 0 and not page[end : fence.start()].strip()
        out.append(
            Block(
                fence["kind"], caption, text, start, fence.end("body"), len(out) - 1 if near else -1
            )
        )
        end = fence.end()
    return out


def run_page(page: str, folder: Path) -> Iterator[Outcome]:
    """Run a page block by block.

    Parameters
    ----------
    page : str
        Markdown.
    folder : path
        Where its files are made.
    """
    names: dict[str, object] = {"__name__": "__main__"}
    blocks = blocks_of(page)
    printed = ""
    for number, block in enumerate(blocks):
        if block.caption.startswith("not run"):
            continue
        if _FILE.match(block.caption):
            (folder / block.caption).write_text(block.text, "utf-8")
        elif block.kind == "console":
            yield Outcome(block, _session(block.text, folder))
        elif block.kind == "python" and not block.caption:
            with _within(folder) as out:
                exec(compile(block.text, "<page>", "exec"), names)
            printed = out.getvalue()
        elif block.kind == "text" and block.behind == number - 1 >= 0:
            before = blocks[number - 1]
            if before.kind == "python" and not before.caption:
                yield Outcome(block, printed)


def _session(shown: str, folder: Path) -> str:
    """Return a session with the output that its commands give now."""
    lines: list[str] = []
    commands: list[list[str]] = []
    for line in shown.splitlines():
        if line.startswith("$ "):
            commands.append([line])
        elif commands and commands[-1][-1].endswith("\\"):
            commands[-1].append(line)
    for command in commands:
        lines += command
        joined = " ".join(part.rstrip("\\").strip() for part in command).removeprefix("$ ")
        lines += [line.rstrip() for line in _output(joined, folder).splitlines()]
    return "\n".join(lines) + "\n"


def _output(command: str, folder: Path) -> str:
    words = shlex.split(command)
    plain = not any(mark in command for mark in "|><&;")
    if plain and words[0] == "sindy-surge":
        from comparisons.cli import main

        with _within(folder, words) as out:
            main(words[1:])
        return out.getvalue()
    if plain and words[0] == "python":
        script = str(ROOT / words[1]) if words[1].startswith(OWN) else words[1]
        with _within(folder, words[1:], Path(script).parent) as out:
            runpy.run_path(script, run_name="__main__")
        return out.getvalue()
    here = str(Path(sys.executable).parent)
    done = subprocess.run(
        command,
        env={**os.environ, "PATH": os.pathsep.join((here, os.environ.get("PATH", "")))},
        shell=True,
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    return done.stdout


@contextlib.contextmanager
def _within(
    folder: Path, arguments: Sequence[str] = ("python",), home: Path | None = None
) -> Iterator[io.StringIO]:
    """Work in a folder with other arguments, and catch what is printed."""
    out = io.StringIO()
    before = Path.cwd()
    path = [*([str(home)] if home is not None else []), *sys.path]
    os.chdir(folder)
    try:
        with (
            patch.object(sys, "argv", list(arguments)),
            patch.object(sys, "path", path),
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(out),
        ):
            yield out
    finally:
        os.chdir(before)


def agree(shown: str, found: str) -> bool:
    """Tell whether two outputs say the same, numbers to the digits that are shown.

    Parameters
    ----------
    shown : str
        What a page shows; a line of three dots stands for any lines.
    found : str
        What was printed.
    """
    return _lines_agree(shown.rstrip().splitlines(), found.rstrip().splitlines())


def _lines_agree(shown: Sequence[str], found: Sequence[str]) -> bool:
    if not shown:
        return not found
    if shown[0].strip() == ANY:
        rest = shown[1:]
        return any(_lines_agree(rest, found[k:]) for k in range(len(found) + 1))
    return bool(found) and _line_agrees(shown[0], found[0]) and _lines_agree(shown[1:], found[1:])


def _line_agrees(shown: str, found: str) -> bool:
    if shown.rstrip() == found.rstrip():
        return True
    if " ".join(_NUMBER.sub("0", shown).split()) != " ".join(_NUMBER.sub("0", found).split()):
        return False
    pairs = zip(_NUMBER.findall(shown), _NUMBER.findall(found), strict=True)
    return all(_number_agrees(one, other) for one, other in pairs)


def _number_agrees(shown: str, found: str) -> bool:
    one, other = (float(text.replace("−", "-")) for text in (shown, found))
    mantissa, _, power = shown.partition("e")
    if "." not in mantissa:
        # Rows are counted, and not rounded.
        return one == other
    digit = 10.0 ** (int(power or 0) - len(mantissa.partition(".")[2]))
    return abs(one - other) <= DIGITS * digit


def _written(page: str, outcomes: Sequence[Outcome]) -> str:
    """Return the page with the output found; blocks with three dots stay as they are."""
    out = page
    for outcome in reversed(outcomes):
        block = outcome.block
        if ANY not in (line.strip() for line in block.text.splitlines()):
            out = out[: block.start] + outcome.found + out[block.stop :]
    return out


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("pages", type=Path, nargs="+", metavar="PAGE")
    parser.add_argument("--write", action="store_true", help="put the output found in its place")
    options = parser.parse_args()
    failed = False
    for path in options.pages:
        page = path.read_text("utf-8")
        with tempfile.TemporaryDirectory() as folder:
            outcomes = list(run_page(page, Path(folder)))
        for outcome in outcomes:
            if not outcome.agrees:
                failed = True
                line = page.count("\n", 0, outcome.block.start) + 1
                sys.stdout.write(f"{path}:{line}: found\n{outcome.found}\n")
        if options.write:
            path.write_text(_written(page, outcomes), "utf-8")
    return 0 if options.write else int(failed)


if __name__ == "__main__":
    raise SystemExit(main())
