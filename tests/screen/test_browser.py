"""Reports and the live page in a headless Chromium: no error, tables sort, nothing runs wide."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Any

import pytest
from made_pages import PAGES, made_page

OPTIONS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    # Shared memory of a container is small.
    "--disable-dev-shm-usage",
)
NARROW, WIDE = 390, 1280


@pytest.fixture(scope="session")
def driver(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A headless Chromium with an empty profile and no network."""
    webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed")
    chromium, chromedriver = shutil.which("chromium"), shutil.which("chromedriver")
    if not (chromium and chromedriver):
        pytest.skip("no chromium: tests/screen/run installs Debian's")
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for option in (*OPTIONS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(option)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    service = Service(chromedriver)
    browser = webdriver.Chrome(options=options, service=service)
    browser.execute_cdp_cmd("Network.enable", {})
    offline = {"offline": True, "latency": 0, "downloadThroughput": 0, "uploadThroughput": 0}
    browser.execute_cdp_cmd("Network.emulateNetworkConditions", offline)
    yield browser
    browser.quit()
    # What selenium leaves to the garbage collector, pytest takes for an error.
    browser.command_executor.close()
    if service.process is not None:
        for stream in (service.process.stdin, service.process.stdout, service.process.stderr):
            if stream is not None:
                stream.close()


def show(driver: Any, page: Path, width: int = WIDE) -> None:
    shape = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", shape)
    driver.get(page.as_uri())


def errors(driver: Any) -> list[str]:
    return [entry["message"] for entry in driver.get_log("browser")]


def runs_wide(driver: Any) -> bool:
    return bool(
        driver.execute_script(
            "const page = document.documentElement; return page.scrollWidth > page.clientWidth"
        )
    )


@pytest.mark.parametrize("kind", sorted(PAGES))
def test_a_report_opens_without_an_error_and_fits_a_narrow_screen(
    kind: str, driver: Any, tmp_path: Path
) -> None:
    page = tmp_path / f"{kind}.html"
    page.write_text(made_page(kind), "utf-8")
    for width in (WIDE, NARROW):
        show(driver, page, width)
        assert not runs_wide(driver)
    assert errors(driver) == []
    broken = "return [...document.images].filter((i) => !i.naturalWidth).length"
    assert driver.execute_script(broken) == 0


def test_tables_sort_by_their_numbers_both_ways(driver: Any, tmp_path: Path) -> None:
    page = tmp_path / "compare.html"
    page.write_text(made_page("compare"), "utf-8")
    show(driver, page)
    column = """
      const table = document.querySelector("table.sortable");
      const heads = [...table.tHead.rows[0].cells];
      const at = heads.findIndex((head) => head.textContent.startsWith("τ"));
      if (arguments[0]) heads[at].querySelector("button").click();
      return [...table.tBodies[0].rows].map((row) => parseFloat(row.cells[at].textContent));
    """
    assert driver.execute_script(column, False) == [18.01, 30.1, 20.0]
    assert driver.execute_script(column, True) == [18.01, 20.0, 30.1]
    assert driver.execute_script(column, True) == [30.1, 20.0, 18.01]
    assert errors(driver) == []


def test_the_live_page_opens_without_an_error(driver: Any, tmp_path: Path) -> None:
    web = resources.files("comparisons.live") / "web"
    for file in web.iterdir():
        if file.is_file():
            (tmp_path / file.name).write_bytes(file.read_bytes())
    page = tmp_path / "page.html"
    # On disk its style and script lie beside it.
    text = page.read_text("utf-8").replace('="/', '="')
    page.write_text(text, "utf-8")
    for width in (WIDE, NARROW):
        show(driver, page, width)
        assert not runs_wide(driver)
    # There is no server behind a file: that alone may be said.
    assert [e for e in errors(driver) if "SyntaxError" in e or "TypeError" in e] == []
