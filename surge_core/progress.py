"""How far a long work is: bars on a terminal, nothing or one line a step where stderr is none."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TypeVar

_T = TypeVar("_T")

REFRESH_S = 0.5


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
    left = "" if isinstance(steps, int) else ", about {remaining} left"
    form = f"{{percentage:3.0f}}%|{{bar:24}}| {{desc}} [{{elapsed}}{left}]"
    number, stop = 0, threading.Event()
    with tqdm(
        total=sum(expected_s), desc="starting", bar_format=form, leave=False, disable=None
    ) as bar:

        def begin(words: str) -> None:
            nonlocal number
            bar.update(sum(expected_s[:number]) - bar.n)
            number = min(number + 1, len(expected_s))
            bar.set_description_str(words)
            if bar.disable and lines:
                sys.stderr.write(f"[{number}/{len(expected_s)}] {words}\n")
                sys.stderr.flush()

        def tick() -> None:
            while not stop.wait(REFRESH_S):
                if left:
                    # A step that lasts longer than expected is shown as nearly done.
                    bar.n = min(bar.n + REFRESH_S, 0.99 * sum(expected_s[:number]))
                bar.refresh()

        ticking = threading.Thread(target=tick, daemon=True)
        if not bar.disable:
            ticking.start()
        try:
            yield begin
        finally:
            stop.set()
            if ticking.is_alive():
                ticking.join()


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
