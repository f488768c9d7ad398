"""What became of a fit, and what to do about it."""

from __future__ import annotations

from enum import StrEnum

__all__ = ["FitState"]


class FitState(StrEnum):
    """Result of a fit; each member carries its advice.

    Attributes
    ----------
    advice : str
        What the result means and what to do about it.
    """

    advice: str

    def __new__(cls, code: str, advice: str) -> FitState:
        """Make a string member and hang its advice on it."""
        member = str.__new__(cls, code)
        member._value_ = code
        member.advice = advice
        return member

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
    CONTRADICTED = (
        "contradicted",
        "terms with ψ' give a lag that the weak form does not see: strongly coloured noise or a "
        "missing effect passes for them; fit again with psi_terms=False and compare",
    )
    NOT_CONVERGED = (
        "not_converged",
        "the last iterations still moved the result; check the range of φ and the scatter of ψ'",
    )
    TOO_FEW_ROWS = (
        "too_few_rows",
        "not enough equations within the segments for a lag; the fit is static, of minimum norm: "
        "use longer segments or a smaller library",
    )
    CONSTANT_SIGNAL = (
        "constant_signal",
        "the inputs or ψ' do not change, so that no lag shows; the fit is static: use a record "
        "with surge cycles",
    )
