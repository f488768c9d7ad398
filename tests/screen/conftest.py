"""A real browser without a window, and reports of every kind as files on disk."""

from __future__ import annotations

import base64
import json
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from made_pages import PAGES, made_page

OPTIONS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    # Shared memory of a container is small.
    "--disable-dev-shm-usage",
    "--force-device-scale-factor=1",
)
WIDE = (1280, 900)
PLAIN = "record.csv"
DOT = (
    "data:image/png;base64,iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAAAAAA6fptVAAAACklEQVR42mP8/x8AAwMCAO"
    "+ip1sAAAAASUVORK5CYII="
)
# Schemes of what a page on disk may ask for.
OWN = ("file:", "data:", "about:")


@dataclass
class Browser:
    """A browser that is told what to do, and what it logged.

    Parameters
    ----------
    driver : WebDriver
        Of selenium.
    """

    driver: Any
    seen: list[str] = field(default_factory=list)

    def open(self, page: Path, width: int = WIDE[0], height: int = WIDE[1]) -> Browser:
        """Show a page at a width, in CSS pixels."""
        self.resize(width, height)
        self.driver.get(page.as_uri())
        return self

    def resize(self, width: int, height: int = WIDE[1]) -> None:
        """Change the width of the page."""
        self.command(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )

    def command(self, name: str, **arguments: Any) -> Any:
        """Send a command of the browser's own protocol."""
        return self.driver.execute_cdp_cmd(name, arguments)

    def run(self, script: str, *arguments: Any) -> Any:
        """Return what a script that a test brings gives; the page's policy does not bind it."""
        return self.driver.execute_script(script, *arguments)

    def all(self, selector: str) -> list[Any]:
        """Return the elements of a selector."""
        found: list[Any] = self.driver.find_elements("css selector", selector)
        return found

    def messages(self) -> list[str]:
        """Return what the console said since it was last asked: errors, broken policies."""
        return [entry["message"] for entry in self.driver.get_log("browser")]

    def requests(self) -> list[str]:
        """Return what was asked for since it was last asked, but for the page and its images."""
        entries = [json.loads(e["message"])["message"] for e in self.driver.get_log("performance")]
        asked = [
            entry["params"]["request"]["url"]
            for entry in entries
            if entry["method"] == "Network.requestWillBeSent"
        ]
        return [url for url in asked if not url.startswith(OWN)]

    def pdf(self) -> bytes:
        """Return the page as it is printed."""
        printed = self.command("Page.printToPDF", printBackground=True, preferCSSPageSize=True)
        return base64.b64decode(printed["data"])


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """A headless Chromium with an empty profile and no network."""
    webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed")
    paths = [shutil.which(name) for name in ("chromium", "chromedriver")]
    if not all(paths):
        pytest.skip("no chromium: tests/screen/run installs Debian's")
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = paths[0]
    for option in (*OPTIONS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(option)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    service = Service(paths[1])
    driver = webdriver.Chrome(options=options, service=service)
    try:
        own = Browser(driver)
        own.command("Network.enable")
        own.command(
            "Network.emulateNetworkConditions",
            offline=True,
            latency=0,
            downloadThroughput=0,
            uploadThroughput=0,
        )
        yield own
    finally:
        driver.quit()
        _closed(driver, service)


def _closed(driver: Any, service: Any) -> None:
    """Close what selenium leaves to the garbage collector, which pytest takes for an error."""
    executor = driver.command_executor
    executor.close()
    if service.process is not None:
        for stream in (service.process.stdin, service.process.stdout, service.process.stderr):
            if stream is not None:
                stream.close()


@pytest.fixture(scope="session")
def page_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Return a function that writes a report once: of a kind, with a name for all that has one."""
    folder = tmp_path_factory.mktemp("pages")

    @cache
    def write(kind: str, name: str = PLAIN) -> Path:
        path = folder / f"{kind}-{'plain' if name == PLAIN else 'hostile'}.html"
        with pytest.MonkeyPatch.context() as patch:
            if name != PLAIN:
                # Names are looked at in the page; drawing them takes the longest.
                patch.setattr("comparisons.page.style.figure_to_data_uri", lambda _: DOT)
            path.write_text(made_page(kind, name), "utf-8")
        return path

    return write


@pytest.fixture(params=sorted(PAGES))
def page(request: pytest.FixtureRequest, page_of: Callable[..., Path]) -> Path:
    """A report of every kind, one after the other."""
    return page_of(request.param)
