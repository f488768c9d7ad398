"""The page of a running test: its numbers, and for whom they are."""

from __future__ import annotations

import http.client
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from comparisons.live.estimate import Estimate
from comparisons.live.screens import Page, live_document
from surge_core.errors import InputError

NAN = float("nan")
MONITOR: Any = SimpleNamespace(
    point={"time_s": 1.006, "Wc25_kg_s": 10.0, "pressure_ratio": 2.1, "phi": NAN},
    machine="surge",
    detector=SimpleNamespace(n_cycles=4, period_s=0.14),
    estimate=Estimate(tau_s=0.0183, tau_stderr_s=0.0012, curve=((0.1, 1.5, 0.02),)),
    trail=((1.0, 0.1, 1.5), (1.005, 0.1, NAN)),
)
STATE = live_document(
    MONITOR,
    test="test <b>7</b>",
    phase="running",
    feed="receiving",
    record="7 rows",
    events=("12:00:01 surge: <script>",),
)


@pytest.fixture
def page() -> Iterator[Page]:
    made = Page(0)
    made.show(STATE)
    yield made
    made.close()


def asked(page: Page, path: str, host: str = "") -> tuple[int, bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=60.0)
    connection.request("GET", path, headers={"Host": host or f"127.0.0.1:{page.port}"})
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer.status, content


def test_the_page_is_there_for_this_machine_and_nothing_else(page: Page) -> None:
    status, content = asked(page, "/", f"localhost:{page.port}")
    assert status == 200
    assert b"<html" in content
    assert asked(page, "/../page.py")[0] == 404
    status, content = asked(page, "/state.json", f"example.org:{page.port}")
    assert status == 421
    assert b"surge," not in content
    with pytest.raises(InputError, match="--page"):
        Page(page.port)
