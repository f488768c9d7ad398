"""The page: this machine only, nothing from elsewhere, and text that stays text."""

from __future__ import annotations

import http.client
import json
import math
import re
import socket
from collections.abc import Iterator
from importlib import resources
from pathlib import Path

import pytest
from live_records import LiveRecord, play

from comparisons.live.estimate import Estimate
from comparisons.live.latency import Latency
from comparisons.live.page import Page
from comparisons.live.state import Event, LiveState, Point, page_document
from surge_core.errors import InputError

STATE = LiveState(
    test='<script>alert("1")</script> & co',
    phase="running",
    feed="receiving",
    latency=Latency(0.2),
    n_rows=3,
    point=Point(1.0, 10.0, 2.0, math.nan, 1.5, 0.8),
    machine="surge, in stall",
    n_cycles=4,
    period_s=0.14,
    estimate=Estimate(
        tau_s=0.0183, tau_stderr_s=0.0012, n_cycles=4, phi=(0.1,), psi_p=(1.2,), psi_p_stderr=(0.1,)
    ),
    trail=((1.0, math.nan, 1.5, 10.0, 2.0), (1.005, 0.1, math.inf, 11.0, 2.1)),
    events=(Event("12:00:00", "surge", "surge: <b>now</b>"),),
)


@pytest.fixture
def page() -> Iterator[Page]:
    page = Page(0)
    page.show(STATE)
    yield page
    page._asked.clear()
    page.close()


def asked(
    page: Page, path: str, method: str = "GET", **headers: str
) -> tuple[int, dict[str, str], bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=10)
    connection.request(method, path, headers=headers)
    answer = connection.getresponse()
    found = answer.status, dict(answer.getheaders()), answer.read()
    connection.close()
    return found


def test_its_numbers_are_strict_json(page: Page) -> None:
    status, headers, content = asked(page, "/state.json?x=1")
    assert status == 200
    assert headers["Content-Type"] == "application/json"

    def refused(name: str) -> None:
        raise AssertionError(name)

    document = json.loads(content, parse_constant=refused)
    assert document == page_document(STATE)
    assert document["schema"] == "sindy-surge/live/1"
    assert document["point"] == [None, 1.5]
    assert document["trail"][1] == [1.005, 0.1, None, 11.0, 2.1]
    assert document["tau_ms"] == [18.3, 1.2]
    fields = {field["label"]: field["value"] for field in document["fields"]}
    assert fields["time constant τ"] == "18.3 ± 1.2 ms, provisional, 4 cycles"
    assert fields["surge cycles"] == "4, one every 140 ms (7.14 Hz)"
    assert fields["corrected flow"] == "22.0 lbm/s (10.00 kg/s)"
    assert fields["φ"] == "–"


def test_nothing_of_it_comes_from_elsewhere_and_no_page_may_frame_it(page: Page) -> None:
    for path in ("/", "/page.js", "/page.css", "/state.json"):
        status, headers, content = asked(page, path)
        assert status == 200
        policy = headers["Content-Security-Policy"]
        assert "default-src 'none'" in policy
        assert "frame-ancestors 'none'" in policy
        assert "unsafe" not in policy
        assert "Access-Control-Allow-Origin" not in headers
        assert headers["X-Content-Type-Options"] == "nosniff"
        text = content.decode("utf-8").replace("http://www.w3.org/2000/svg", "")
        assert "//" not in re.sub(r"^\s*//.*$", "", text, flags=re.MULTILINE).replace("https:", "")


def test_text_goes_in_as_text() -> None:
    script = (resources.files("comparisons.live") / "web" / "page.js").read_text("utf-8")
    for way in ("innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "eval("):
        assert way not in script
    html = (resources.files("comparisons.live") / "web" / "page.html").read_text("utf-8")
    assert not re.search(r"<script(?![^>]*src=)|\son\w+=|\sstyle=", html)


@pytest.mark.parametrize("host", ["example.org", "127.0.0.1", "localhost:1", "", "127.0.0.1:80"])
def test_a_request_for_another_host_is_refused(page: Page, host: str) -> None:
    status, _, content = asked(page, "/state.json", Host=host)
    assert status == 421
    assert b"surge" not in content


def test_localhost_is_this_machine(page: Page) -> None:
    assert asked(page, "/", Host=f"localhost:{page.port}")[0] == 200


@pytest.mark.parametrize("path", ["/../page.py", "/web/page.html", "/page.html", "/%2e%2e/"])
def test_there_are_no_other_files(page: Page, path: str) -> None:
    assert asked(page, path)[0] == 404


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS"])
def test_it_takes_nothing(page: Page, method: str) -> None:
    assert asked(page, "/state.json", method)[0] == 501


def test_it_listens_on_this_machine_only(page: Page) -> None:
    assert page._server.server_address[0] == "127.0.0.1"


def test_a_port_that_is_taken_is_refused() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(InputError, match=f"--page: .*{port}"):
            Page(port)


def test_before_the_first_rows_there_is_no_state_and_that_is_valid_too() -> None:
    page = Page(0)
    assert json.loads(asked(page, "/state.json")[2]) == {}
    page._asked.clear()
    page.close()


def test_its_size_is_bounded_however_long_the_run(record: LiveRecord, tmp_path: Path) -> None:
    states: list[LiveState] = []

    class Keeping:
        def show(self, state: LiveState) -> None:
            states.append(state)

        def close(self) -> None:
            return

    play(record, tmp_path, [record.content, 0.2], screens=[Keeping()])
    document = page_document(states[-1])
    # 3 s of the record at 200 points a second; the trail holds six seconds at most.
    assert len(document["trail"]) == 600
    assert len(json.dumps(document)) < 60_000
    assert document["machine"].startswith("surge")
