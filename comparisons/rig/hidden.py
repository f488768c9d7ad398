"""Effects that the rig can hide in a record: each where it happens, none named in what is written.

An effect has one size. It alters the plant, a sensor, or what ``test.toml`` states, and a reduction
that trusts ``test.toml`` leaves it in ψ' or φ. `HIDEABLE` lists them under the names of the effects
that a lag model may lack. A sensor's effect changes no row of the plant; one in the plant changes
how it surges, and too much of it lets a case recover or come to rest in stall.

Of the names `amplitude_dependent_lag` is not here: the surge of the rig is a limit cycle whose
amplitude stays within a few percent, so that such a lag is one of another length and no more.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import Any, TypeAlias

from surge_core.errors import InputError

# Thin casings and blade tips take up the heat of the gas within a few seconds. With 2 s a share of
# 0.18 takes the deep reversals off the 90 % case, with 3 s it does not.
HEAT_SOAK_S = 3.0
# Surge heats the inlet until N_c has fallen from 98.5 to 73 to 76 % (claim 25).
SETTLED_SPEED_FRAC = 0.75
# In the lower half of the in-stall range (-0.02 to 0.19), and narrower than a parabola can bend.
BUMP_PHI = 0.03
BUMP_WIDTH_PHI = 0.025
# Deep stall once the flow has all but stopped, until the blading has cleared again; both lie inside
# every cycle of the cases.
BRANCH_PHIS = (0.02, 0.10)
# Below it the cells fill most of the annulus.
LOW_FLOW_PHI = 0.05
# The cells of the cases turn at 0.43 of the rotor's speed; cells have been seen from 0.2 to 0.7 of
# it. A choice: 0.28 is 53 Hz at 98.5 %, above surge, and no average over a period of the first
# pattern takes it out.
SECOND_CELL_ROTOR_FRAC = 0.28
# Eddies of the size of a probe's support, 0.05 m, that pass at 50 m/s.
WAKE_TIME_S = 0.001


@dataclass(frozen=True)
class Hideable:
    """One effect that can be hidden, and the sizes that it can have.

    Parameters
    ----------
    what : str
        What the size is, with its unit.
    bounds : tuple of float
        Least and largest size.
    default : float
        Size without one given.
    unit : str
        Unit of the size.
    neutral : float
        Size at which the rig is as it is described.
    """

    what: str
    bounds: tuple[float, float]
    default: float
    unit: str = "1"
    neutral: float = 0.0


def _hideable() -> dict[str, Hideable]:
    text = files("comparisons.rig").joinpath("hidden.toml").read_text("utf-8")
    numbers = {
        "soak_s": HEAT_SOAK_S, "settled": SETTLED_SPEED_FRAC, "branch": BRANCH_PHIS,
        "bump": BUMP_PHI, "width": BUMP_WIDTH_PHI, "low_flow": LOW_FLOW_PHI,
    }  # fmt: skip
    found = {}
    for name, table in tomllib.loads(text).items():
        low, high = table.pop("bounds")
        found[name] = Hideable(table.pop("what").format(**numbers), (low, high), **table)
    return found


HIDEABLE: Mapping[str, Hideable] = _hideable()
# What differs from the rig as it is described: the size of each effect of `HIDEABLE`.
Alteration: TypeAlias = Mapping[str, float]
UNTOUCHED: Alteration = {name: kind.neutral for name, kind in HIDEABLE.items()}


def hide_effect(name: str | None, size: float | None) -> tuple[Alteration, dict[str, Any]]:
    """Return what an effect alters in a record, and its entry in the truth.

    The first has the size of every effect, the neutral one of those that are not hidden; the second
    name, size, unit and what the size is, and is empty where nothing is hidden.
    """
    if name is None:
        if size is not None:
            expected = "a size only with the name of the effect that it belongs to"
            found = f"{size!r} with no effect"
            remedy = "name the effect with hide"
            raise InputError("hide_size", expected=expected, found=found, remedy=remedy)
        return UNTOUCHED, {}
    if name not in HIDEABLE:
        known = "one of " + ", ".join(HIDEABLE)
        raise InputError("hide", expected=known, found=f"{name!r}", remedy="name one")
    kind = HIDEABLE[name]
    value = kind.default if size is None else float(size)
    least, most = kind.bounds
    if not least <= value <= most:
        expected = f"{least:g} to {most:g} ({kind.what})"
        raise InputError(f"hide_size of {name}", expected=expected, found=f"{value:g}")
    truth = {"effect": name, "size": value, "unit": kind.unit, "what": kind.what}
    return {**UNTOUCHED, name: value}, truth
