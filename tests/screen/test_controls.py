"""Sorting and enlarging, by mouse and by keyboard."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from made_pages import PAGES

from comparisons.show.report import Cell, Head, Part, ReportSection, Table, render_report

if TYPE_CHECKING:
    from conftest import Browser

KINDS = sorted(PAGES)
# Cells of one column as they may come, and their order.
MIXED: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "error": (
        ("0.12 ± 0.03", "", "−0.5 ± 0.1", "n/a", "-2", "10", "9.5 ± ?"),
        ("-2", "−0.5 ± 0.1", "0.12 ± 0.03", "9.5 ± ?", "10", "", "n/a"),
    ),
    "unit": (
        ("2 s", "30 ms", "900 µs", "(1.5 ± 0.1) ms", "", "0.5 s", "not known"),
        ("900 µs", "(1.5 ± 0.1) ms", "30 ms", "0.5 s", "2 s", "", "not known"),
    ),
    "power": (
        ("(1.21 ± 0.05)e-06", "3e-7", "2·10⁻⁶ V", "12,345", "∞", "−∞", "1.5"),
        ("−∞", "3e-7", "(1.21 ± 0.05)e-06", "2·10⁻⁶ V", "1.5", "12,345", "∞"),
    ),
    "bound": (
        ("< 0.07", "> 1", "≥ 0.5", "3 … 4", "2 to 9", "100 %", "—"),
        ("< 0.07", "≥ 0.5", "> 1", "2 to 9", "3 … 4", "100 %", "—"),
    ),
    "words": (
        ("record 10", "record 9", "Ähre", "apfel", "zebra", "", "985.csv"),
        ("985.csv", "Ähre", "apfel", "record 9", "record 10", "zebra", ""),
    ),
    "ties": (
        ("1 a", "1 b", "0 c", "1 d", "0 e", "0 f", "1 g"),
        ("0 c", "0 e", "0 f", "1 a", "1 b", "1 d", "1 g"),
    ),
    "zero": (
        ("best", "0.2 ± 0.1", "−0.1", "0.1", "", "5", "0.05"),
        ("−0.1", "best", "0.05", "0.1", "0.2 ± 0.1", "5", ""),
    ),
}


def cells(browser: Browser, table: Any, column: int) -> list[str]:
    """Return what a column shows, small print left out."""
    texts: list[str] = browser.run(
        "return [...arguments[0].tBodies[0].rows]"
        ".map((row) => (row.cells[arguments[1]].firstChild?.textContent ?? '').trim())",
        table,
        column,
    )
    return texts


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page with every kind of column, and a table whose rows belong together."""
    heads = tuple(
        Head(name, numeric=name not in ("words", "ties"), zero="best" if name == "zero" else "")
        for name in MIXED
    )
    columns = [before for before, _ in MIXED.values()]
    own: tuple[tuple[str | Cell, ...], ...] = tuple(
        (str(number), *row) for number, row in enumerate(zip(*columns, strict=True))
    )
    grouped = Table("Grouped", (Head("a"), Head("b")), (("x", "2"), ("", "1"), ("y", "0")))
    tables = (Table("Mixed", (Head("row"), *heads), own), grouped)
    path = tmp_path_factory.mktemp("mixed") / "mixed.html"
    page = render_report([ReportSection("x", extra=(Part("x", tables),))], title="x", command="x")
    path.write_text(page, "utf-8")
    return path


@pytest.mark.parametrize("name", MIXED)
def test_columns_sort_by_what_their_cells_mean(browser: Browser, mixed: Path, name: str) -> None:
    browser.open(mixed)
    table = browser.all("table.sortable")[0]
    column = 1 + list(MIXED).index(name)
    before, ascending = MIXED[name]
    head = table.find_elements("css selector", "th")[column]
    head.click()
    assert cells(browser, table, column) == list(ascending)
    assert head.get_dom_attribute("aria-sort") == "ascending"
    head.click()
    assert head.get_dom_attribute("aria-sort") == "descending"
    # Rows that tie keep their order, and empty cells stay last.
    falling = cells(browser, table, column)
    empty = [text for text in ascending if text in ("", "n/a", "not known", "—")]
    assert falling[len(falling) - len(empty) :] == empty
    if name == "ties":
        assert falling == ["1 a", "1 b", "1 d", "1 g", "0 c", "0 e", "0 f"]
    else:
        assert falling[: len(falling) - len(empty)] == list(ascending)[: 7 - len(empty)][::-1]
    head.click()
    assert cells(browser, table, column) == list(before)
    assert head.get_dom_attribute("aria-sort") is None


def test_one_column_is_sorted_at_a_time_and_its_rows_stay_whole(
    browser: Browser, mixed: Path
) -> None:
    browser.open(mixed)
    table = browser.all("table.sortable")[0]
    heads = table.find_elements("css selector", "th")
    heads[1].click()
    heads[2].click()
    assert [h.get_dom_attribute("aria-sort") for h in heads].count("ascending") == 1
    numbers = [int(text) for text in cells(browser, table, 0)]
    for column, (before, _) in enumerate(MIXED.values(), start=1):
        assert cells(browser, table, column) == [before[number] for number in numbers]


def test_rows_that_belong_together_stay_where_they_are(browser: Browser, mixed: Path) -> None:
    browser.open(mixed)
    assert len(browser.all("table.sortable")) == 2  # with that of the versions
    assert not [
        t for t in browser.all("table:not(.sortable)") if t.find_elements("tag name", "button")
    ]


def test_the_keyboard_sorts(browser: Browser, mixed: Path) -> None:
    from selenium.webdriver.common.keys import Keys

    browser.open(mixed)
    button = browser.all("button.sort")[1]
    reached = False
    body = browser.all("body")[0]
    for _ in range(40):
        browser.driver.switch_to.active_element.send_keys(Keys.TAB)
        if browser.driver.switch_to.active_element == button:
            reached = True
            break
    assert reached
    assert body != button
    table = browser.all("table.sortable")[0]
    button.send_keys(Keys.ENTER)
    assert cells(browser, table, 1) == list(MIXED["error"][1])
    button.send_keys(Keys.SPACE)
    assert cells(browser, table, 1)[0] == "10"
    assert browser.driver.switch_to.active_element == button


# Every column of numbers after one click on its head, and after two.
CLICKS = """
const out = [];
for (const table of document.querySelectorAll("table.sortable")) {
  [...table.tHead.rows[0].cells].forEach((head, column) => {
    if (!head.classList.contains("numeric")) return;
    out.push([0, 1].map(() => {
      head.querySelector("button").click();
      return [...table.tBodies[0].rows]
        .map((row) => row.cells[column].firstChild?.textContent ?? "");
    }));
  });
}
return out;
"""


def number(text: str) -> float:
    """Return the number that a cell begins with, by a reading of its own; nan for none."""
    plain = text.replace("−", "-").lstrip("<>≤≥( ").replace("best", "0").replace("reference", "0")
    match = re.match(r"[-+]?\d*\.?\d+(?:e[-+]?\d+)?", plain)
    if match is None:
        return math.nan
    power = re.search(r"\)e([-+]\d+)", plain)
    tens = re.search(r"·10⁻([⁰¹²³⁴-⁹]+)", plain)
    value = float(match.group()) * (10.0 ** int(power.group(1)) if power else 1.0)
    return value * (10.0 ** -"⁰¹²³⁴⁵⁶⁷⁸⁹".index(tens.group(1)) if tens else 1.0)


@pytest.mark.parametrize("kind", KINDS)
def test_real_tables_sort_by_their_numbers(
    browser: Browser, page_of: Callable[..., Path], kind: str
) -> None:
    browser.open(page_of(kind))
    seen = 0
    for rising, falling in browser.run(CLICKS):
        # Prefixes of units have a test of their own.
        if len({re.sub(r"[-\d.± ()…−<>e]+", "", text) for text in rising} - {""}) > 1:
            continue
        for sign, texts in ((1.0, rising), (-1.0, falling)):
            values = [sign * number(text) for text in texts]
            known = [value for value in values if not math.isnan(value)]
            assert known == sorted(known)
            assert values[: len(known)] == known  # what is not known comes last
        seen += 1
    assert seen > 0 or kind in ("reduce",)


@pytest.mark.parametrize("kind", KINDS)
def test_pictures_are_enlarged_and_closed(
    browser: Browser, page_of: Callable[..., Path], kind: str
) -> None:
    from selenium.webdriver.common.keys import Keys

    browser.open(page_of(kind), width=700)
    figure = browser.all("figure")[0]
    image = figure.find_element("css selector", "img")
    button = figure.find_element("css selector", "button.enlarge")
    dialog = browser.all("dialog")[0]
    assert not dialog.is_displayed()
    shown = image.rect["width"]

    image.click()
    assert dialog.is_displayed()
    large = dialog.find_element("css selector", "img")
    assert large.rect["width"] > 1.3 * shown
    assert large.get_dom_attribute("alt") == image.get_dom_attribute("alt")
    assert dialog.accessible_name == figure.find_element("css selector", "h4").text
    large.click()
    assert not dialog.is_displayed()
    assert browser.driver.switch_to.active_element == button

    button.send_keys(Keys.ENTER)
    assert dialog.is_displayed()
    browser.driver.switch_to.active_element.send_keys(Keys.ESCAPE)
    assert not dialog.is_displayed()
    assert browser.driver.switch_to.active_element == button

    button.send_keys(Keys.SPACE)
    dialog.find_element("css selector", "button").send_keys(Keys.ENTER)
    assert not dialog.is_displayed()
