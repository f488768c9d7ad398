"""How far a long work is: bars on a terminal, nothing where stderr is none."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from threading import Event, Thread
from typing import Any, TypeVar

__all__ = ["shown_count", "shown_over", "shown_steps"]

_T = TypeVar("_T")
# As large as a terminal is that says nothing of its size.
_COLUMNS, _LINES = 80, 24
# So often a bar is drawn anew while a step lasts, in seconds: a clock that stands looks like death.
_TICK_S = 0.5
# What is counted comes in bunches: the time left follows the mean rate more than the last one.
_SMOOTHING = 0.05


def shown_over(
    items: Iterable[_T], *, unit: str = "step", words: str = "", total: int | None = None
) -> Iterable[_T]:
    """Show how far an iteration is.

    Parameters
    ----------
    items : iterable
        What is worked through.
    unit : str
        What one of them is.
    words : str
        What is done.
    total : int, optional
        How many there are, where they come one by one; without it they are counted first.
    """
    if total is None:
        items = list(items)
        total = len(items)
    with _bar(total=total, unit=unit) as bar:
        bar.set_description_str(words)
        for item in items:
            yield item
            bar.update()


@contextmanager
def shown_steps(steps: int) -> Iterator[Callable[[str], None]]:
    """Give a function that says which step begins.

    Parameters
    ----------
    steps : int
        How many there are at most.
    """
    with _bar(total=steps, unit="step") as bar:
        begun = False

        def told(words: str) -> None:
            nonlocal begun
            if begun:
                bar.update()
            begun = True
            bar.set_description_str(words)

        yield told


@contextmanager
def shown_count(
    words: str = "", *, unit: str, total: int | None = None, resumed: bool = False
) -> Iterator[Callable[..., None]]:
    """Give a function that is told how many more are done; one more, where it is told nothing.

    Parameters
    ----------
    words : str
        What is done.
    unit : str
        What is counted; rows, of which there are many, are shown in thousands and millions.
    total : int, optional
        How many there are, where that is known.
    resumed : bool
        Whether the first number it is told was done before, and says nothing of the time left.
    """
    with _bar(total, unit, unit_scale=unit == "row", smoothing=_SMOOTHING) as bar:
        bar.set_description_str(words)
        before = resumed

        def counted(count: int = 1) -> None:
            nonlocal before
            if before:
                bar.initial = bar.n = bar.last_print_n = count
                bar.refresh()
                before = False
            else:
                bar.update(count)

        yield counted


def _bar_size() -> dict[str, Any]:
    """Return how large tqdm is to take the terminal for; nothing where it says so itself.

    A pseudo-terminal that nobody gave a size has no columns and no lines, and a bar that fits it
    has no letter.
    """
    try:
        known = min(os.get_terminal_size(sys.stderr.fileno())) > 0
    except (OSError, ValueError):
        return {}
    return {} if known else {"ncols": _COLUMNS, "nrows": _LINES}


class _NoBar:
    """What is told to a bar where there is none to be seen."""

    def set_description_str(self, words: str) -> None:
        """Say nothing."""

    def update(self, count: int = 1) -> None:
        """Count nothing."""

    def refresh(self) -> None:
        """Draw nothing."""


@contextmanager
def _bar(total: int | None, unit: str, **shape: Any) -> Iterator[Any]:
    """Draw a bar whose clock goes on while a step lasts, and take it away at the end."""
    if not sys.stderr.isatty():
        yield _NoBar()
        return
    from tqdm import tqdm

    shape.update(_bar_size())
    with tqdm(total=total, unit=unit, leave=False, **shape) as bar:
        ended = Event()

        def tick() -> None:
            while not ended.wait(_TICK_S):
                bar.refresh()

        ticking = Thread(target=tick, daemon=True)
        ticking.start()
        try:
            yield bar
        finally:
            ended.set()
            ticking.join()
