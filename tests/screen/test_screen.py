"""Reports in a real browser: nothing leaves, nothing foreign runs, everything can be read."""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from made_pages import EVIL, PAGES

if TYPE_CHECKING:
    from conftest import Browser

KINDS = sorted(PAGES)
A4_PT = (595.0, 842.0)
# Width of A4 less the margins of 16 mm, in CSS pixels of 1/96 inch.
PRINTED_PX = 672
# WCAG 2.1, 1.4.3: least contrast of text that is not large.
LEAST_CONTRAST = 4.5

# Every text with its colour and that of the nearest background which is not see-through.
CONTRASTS = """
const channels = (text) => text.match(/[\\d.]+/g).map(Number);
const luminance = ([r, g, b]) => [r, g, b].map((v) => v / 255)
  .map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4))
  .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
const behind = (element) => {
  for (let e = element; e; e = e.parentElement) {
    const colour = channels(getComputedStyle(e).backgroundColor);
    if (colour.length < 4 || colour[3] > 0) return colour;
  }
  return [255, 255, 255];
};
const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
const out = [];
while (walker.nextNode()) {
  const element = walker.currentNode.parentElement;
  const text = walker.currentNode.textContent.trim();
  if (!text || !element.checkVisibility()) continue;
  const [a, b] = [channels(getComputedStyle(element).color), behind(element)].map(luminance);
  out.push([(Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05), text.slice(0, 40)]);
}
return out;
"""


def test_no_request_leaves_and_the_console_stays_silent(browser: Browser, page: Path) -> None:
    browser.messages(), browser.requests()
    browser.open(page)
    images = browser.all("figure img")
    # Every kind of report has pictures.
    assert images
    for image in images:
        assert browser.run("return arguments[0].naturalWidth", image) > 300
    assert browser.messages() == []
    assert browser.requests() == []


def test_contents_lead_to_every_heading(browser: Browser, page: Path) -> None:
    browser.open(page)
    links = browser.all("nav a")
    targets = [link.get_dom_attribute("href") for link in links]
    headings = browser.run(
        "return [...document.querySelectorAll('main h2, main h3')].map((h) => '#' + h.id)"
    )
    assert targets == headings
    links[-1].click()
    assert browser.run("return location.hash") == targets[-1]
    assert browser.run("return window.scrollY") > 0


@pytest.mark.parametrize("kind", KINDS)
def test_contents_and_tables_need_no_script(
    browser: Browser, page_of: Callable[..., Path], kind: str
) -> None:
    browser.command("Emulation.setScriptExecutionDisabled", value=True)
    try:
        browser.open(page_of(kind))
        browser.all("nav a")[-1].click()
        assert browser.driver.current_url.endswith("#made")
        assert all(table.is_displayed() for table in browser.all("table"))
        assert not browser.all("main button")
    finally:
        browser.command("Emulation.setScriptExecutionDisabled", value=False)


def test_pages_are_built_so_that_they_can_be_listened_to(browser: Browser, page: Path) -> None:
    browser.open(page)
    assert browser.run("return document.documentElement.lang") == "en"
    assert browser.driver.title
    levels = [int(h.tag_name[1]) for h in browser.all("h1, h2, h3, h4, h5, h6")]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(lower <= upper + 1 for upper, lower in pairwise(levels))
    heads = browser.all("th")
    assert heads
    assert all(head.get_dom_attribute("scope") in ("col", "row") for head in heads)
    alts = [image.get_dom_attribute("alt") for image in browser.all("main img")]
    assert alts
    assert all(len(alt) > 40 and re.search(r"\d", alt) for alt in alts)
    assert len(set(alts)) == len(alts)
    figures = browser.all("figure")
    assert figures
    for figure in figures:
        title = figure.find_element("css selector", "h4").text
        alt = figure.find_element("css selector", "img").get_dom_attribute("alt")
        assert alt.strip(" .") != title
    for region in browser.all("[role=region]"):
        assert region.accessible_name


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_text_stands_out_from_what_is_behind_it(
    browser: Browser, page: Path, scheme: str
) -> None:
    feature = {"name": "prefers-color-scheme", "value": scheme}
    browser.command("Emulation.setEmulatedMedia", features=[feature])
    try:
        browser.open(page)
        contrasts = browser.run(CONTRASTS)
    finally:
        browser.command("Emulation.setEmulatedMedia", features=[])
    assert len(contrasts) > 30
    assert [row for row in contrasts if row[0] < LEAST_CONTRAST] == []


@pytest.mark.parametrize("name", ["record.csv", EVIL])
@pytest.mark.parametrize("kind", KINDS)
def test_a_narrow_screen_shows_the_page_without_scrolling_sideways(
    browser: Browser, page_of: Callable[..., Path], kind: str, name: str
) -> None:
    browser.open(page_of(kind, name), width=375)
    assert browser.run("return document.documentElement.scrollWidth") <= 375
    # Text that may wrap lies inside; what may not, a table, scrolls in its own box.
    beyond = browser.run(
        "return [...document.querySelectorAll('h1, h2, h3, h4, p, li, pre, img, .scroll, nav')]"
        ".filter((e) => !e.closest('table') && e.getBoundingClientRect().right > 375.5)"
        ".map((e) => e.outerHTML.slice(0, 80))"
    )
    assert beyond == []


@pytest.mark.parametrize("name", ["record.csv", EVIL])
@pytest.mark.parametrize("kind", KINDS)
def test_printed_pages_hold_everything(
    browser: Browser, page_of: Callable[..., Path], kind: str, name: str
) -> None:
    browser.open(page_of(kind, name), width=PRINTED_PX)
    browser.command("Emulation.setEmulatedMedia", media="print")
    try:
        beyond = browser.run(
            "return [...document.querySelectorAll('main *, header *')]"
            ".filter((e) => e.getBoundingClientRect().right > arguments[0] + 1)"
            ".map((e) => e.outerHTML.slice(0, 80))",
            PRINTED_PX,
        )
        hidden = browser.run(
            "return [...document.querySelectorAll('nav, .enlarge')]"
            ".filter((e) => e.checkVisibility()).length"
        )
        words = browser.run("return document.querySelector('main').innerText")
    finally:
        browser.command("Emulation.setEmulatedMedia", media="")
    assert beyond == []
    assert hidden == 0
    assert "Enlarge" not in words
    printed = browser.pdf()
    assert len(re.findall(rb"/Type\s*/Page\b", printed)) > 0
    boxes = {
        tuple(map(float, box.split())) for box in re.findall(rb"/MediaBox \[([^]]*)\]", printed)
    }
    for box in boxes:
        assert box[2:] == pytest.approx(A4_PT, abs=1.0)
    assert boxes


@pytest.mark.parametrize("kind", KINDS)
def test_hostile_names_show_as_text_and_run_nothing(
    browser: Browser, page_of: Callable[..., Path], kind: str
) -> None:
    browser.messages(), browser.requests()
    browser.open(page_of(kind, EVIL))
    # Of what stands for a path the last part is shown.
    assert browser.driver.title.endswith(EVIL.rsplit("/", 1)[-1]) or kind == "diagnose"
    assert browser.driver.title != "run"
    shown = browser.run("return document.body.textContent")
    assert shown.count(EVIL) >= 2
    assert len(browser.all("script")) == len(browser.all("style")) == 1
    assert not browser.all("svg, iframe, object, embed, link, form")
    handlers = browser.run(
        "return [...document.querySelectorAll('*')].flatMap((e) => e.getAttributeNames())"
        ".filter((name) => name.startsWith('on') || name === 'style')"
    )
    assert handlers == []
    images = browser.all("main img")
    assert images
    for image in images:
        assert image.get_dom_attribute("src").startswith("data:image/png")
    # Sorting and enlarging put names into other places of the page.
    for button in browser.all("button.sort, button.enlarge"):
        browser.run("arguments[0].click()", button)
        browser.run("document.querySelector('dialog')?.close()")
    assert browser.driver.title != "run"
    assert browser.messages() == []
    assert browser.requests() == []


def test_the_policy_holds_where_escaping_would_fail(
    browser: Browser, page_of: Callable[..., Path]
) -> None:
    browser.open(page_of("reproduce"))
    before = browser.driver.title
    browser.run(
        "document.body.insertAdjacentHTML('beforeend', arguments[0])",
        "<img src=x onerror=\"document.title='run'\"><p id=late style='color: red'>x</p>"
        "<style>h1 { display: none }</style><img src=http://127.0.0.1/x.png>",
    )
    browser.driver.execute_async_script(
        "const s = document.createElement('script'); s.textContent = \"document.title = 'run'\";"
        "document.body.append(s); setTimeout(arguments[0], 100)"
    )
    assert browser.driver.title == before
    assert browser.all("h1")[0].is_displayed()
    assert browser.all("#late")[0].value_of_css_property("color") != "rgba(255, 0, 0, 1)"
    assert sum("Content Security Policy" in message for message in browser.messages()) >= 4
