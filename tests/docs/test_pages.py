"""Pages are run: files, commands and Python on them give what the page shows.

A block with the name of a file as its caption is that file; `console` holds commands behind `$`
with what each prints, where a line of three dots stands for any lines; `python` without a caption
is executed, and a `text` block right behind it is what it prints. A caption that begins with "not
run" says why.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import shlex
import subprocess
import sys
from operator import itemgetter
from pathlib import Path

import pytest
from sybil import Example, Sybil
from sybil.parsers.myst import CodeBlockParser

from comparisons.cli import main

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [DOCS / "from_your_file.md", *sorted((DOCS / "tutorials").glob("*.md"))]
NUMBER = re.compile(r"[-+−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
ERROR = re.compile(rf"({NUMBER.pattern})(?:\s±\s({NUMBER.pattern})|\((\d+(?:\.\d+)?)\))")
# Another processor rounds the last digit otherwise, and ends a search 0.2 standard errors away.
DIGITS, OF_ERROR = 1.01, 0.3


def run_block(example: Example) -> None:
    language = example.region.lexemes["arguments"]
    caption = (example.region.lexemes.get("options") or {}).get("caption", "")
    folder: Path = example.namespace["folder"]
    if caption.startswith("not run"):
        return
    if re.fullmatch(r"[\w.-]+\.\w+", caption):
        (folder / caption).write_text(example.parsed, "utf-8")
    elif language == "console":
        run_session(example.parsed, folder)
    elif language == "python":
        printed = io.StringIO()
        with contextlib.chdir(folder), contextlib.redirect_stdout(printed):
            exec(compile(example.parsed, "page", "exec"), example.namespace["names"])
        example.namespace["printed"] = (example.region.end, printed.getvalue())
    elif language == "text" and "printed" in example.namespace:
        end, found = example.namespace.pop("printed")
        if not example.document.text[end : example.region.start].strip():
            assert_agrees(example.parsed, found)


def run_session(text: str, folder: Path) -> None:
    """Run each command, and compare what it prints; `$ echo $?` behind it states its exit code."""
    parts = re.split(r"^\$ ", text.replace("\\\n", ""), flags=re.MULTILINE)[1:]
    commands = [part.partition("\n")[::2] for part in parts]
    for number, (command, shown) in enumerate(commands):
        if command == "echo $?":
            continue
        returned, printed = run_command(command, folder)
        asked = number + 1 < len(commands) and commands[number + 1][0] == "echo $?"
        code = int(commands[number + 1][1]) if asked else 0
        assert returned == code, f"{command}: exit code {returned}\n{printed}"
        assert_agrees(shown, printed)


def run_command(command: str, folder: Path) -> tuple[int, str]:
    """Return exit code and output; one of ours without a pipe needs no process of its own."""
    if command.startswith("sindy-surge ") and not set(command) & set("|<>&"):
        printed = io.StringIO()
        streams = contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed)
        with contextlib.chdir(folder), streams[0], streams[1]:
            return main(shlex.split(command)[1:]), printed.getvalue()
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ.get("PATH", "")))
    done = subprocess.run(
        re.sub(r"(?<=python )(docs|examples|benchmarks)/", rf"{ROOT}/\1/", command),
        env={**os.environ, "PATH": path},
        shell=True,
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout


def assert_agrees(shown: str, found: str) -> None:
    lines = [line.rstrip() for line in found.rstrip().splitlines()]
    last = {n: 1.0 if "." in d else digit_of(n) for n, _, d in ERROR.findall(shown)}
    stated = [(n, float(e or float(d) * last[n])) for n, e, d in ERROR.findall(shown)]
    errors = dict(sorted(stated, key=itemgetter(1)))
    at, anywhere = 0, False
    for line in shown.rstrip().splitlines():
        if line.strip() == "...":
            anywhere = True
            continue
        if anywhere:
            while at < len(lines) and not same_line(line, lines[at], errors):
                at += 1
        assert at < len(lines), f"not printed: {line}\nnow prints\n{found}"
        assert same_line(line, lines[at], errors), f"{line}\nnow prints\n{lines[at]}\nof\n{found}"
        at, anywhere = at + 1, False
    assert anywhere or at == len(lines), f"the page shows less than is printed:\n{found}"


def same_line(shown: str, found: str, errors: dict[str, float]) -> bool:
    if " ".join(NUMBER.sub("0", shown).split()) != " ".join(NUMBER.sub("0", found).split()):
        return False
    texts = (re.sub(r"(?<=\d)\((\d+)\)", r"(0.\1)", text) for text in (shown, found))
    pairs = zip(*map(NUMBER.findall, texts), strict=True)
    return all(same_number(one, other, errors.get(one, 0.0)) for one, other in pairs)


def same_number(shown: str, found: str, error: float) -> bool:
    """Compare to the digits shown or the error; whole numbers are counted, not rounded."""
    one, other = (float(text.replace("−", "-")) for text in (shown, found))
    return abs(one - other) <= ("." in shown) * max(DIGITS * digit_of(shown), OF_ERROR * error)


def digit_of(number: str) -> float:
    mantissa, _, power = number.partition("e")
    return float(10.0 ** (int(power or 0) - len(mantissa.partition(".")[2])))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_shows_what_its_blocks_print(page: Path, tmp_path: Path) -> None:
    languages = set(re.findall(r"^```(?:\{code-block\} *)?(\w+)$", page.read_text("utf-8"), re.M))
    document = Sybil([CodeBlockParser(name, run_block) for name in languages]).parse(page)
    document.namespace.update(folder=tmp_path, names={"__name__": "__main__"})
    examples = list(document.examples())
    assert examples
    for example in examples:
        example.evaluate()


def test_effect_pages_are_what_the_code_says() -> None:
    done = subprocess.run(
        [sys.executable, str(DOCS / "effects" / "make.py"), "--check"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    for folder in (DOCS / "effects", DOCS / "effects" / "systems"):
        index = (folder / "index.md").read_text("utf-8")
        listed = set(re.findall(r"^\w+$", index.split("{toctree}")[1], re.MULTILINE))
        assert listed == {page.stem for page in folder.glob("*.md")} - {"index"}


def test_a_wrong_digit_is_detected() -> None:
    shown = "τ = 18.01 ± 0.03 ms\n...\nlast line, 7 rows"
    found = "τ = 18.01 ± 0.03 ms\nbetween\n\nlast line, 7 rows"
    assert_agrees(shown, found)
    assert_agrees(shown, found.replace("18.01", "18.02"))
    for wrong in (("18.01", "18.03"), ("7 rows", "8 rows"), ("\nlast line, 7 rows", "")):
        with pytest.raises(AssertionError):
            assert_agrees(shown, found.replace(*wrong))
    with pytest.raises(AssertionError):
        assert_agrees("−3 ms", "3 ms")
