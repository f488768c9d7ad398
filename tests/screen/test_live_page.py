"""The page of a running test: its script in a real browser."""

from __future__ import annotations

from importlib import resources
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from conftest import Browser


@pytest.mark.parametrize("span", [1e-300, 1e-150, 1e-3, 7.0, 1e150])
def test_an_axis_has_its_numbers_however_narrow_it_is(browser: Browser, span: float) -> None:
    script = (resources.files("comparisons.live") / "web" / "page.js").read_text("utf-8")
    functions, _, _ = script.partition("function range")
    ticks = browser.run(f"{functions}; return ticks(0, arguments[0], 5);", span)
    assert 3 <= len(ticks) <= 6
    for tick in ticks:
        # More than 100 digits behind the point are not shown.
        assert float(tick["text"]) == pytest.approx(tick["at"], rel=1e-9, abs=1e-100)
