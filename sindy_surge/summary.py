"""What is shown of a fitted model: one list of fields and tables, for text, HTML and pages."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from sindy_surge.text import EquationParts, write_equation
from surge_core.display import Field, Grid, Sheet
from surge_core.fit_state import FitState
from surge_core.rounding import NOT_KNOWN, round_like, round_to_error
from surge_core.terms import pretty_term

_NORMAL_95 = 1.959963984540054  # two-sided 95 % of the normal distribution


def interval95(value: float, stderr: float) -> tuple[float, float]:
    """Return the 95 % interval of a value that is above zero by its nature; nan without an error.

    Symmetric in its logarithm where the error is small against the value, else cut at zero.
    """
    reach = _NORMAL_95 * stderr
    if not math.isfinite(reach):
        return math.nan, math.nan
    if reach <= 0.5 * value:
        factor = math.exp(reach / value)
        return value / factor, value * factor
    return max(0.0, value - reach), value + reach


@dataclass(frozen=True)
class ModelSummary:
    """What is shown of a fitted model."""

    parts: EquationParts  # The equation with its errors
    state: FitState  # What became of the fit
    name: str = "SparseLagRegressor"  # Name of the estimator
    n_candidates: int = 0  # Number of terms in the library
    inclusion: Sequence[float] | None = None  # Probability that a term belongs, one for each term
    # Structures that the data cannot tell from the chosen one; None if not looked for
    rivals: Sequence[Sequence[str]] | None = None
    # Standard deviation found for the noise of ψ' and of each input
    noise: tuple[float, Sequence[float]] | None = None
    cautions: Sequence[str] = ()  # What to know before the numbers are used

    def sheet(self) -> Sheet:
        """Return the fields, and the table of the terms."""
        parts = self.parts
        names = [pretty_term(name) for name in (parts.output_name, *parts.input_names)]
        noise = () if self.noise is None else (self.noise[0], *self.noise[1])
        tone = "good" if self.state is FitState.OK else "advice"
        fields = [
            Field("equation", write_equation(parts)),
            Field("state", f"{self.state}: {self.state.advice}", tone),
            *self._times(),
            *(Field(f"noise of {n} (std)", f"{x:.3g}") for n, x in zip(names, noise, strict=False)),
            Field("rivals", self._rivals()),
            *([Field("cautions", tuple(self.cautions))] if self.cautions else []),
        ]
        return Sheet(self.name, tuple(fields), (self._terms(),))

    def _rivals(self) -> tuple[str, ...]:
        if self.rivals is None:
            return ("not looked for",)
        written = [", ".join(map(pretty_term, rival)) for rival in self.rivals]
        return ("the data cannot tell from it:", *written) if written else ("none",)

    def _times(self) -> list[Field]:
        parts = self.parts
        tau, error = 1e3 * parts.time_constant_s, 1e3 * parts.time_constant_stderr_s
        rows = [("time constant τ", "none: the fit is static")]
        if not parts.is_static:
            interval = _interval(interval95(tau, error), error)
            rows = [("time constant τ", f"{round_to_error(tau, error)} ms")]
            rows.append(("τ, 95 % interval", f"{interval} ms"))
        if parts.has_dead_time:
            dead, error = 1e3 * parts.dead_time_s, 1e3 * parts.dead_time_stderr_s
            rows.append(("dead time d", f"{round_to_error(dead, error)} ms"))
        return [Field(*row) for row in rows]

    def _terms(self) -> Grid:
        parts = self.parts
        header = ["term", "coefficient ± std error"]
        rows = [
            [pretty_term(term), round_to_error(value, error)]
            for term, value, error in zip(parts.terms, parts.coef, parts.stderr, strict=True)
        ]
        if self.inclusion is not None:
            header.append("inclusion probability")
            for row, share in zip(rows, self.inclusion, strict=True):
                row.append(f"{share:.2f}" if math.isfinite(share) else NOT_KNOWN)
        title = f"Terms of {pretty_term(parts.output_name)}_QS: {len(rows)}"
        title += f" of {self.n_candidates} candidates"
        return Grid(title, tuple(header), tuple(map(tuple, rows)))


def _interval(bounds: tuple[float, float], stderr: float) -> str:
    if not all(map(math.isfinite, bounds)):
        return NOT_KNOWN
    return " to ".join(round_like(bound, stderr) for bound in bounds)
