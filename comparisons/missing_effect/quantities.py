"""Numbers with units, and the equations of a lag model and its effects, as people read them."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence

from comparisons.missing_effect.effect import Effect, FittedParameter
from comparisons.missing_effect.fit import Fit
from surge_core.rounding import bracketed, round_to_error, significant

_SYMBOLS = {
    "Delta": "Δ",
    "phi_lo": "φ_lo",
    "phi_hi": "φ_hi",
    "phi_t": "φ_t",
    "phi_gate": "φ_gate",
    "a2": "a₂",
    "tau_tc": "τ_tc",
    "l": "ℓ",
    "tau": "τ",
}
# Parameters that were held at one of a few values: a word says more than the value.
_HELD = {
    ("reverse_flow_branch", "lagged"): {1.0: "behind the lag", 0.0: "not lagged"},
    ("characteristic_shape", "intervals"): {},
    # A number of the method: how the ends of a record are taken.
    ("amplitude_dependent_lag", "prolonged"): None,
    ("characteristic_shape", "phi_from"): None,
    ("characteristic_shape", "phi_to"): None,
}
# A number of this unit below the limit is read in a smaller unit.
_SMALLER = {"s": (1.0, 1e3, "ms"), "s^2": (1e-2, 1e6, "ms²")}
_UNITS = {"1": "", "s^2": "s²"}
PORT_WORDS = {
    "input": "at the input φ",
    "characteristic": "in the characteristic ψ'_QS",
    "lag": "in the lag",
    "output": "at the output ψ'",
    "noise": "on the measured φ",
}
_OPEN_SYMBOLS = (
    ("dphi", "dφ/dt"),
    ("dpsi", "dψ'/dt"),
    ("phi", "φ"),
    ("psi", "ψ'"),
    ("sgn", "sign"),
)
_OPEN_MEANING = (
    (r"\be\b", "e is τ dψ'/dt, how far ψ' is from its quasi-steady value"),
    (r"\bA\b", "A is the amplitude of φ"),
    (r"\bt\b", "t is the facility clock"),
    (r"\bn\b", "n is the corrected speed"),
)
# Symbols that take a prefix; what stands behind a stroke or a dot stays as it is.
PREFIXED = frozenset(
    ("m", "V", "A", "s", "N", "rad", "K", "Pa", "W", "J", "T", "C", "F", "H", "Ω", "bar", "l", "L")
)
# Below these a number is given in thousandths, millionths, … of its unit.
STEPS_DOWN = ((1e-7, 1e9, "n", "10⁻⁹"), (1e-4, 1e6, "µ", "10⁻⁶"), (0.1, 1e3, "m", "10⁻³"))
# Of units that take no prefix: smaller numbers read badly as decimals.
PLAIN_BELOW = 1e-2
# A number that these records leave anywhere in its range.
NOT_FIXED = "not fixed"


def symbol(parameter: str) -> str:
    """Return the symbol of a parameter."""
    return _SYMBOLS.get(parameter, parameter)


def quantity(value: float, stderr: float, unit: str) -> str:
    """Return a number with its standard error and unit; small times are written in ms.

    An error that is not known is NaN; one beyond the range of its number is infinite.
    """
    factor, shown = _read_in(value, unit)
    value, stderr = factor * value, factor * stderr
    if math.isinf(stderr):
        return NOT_FIXED
    if math.isnan(stderr):
        return f"about {float(f'{value:.2g}'):g} {shown}".rstrip()
    if stderr <= 0.0:
        return f"{significant(value)} {shown}".rstrip() + " (held)"
    return f"{round_to_error(value, stderr)} {shown}".rstrip()


def last_digits(value: float, stderr: float) -> str:
    """Return a number with its standard error in its last digits, if these records fix it."""
    return NOT_FIXED if math.isinf(stderr) else bracketed(value, stderr)


def size_words(value: float, unit: str) -> str:
    """Return a size in the unit that is easiest read, to the two digits that are known of it."""
    factor, shown = _read_in(value, unit)
    return f"{float(significant(factor * value, 2)):g} {shown}".rstrip()


def _read_in(value: float, unit: str) -> tuple[float, str]:
    """Return the factor to the unit in which a number reads well, and that unit."""
    limit, factor, smaller = _SMALLER.get(unit, (0.0, 1.0, ""))
    return (factor, smaller) if abs(value) < limit else (1.0, _UNITS.get(unit, unit))


def tau_ms(tau_s: float, stderr_s: float | None = None) -> str:
    """Return a time constant in milliseconds, with its standard error where it is given."""
    if stderr_s is None:
        return f"{significant(1e3 * tau_s)} ms"
    return f"{round_to_error(1e3 * tau_s, 1e3 * stderr_s)} ms"


def number_rows(effect: str, parameters: Sequence[FittedParameter]) -> tuple[tuple[str, str], ...]:
    """Return symbol and text of each number of an effect; a held one may be a word alone."""
    rows = []
    for p in parameters:
        words = _HELD.get((effect, p.name), "")
        if words is None:
            continue
        if isinstance(words, dict):
            rows.append(("", words.get(p.value, f"{p.value:g} {p.name}")))
        elif p.name == "phi_gate":
            # 0 stands for stall as the record flags it.
            rows += [("", f"where φ < {p.value:.3g}")] if p.value else []
        else:
            named = "largest f" if effect == "characteristic_shape" else symbol(p.name)
            rows.append((named, quantity(p.value, p.stderr, p.unit)))
    return tuple(rows)


def numbers_of(effect: str, parameters: Sequence[FittedParameter]) -> str:
    """Return the numbers of an effect in one line."""
    rows = number_rows(effect, parameters)
    return ", ".join(f"{name} = {text}" if name else text for name, text in rows)


def label_of(effect: Effect) -> str:
    """Return the name of an effect with the place at which it acts."""
    name = f"open_{open_words(effect.name)}" if effect.unnamed else effect.name
    return f"{name} {PORT_WORDS[effect.port]}"


def plain_name(name: str) -> str:
    """Return the name of an effect, or of two, without underscores; signals keep theirs."""
    return re.sub(r"(^|(?<= \+ ))[^( ]+", lambda found: found[0].replace("_", " "), name)


def equation_of(effect: Effect) -> str:
    """Return what an effect adds."""
    return f"+ c · {open_words(effect.name)}" if effect.unnamed else effect.equation


def letters_of(effect: Effect) -> str:
    """Say what the letters of an open term stand for; empty for an effect with a name."""
    if not effect.unnamed:
        return ""
    return "; ".join(words for letter, words in _OPEN_MEANING if re.search(letter, effect.name))


def model_equation(fit: Fit) -> str:
    """Return the equation of a fitted model, its effects named behind it."""
    from surge_core.terms import pretty_term

    text = "τ dψ'/dt + ψ' ="
    for name, value in zip(fit.structure.terms, fit.coefficients, strict=False):
        factor = "" if name == "1" else f" {pretty_term(name)}"
        sign = ("−" if value < 0.0 else "") if text.endswith("=") else "−" if value < 0.0 else "+"
        gap = "" if text.endswith("=") else " "
        text += f" {sign}{gap}{significant(abs(float(value)))}{factor}"
    text += f", τ = {tau_ms(fit.tau_s)}"
    for effect in fit.structure.in_order:
        name = "open term" if effect.unnamed else plain_name(effect.name)
        text += f"; {name}: {equation_of(effect)}"
    return text


def chance(p_value: float) -> str:
    """Return a p-value in a few letters."""
    if p_value < 1e-300:
        return "<1e-300"
    return f"{p_value:.0e}" if p_value < 0.01 else f"{p_value:.2f}"


def open_words(name: str) -> str:
    """Return the name of an open term in the field's symbols."""
    for plain, pretty in _OPEN_SYMBOLS:
        name = re.sub(rf"(?<![A-Za-z]){plain}(?![A-Za-z])", pretty, name)
    name = name.removesuffix(" at the output")
    return name.replace("*", "·").replace("^2", "²").replace("^3", "³")


class Scale:
    """A factor to a unit that reads well; the unit is empty for a pure number."""

    def __init__(self, factor: float, unit: str) -> None:
        self.factor = factor
        self.unit = "" if unit == "1" else unit

    def text(self, value: float, digits: int = 3) -> str:
        """Return a number of the model's unit in this one, with the unit."""
        number = significant(value * self.factor, digits)
        joined = "·" if self.unit.startswith("10") else " "
        return f"{number}{joined}{self.unit}" if self.unit else number

    @property
    def bracketed(self) -> str:
        """The unit in brackets, for axes and heads."""
        return f"[{self.unit or '-'}]"


def scale_of(unit: str, sizes: Iterable[float]) -> Scale:
    """Return the unit in which numbers of some sizes read well; the largest decides."""
    finite = [abs(size) for size in sizes if math.isfinite(size)]
    largest = max(finite, default=1.0)
    match = re.match(r"([^\W\d_]+)(?=$|/|·)", unit)
    prefixed = match is not None and match.group(1) in PREFIXED
    if not 0.0 < largest < (STEPS_DOWN[-1][0] if prefixed else PLAIN_BELOW):
        return Scale(1.0, unit)
    for below, factor, prefix, power in STEPS_DOWN:
        if largest < below:
            plain = power if unit == "1" else f"{power} {unit}"
            return Scale(factor, f"{prefix}{unit}" if prefixed else plain)
    return Scale(1.0, unit)


def typical(sizes: Iterable[float]) -> float:
    """Return the geometric mean of sizes that differ by much; 1 where none is known."""
    known = [math.log(size) for size in sizes if math.isfinite(size) and size > 0.0]
    return math.exp(sum(known) / len(known)) if known else 1.0
