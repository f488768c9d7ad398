"""The identified equation as text, as LaTeX or as pysindy writes it, rounded to its uncertainty."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from surge_core.errors import InputError

__all__ = [
    "EquationParts",
    "format_uncertain",
    "pretty_term",
    "pysindy_equations",
    "read_term",
    "round_to_error",
    "write_equation",
]

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
# Beyond these a number is easier read with a power of ten.
_PLAIN_RANGE = (1e-4, 1e6)
# Below this a float has lost its digits: the value is taken as exact.
_SMALLEST_ERROR = 1e-300

# What a term's name may call, and how LaTeX names it.
FUNCTIONS = {
    "relu": r"\operatorname{relu}",
    "abs": r"\operatorname{abs}",
    "sign": r"\operatorname{sign}",
    "sqrt": r"\operatorname{sqrt}",
    "exp": r"\exp",
    "log": r"\ln",
    "sin": r"\sin",
    "cos": r"\cos",
    "tan": r"\tan",
    "sinh": r"\sinh",
    "cosh": r"\cosh",
    "tanh": r"\tanh",
    "arctan": r"\arctan",
}
_GREEK = {"phi": ("φ", r"\varphi"), "psi_p": ("ψ'", r"{\psi'}"), "psi": ("ψ", r"\psi")}

Token = tuple[Literal["function", "name", "number", "operator", "space"], str]


@dataclass(frozen=True)
class EquationParts:
    """What the equation τ dψ'/dt + ψ' = Σ β_i s_i(φ(t − d), ψ') is written from.

    Parameters
    ----------
    terms : tuple of str
        Names s_i of the terms, in pysindy's manner; the lag's own ψ' is not among them.
    coef, stderr : tuple of float
        Coefficients β_i and their standard errors, in physical units.
    time_constant_s, time_constant_stderr_s : float
        τ and its standard error in seconds; nan for a static fit.
    dead_time_s, dead_time_stderr_s : float
        Dead time d of the inputs and its standard error in seconds. A d of 0 with an error of
        nan was not looked for and is not written.
    input_names : tuple of str
        Names of the inputs, in the order of their columns.
    output_name : str
        Name of ψ' in the terms.
    """

    terms: tuple[str, ...]
    coef: tuple[float, ...]
    stderr: tuple[float, ...]
    time_constant_s: float
    time_constant_stderr_s: float
    dead_time_s: float = 0.0
    dead_time_stderr_s: float = math.nan
    input_names: tuple[str, ...] = ("phi",)
    output_name: str = "psi_p"

    def __post_init__(self) -> None:
        """Take any sequences and keep plain values, which compare, hash and pickle."""
        for name in ("terms", "input_names"):
            object.__setattr__(self, name, tuple(str(value) for value in getattr(self, name)))
        for name in ("coef", "stderr"):
            object.__setattr__(self, name, tuple(float(value) for value in getattr(self, name)))
        if not len(self.terms) == len(self.coef) == len(self.stderr):
            raise InputError(
                "terms",
                expected="as many terms as coefficients and standard errors",
                found=f"{len(self.terms)}, {len(self.coef)} and {len(self.stderr)}",
            )

    @property
    def is_static(self) -> bool:
        """Whether the fit has no time constant."""
        return math.isnan(self.time_constant_s)

    @property
    def has_dead_time(self) -> bool:
        """Whether a dead time was fitted or given."""
        return self.dead_time_s != 0.0 or math.isfinite(self.dead_time_stderr_s)


def round_to_error(value: float, stderr: float) -> tuple[str, str]:
    """Round a value and its standard error as the Particle Data Group does.

    The error keeps two digits if they are 10 to 35, else one; a value with no usable error
    keeps six digits.

    Parameters
    ----------
    value : float
        The value.
    stderr : float
        Its standard error, in the same unit.

    Returns
    -------
    tuple of str
        Value and error with the same decimals, e.g. ``("1.21", "0.04")``; the error is empty
        where it is not known.
    """
    if not _usable(value, stderr):
        return f"{value:.6g}", "0" if stderr == 0 else ""
    exponent = _power_of_ten(value, stderr)
    scale = 10.0**exponent
    decimals = _decimals(stderr / scale)
    suffix = f"e{exponent:+03d}" if exponent else ""
    return (
        _fixed(value / scale, decimals) + suffix,
        _fixed(stderr / scale, decimals) + suffix,
    )


def format_uncertain(value: float, stderr: float) -> str:
    """Round a value to its standard error and write the error in its last digits.

    Parameters
    ----------
    value : float
        The value.
    stderr : float
        Its standard error, in the same unit.

    Returns
    -------
    str
        For example ``1.21(4)`` for 1.21 ± 0.04, ``47.4(1.2)`` for 47.4 ± 1.2, ``1.20(3)e-08``.
        Digits are kept as in `round_to_error`.
    """
    if not _usable(value, stderr):
        return f"{value:.6g}"
    exponent = _power_of_ten(value, stderr)
    scaled, error = value / 10.0**exponent, stderr / 10.0**exponent
    decimals = _decimals(error)
    text = _fixed(error, decimals)
    if decimals > 0 and error < 1:
        text = f"{round(error * 10**decimals)}"
    suffix = f"e{exponent:+03d}" if exponent else ""
    return f"{_fixed(scaled, decimals)}({text}){suffix}"


def _usable(value: float, stderr: float) -> bool:
    finite = math.isfinite(value) and math.isfinite(stderr)
    return finite and stderr > max(1e-12 * abs(value), _SMALLEST_ERROR)


def _power_of_ten(value: float, stderr: float) -> int:
    """Return the power of ten to write, 0 for numbers that are read well without one."""
    largest = max(abs(value), stderr)
    low, high = _PLAIN_RANGE
    return 0 if low <= largest < high else math.floor(math.log10(largest))


def _decimals(stderr: float) -> int:
    exponent = math.floor(math.log10(stderr))
    return -exponent + (1 if stderr / 10.0**exponent < 3.55 else 0)


def _fixed(value: float, decimals: int) -> str:
    return f"{round(value, decimals):.{max(decimals, 0)}f}"


def read_term(term: str, names: Sequence[str]) -> list[Token] | None:
    """Split the name of a term into inputs, numbers, functions and operators.

    Parameters
    ----------
    term : str
        Name of the term, e.g. ``phi^2[phi<0]``.
    names : sequence of str
        Names of the inputs and of ψ'; they may hold anything.

    Returns
    -------
    list of (kind, text) or None
        The tokens in order; None if something is none of these, e.g. ``f0(phi)``.
    """
    longest_first = sorted({name for name in names if name}, key=len, reverse=True)
    known = "|".join(_whole(name) for name in longest_first) or "(?!)"
    pattern = re.compile(
        rf"(?P<function>(?:{'|'.join(FUNCTIONS)})(?=\())|(?P<name>{known})"
        r"|(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)"
        r"|(?P<operator><=|>=|\*\*|[-+*/^()\[\]|<>])|(?P<space>\s+)"
    )
    tokens: list[Token] = []
    position = 0
    while position < len(term):
        match = pattern.match(term, position)
        if match is None:
            return None
        kind: Any = match.lastgroup
        tokens.append((kind, match.group()))
        position = match.end()
    return tokens


def _whole(name: str) -> str:
    """Match the name, not the beginning or end of a longer word."""
    before = r"(?<!\w)" if re.match(r"\w", name) else ""
    after = r"(?!\w)" if re.search(r"\w\Z", name) else ""
    return before + re.escape(name) + after


def pretty_term(term: str) -> str:
    """Write a term with φ, ψ' and raised exponents.

    Parameters
    ----------
    term : str
        Name of the term, e.g. ``psi_p phi^2``.

    Returns
    -------
    str
        E.g. ``ψ' φ²``.
    """
    term = " ".join(term.split())
    for name, (symbol, _) in _GREEK.items():
        term = re.sub(rf"\b{name}\b", symbol, term)
    return re.sub(r"\^(-?\d+)(?![\d.])", lambda m: m.group(1).translate(_SUPERSCRIPTS), term)


def _latex_name(name: str) -> str:
    if name in _GREEK:
        return _GREEK[name][1]
    escaped = re.sub(r"([#$%&_{}])", r"\\\1", " ".join(name.replace("\\", " ").split()))
    escaped = re.sub(r"[~^]", lambda m: rf"\{m.group()}{{}}", escaped)
    return rf"\text{{{escaped}}}"


def _latex_term(term: str, names: Sequence[str]) -> str:
    tokens = read_term(term, names)
    if tokens is None:
        return _latex_name(term)
    operators = {"*": r"\,", "**": "^", "<=": r"\le ", ">=": r"\ge ", "[": r"\,["}
    written, raised = [], False
    for kind, text in tokens:
        if kind == "function":
            written.append(FUNCTIONS[text])
        elif kind == "name":
            written.append(_latex_name(text))
        elif kind == "space":
            written.append(r"\,")
        elif kind == "number":
            written.append(f"{{{text}}}" if raised else text)
        else:
            written.append(operators.get(text, text))
        raised = text in ("^", "**")
    return "".join(written)


def _sum(parts: EquationParts, style: str) -> str:
    names = (*parts.input_names, parts.output_name)
    written: list[str] = []
    for term, value, error in zip(parts.terms, parts.coef, parts.stderr, strict=True):
        number = format_uncertain(abs(value), error)
        # A leading minus for the first term, a binary sign for every other.
        sign = ("−" if style == "text" else "-") if value < 0 else "+"
        glue = f" {sign} " if written else ("" if value >= 0 else sign)
        if style == "latex":
            number = _latex_number(number)
            factor = r"\," + _latex_term(term, names)
        else:
            factor = " " + pretty_term(term)
        written.append(f"{glue}{number}{'' if term == '1' else factor}")
    return "".join(written) or "0"


def _latex_number(text: str) -> str:
    return re.sub(r"e([+-]\d+)$", lambda m: rf"\times 10^{{{int(m.group(1))}}}", text)


def write_equation(parts: EquationParts, style: Literal["text", "latex"] = "text") -> str:
    """Write τ dψ'/dt + ψ' = Σ β_i s_i(φ(t − d), ψ') with its numbers, rounded to their errors.

    Parameters
    ----------
    parts : EquationParts
        Terms, coefficients and times.
    style : {"text", "latex"}
        How to write it. For source code see `sindy_surge.export.python_source`.

    Returns
    -------
    str
        The equation, with units.

    Raises
    ------
    InputError
        For another style.
    """
    if style == "latex":
        return _latex(parts)
    if style != "text":
        raise InputError("style", expected='"text" or "latex"', found=repr(style))
    tau = format_uncertain(parts.time_constant_s, parts.time_constant_stderr_s)
    output = pretty_term(parts.output_name)
    left = output if parts.is_static else f"{tau} s · d{output}/dt + {output}"
    delayed = ""
    if parts.has_dead_time:
        size = format_uncertain(abs(parts.dead_time_s), parts.dead_time_stderr_s)
        inputs = ", ".join(map(pretty_term, parts.input_names))
        delayed = f", with {inputs} at t {'−' if parts.dead_time_s >= 0 else '+'} {size} s"
    has_time = parts.has_dead_time or not parts.is_static
    units = f"{output} dimensionless" + (", t in s" if has_time else "")
    if any(re.search(r"\bphi\b", term) for term in parts.terms):
        units = "φ, " + units
    return f"{left} = {_sum(parts, style)}{delayed}   [{units}]"


def _latex(parts: EquationParts) -> str:
    tau = _latex_number(format_uncertain(parts.time_constant_s, parts.time_constant_stderr_s))
    output = {"psi_p": r"\psi'"}.get(parts.output_name, _latex_name(parts.output_name))
    left = output
    if not parts.is_static:
        slope = rf"\frac{{\mathrm{{d}}{output}}}{{\mathrm{{d}}t}}"
        left = rf"{tau}\,\mathrm{{s}}\,{slope} + {output}"
    text = f"{left} = {_sum(parts, 'latex')}"
    if parts.has_dead_time:
        dead = _latex_number(format_uncertain(parts.dead_time_s, parts.dead_time_stderr_s))
        inputs = r",\,".join(rf"{_latex_name(n)}={_latex_name(n)}(t-d)" for n in parts.input_names)
        text += rf",\quad {inputs},\quad d={dead}\,\mathrm{{s}}"
    return text


def pysindy_equations(parts: EquationParts, precision: int = 3, lhs: bool = False) -> list[str]:
    """Write dψ'/dt as ``SINDy.equations`` does: −ψ'/τ + Σ (β_i/τ) s_i, in 1/s.

    Every coefficient keeps `precision` decimals as in pysindy, and as many significant digits
    where the decimals alone would round it away.

    Parameters
    ----------
    parts : EquationParts
        Terms, coefficients and times.
    precision : int
        Decimals and least significant digits of a coefficient.
    lhs : bool
        Whether to write ``(psi_p)' =`` in front, as ``SINDy.print`` does.

    Returns
    -------
    list of str
        One equation, e.g. ``-55.556 psi_p + 19.444 1 + 66.667 phi``; a delayed input is
        written ``phi(t-0.002)``, t in seconds.

    Raises
    ------
    InputError
        For a static fit, which has no rate, or a precision below 1.
    """
    given: Any = precision
    if not (isinstance(given, (int, np.integer)) and given >= 1):
        raise InputError(
            "precision", expected="a whole number of at least 1", found=repr(precision)
        )
    require_rate(parts)
    rates = [(-1.0, parts.output_name)]
    rates += [
        (value, _delayed(term, parts)) for value, term in zip(parts.coef, parts.terms, strict=True)
    ]
    right = " + ".join(
        f"{_digits(value / parts.time_constant_s, precision)} {term}" for value, term in rates
    )
    return [f"({parts.output_name})' = {right}" if lhs else right]


def require_rate(parts: EquationParts) -> None:
    """Refuse a static fit where dψ'/dt is asked for.

    Parameters
    ----------
    parts : EquationParts
        The equation.

    Raises
    ------
    InputError
        If there is no time constant, or it is not positive.
    """
    if not parts.time_constant_s > 0:
        raise InputError(
            "time constant",
            expected="a positive one, for dψ'/dt",
            found="none, for the fit is static" if parts.is_static else f"{parts.time_constant_s}",
            remedy="`equation()` and `characteristic` give the curve; `fit_state_.advice` says "
            "why there is no lag",
        )


def _digits(value: float, precision: int) -> str:
    size = abs(value)
    if size == 0 or not math.isfinite(size):
        return f"{value:.{precision}f}"
    if size < _PLAIN_RANGE[0] or size >= 1e3 * _PLAIN_RANGE[1]:
        return f"{value:.{precision - 1}e}"
    return f"{value:.{max(precision, precision - 1 - math.floor(math.log10(size)))}f}"


def _delayed(term: str, parts: EquationParts) -> str:
    if not parts.dead_time_s:
        return term
    when = f"t{-parts.dead_time_s:+.6g}"
    tokens = read_term(term, (*parts.input_names, parts.output_name))
    if tokens is None:
        return f"({term})({when})"
    return "".join(
        f"{text}({when})" if kind == "name" and text in parts.input_names else text
        for kind, text in tokens
    )
