"""Writing results whole or not at all."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from surge_core.errors import InputError


def check_target(path: Path, suffixes: tuple[str, ...] = ()) -> None:
    """Refuse, before any work is done, a target that cannot be written.

    Parameters
    ----------
    path : path
        Where a result is to go.
    suffixes : tuple of str
        Suffixes that are allowed; empty for any.

    Raises
    ------
    InputError
        When the folder does not exist, the target is a folder, or the suffix is another.
    """
    if suffixes and path.suffix.lower() not in suffixes:
        raise InputError(
            str(path),
            expected="an output file ending in " + " or ".join(suffixes),
            found=f"the suffix '{path.suffix}'",
        )
    if path.is_dir():
        raise InputError(str(path), expected="a file to write to", found="a folder")
    if path.exists() and not path.is_file():
        raise InputError(str(path), expected="a plain file to write to", found="a device or pipe")
    if not path.parent.is_dir():
        raise InputError(str(path), expected="an existing folder", found=f"no folder {path.parent}")
    if not os.access(path.parent, os.W_OK):
        raise InputError(str(path), expected="a folder that can be written to", found="no right")


def check_apart(inputs: Iterable[Path], outputs: Iterable[Path]) -> None:
    """Refuse an output that would replace an input or another output.

    Parameters
    ----------
    inputs : iterable of path
        Files that are read.
    outputs : iterable of path
        Files that are to be written.

    Raises
    ------
    InputError
        Naming the file.
    """
    taken = {path.resolve(): "an input of this command" for path in inputs}
    for path in outputs:
        if path.resolve() in taken:
            raise InputError(
                str(path),
                expected="a file of its own for each output",
                found=taken[path.resolve()],
                remedy="nothing was written; choose another name",
            )
        taken[path.resolve()] = "another output of this command"


def replace_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Let ``write`` fill a temporary neighbour, then put it in place of the target.

    Parameters
    ----------
    path : path
        Target.
    write : callable
        ``write(temporary)`` fills the file; if it fails, nothing is left behind.
    """
    check_target(path)
    temporary = path.with_name(f".{path.stem}-{os.urandom(4).hex()}{path.suffix}")
    try:
        write(temporary)
        temporary.replace(path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        if error.filename not in (None, str(temporary)):
            raise
        # The name of the neighbour says nothing to a user, and some libraries name no file at all.
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def write_whole(path: Path, text: str) -> None:
    """Write a text file, whole or not at all.

    Parameters
    ----------
    path : path
        Target.
    text : str
        Its content, written as UTF-8.
    """
    replace_whole(path, lambda temporary: temporary.write_text(text, "utf-8"))


def to_strict_json(document: dict[str, Any] | list[Any]) -> str:
    """Return JSON in which a number that is not finite is null: JSON has no NaN.

    Parameters
    ----------
    document : dict or list
        Of plain types.
    """
    return json.dumps(_finite(document), indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
