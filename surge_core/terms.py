"""Names of terms in the field's letters: ``psi_p phi^2`` is ψ' φ²."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

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
