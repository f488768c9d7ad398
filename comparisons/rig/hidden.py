"""Effects that the rig can hide in a record: each where it happens, none named in what is written.

An effect has one size. It alters the plant, a sensor, or what ``test.toml`` states, and a reduction
that trusts ``test.toml`` leaves it in ψ' or φ. `HIDEABLE` lists them under the names of the effects
that a lag model may lack. A sensor's effect changes no row of the plant; one in the plant changes
how it surges, and too much of it lets a case recover or come to rest in stall.

Of the names `amplitude_dependent_lag` is not here: the surge of the rig is a limit cycle whose
amplitude stays within a few percent, so that such a lag is one of another length and no more.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

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
class Alteration:
    """What differs from the rig as it is described: the size of each effect of `HIDEABLE`.

    The defaults differ in nothing.
    """

    transport_delay: float = 0.0
    facility_heating: float = 0.0
    speed_droop: float = 0.0
    hysteresis: float = 0.0
    reverse_flow_branch: float = 1.0
    characteristic_shape: float = 0.0
    second_order_lag: float = 0.0
    asymmetric_lag: float = 0.0
    flow_dependent_lag: float = 0.0
    flow_inertia: float = 1.0
    thermocouple_lag: float = 0.0
    sensitivity_drift: float = 0.0
    bias_drift: float = 0.0
    rotating_stall_ripple: float = 0.0
    flow_noise: float = 0.0


UNTOUCHED = Alteration()


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
    """

    what: str
    bounds: tuple[float, float]
    default: float
    unit: str = "1"


HIDEABLE: Mapping[str, Hideable] = {
    "transport_delay": Hideable(
        "how late the tape records the plane 31 channels, in s",
        bounds=(0.0, 0.02),
        default=0.005,
        unit="s",
    ),
    "facility_heating": Hideable(
        f"share of ψ'_QS lost to heat soak, with a time constant of {HEAT_SOAK_S:g} s",
        bounds=(0.0, 0.2),
        default=0.12,
    ),
    # In stall only: the table of the unstalled branch knows N_c already. With a power of 1 or
    # more the 95 % case recovers for good.
    "speed_droop": Hideable(
        "power of N_c that ψ'_QS goes with in stall, over "
        f"{SETTLED_SPEED_FRAC:g} of the initial N_c",
        bounds=(-3.0, 3.0),
        default=-2.0,
    ),
    "hysteresis": Hideable(
        f"ψ'_QS lost from φ below {BRANCH_PHIS[0]:g} until φ above {BRANCH_PHIS[1]:g}",
        bounds=(-0.3, 0.3),
        default=0.15,
    ),
    "reverse_flow_branch": Hideable(
        "factor on the loss in reversed flow, which acts without the lag",
        bounds=(0.2, 10.0),
        default=2.5,
    ),
    "characteristic_shape": Hideable(
        f"height of a bell of width {BUMP_WIDTH_PHI:g} at φ = {BUMP_PHI:g} in ψ'_QS",
        bounds=(-0.3, 0.3),
        default=0.2,
    ),
    # A plenum in the gas path would not show: φ and ψ' are both measured before it. A cavity
    # between taps and transducers puts a second pole behind the lag. Laminar flow through a
    # tube of length l and bore d into a volume V at pressure p: T = 128 μ l V/(π d⁴ p), 5 ms
    # for 1 m of 1 mm and 1.2 cm³ at 3 bar.
    "second_order_lag": Hideable(
        "time in which cavities behind the plane 31 taps fill, in s",
        bounds=(0.0, 0.02),
        default=0.005,
        unit="s",
    ),
    "asymmetric_lag": Hideable(
        "share by which τ is longer while φ rises and shorter while it falls",
        bounds=(-0.6, 0.6),
        default=0.3,
    ),
    "flow_dependent_lag": Hideable(
        f"share by which τ is longer at φ below {LOW_FLOW_PHI:g}",
        bounds=(-0.6, 1.0),
        default=0.5,
    ),
    "flow_inertia": Hideable("stated over true ∫dx/A", bounds=(0.2, 3.0), default=1.5),
    # A sheathed junction of a millimetre or so in place of the 10 ms of a fine wire.
    "thermocouple_lag": Hideable(
        "time constant of the T25 junctions beyond the stated one, in s",
        bounds=(0.0, 1.0),
        default=0.2,
        unit="s",
    ),
    # Before the first stall, and at the deepest P31 of a cycle, plane 31 is at 3.5 V of 5: a drift
    # that goes beyond a quarter, or 1 V, by the end of a record leaves the converter's range.
    "sensitivity_drift": Hideable(
        "rate of the plane 31 sensitivity after its calibration, in 1/s",
        bounds=(-0.1, 0.1),
        default=0.03,
        unit="1/s",
    ),
    "bias_drift": Hideable(
        "rate of the plane 31 zero after its reading, in V/s",
        bounds=(-0.25, 0.25),
        default=0.02,
        unit="V/s",
    ),
    "rotating_stall_ripple": Hideable(
        "amplitude of a second cell pattern over that of the first",
        bounds=(0.0, 1.5),
        default=0.8,
    ),
    "flow_noise": Hideable(
        "noise of the downstream holes of plane 25 over the pressure difference of the pair",
        bounds=(0.0, 0.6),
        default=0.4,
    ),
}


def hide_effect(name: str | None, size: float | None) -> tuple[Alteration, dict[str, Any]]:
    """Return what an effect alters in a record, and its entry in the truth.

    Parameters
    ----------
    name : str or None
        One out of `HIDEABLE`; None: nothing is hidden.
    size : float, optional
        Its size, in the unit that `HIDEABLE` states; by default the one stated there.

    Returns
    -------
    Alteration
        With the neutral size that of an untouched rig.
    dict
        Name, size, unit and what the size is; empty where nothing is hidden.

    Raises
    ------
    InputError
        When the name is not known, or the size is out of range or has no name to belong to.
    """
    if name is None:
        if size is not None:
            raise InputError(
                "hide_size",
                expected="a size only with the name of the effect that it belongs to",
                found=f"{size!r} with no effect",
                remedy="name the effect with hide",
            )
        return UNTOUCHED, {}
    if name not in HIDEABLE:
        raise InputError(
            "hide", expected="one of " + ", ".join(HIDEABLE), found=f"{name!r}", remedy="name one"
        )
    kind = HIDEABLE[name]
    value = kind.default if size is None else float(size)
    least, most = kind.bounds
    if not least <= value <= most:
        raise InputError(
            f"hide_size of {name}",
            expected=f"{least:g} to {most:g} ({kind.what})",
            found=f"{value:g}",
        )
    truth = {"effect": name, "size": value, "unit": kind.unit, "what": kind.what}
    return replace(UNTOUCHED, **{name: value}), truth
