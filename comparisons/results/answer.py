"""The answer of an analysis: τ, the characteristic, whom to believe, what is missing or refused."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from comparisons.results.names import SYMBOLS
from surge_core.display import Displayed, Field, Sheet
from surge_core.rounding import round_like, round_to_error
from surge_core.terms import signed_sum, terms_json
from surge_core.types import BoolArray, FloatArray


@dataclass(frozen=True)
class Curve:
    """A quasi-steady characteristic where φ was scored, and the points that it was fitted to.

    Parameters
    ----------
    target : {"psi_p", "psi"}
        The coefficient.
    terms : tuple of str
        Names of its terms, ``"1"``, ``"phi"``, ``"phi^2"``, …
    coefficients, coefficient_stderr : tuple of float
        One for each term.
    valid_phi : tuple of float
        Range of φ in which it holds: 5th to 95th percentile of the scored rows.
    phi, value, stderr : ndarray of shape (n,)
        The curve and its standard error over that range.
    measured_phi, measured : ndarray of shape (m,)
        The scored rows, with the lag in them.
    rising : ndarray of bool, shape (m,)
        Where φ rises at them: the lag holds ψ' below a rising curve then, and above it where φ
        falls.
    """

    target: str
    terms: tuple[str, ...]
    coefficients: tuple[float, ...]
    coefficient_stderr: tuple[float, ...]
    valid_phi: tuple[float, float]
    phi: FloatArray
    value: FloatArray
    stderr: FloatArray
    measured_phi: FloatArray
    measured: FloatArray
    rising: BoolArray

    def equation(self) -> str:
        """Write the curve in its terms, each number rounded to its standard error."""
        terms = zip(self.terms, self.coefficients, self.coefficient_stderr, strict=True)
        return f"{SYMBOLS[self.target]}_QS = {signed_sum(list(terms))}"

    def to_json(self) -> dict[str, Any]:
        """Return the curve as plain JSON types."""
        return {
            "target": self.target,
            "terms": terms_json(self.terms, self.coefficients, self.coefficient_stderr),
            "valid_phi": list(self.valid_phi),
            "phi": self.phi.tolist(),
            self.target: self.value.tolist(),
            "stderr": self.stderr.tolist(),
        }


@dataclass(frozen=True)
class Answer(Displayed):
    """What an engineer asks of a surge record, in the order in which it is asked.

    Parameters
    ----------
    test : str
        The test in a line.
    time_constant_s, time_constant_stderr_s : float
        τ to quote and its standard error, in seconds; NaN where none may be quoted.
    ci95_s : tuple of float
        Its 95 % interval, in seconds.
    estimator : str
        Key of the estimator to believe; empty where none is recommended.
    label : str
        Name of the first estimator of the table.
    why : str
        Whom to believe and why, or why none.
    others : str
        How the τ of the other steps compare with it.
    curve : Curve or None
        The characteristic; None where no τ is quoted, or the estimator states no curve.
    verdict : str
        Of the diagnosis; empty where it was not made.
    missing : str
        What is missing, or that nothing is and what would have been seen.
    refused : tuple of str
        What was refused and why.
    work : str
        What is known of ψ_QS; empty where it was not asked for, or is not stated.
    """

    test: str
    time_constant_s: float
    time_constant_stderr_s: float
    ci95_s: tuple[float, float]
    estimator: str
    label: str
    why: str
    others: str
    curve: Curve | None
    verdict: str
    missing: str
    refused: tuple[str, ...]
    work: str = ""

    @property
    def tau_words(self) -> str:
        """τ with its interval, or that none is quoted."""
        tau, error = 1e3 * self.time_constant_s, 1e3 * self.time_constant_stderr_s
        if not math.isfinite(tau):
            return "none to quote"
        if error == 0.0:
            return f"{tau:g} ms (held)"
        low, high = (round_like(1e3 * end, error) for end in self.ci95_s)
        return f"{round_to_error(tau, error)} ms (95 %: {low} to {high} ms)"

    @property
    def curve_words(self) -> str:
        """The characteristic in plain powers and where it holds."""
        if self.curve is None:
            return "none to read"
        low, high = self.curve.valid_phi
        return f"{self.curve.equation()}, for φ from {low:.3f} to {high:.3f}"

    @property
    def lines(self) -> tuple[tuple[str, str], ...]:
        """Question and answer, in the order of reading."""
        nothing = "nothing" if math.isfinite(self.time_constant_s) else "τ, for the reason above"
        refused = "; ".join(text.rstrip(".") for text in self.refused) or nothing
        believed = (self.why, *([self.others] if self.others else ()))
        return (
            ("τ", self.tau_words),
            ("characteristic", self.curve_words),
            *([("work coefficient", self.work)] if self.work else []),
            ("whom to believe", " ".join(believed)),
            ("what is missing", self.missing),
            ("what was refused", refused),
        )

    def to_json(self) -> dict[str, Any]:
        """Return the answer as plain JSON types, NaN for what is not known."""
        return {
            "test": self.test,
            "time_constant_s": {
                "value": self.time_constant_s,
                "stderr": self.time_constant_stderr_s,
                "ci95": list(self.ci95_s),
            },
            "estimator": self.estimator or None,
            "label": self.label,
            "why": self.why,
            "others": self.others,
            "equation": None if self.curve is None else self.curve.equation(),
            "characteristic": None if self.curve is None else self.curve.to_json(),
            "verdict": self.verdict or None,
            "missing": self.missing,
            "refused": list(self.refused),
        }

    def _sheet(self) -> Sheet:
        return Sheet(self.test, tuple(Field(label, words) for label, words in self.lines))
