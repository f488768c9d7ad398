"""How a fit ended: a code whose text is the advice."""

from __future__ import annotations

from enum import Enum

__all__ = ["FitState"]


class FitState(Enum):
    """How a fit ended; the value is the advice that goes with it."""

    CONVERGED = "The fit converged."
    NOT_CONVERGED = (
        "The fit stopped before it converged: check φ and ψ' for outliers and misalignment, or "
        "take a simpler characteristic."
    )
    AT_LOWER_BOUND = (
        "The time constant ran to its lower bound: the data show no lag at this sample rate; "
        "sample faster, or check that φ and ψ' were filtered alike."
    )
    AT_UPPER_BOUND = (
        "The time constant ran to its upper bound: slow drift is read as the lag; take "
        "noise='output-error' with drift='spline', or shorten the window."
    )
    RANK_DEFICIENT = (
        "The terms cannot be told apart on these rows (φ hardly moves, or a term is the sum of "
        "others): neither the characteristic nor the time constant can be read; take fewer terms "
        "or rows in which φ moves."
    )
    TOO_FEW_ROWS = (
        "There are fewer scored rows than parameters: no time constant can be had; the terms are "
        "fitted as a static curve of least norm."
    )

    BLOWDOWN = (
        "Hardly a row in stall is in forward flow: the plenum blows down at nearly constant φ, and "
        "its time constant would be read as the lag's; none is stated. Take a record with more "
        "throttle, or a smaller discharge volume."
    )

    @property
    def advice(self) -> str:
        """What it means and what to do about it."""
        return self.value

    @property
    def code(self) -> str:
        """The name in lower case, as written to JSON."""
        return self.name.lower()
