"""The page of a running test: its numbers, and for whom they are."""

from __future__ import annotations

import http.client
import json
from collections.abc import Iterator

import pytest

from comparisons.live.estimate import Estimate
from comparisons.live.page import Page
from comparisons.live.state import Event, LiveState, Point, page_document, status_line
from surge_core.errors import InputError

NAN = float("nan")
STATE = LiveState(
    test="test <b>7</b>",
    phase="running",
    feed="receiving",
    n_rows=1006,
    n_pieces=2,
    n_refused=3,
    point=Point(1.006, 10.0, 2.1, NAN, 1.5, 0.98),
    machine="surge, in stall",
    n_cycles=4,
    period_s=0.14,
    estimate=Estimate(tau_s=0.0183, tau_stderr_s=0.0012, n_cycles=4, curve=((0.1, 1.5, 0.02),)),
    trail=((1.0, 0.1, 1.5, 11.0, 2.1), (1.005, 0.1, NAN, 11.0, 2.1)),
    events=(Event("12:00:01", "surge", "surge: <script>"),),
)


@pytest.fixture
def page() -> Iterator[Page]:
    made = Page(0)
    made.show(STATE)
    yield made
    made.close()


def asked(page: Page, path: str, host: str = "") -> tuple[int, str, bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=60.0)
    connection.request("GET", path, headers={"Host": host or f"127.0.0.1:{page.port}"})
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer.status, answer.headers.get("Content-Type", ""), content


def test_its_numbers_are_strict_json(page: Page) -> None:
    status, kind, content = asked(page, "/state.json?x=1")
    assert (status, kind) == (200, "application/json")
    assert b"NaN" not in content
    document = json.loads(content)
    assert document == page_document(STATE)
    assert set(document) == {
        *("schema", "test", "phase", "machine", "feed_silent", "fields", "point", "trail"),
        *("tau_ms", "curve", "events"),
    }
    assert document["schema"] == "sindy-surge/live/1"
    assert document["point"] == [None, 1.5]
    assert document["trail"][1] == [1.005, 0.1, None, 11.0, 2.1]
    assert (document["tau_ms"], document["curve"]) == ([18.3, 1.2], [[0.1, 1.5, 0.02]])
    fields = {field["label"]: field["value"] for field in document["fields"]}
    assert fields["time constant τ"] == "18.3 ± 1.2 ms, provisional, 4 cycles"
    assert fields["surge cycles"] == "4, one every 140 ms (7.14 Hz)"
    assert fields["corrected flow"] == "22.0 lbm/s (10.00 kg/s)"
    assert fields["record"] == "1006 rows, in 2 pieces, 3 lines left out"
    assert fields["φ"] == "–"


def test_the_page_and_its_files_are_there_and_nothing_else(page: Page) -> None:
    for path, kind in (("/", "text/html"), ("/page.js", "text/javascript"), ("/page.css", "text/")):
        status, found, content = asked(page, path)
        assert status == 200
        assert found.startswith(kind)
        assert content
    for path in ("/../page.py", "/web/page.html", "/page.html"):
        assert asked(page, path)[0] == 404


def test_a_request_for_another_host_is_refused(page: Page) -> None:
    for host in ("example.org", f"example.org:{page.port}"):
        status, _, content = asked(page, "/state.json", host)
        assert status == 421
        assert b"surge," not in content
    assert asked(page, "/", f"localhost:{page.port}")[0] == 200


def test_a_port_that_is_taken_is_refused(page: Page) -> None:
    with pytest.raises(InputError, match="--page"):
        Page(page.port)


def test_the_line_of_a_terminal_says_the_same() -> None:
    line = status_line(STATE)
    for words in ("surge, in stall", "22.0 lbm/s", "18.3 ± 1.2 ms, provisional", "receiving"):
        assert words in line
