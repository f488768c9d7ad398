"""How a fit ended: a code, and the advice that goes with it."""

from __future__ import annotations

from enum import StrEnum
from typing import Self

__all__ = ["AdvisedState", "FitState"]


class AdvisedState(StrEnum):
    """How something ended; a member is its code as written to JSON.

    Attributes
    ----------
    advice : str
        What the state means and what to do about it.
    """

    advice: str

    def __new__(cls, code: str, advice: str) -> Self:
        """Make a string member that carries its advice."""
        member = str.__new__(cls, code)
        member._value_ = code
        member.advice = advice
        return member

    @property
    def code(self) -> str:
        """The code, as written to JSON."""
        return str(self.value)


class FitState(AdvisedState):
    """How a fit ended."""

    CONVERGED = ("converged", "The fit converged.")
    NOT_CONVERGED = (
        "not_converged",
        "The fit stopped before it converged: check φ and ψ' for outliers and misalignment, or "
        "take a simpler characteristic.",
    )
    AT_LOWER_BOUND = (
        "at_lower_bound",
        "The time constant ran to its lower bound: no lag is seen. Where there should be one, the "
        "noise of φ drives the fit, φ and the coefficient were not filtered alike, or the samples "
        "are too far apart.",
    )
    AT_UPPER_BOUND = (
        "at_upper_bound",
        "The time constant ran to its upper bound: slow drift is read as the lag; take "
        "noise='output-error' with drift='spline', or shorten the window.",
    )
    RANK_DEFICIENT = (
        "rank_deficient",
        "The terms cannot be separated on these rows (φ hardly moves, or a term is the sum of "
        "others): neither the characteristic nor the time constant can be read; take fewer terms "
        "or rows in which φ moves.",
    )
    TOO_FEW_ROWS = (
        "too_few_rows",
        "There are fewer scored rows than parameters: no time constant can be had; the terms are "
        "fitted as a static curve of least norm.",
    )
    TOO_FEW_CYCLES = (
        "too_few_cycles",
        "There are too few cycles to know the scatter between them, and nothing is stated; take a "
        "longer record, or name a longer window.",
    )
    BLOWDOWN = (
        "blowdown",
        "Hardly a row in stall is in forward flow: the plenum blows down at nearly constant φ, and "
        "its time constant would be read as the lag's; none is stated. Take a record with more "
        "throttle, or a smaller discharge volume.",
    )
    OK = ("ok", "the structure stands: no larger one explains more than its terms cost")
    NO_CONSISTENT_STRUCTURE = (
        "no_consistent_structure",
        "every structure tried is refuted by another; the family of models is wrong or noise is "
        "not white: look for a missing effect, a time shift between φ and ψ', or raise max_terms",
    )
    MODEL_ERROR_DOMINATES = (
        "model_error_dominates",
        "what the terms leave is far above the noise and comes again in every cycle: the "
        "structure, kept small, was chosen by cycles left out and fitted in the weak form; the "
        "band covers the choice of the test function, not an error of φ itself: look for a "
        "missing effect, or for what filtering and segmentation did to the signals",
    )
    LAG_BELOW_RESOLUTION = (
        "lag_below_resolution",
        "the time constant is shorter than the sampling can show; treat ψ' as quasi-steady or "
        "sample faster",
    )
    LAG_UNDETERMINED = (
        "lag_undetermined",
        "the error of the time constant is as large as itself, or it runs to the length of the "
        "longest segment; the record does not excite the lag: use longer segments or more cycles",
    )
    UNRELATED = (
        "unrelated",
        "no term explains more of ψ' than its own scatter would let it; check that φ and ψ' are of "
        "one record and one clock, and that ψ' moves at all beside its noise",
    )
    FEW_EQUATIONS = (
        "few_equations",
        "a structure was found, but on so few rows that a choice among so many terms is worth "
        "little, and the errors stated are too small: use a longer record, or a smaller library",
    )
    CONSTANT_SIGNAL = (
        "constant_signal",
        "the inputs or ψ' do not change, so that no lag shows; the fit is static: use a record "
        "with surge cycles",
    )
