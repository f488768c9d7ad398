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
    """Refuse, before any work is done, a target that cannot be written or has another suffix."""
    ending, folder = " or ".join(suffixes), path.parent
    for wrong, expected, found in (
        (
            suffixes and path.suffix.lower() not in suffixes,
            f"an output file ending in {ending}",
            f"the suffix '{path.suffix}'",
        ),
        (path.is_dir(), "a file to write to", "a folder"),
        (path.exists() and not path.is_file(), "a plain file to write to", "a device or pipe"),
        (not folder.is_dir(), "an existing folder", f"no folder {folder}"),
        (not os.access(folder, os.W_OK), "a folder that can be written to", "no right"),
    ):
        if wrong:
            raise InputError(str(path), expected=expected, found=found)


def check_apart(inputs: Iterable[Path], outputs: Iterable[Path]) -> None:
    """Refuse an output that would replace an input or another output."""
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
    """Let ``write(temporary)`` fill a neighbour of the target, then put it in its place.

    If that fails, nothing is left behind.
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
    """Write a text file in UTF-8, whole or not at all."""
    replace_whole(path, lambda temporary: temporary.write_text(text, "utf-8"))


def to_strict_json(document: dict[str, Any] | list[Any]) -> str:
    """Return plain types as JSON, in which a number that is not finite is null."""
    return json.dumps(_finite(document), indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
