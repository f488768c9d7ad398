"""The identified equation as text, as pysindy writes it, and what else is shown of a model."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from surge_core.display import Field, Grid, Sheet
from surge_core.errors import require, whole_number
from surge_core.fit_state import FitState
from surge_core.rounding import NOT_KNOWN, round_like, round_to_error
from surge_core.terms import pretty_term, signed_sum, uncertain

_NORMAL_95 = 1.959963984540054  # two-sided 95 % of the normal distribution


def interval95(value: float, stderr: float, quantile: float = _NORMAL_95) -> tuple[float, float]:
    """Return the 95 % interval of a value that is above zero by its nature; nan without an error.

    Symmetric in its logarithm where the error is small against the value, else cut at zero: of an
    error so large the logarithm is not normal either, and only a bound from above is known.
    """
    reach = quantile * stderr
    if not math.isfinite(value + reach):
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


@dataclass(frozen=True)
class EquationParts:
    """What the equation τ dψ'/dt + ψ' = Σ β_i s_i(φ(t − d), ψ') is written from."""

    # Names s_i of the terms, in pysindy's manner; the lag's own ψ' is not among them
    terms: tuple[str, ...]
    coef: tuple[float, ...]  # Coefficients β_i and their standard errors, in physical units
    stderr: tuple[float, ...]
    time_constant_s: float  # τ and its standard error in seconds; nan for a static fit
    time_constant_stderr_s: float
    # Dead time d of the inputs and its standard error in seconds. A d of 0 with an error of nan was
    # not looked for and is not written
    dead_time_s: float = 0.0
    dead_time_stderr_s: float = math.nan
    input_names: tuple[str, ...] = ("phi",)  # Names of the inputs, in the order of their columns
    output_name: str = "psi_p"  # Name of ψ' in the terms

    @property
    def is_static(self) -> bool:
        """Whether the fit has no time constant."""
        return math.isnan(self.time_constant_s)

    @property
    def has_dead_time(self) -> bool:
        """Whether a dead time was fitted or given."""
        return self.dead_time_s != 0.0 or math.isfinite(self.dead_time_stderr_s)

    def rate_or_refuse(self) -> float:
        """Return τ, or refuse a fit without one where dψ'/dt is asked for."""
        found, remedy = "none, for the fit is static", "`characteristic` gives the curve"
        positive = self.time_constant_s > 0
        require(positive, "time constant", "a positive one, for dψ'/dt", found, remedy)
        return self.time_constant_s


def write_equation(parts: EquationParts) -> str:
    """Write τ dψ'/dt + ψ' = Σ β_i s_i(φ(t − d), ψ') with its units, rounded to errors."""
    tau = uncertain(parts.time_constant_s, parts.time_constant_stderr_s)
    dead = uncertain(abs(parts.dead_time_s), parts.dead_time_stderr_s)
    late = "−" if parts.dead_time_s >= 0 else "+"
    terms = list(zip(parts.terms, parts.coef, parts.stderr, strict=True))
    output = pretty_term(parts.output_name)
    left = output if parts.is_static else f"{tau} s · d{output}/dt + {output}"
    delayed = ""
    if parts.has_dead_time:
        delayed = f", with {', '.join(map(pretty_term, parts.input_names))} at t {late} {dead} s"
    units = f"{output} dimensionless"
    units += ", t in s" if parts.has_dead_time or not parts.is_static else ""
    if any(re.search(r"\bphi\b", term) for term in parts.terms):
        units = "φ, " + units
    return f"{left} = {signed_sum(terms)}{delayed}   [{units}]"


def pysindy_equations(parts: EquationParts, precision: int = 3) -> list[str]:
    """Write dψ'/dt as ``SINDy.equations`` does: −ψ'/τ + Σ (β_i/τ) s_i, in 1/s.

    E.g. ``-55.556 psi_p + 19.444 1 + 66.667 phi``; a delayed input is written ``phi(t-0.002)``, t
    in seconds. The precision is in decimals as in pysindy, and in as many significant digits where
    the decimals alone would round a coefficient away. A static fit, which has no rate, is refused.
    """
    whole_number("precision", precision, 1, 15)
    tau = parts.rate_or_refuse()
    rates = [(-1.0, parts.output_name)]
    rates += [(v, _delayed(term, parts)) for v, term in zip(parts.coef, parts.terms, strict=True)]
    return [" + ".join(f"{_digits(value / tau, precision)} {term}" for value, term in rates)]


def _digits(value: float, precision: int) -> str:
    return f"{value:.{precision}f}" if abs(value) >= 0.1 else f"{value:.{precision}g}"


def _delayed(term: str, parts: EquationParts) -> str:
    if not parts.dead_time_s:
        return term
    when = f"(t{-parts.dead_time_s:+.6g})"
    # The longest name first, and each where it stands by itself.
    names = map(re.escape, sorted(filter(None, parts.input_names), key=len, reverse=True))
    return re.sub(rf"(?<!\w)(?:{'|'.join(names)})(?!\w)", lambda m: m.group() + when, term)
