"""The switches of the reduction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from classic_ml.work.balance import WORK_FORMS
from surge_core.errors import InputError, one_of, positive

_CHOICES = {"filter_order": (3, 5), "phase": ("zero", "causal", "none"), "work_form": WORK_FORMS}
# What must be above zero, or one of these.
_POSITIVE: dict[str, tuple[object, ...]] = {
    "cutoff_hz": (),
    "threshold_lbm_s": (None, "none"),
    "hysteresis_lbm_s": (None, 0.0),
    "probe_ramp": (0.0,),
}
# The slowest surge cycles last some seconds; what a filter below leaves of others is none.
LEAST_CUTOFF_HZ = 1.0


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
    threshold_lbm_s : float, "none" or None
        Corrected flow between in-stall and unstalled; None takes what test.toml states, and
        estimates it where that states none.
    hysteresis_lbm_s : float or None
        Half width of the band around it; None takes what test.toml says.
    thermocouple_inversion : bool
        Undo the lag of the thermocouples. The paper did not; behind a 48 Hz filter the lag of T25
        cancels part of what the filter does to the curve, so that undoing it alone makes the
        curve worse.
    work_form : {"auto", "exit-flow", "mass-balance", "temperature-rise"}
        How ψ is computed: by Eq 13 with W31 as measured, with the storage between the planes from a
        balance of mass, from the temperature rise alone, or by the first unless the flows of the
        two planes disagree by more than ψ can bear.
    window_s : tuple of float, optional
        Quasi-steady cycles on the facility clock; None takes test.toml's, else they are found.
    probe_ramp : float
        Calculated Mach number below which b of Eq 2 falls to nothing in proportion; 0 is the
        paper's law, whose flow jumps at zero. A calibration never says which holds there.

    Raises
    ------
    InputError
        Naming the setting at fault.
    """

    filter_order: int = 3
    cutoff_hz: float = 48.0
    phase: str = "zero"
    threshold_lbm_s: float | str | None = None
    hysteresis_lbm_s: float | None = None
    thermocouple_inversion: bool = False
    work_form: str = "auto"
    window_s: tuple[float, float] | None = None
    probe_ramp: float = 0.0

    @property
    def low_pass(self) -> dict[str, Any]:
        """The filter, as ``classic_ml.filters.low_pass`` takes it."""
        return {"order": self.filter_order, "cutoff_hz": self.cutoff_hz, "phase": self.phase}

    def __post_init__(self) -> None:
        where = "ReductionSettings."
        for name, choices in _CHOICES.items():
            one_of(where + name, getattr(self, name), choices)
        for name, free in _POSITIVE.items():
            if getattr(self, name) not in free:
                positive(where + name, getattr(self, name))
        if self.cutoff_hz < LEAST_CUTOFF_HZ:
            raise InputError(
                where + "cutoff_hz",
                expected=f"at least {LEAST_CUTOFF_HZ:g} Hz, so that the surge cycles pass",
                found=f"{self.cutoff_hz:g}",
            )
        window = self.window_s
        # A time that is no number is neither before nor behind another.
        if window is not None and not (
            len(window) == 2 and -np.inf < window[0] < window[1] < np.inf
        ):
            raise InputError(
                where + "window_s", expected="two times, the earlier first", found=repr(window)
            )
