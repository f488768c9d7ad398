"""One printable line for a mistake of the user, whatever a file holds."""

from __future__ import annotations

import argparse
from typing import NoReturn

from surge_core.errors import InputError

__all__ = ["OneLineParser", "printable", "sentence"]

# No sentence of ours is longer: beyond it, something out of a file is in it.
LONGEST = 500


def printable(text: str) -> str:
    r"""Return a text with what would steer a terminal written out, a line break as ``\n``.

    Parameters
    ----------
    text : str
        Any text.
    """
    if text.isprintable():
        return text
    return "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode("ascii")
        for letter in text
    )


def sentence(error: InputError) -> str:
    """Return what an input was refused with, as one line of printable text.

    Parameters
    ----------
    error : InputError
        What was expected and what was found.
    """
    return shortened(str(error))


def shortened(text: str) -> str:
    """Return a text as one printable line with its middle left out where it is too long.

    Parameters
    ----------
    text : str
        Any text.
    """
    line = printable(text)
    if len(line) <= LONGEST:
        return line
    return f"{line[: LONGEST // 2]}…{line[1 - LONGEST // 2 :]}"


class OneLineParser(argparse.ArgumentParser):
    """A parser that refuses in one line, without the whole usage above it."""

    def error(self, message: str) -> NoReturn:
        """End the program with exit code 2 and the message.

        Parameters
        ----------
        message : str
            What was wrong.
        """
        words = shortened(message.removeprefix("argument "))
        self.exit(2, f"{self.prog}: {words}; what is expected: {self.prog} --help\n")
