"""Rigs that draw a machine at random and write its raw record and its truth.

A rig is a function of a seed and a folder, which leaves ``raw.csv`` and ``test.toml`` there and the
truth in ``truth/truth.toml``: ``tau_s`` and, where it is known, the curve as ``beta`` (powers of φ)
or as ``quasi_steady`` with ``phi`` and ``psi_p``; ``effects``, a list, names what else the machine
has. Rigs of other packages come by entry points of the group ``sindy_surge.rigs``.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

from surge_core.errors import InputError

ENTRY_POINTS = "sindy_surge.rigs"
_OWN = (
    EntryPoint("lumped", "comparisons.rig.drawn:draw_record", ENTRY_POINTS),
    EntryPoint("distributed", "comparisons.rig_distributed:draw_record", ENTRY_POINTS),
)


def rig_names() -> tuple[str, ...]:
    """Return the names of the rigs that are installed."""
    return tuple(_rigs())


def draw_of(name: str) -> Callable[[int, Path], None]:
    """Return what draws a machine of a rig.

    Parameters
    ----------
    name : str
        Out of :func:`rig_names`.

    Raises
    ------
    InputError
        When there is no such rig.
    """
    if name not in _rigs():
        raise InputError("rig", expected="one of " + ", ".join(_rigs()), found=repr(name))
    draw: Callable[[int, Path], None] = _rigs()[name].load()
    return draw


@cache
def _rigs() -> dict[str, EntryPoint]:
    return {point.name: point for point in (*_OWN, *entry_points(group=ENTRY_POINTS))}
