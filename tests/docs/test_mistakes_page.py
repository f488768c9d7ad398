"""The page of mistakes is the table of mistakes, and quotes what the commands print."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from mistake import FLAGGED, HARMLESS, REFUSED, UNNOTICED
from mistake_desk import clean_files
from mistakes import MISTAKES

DOCS = Path(__file__).parents[2] / "docs"
sys.path[:0] = [str(DOCS), str(DOCS / "effects")]

import blocks  # noqa: E402
import make_mistakes  # noqa: E402

BEGINS = {
    REFUSED: "**Refused**: `",
    FLAGGED: "**Noted**: `",
    HARMLESS: "**Harmless**: ",
    UNNOTICED: "**Unnoticed**: ",
}
AGAIN = "run `python docs/make_mistakes.py`"
# What packages for a format say of a broken file is theirs, and other releases say it otherwise.
THEIR_WORDS = "cannot be read ("
EVERY = 12


@pytest.fixture(scope="module")
def said() -> dict[str, str]:
    return make_mistakes.said_on(make_mistakes.PAGE)


def test_the_page_holds_each_row_in_its_group(said: dict[str, str]) -> None:
    shown = blocks.blocks_of(make_mistakes.PAGE)
    assert shown["count"] == make_mistakes.count_block(), AGAIN
    assert shown["groups"] == make_mistakes.groups_block(said), AGAIN


def test_each_row_says_what_the_table_owes(said: dict[str, str]) -> None:
    for row in MISTAKES:
        text = said[row.id].replace(r"\|", "|")
        assert text.startswith(BEGINS[row.outcome]), f"{row.id}: {AGAIN}"
        if row.outcome == REFUSED:
            assert [word for word in row.says if word not in text] == [], f"{row.id}: {AGAIN}"


def test_what_is_quoted_is_what_is_printed(
    said: dict[str, str], tmp_path_factory: pytest.TempPathFactory
) -> None:
    clean = clean_files(tmp_path_factory.mktemp("clean"))
    shut = (make_mistakes.SHUT,) if make_mistakes.IS_ROOT else ()
    own = [m for m in MISTAKES if THEIR_WORDS not in said[m.id] and m.id not in shut]
    for row in own[::EVERY]:
        assert make_mistakes.answer_of(row, clean) == said[row.id], f"{row.id}: {AGAIN}"


def test_no_place_of_the_machine_that_made_it_is_on_the_page(said: dict[str, str]) -> None:
    text = make_mistakes.PAGE.read_text("utf-8")
    assert [line for line in text.splitlines() if "/tmp" in line or str(Path.home()) in line] == []
