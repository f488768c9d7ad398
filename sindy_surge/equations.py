"""The identified equation as text, as LaTeX or as Python, rounded to its uncertainty."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

__all__ = ["format_equation", "format_uncertain"]

_SUPERSCRIPTS = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")


def format_uncertain(value: float, stderr: float) -> str:
    """Round a value to its standard error, in the notation of the Particle Data Group.

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
    str
        For example ``1.21(4)`` for 1.21 ± 0.04, ``47.4(1.2)`` for 47.4 ± 1.2.
    """
    if not (math.isfinite(value) and math.isfinite(stderr)) or stderr <= 1e-12 * abs(value):
        return f"{value:.6g}"
    exponent = math.floor(math.log10(stderr))
    leading = stderr / 10.0**exponent
    digits = -exponent + (1 if leading < 3.55 else 0)
    if digits <= 0:
        step = 10.0**-digits
        return f"{round(value / step) * step:.0f}({round(stderr / step) * step:.0f})"
    rounded = f"{value:.{digits}f}"
    error = round(stderr * 10**digits)
    if error >= 10 and stderr >= 1:
        return f"{rounded}({stderr:.{digits}f})"
    return f"{rounded}({error})"


def _pretty(term: str, style: str) -> str:
    if style == "latex":
        term = re.sub(r"\^(\d+)", r"^{\1}", term).replace(" ", r"\,")
        term = re.sub(r"\bphi\b", r"\\varphi ", term)
        term = re.sub(r"\[([^\]]*)\]", r"\\,[\1]", term)
        return re.sub(r"\b(relu|exp)\(", r"\\operatorname{\1}(", term).replace(" }", "}")
    term = re.sub(r"\bphi\b", "φ", term)
    return re.sub(r"\^(\d+)", lambda m: m.group(1).translate(_SUPERSCRIPTS), term)


def _sum(terms: Sequence[str], coef: Sequence[float], stderr: Sequence[float], style: str) -> str:
    parts: list[str] = []
    for term, value, error in zip(terms, coef, stderr, strict=True):
        number = format_uncertain(abs(value), error)
        # A leading minus for the first term, a binary sign for every other.
        sign = ("−" if style == "text" else "-") if value < 0 else "+"
        glue = f" {sign} " if parts else ("" if value >= 0 else sign)
        factor = "" if term == "1" else (" " if style == "text" else r"\,") + _pretty(term, style)
        parts.append(f"{glue}{number}{factor}")
    return "".join(parts) or "0"


def format_equation(
    terms: Sequence[str],
    coef: Sequence[float],
    stderr: Sequence[float],
    time_constant_s: float,
    time_constant_stderr_s: float,
    style: str = "text",
) -> str:
    """Write τ dψ'/dt + ψ' = Σ β_i s_i(φ) with its numbers.

    Parameters
    ----------
    terms : sequence of str
        Names of the terms.
    coef, stderr : sequence of float
        Coefficients and their standard errors.
    time_constant_s, time_constant_stderr_s : float
        τ and its standard error in seconds; nan leaves the derivative out.
    style : {"text", "latex", "python"}
        How to write it; "python" gives the source of a function of φ that returns ψ'_QS, with
        every digit.

    Returns
    -------
    str
        The equation, with units.
    """
    if style == "python":
        return _python(terms, coef, time_constant_s)
    right = _sum(terms, coef, stderr, style)
    tau = format_uncertain(time_constant_s, time_constant_stderr_s)
    if style == "latex":
        left = (
            r"\psi'"
            if math.isnan(time_constant_s)
            else (rf"{tau}\,\mathrm{{s}}\,\frac{{\mathrm{{d}}\psi'}}{{\mathrm{{d}}t}} + \psi'")
        )
        return f"{left} = {right}"
    left = "ψ'" if math.isnan(time_constant_s) else f"{tau} s · dψ'/dt + ψ'"
    units = "ψ' dimensionless" if math.isnan(time_constant_s) else "ψ' dimensionless, t in s"
    if any(re.search(r"\bphi\b", term) for term in terms):
        units = "φ, " + units
    return f"{left} = {right}   [{units}]"


def _python(terms: Sequence[str], coef: Sequence[float], time_constant_s: float) -> str:
    inputs = sorted(
        {w for t in terms for w in re.findall(r"[A-Za-z_]\w*", t)} - {"relu", "exp"}
    ) or ["phi"]
    factors = []
    for term, value in zip(terms, coef, strict=True):
        code = re.sub(r"(\w|\))\s+(?=[A-Za-z_])", r"\1 * ", term).replace("^", "**")
        code = re.sub(r"\brelu\(([^()]*)\)", r"np.maximum(\1, 0.0)", code)
        code = re.sub(r"\[([^\]]*)\]", r" * (\1)", code)
        code = re.sub(r"\bexp\(", "np.exp(", code)
        factors.append(f"{float(value)!r} * {code}" if term != "1" else repr(float(value)))
    tau = "np.nan" if math.isnan(time_constant_s) else repr(float(time_constant_s))
    body = "\n        + ".join(factors) or "0.0"
    return (
        "import numpy as np\n\n"
        f"TIME_CONSTANT_S = {tau}\n\n\n"
        f"def characteristic({', '.join(inputs)}):\n"
        f'    """Return the quasi-steady ψ\'_QS (dimensionless)."""\n'
        f"    return (\n        {body}\n    )\n"
    )
