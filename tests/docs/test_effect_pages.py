"""Each effect has a page, and what a page says of it is what the code says."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from comparisons.missing_effect import CATALOGUE, SYSTEM_CATALOGUE
from comparisons.missing_effect.catalogue import FLOW_NOISE

DOCS = Path(__file__).parents[2] / "docs"
EFFECTS = DOCS / "effects"
SYSTEMS = EFFECTS / "systems"
sys.path[:0] = [str(EFFECTS), str(DOCS / "_ext")]

import blocks  # noqa: E402
import lag_effects  # noqa: E402
import sessions  # noqa: E402
import system_effects  # noqa: E402

LAG_NAMES = {effect.name for effect in CATALOGUE} | {FLOW_NOISE.name}
SYSTEM_NAMES = {effect.name for effect in SYSTEM_CATALOGUE}
LARGEST_PICTURE = 40 * 1024


def pages(folder: Path) -> list[Path]:
    return sorted(page for page in folder.glob("*.md") if page.stem != "index")


EVERY = [(page, lag_effects) for page in pages(EFFECTS)] + [
    (page, system_effects) for page in pages(SYSTEMS)
]


def told(case: tuple[Path, ModuleType]) -> str:
    return case[0].relative_to(EFFECTS).with_suffix("").as_posix()


@pytest.mark.parametrize(
    ("folder", "names"), [(EFFECTS, LAG_NAMES), (SYSTEMS, SYSTEM_NAMES)], ids=["lag", "systems"]
)
def test_the_pages_are_the_catalogue(folder: Path, names: set[str]) -> None:
    assert {page.stem for page in pages(folder)} == names
    index = (folder / "index.md").read_text("utf-8")
    tree = re.search(r"```\{toctree\}\n(.*?)```", index, re.DOTALL)
    assert tree is not None
    assert set(re.findall(r"^\w+$", tree[1], re.MULTILINE)) == names


@pytest.mark.parametrize("case", EVERY, ids=told)
def test_what_the_code_says_is_on_the_page(case: tuple[Path, ModuleType]) -> None:
    page, home = case
    shown = blocks.blocks_of(page)
    for name, text in home.plain_blocks(page.stem).items():
        assert shown[name] == text, f"run `python docs/effects/make.py --plain`: {name}"
    # What must be measured is there, and was not left open.
    assert all(shown.values())
    assert {"picture", "mimics"} <= set(shown)


@pytest.mark.parametrize(
    ("folder", "block"),
    [(EFFECTS, lag_effects.index_block), (SYSTEMS, system_effects.index_block)],
    ids=["lag", "systems"],
)
def test_the_index_is_the_catalogue(folder: Path, block: Callable[[], str]) -> None:
    assert blocks.blocks_of(folder / "index.md")["table"] == block()


@pytest.mark.parametrize("case", EVERY, ids=told)
def test_a_page_has_a_small_picture_that_is_described(case: tuple[Path, ModuleType]) -> None:
    page, _ = case
    text = page.read_text("utf-8")
    figure = re.search(r"```\{figure\} (\S+)\n:alt: (.+)\n\n(.+)", text)
    assert figure is not None
    picture = page.parent / figure[1]
    assert picture.stem == page.stem
    assert picture.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert picture.stat().st_size <= LARGEST_PICTURE
    assert len(figure[2]) > 60
    assert len(figure[3]) > 20


# One in which little but noise could differ, and one with thresholds that are searched.
@pytest.mark.parametrize("name", ["bias_drift", "hysteresis"])
def test_numbers_of_a_page_are_what_is_measured(name: str) -> None:
    shown = blocks.blocks_of(EFFECTS / f"{name}.md")["picture"]
    assert sessions.agree(shown, lag_effects.picture_words(name))


def test_numbers_of_a_system_are_what_is_measured() -> None:
    seed = system_effects.SEEDS[:1]
    shown = blocks.blocks_of(SYSTEMS / "further_lag.md")["picture"]
    one = system_effects.found("further_lag", *seed)
    assert sessions.agree(shown, system_effects.picture_words("further_lag", one))


def test_the_commands_of_a_page_hide_and_find(tmp_path: Path) -> None:
    commands = blocks.blocks_of(EFFECTS / "bias_drift.md")["commands"]
    session = re.search(r"```console\n(.*?)```", commands, re.DOTALL)
    assert session is not None
    page = f"```console\n{session[1]}```\n"
    (outcome,) = sessions.run_page(page, tmp_path)
    assert "record-3.csv" in outcome.found
    assert "VERDICT: named\n" in outcome.found
    assert "It is bias_drift, at the port “output”: ψ' + c t." in outcome.found
    assert "nothing to tell apart" in outcome.found
