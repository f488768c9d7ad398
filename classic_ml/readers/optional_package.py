"""Packages that not every user needs."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

from surge_core.errors import InputError

__all__ = ["needed"]


def needed(package: str, extra: str, file: Path) -> None:
    """Refuse a file whose reader is not installed, and name what to install.

    Parameters
    ----------
    package : str
        Name under which it is imported.
    extra : str
        The extra of this project that brings it.
    file : path
        The file that needs it.

    Raises
    ------
    InputError
        When the package is missing.
    """
    if find_spec(package) is None:
        raise InputError(
            str(file),
            expected=f"the package {package}, which reads files ending in {file.suffix}",
            found="it is not installed",
            remedy=f"pip install 'sindy-surge[{extra}]'",
        )
