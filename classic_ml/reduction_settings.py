"""The switches of the reduction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from classic_ml.work.forms import WORK_FORMS
from surge_core.errors import InputError

__all__ = ["ReductionSettings"]

_CHOICES = {
    "filter_order": (3, 5),
    "phase": ("zero", "causal", "none"),
    "probes": ("all", "tip", "hub"),
    "near_stall_match": ("pair", "forward", "none"),
    "stall_rule": ("threshold", "hub-tip"),
    "work_form": WORK_FORMS,
}


@dataclass(frozen=True)
class ReductionSettings:
    """The switches of the reduction; the defaults are what a careful reduction uses.

    Parameters
    ----------
    filter_order : {3, 5}
        Order of the Butterworth low-pass.
    cutoff_hz : float
        Its −3 dB frequency in one pass.
    phase : {"zero", "causal", "none"}
        Forth and back; once, as in the paper (delays by about 8 ms); or no filter at all.
    probes : {"all", "tip", "hub"}
        Immersions in the plane averages.
    threshold_lbm_s : float, "none" or None
        Corrected flow between in-stall and unstalled; None takes what test.toml states, and
        estimates it where that states none.
    hysteresis_lbm_s : float or None
        Half width of the band around it; None takes what test.toml says.
    stall_rule : {"threshold", "hub-tip"}
        How the stall state is estimated.
    inertia_factor : float
        Multiplies ∫dx/A in Eq 5; 0 drops the inertia term.
    thermocouple_inversion : bool
        Undo the lag of the thermocouples. The paper did not; behind a 48 Hz filter the lag of T25
        cancels part of what the filter does to the curve, so that undoing it alone makes the
        curve worse.
    near_stall_match : {"pair", "forward", "none"}
        What the near-stall match moves.
    work_form : {"auto", "exit-flow", "mass-balance", "temperature-rise"}
        How ψ is computed: by Eq 13 with W31 as measured, with the storage between the planes from a
        balance of mass, from the temperature rise alone, or by the first unless the flows of the
        two planes disagree by more than ψ can bear.
    window_s : tuple of float, optional
        Quasi-steady cycles on the facility clock; None takes test.toml's, else they are found.

    Raises
    ------
    InputError
        Naming the setting at fault.
    """

    filter_order: int = 3
    cutoff_hz: float = 48.0
    phase: str = "zero"
    probes: str = "all"
    threshold_lbm_s: float | str | None = None
    hysteresis_lbm_s: float | None = None
    stall_rule: str = "threshold"
    inertia_factor: float = 1.0
    thermocouple_inversion: bool = False
    near_stall_match: str = "pair"
    work_form: str = "auto"
    window_s: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        for name, choices in _CHOICES.items():
            if getattr(self, name) not in choices:
                raise _refused(name, " or ".join(repr(c) for c in choices), getattr(self, name))
        if not _is_number(self.cutoff_hz, above=0.0):
            raise _refused("cutoff_hz", "a number above 0", self.cutoff_hz)
        threshold = self.threshold_lbm_s
        if threshold not in (None, "none") and not _is_number(threshold, above=0.0):
            raise _refused("threshold_lbm_s", "a number above 0, 'none' or None", threshold)
        if not _is_number(self.inertia_factor, least=0.0):
            raise _refused("inertia_factor", "a number from 0 on", self.inertia_factor)
        hysteresis = self.hysteresis_lbm_s
        if hysteresis is not None and not _is_number(hysteresis, least=0.0):
            raise _refused("hysteresis_lbm_s", "a number from 0 on, or None", hysteresis)
        window = self.window_s
        if window is not None and not (
            len(window) == 2 and all(_is_number(v) for v in window) and window[0] < window[1]
        ):
            raise _refused("window_s", "two times, the earlier first", window)


def _is_number(value: object, *, above: float = -np.inf, least: float = -np.inf) -> bool:
    return (
        isinstance(value, int | float)
        and not isinstance(value, bool)
        and bool(np.isfinite(value))
        and value > above
        and value >= least
    )


def _refused(name: str, expected: str, found: object) -> InputError:
    return InputError(f"ReductionSettings.{name}", expected=expected, found=repr(found))
