"""One printable line for a mistake of the user, whatever a file holds."""

from __future__ import annotations

import argparse
import re
from typing import Any, NoReturn

__all__ = ["OneLineParser", "one_line"]

# No sentence of ours is longer: beyond it, something out of a file is in it.
LONGEST = 500


def one_line(text: str) -> str:
    r"""Return a text as one line, its middle left out where it is too long.

    Parameters
    ----------
    text : str
        Any text; what would steer a terminal is written out, a line break as ``\n``.
    """
    line = "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode("ascii")
        for letter in text
    )
    if len(line) <= LONGEST:
        return line
    return f"{line[: LONGEST // 2]}…{line[1 - LONGEST // 2 :]}"


class OneLineParser(argparse.ArgumentParser):
    """A parser that refuses in one line, without the whole usage above it."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        # "-5ms" is a value like "-5": what is wrong with it, its option says.
        self._negative_number_matcher = re.compile(r"-\.?\d.*")

    def error(self, message: str) -> NoReturn:
        """End the program with exit code 2 and the message.

        Parameters
        ----------
        message : str
            What was wrong.
        """
        words = one_line(message.removeprefix("argument "))
        self.exit(2, f"{self.prog}: {words}; what is expected: {self.prog} --help\n")
