"""Pages are run: sessions, scripts and examples print what the page shows, to its last digit."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
sys.path.insert(0, str(DOCS / "_ext"))

import sessions  # noqa: E402

PAGES = [DOCS / "from_your_file.md", *sorted((DOCS / "tutorials").glob("*.md"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_shows_what_its_commands_print(page: Path, tmp_path: Path) -> None:
    text = page.read_text("utf-8")
    for outcome in sessions.run_page(text, tmp_path):
        line = text.count("\n", 0, outcome.block.start) + 1
        wrong = "; ".join(outcome.wrong_codes)
        assert outcome.agrees, f"{page.name}:{line} {wrong} now prints\n{outcome.found}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_what_is_not_run_says_why(page: Path) -> None:
    text = page.read_text("utf-8")
    blocks = sessions.blocks_of(text)
    assert blocks
    skipped = [block for block in blocks if block.caption.startswith("not run")]
    assert all(":" in block.caption for block in skipped)
    # A page that runs nothing would pass everything.
    ran = [b for b in blocks if b.kind in ("console", "python") and b not in skipped]
    assert ran or page.stem == "measured"


def test_a_wrong_digit_is_seen() -> None:
    shown = "τ = 18.01 ± 0.03 ms\n...\nlast line, 7 rows"
    found = "τ = 18.01 ± 0.03 ms\nbetween\n\nlast line, 7 rows"
    assert sessions.agree(shown, found)
    # One unit of the last digit is another processor's rounding; two are another number.
    assert sessions.agree(shown, found.replace("18.01", "18.02"))
    assert not sessions.agree(shown, found.replace("18.01", "18.03"))
    assert not sessions.agree(shown, found.replace("7 rows", "8 rows"))
    assert not sessions.agree(shown, found.replace("last line", "last word"))
    assert not sessions.agree(shown, found.replace("\nlast line, 7 rows", ""))
    assert not sessions.agree(shown.replace("...\n", ""), found)
    assert not sessions.agree("−3 ms", "3 ms")
    assert not sessions.agree("1.5e-03", "1.5e-04")


def test_a_page_is_run_in_order(tmp_path: Path) -> None:
    page = (
        "```{code-block} python\n:caption: make.py\n\nprint(6 * 7)\n```\n"
        "```console\n$ python make.py\n41\n```\n"
        "```python\nx = 2\n```\nand\n```python\nprint(x)\n```\n\n```text\n2\n```\n"
        "```{code-block} console\n:caption: not run: no such thing\n\n$ false\nall well\n```\n"
        "```text\nnot an output\n```\n"
    )
    outcomes = list(sessions.run_page(page, tmp_path))
    assert [outcome.agrees for outcome in outcomes] == [False, True]
    assert outcomes[0].found == "$ python make.py\n42\n"


CODES = (
    "```console\n$ sindy-surge inspect none.csv\n{said}{asked}```\n"
    "```console\n$ python stop.py\nbefore\n$ echo $?\n{stop}\n$ false\n$ echo $?\n1\n```\n"
    "```console\n$ echo {word}\nword\n```\n"
)
SCRIPT = '```{code-block} python\n:caption: stop.py\n\nprint("before")\nraise SystemExit(3)\n```\n'
SAID = "sindy-surge: none.csv: expected a raw record, found no such file\n"


@pytest.mark.parametrize(
    ("asked", "stop", "wrong"),
    [
        ("$ echo $?\n2\n", "3", ""),
        ("", "3", "sindy-surge inspect none.csv: exit code 2, where the page states 0"),
        ("$ echo $?\n0\n", "3", "inspect none.csv: exit code 2, where the page states 0"),
        ("$ echo $?\n2\n", "0", "python stop.py: exit code 3, where the page states 0"),
    ],
)
@pytest.mark.parametrize("write", [False, True])
def test_an_exit_code_that_is_not_as_stated_fails_whether_the_page_is_written_or_not(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    asked: str,
    stop: str,
    wrong: str,
    write: bool,
) -> None:
    file = tmp_path / "page.md"
    page = SCRIPT + CODES.format(said=SAID, asked=asked, stop=stop, word="word")
    file.write_text(page, "utf-8")
    assert sessions.main([str(file), *(["--write"] if write else [])]) == int(bool(wrong))
    said = capsys.readouterr().out
    assert wrong in said
    assert said.count("exit code") == bool(wrong)
    # What is wrong is left to be mended by hand.
    assert file.read_text("utf-8") == page


def test_output_that_differs_fails_unless_it_is_written(tmp_path: Path) -> None:
    file = tmp_path / "page.md"
    page = SCRIPT + CODES.format(said=SAID, asked="$ echo $?\n2\n", stop="3", word="other")
    file.write_text(page, "utf-8")
    assert sessions.main([str(file)]) == 1
    assert file.read_text("utf-8") == page
    assert sessions.main([str(file), "--write"]) == 0
    assert file.read_text("utf-8") == page.replace("\nword\n", "\nother\n")
    assert sessions.main([str(file)]) == 0
