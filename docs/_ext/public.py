"""Which names the API reference documents: those that its pages list."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

API = Path(__file__).parents[1] / "api"
_MODULE = re.compile(r"^\.\. (?:py:)?currentmodule:: (\S+)$")
_DATA = re.compile(r"^\.\. py:data:: (\w+)$")
_ENTRY = re.compile(r"^   (\w+)$")


@cache
def documented() -> tuple[str, ...]:
    """Return the full name of each object of the reference, in its order, doubles included."""
    out = []
    for page in sorted(API.glob("*.rst")):
        module, listing = "", False
        for line in page.read_text("utf-8").splitlines():
            if found := _MODULE.match(line):
                module = found[1]
            elif found := _DATA.match(line):
                out.append(f"{module}.{found[1]}")
            elif line.startswith(".. autosummary::"):
                listing = True
            elif line and not line.startswith(" "):
                listing = False
            elif listing and (found := _ENTRY.match(line)):
                out.append(f"{module}.{found[1]}")
    return tuple(out)
