"""Run what a page shows: its sessions, scripts and files, in order, in one folder.

    python docs/_ext/sessions.py PAGE...            say where output differs
    python docs/_ext/sessions.py --write PAGE...    put the output found in the place of that shown

A page is Markdown. Of its fenced blocks

- one with a caption that is the name of a file is that file;
- ``console`` holds commands behind ``$`` and what each prints; ``...`` alone in a line stands for
  any lines, and a caption that begins with "not run" says why it is not run. A command ends with
  exit code 0, or with the one that ``$ echo $?`` behind it shows: another one is an error, which
  ``--write`` leaves for somebody to look at;
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
from collections.abc import Callable, Iterator, Sequence
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
# Asks for the exit code of the command before.
ASK_CODE = "echo $?"
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
    follows_on : bool
        Whether nothing but blank lines lies between it and the block before.
    """

    kind: str
    caption: str
    text: str
    start: int
    stop: int
    follows_on: bool = False


@dataclass(frozen=True)
class Outcome:
    """What a block shows and what was found.

    Parameters
    ----------
    block : Block
        The block.
    found : str
        Its text with the output found.
    wrong_codes : tuple of str
        Commands that ended with another exit code than the page states, and with which.
    """

    block: Block
    found: str
    wrong_codes: tuple[str, ...] = ()

    @property
    def agrees(self) -> bool:
        """Whether the page shows what was found."""
        return not self.wrong_codes and agree(self.block.text, self.found)


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
        follows_on = end >= 0 and not page[end : fence.start()].strip()
        out.append(Block(fence["kind"], caption, text, start, fence.end("body"), follows_on))
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
            yield _session(block, folder)
        elif block.kind == "python" and not block.caption:
            with _within(folder) as out:
                exec(compile(block.text, "<page>", "exec"), names)
            printed = out.getvalue()
        elif block.kind == "text" and block.follows_on:
            before = blocks[number - 1]
            if before.kind == "python" and not before.caption:
                yield Outcome(block, printed)


@dataclass
class _Command:
    """A command of a session, as it is shown there."""

    lines: list[str]
    shown: list[str]

    @property
    def text(self) -> str:
        """What is typed, in one line."""
        return " ".join(line.rstrip("\\").strip() for line in self.lines).removeprefix("$ ")


def _commands_of(shown: str) -> list[_Command]:
    commands: list[_Command] = []
    for line in shown.splitlines():
        if line.startswith("$ "):
            commands.append(_Command([line], []))
        elif commands and commands[-1].lines[-1].endswith("\\"):
            commands[-1].lines.append(line)
        elif commands:
            commands[-1].shown.append(line)
    return commands


def _session(block: Block, folder: Path) -> Outcome:
    """Run a session, and return the output and the exit codes that its commands give now."""
    lines: list[str] = []
    wrong: list[str] = []
    commands = _commands_of(block.text)
    code = 0
    for command, then in zip(commands, [*commands[1:], None], strict=True):
        lines += command.lines
        if command.text == ASK_CODE:
            lines.append(str(code))
            continue
        printed, code = _output(command.text, folder)
        lines += [line.rstrip() for line in printed.splitlines()]
        asked = then is not None and then.text == ASK_CODE
        stated = "".join(then.shown).strip() if then is not None and asked else "0"
        if str(code) != stated:
            wrong.append(f"{command.text}: exit code {code}, where the page states {stated}")
    return Outcome(block, "\n".join(lines) + "\n", tuple(wrong))


def _output(command: str, folder: Path) -> tuple[str, int]:
    """Return what a command prints, and its exit code."""
    words = shlex.split(command)
    plain = not any(mark in command for mark in "|><&;")
    if plain and words[0] == "sindy-surge":
        from comparisons.cli import main

        with _within(folder, words) as out:
            code = _exit_code(lambda: main(words[1:]))
        return out.getvalue(), code
    if plain and words[0] == "python":
        script = str(ROOT / words[1]) if words[1].startswith(OWN) else words[1]
        with _within(folder, words[1:], Path(script).parent) as out:
            code = _exit_code(lambda: runpy.run_path(script, run_name="__main__"))
        return out.getvalue(), code
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
    return done.stdout, done.returncode


def _exit_code(work: Callable[[], object]) -> int:
    """Return the exit code of what runs in this process, as a process of its own would have it."""
    try:
        code = work()
    except SystemExit as stop:
        if stop.code is None or isinstance(stop.code, int):
            return stop.code or 0
        sys.stderr.write(f"{stop.code}\n")
        return 1
    return code if isinstance(code, int) else 0


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
    """Return the page with the output found.

    Blocks with three dots stay as they are, and those with an exit code that is not the stated
    one, whose output may be that of a fault.
    """
    out = page
    for outcome in reversed(outcomes):
        block = outcome.block
        dots = ANY in (line.strip() for line in block.text.splitlines())
        if not dots and not outcome.wrong_codes:
            out = out[: block.start] + outcome.found + out[block.stop :]
    return out


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command.

    Parameters
    ----------
    arguments : sequence of str, optional
        Arguments; those of the process without it.

    Returns
    -------
    int
        1 where a page does not show what was found: its exit codes, and its output unless that was
        written; else 0.
    """
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("pages", type=Path, nargs="+", metavar="PAGE")
    parser.add_argument("--write", action="store_true", help="put the output found in its place")
    options = parser.parse_args(arguments)
    failed = False
    for path in options.pages:
        page = path.read_text("utf-8")
        with tempfile.TemporaryDirectory() as folder:
            outcomes = list(run_page(page, Path(folder)))
        for outcome in outcomes:
            if not outcome.agrees:
                failed = failed or bool(outcome.wrong_codes) or not options.write
                line = page.count("\n", 0, outcome.block.start) + 1
                wrong = "".join(f"{words}\n" for words in outcome.wrong_codes)
                sys.stdout.write(f"{path}:{line}: {wrong}found\n{outcome.found}\n")
        if options.write:
            path.write_text(_written(page, outcomes), "utf-8")
    return int(failed)


if __name__ == "__main__":
    raise SystemExit(main())
