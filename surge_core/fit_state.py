"""How a fit ended: a code, and the advice that goes with it."""

from __future__ import annotations

from enum import StrEnum
from typing import Self


class FitState(StrEnum):
    """How a fit ended; a member is its code as written to JSON.

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
    TWO_READINGS = (
        "two_readings",
        "The rows in stall alone give another time constant than all forward rows, by about two "
        "standard deviations or more: the interval spans both. A record with smaller loops, or a "
        "lower noise of the probes, would separate them.",
    )
    UNCERTAIN = (
        "uncertain",
        "The record does not hold the time constant: cycles, the choices of the fit, the noise of "
        "the probes and the time from plane to plane together leave more than 12 %. A longer "
        "record lessens the scatter of the cycles alone.",
    )
    TWIN_BIASED = (
        "twin_biased",
        "The record, measured again from its own fitted model, gives another time constant by more "
        "than two standard deviations: what is fitted is not what such a machine would leave. Look "
        "for a missing effect, or for a probe that reads wrong.",
    )
    MISALIGNED = (
        "misaligned",
        "Plane 31 is out of time with plane 25, as their flows show or as the record is explained "
        "better, and that moves the time constant by more than its standard deviation: a delay "
        "would be read as the lag. Check that all channels share one clock.",
    )
    STATES_PART = (
        "states_part",
        "In more than half of the cycles the flow levels of stall and recovery give another state "
        "than the flow at hub and tip, which ψ' confirms: which rows are in stall is not known, "
        "and without it no time constant is. Check the probes of one immersion against the other.",
    )
    ONE_IMMERSION = (
        "one_immersion",
        "Probes at one immersion do not show which rows are in stall, and the flow of the plane is "
        "not theirs: the time constant that they give is off by a fifth and more, and none is "
        "stated. Add a probe pair at hub or tip.",
    )
    AT_SEARCH_END = (
        "at_search_end",
        "The time constant lies at an end of what was searched (4 to 80 ms): the record does not "
        "hold it.",
    )
    UNEXPLAINED = (
        "unexplained",
        "the equations leave more than white noise, and what they leave comes in runs: a term that "
        "the library lacks, a state that was not measured, an input that is missing, a parameter "
        "that moves, or a sensor that clips, filters or drifts; widen the library, give the hidden "
        "state, or look at the sensors",
    )
    COLOURED_REST = (
        "coloured_rest",
        "the equations follow the data within the noise, but what they leave comes in runs: a term "
        "that the library lacks is made up for by others, the noise is not white, or an input has "
        "noise; coefficients are off by more than their errors say: widen the library, or measure "
        "without a filter",
    )
    ODD_ROWS = (
        "odd_rows",
        "single rows lie farther from the equations than normal noise does, and coefficients are "
        "bent towards them: look where a reading is farthest from the run of the equations, and "
        "cut the record there; or the noise grows with the reading",
    )
    COARSE_ROWS = (
        "coarse_rows",
        "between two rows the states or the inputs bend more than can be followed, or the record "
        "does not show whether an input is held there: coefficients may be off by more than their "
        "errors say, and needless terms may make up for it; sample faster",
    )
    LIBRARY_TOO_SMALL = (
        "library_too_small",
        "a term that the library lacks would explain more than it costs: the terms stated make up "
        "for another law, such as x/(1 + x): widen the library",
    )
    READ_LATE = (
        "read_late",
        "readings that come late explain the record with fewer terms: the equations stated are "
        "those with these readings moved; check their sensor for a delay, a lag or a clock of its "
        "own and set the column right, or look for a state between that was not measured",
    )
    UNDECIDED = (
        "undecided",
        "the rivals are together likelier than the equations stated, or a term is smaller than its "
        "error: the record does not tell which terms are true; use a longer record that visits "
        "more states, or a smaller library",
    )
    NO_EQUATIONS = (
        "no_equations",
        "no model was found that the data follow, and none is stated: check that every state and "
        "input was measured, and on one clock, and that no angle jumps by a turn; the library may "
        "lack a term, or be too large for these records",
    )
    SHORT_RUNS_ONLY = (
        "short_runs_only",
        "the equations follow the data over short stretches, and no run of them follows a whole "
        "record: cut the record where something changed, or look for a missing term",
    )
    PROPOSED = (
        "proposed",
        "the terms are those that the optimizer proposed, fitted; they were compared with no "
        "others, nor with the noise: search='full' does that",
    )
    OK = ("ok", "no larger structure of this library explains more than its terms cost")
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
        "by its errors the lag may be endless, as slow drift looks (LagRegressor models it with "
        "noise='output-error' and drift='spline'), or none: no time constant is stated; use longer "
        "segments or more cycles; a system that is no lag behind a curve is one for "
        "`sindy-surge discover`",
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
    DOES_NOT_CYCLE = (
        "does_not_cycle",
        "simulated, the model settles or runs away instead of cycling: use more cycles, and look "
        "for clipped signals, a transient, or channels shifted in time against each other; "
        "`sindy-surge total-system` fits the loop to the raw counts",
    )
    CYCLES_DIFFER = (
        "cycles_differ",
        "the model cycles, but its period or an extreme is more than 5 % off the record's: look "
        "for a missing effect, a time shift between the channels, or cycles that drift",
    )
    PERIOD_OFF = (
        "period_off",
        "the model's period is more than five of its own errors off the record's: its terms follow "
        "the curve, but coefficients, τ or levels are off by more than their errors say; sample "
        "faster, or look for a missing effect",
    )
    CONSTANT_SIGNAL = (
        "constant_signal",
        "the inputs or ψ' do not change, so that no lag shows; the fit is static: use a record "
        "with surge cycles",
    )

    @property
    def code(self) -> str:
        """The code, as written to JSON."""
        return str(self.value)

    @property
    def withholds(self) -> bool:
        """Whether no time constant is stated for a whole record."""
        return self in WITHHOLDING


# So many errors from an endless lag one still seems one in 5 % of records, with a level fitted
# (Dickey and Fuller; MacKinnon 2010): of ten lags of 10 s in 3 s six were `ok`, as 1.8 ± 0.6 s.
INTEGRATOR = 2.86


def holds_lag(tau_s: float, stderr_s: float, longest_s: float) -> bool:
    """Return whether 1/τ lies so many errors above that of the longest lag searched."""
    return bool(tau_s / longest_s + INTEGRATOR * stderr_s / tau_s < 1.0)


# The states, each equal to its code, in which no time constant of a whole record is stated.
WITHHOLDING: frozenset[str] = frozenset({
    FitState.BLOWDOWN,
    FitState.UNCERTAIN,
    FitState.TWIN_BIASED,
    FitState.MISALIGNED,
    FitState.STATES_PART,
    FitState.ONE_IMMERSION,
    FitState.TOO_FEW_CYCLES,
    FitState.AT_SEARCH_END,
    FitState.LAG_UNDETERMINED,
})  # fmt: skip
