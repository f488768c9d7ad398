"""What a user is told of a mistake: one line of printable text, however hostile the file."""

from __future__ import annotations

import argparse
import re
import unicodedata
from collections.abc import Iterator
from pathlib import Path
from typing import NoReturn, Protocol, TextIO

__all__ = [
    "OneLineParser",
    "PrintableStream",
    "beyond_memory",
    "printable",
    "sentence",
    "too_deep",
    "too_many_digits",
]

# More letters than this of a name or a value out of a file tell nobody anything.
LONGEST = {"where": 160, "expected": 200, "found": 180, "remedy": 160}
LONGEST_LINE = 300
# No sentence of ours is longer: beyond it, something out of a file is in it.
LONGEST_PLAIN = 500
# Control characters, those that turn the direction of writing, halves of characters, and ends of
# lines and paragraphs.
STEERING = ("Cc", "Cf", "Cs", "Zl", "Zp")


# The words of argparse, and ours for them.
ARGPARSE_SAYS = (
    (r"^argument ", ""),
    (r": invalid float value: (.*)", r": expected a number, found \1"),
    (r": invalid int value: (.*)", r": expected a whole number, found \1"),
    (r": invalid choice: (.*?) \(choose from (.*)\)", r": expected one of \2, found \1"),
    (r": expected (one|\d+) arguments?$", r": expected \1 value(s) behind it, found others"),
    (r": expected at least one argument$", ": expected one value and more behind it, found none"),
    (r"^the following arguments are required: (.*)", r"expected \1, found none"),
    (r"^unrecognized arguments: (.*)", r"expected known options and files, found \1"),
)


# The words of Python, and ours for them.
PYTHON_SAYS = {"True": "true", "False": "false", "None": "nothing"}
UNDECODED = r"'utf-8' codec can't decode bytes? [\w ]*in position ([\d-]+): [a-z ]+"


class _Refusal(Protocol):
    where: str
    expected: str
    found: str
    remedy: str


def printable(text: str) -> str:
    r"""Return a text with what would steer a terminal written out, a line break as ``\n``.

    Parameters
    ----------
    text : str
        Any text.
    """
    if text.isprintable():
        return text
    return "".join(_written_out(letter) for letter in text)


def _written_out(letter: str) -> str:
    if unicodedata.category(letter) not in STEERING:
        return letter
    return letter.encode("unicode_escape").decode("ascii")


class PrintableStream:
    """A stream of text that passes lines and tabulators on and writes out what else would steer.

    Parameters
    ----------
    stream : text stream
        Where the text goes.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write a text, and return how much was taken of it: all.

        Parameters
        ----------
        text : str
            Any text.
        """
        lines = ("\t".join(map(printable, line.split("\t"))) for line in text.split("\n"))
        self._stream.write("\n".join(lines))
        return len(text)

    def __getattr__(self, name: str) -> object:
        """Be in all else what the stream is."""
        return getattr(self._stream, name)


def _shortened(text: str, most: int) -> str:
    """Return a text with its middle left out where it is too long: names end with what matters."""
    # Escapes make a text longer, never by more than ten times.
    shown = printable(text if len(text) <= 4 * most else text[: 2 * most] + text[-2 * most :])
    if len(shown) <= most:
        return shown
    return f"{shown[: most * 2 // 3]}…{shown[len(shown) - most // 3 + 1 :]}"


def _in_words(text: str) -> str:
    """Return what Python calls a value or a failure as a user calls it."""
    if text in PYTHON_SAYS:
        return PYTHON_SAYS[text]
    text = re.sub(UNDECODED, r"no text in UTF-8 from byte \1 on", text)
    return re.sub(r"<class '([\w.]+)'>", r"\1", text)


def sentence(error: _Refusal) -> str:
    """Return what an input was refused with, as one line of printable text.

    Parameters
    ----------
    error : InputError
        Of either package.
    """
    words = {name: _in_words(getattr(error, name)) for name in LONGEST}
    whole = sum(map(len, words.values()))
    return _put_together(
        {
            name: printable(text) if whole <= LONGEST_PLAIN else _shortened(text, LONGEST[name])
            for name, text in words.items()
        }
    )


def _put_together(parts: dict[str, str]) -> str:
    text = "{where}: expected {expected}, found {found}".format(**parts)
    return f"{text}; {parts['remedy']}" if parts["remedy"] else text


def beyond_memory(arguments: argparse.Namespace) -> str:
    """Return the sentence for data that do not fit into memory.

    Parameters
    ----------
    arguments : argparse.Namespace
        Of the command, which name its files.
    """
    return f"{_files(arguments)}: expected data that fit into memory, found more"


def too_deep(arguments: argparse.Namespace) -> str:
    """Return the sentence for a file whose values lie in one another beyond all measure.

    Parameters
    ----------
    arguments : argparse.Namespace
        Of the command, which name its files.
    """
    return f"{_files(arguments)}: expected values nested a few deep, found them nested without end"


def too_many_digits(arguments: argparse.Namespace) -> str:
    """Return the sentence for a file with a number that nobody can mean.

    Parameters
    ----------
    arguments : argparse.Namespace
        Of the command, which name its files.
    """
    return f"{_files(arguments)}: expected numbers of a few digits, found one of more than 4300"


def _files(arguments: argparse.Namespace) -> str:
    """Return the input files that a command line names."""
    names = [str(path) for path in _paths(arguments) if path.is_file()]
    return _shortened(", ".join(dict.fromkeys(names)) or "input", LONGEST["where"])


def _paths(arguments: argparse.Namespace) -> Iterator[Path]:
    for value in vars(arguments).values():
        for item in value if isinstance(value, list) else [value]:
            if isinstance(item, Path):
                yield item


class OneLineParser(argparse.ArgumentParser):
    """A parser that refuses in one line, without the whole usage above it."""

    def error(self, message: str) -> NoReturn:
        """End the program with exit code 2 and the message.

        Parameters
        ----------
        message : str
            What was wrong.
        """
        for pattern, told in ARGPARSE_SAYS:
            message = re.sub(pattern, told, message, flags=re.DOTALL)
        words = _shortened(message, LONGEST_LINE - 2 * len(self.prog))
        self.exit(2, f"{self.prog}: {words}; see {self.prog} --help\n")
