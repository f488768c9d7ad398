"""Terms in the field's letters, ``psi_p phi^2`` as ψ' φ², and sums of them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from surge_core.rounding import bracketed

_GREEK = {"phi": "φ", "psi_p": "ψ'", "psi": "ψ", "plenum": "Ψ"}
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def pretty_term(term: str) -> str:
    """Write a term with φ, ψ' and raised exponents: ``psi_p phi^2`` as ``ψ' φ²``."""
    term = " ".join(term.split())
    for name, symbol in _GREEK.items():
        term = re.sub(rf"\b{name}\b", symbol, term)
    term = re.sub(r"sqrt\(([φψΨ])\)", r"√\1", term)
    return re.sub(r"\^(-?\d+)(?![\d.])", lambda m: m.group(1).translate(_SUPERSCRIPTS), term)


def terms_json(
    names: Iterable[str], coefficients: Iterable[float], stderr: Iterable[float]
) -> list[dict[str, Any]]:
    """Return terms with their coefficients and standard errors, as every document has them."""
    return [
        {"name": name, "coefficient": float(value), "stderr": float(error)}
        for name, value, error in zip(names, coefficients, stderr, strict=True)
    ]


# An error below this share of the value is rounding: the value is taken as exact.
_EXACT = 1e-12


def uncertain(value: float, stderr: float) -> str:
    """Round a value to its standard error, e.g. ``1.21(4)``; six digits without one."""
    known = math.isfinite(value) and math.isfinite(stderr) and stderr > _EXACT * abs(value)
    return bracketed(value, stderr) if known else f"{value:.6g}"


def signed_sum(
    terms: Sequence[tuple[str, float, float]], named: Callable[[str], str] = pretty_term
) -> str:
    """Write a sum of terms (name, coefficient, standard error), each rounded to its error."""
    text = ""
    for name, value, error in terms:
        sign = "−" if value < 0 else "+"
        glue = f" {sign} " if text else ("−" if value < 0 else "")
        written = "" if name == "1" else " " + named(name)
        text += f"{glue}{uncertain(abs(value), error)}{written}"
    return text or "0"
