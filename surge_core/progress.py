"""How far a long work is: bars on a terminal, nothing or one line a step where stderr is none."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TypeVar

__all__ = ["shown_count", "shown_over", "shown_steps"]

_T = TypeVar("_T")


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
    from tqdm import tqdm

    if total is None:
        items = list(items)
    # `disable=None` is quiet where stderr is no terminal.
    return tqdm(items, words or None, total, unit=unit, leave=False, disable=None)


@contextmanager
def shown_steps(steps: int, *, lines: bool = False) -> Iterator[Callable[[str], None]]:
    """Give a function that says which step begins.

    Parameters
    ----------
    steps : int
        How many there are at most.
    lines : bool
        Where stderr is no terminal, write a line a step instead of nothing.
    """
    from tqdm import tqdm

    with tqdm(total=steps, unit="step", leave=False, disable=None) as bar:
        begun = 0

        def begin(words: str) -> None:
            nonlocal begun
            bar.update(min(begun, 1))
            bar.set_description_str(words)
            begun += 1
            if bar.disable and lines:
                sys.stderr.write(f"[{begun}/{steps}] {words}\n")
                sys.stderr.flush()

        yield begin


@contextmanager
def shown_count(
    words: str = "", *, unit: str, total: int | None = None
) -> Iterator[Callable[..., object]]:
    """Give a function to be called with how many more are done; one more without a number.

    Parameters
    ----------
    words : str
        What is done.
    unit : str
        What is counted; rows, of which there are many, are shown in thousands and millions.
    total : int, optional
        How many there are, where that is known.
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
