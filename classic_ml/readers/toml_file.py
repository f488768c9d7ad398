"""The text of a TOML file as tables, and its values in words; every failure is one sentence."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from datetime import date, datetime, time
from pathlib import Path
from typing import Any

from surge_core.errors import InputError

__all__ = ["load_toml", "no_file", "shown"]

# The description of a test with a thousand channels has half a megabyte.
MOST_BYTES = 4_000_000
# Of a value that is longer nobody reads more.
LONGEST = 60


def load_toml(file: Path, what: str) -> dict[str, Any]:
    """Read a TOML file.

    Parameters
    ----------
    file : path
        The file; a byte-order mark, as Windows programs write it, does not count.
    what : str
        What it should be, in words.

    Returns
    -------
    dict
        Its tables.

    Raises
    ------
    InputError
        When there is no such file, or it is no TOML; in one sentence with the line.
    """
    if not file.is_file():
        raise InputError(str(file), expected=what, found=no_file(file))
    size = file.stat().st_size
    if size > MOST_BYTES:
        raise InputError(
            str(file), expected=f"{what}, of a few kB", found=f"a file of {size / 1e6:.0f} MB"
        )
    text = _text(file)
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        found = str(error).strip().splitlines()[0]
        lines = text.count("\n") + 1
        found = found.replace("(at end of document)", f"(at its end, line {lines})")
    except RecursionError:
        found = "values nested too deeply"
    except ValueError:
        # Python refuses to read a whole number of more digits.
        found = "a number of more than 4300 digits"
    raise InputError(str(file), expected="a TOML file", found=found)


def no_file(file: Path) -> str:
    """Return what is found where no plain file is.

    Parameters
    ----------
    file : path
        The place.
    """
    if file.is_dir():
        return "a folder"
    return "a device or pipe" if file.exists() else "no such file"


def _text(file: Path) -> str:
    data = file.read_bytes()
    found = "bytes that are no text in UTF-8"
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        found = "UTF-16 text"
    else:
        try:
            return data.decode("utf-8-sig")
        except UnicodeDecodeError:
            pass
    raise InputError(str(file), expected="a TOML file", found=found, remedy="save it as UTF-8")


def shown(value: object) -> str:
    """Return a value of a TOML file in words, as the file has it and not as Python does.

    Parameters
    ----------
    value : object
        What `tomllib` made of it.
    """
    if isinstance(value, list):
        few = [shown(v) if not isinstance(v, list) else "[…]" for v in value[:4]]
        return f"[{', '.join([*few, *['…'] * (len(value) > 4)])}]"
    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, str):
        return f"'{_shortened(value)}'"
    if isinstance(value, int) and abs(value) >= 10**LONGEST:
        return "a number of more than 60 digits"
    if isinstance(value, datetime | date | time):
        return f"the date {value.isoformat()}"
    return str(value).lower() if isinstance(value, bool) else str(value)


def _shortened(text: str) -> str:
    return text if len(text) <= LONGEST else text[: LONGEST - 1] + "…"
