"""How far a long work is: bars on a terminal, nothing or one line a step where stderr is none."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

_T = TypeVar("_T")

REFRESH_S = 0.5
# A step that lasts longer than expected is shown as nearly done.
LARGEST_SHARE = 0.95


def shown_over(
    items: Iterable[_T], *, unit: str = "step", words: str = "", total: int | None = None
) -> Iterable[_T]:
    """Show how far an iteration is; without a total, the items are counted first."""
    from tqdm import tqdm

    if total is None:
        items = list(items)
    # `disable=None` is quiet where stderr is no terminal.
    return tqdm(items, words or None, total, unit=unit, leave=False, disable=None)


@contextmanager
def shown_steps(
    steps: int | Sequence[float], *, lines: bool = False
) -> Iterator[Callable[[str], None]]:
    """Give a function that says which step begins.

    ``steps`` is how many there are at most, or how long each lasts as a rule, in seconds: then the
    time left is shown too, scaled by how long those that are done have taken. With ``lines``, a
    line a step is written where stderr is no terminal, instead of nothing.
    """
    from tqdm import tqdm

    expected_s = [1.0] * steps if isinstance(steps, int) else list(steps)
    form = "{percentage:3.0f}%|{bar:24}| {desc} [{elapsed}]"
    with tqdm(total=sum(expected_s), bar_format=form, leave=False, disable=None) as bar:
        shown = _Steps(bar, expected_s, timed=not isinstance(steps, int), lines=lines)
        stop = threading.Event()
        ticking = threading.Thread(target=shown.tick, args=(stop,), daemon=True)
        if not bar.disable:
            ticking.start()
        try:
            yield shown.begin
        finally:
            stop.set()
            if ticking.is_alive():
                ticking.join()


class _Steps:
    """Which step of several is under way, and for how long still."""

    def __init__(self, bar: Any, expected_s: list[float], *, timed: bool, lines: bool) -> None:
        self._bar, self._expected_s = bar, expected_s
        self._timed, self._lines = timed, lines
        self._words, self._number = "starting", 0
        self._start_s = self._step_s = time.monotonic()

    def begin(self, words: str) -> None:
        """Say that the next step begins."""
        n = len(self._expected_s)
        self._number, self._words = min(self._number + 1, n), words
        self._step_s = time.monotonic()
        self.show()
        if self._bar.disable and self._lines:
            sys.stderr.write(f"[{self._number}/{n}] {words}\n")
            sys.stderr.flush()

    def tick(self, stop: threading.Event) -> None:
        """Show how far the steps are every half second, until stopped."""
        while not stop.wait(REFRESH_S):
            self.show()

    def show(self) -> None:
        """Show how far the steps are now."""
        last = max(self._number - 1, 0)
        done = sum(self._expected_s[:last])
        # So many seconds are needed for one that was expected.
        pace = (self._step_s - self._start_s) / done if self._timed and done else 1.0
        within = (time.monotonic() - self._step_s) / max(pace, 0.1) if self._timed else 0.0
        self._bar.n = done + min(within, LARGEST_SHARE * self._expected_s[last])
        left_s = pace * (sum(self._expected_s) - self._bar.n)
        left = f", about {left_s:.0f} s left" if self._timed else ""
        self._bar.set_description_str(f"{self._words}{left}")


@contextmanager
def shown_count(
    words: str = "", *, unit: str, total: int | None = None
) -> Iterator[Callable[..., object]]:
    """Give a function to be called with how many more are done; one more without a number.

    Rows, of which there are many, are shown in thousands and millions.
    """
    from tqdm import tqdm

    with tqdm(
        total=total,
        desc=words or None,
        unit=unit,
        unit_scale=unit == "row",
        leave=False,
        disable=None,
    ) as bar:
        yield bar.update
