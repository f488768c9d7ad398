"""Names of terms and the functions of φ they stand for, without ever executing a name."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from surge_core.errors import InputError
from surge_core.types import FloatArray

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
# A power is made by multiplying: of one with more digits a file would wait for ever.
_EXPONENT = r"(\d{1,2})"


def _power(phi: FloatArray, exponent: str | None) -> FloatArray:
    # By multiplication: numpy's power is ten times slower from the cube on.
    out = phi
    for _ in range(int(exponent or 1) - 1):
        out = out * phi
    return out


_Rule = tuple[re.Pattern[str], Callable[[FloatArray, re.Match[str]], FloatArray]]
_RULES: tuple[_Rule, ...] = (
    (re.compile(r"1"), lambda phi, _: np.ones_like(phi)),
    (re.compile(rf"phi(?:\^{_EXPONENT})?"), lambda phi, m: _power(phi, m[1])),
    (
        re.compile(rf"phi(?:\^{_EXPONENT})?\[phi<0\]"),
        lambda phi, m: np.where(phi < 0.0, _power(phi, m[1]), 0.0),
    ),
    (
        re.compile(rf"relu\(phi(?:([-+])({_NUMBER}))?\)"),
        lambda phi, m: np.maximum(phi - _hinge_at(m), 0.0),
    ),
    (
        re.compile(rf"exp\(-phi/({_NUMBER})\)"),
        lambda phi, m: np.exp(-phi / float(m[1])),
    ),
    (re.compile(rf"min\(phi,({_NUMBER})\)"), lambda phi, m: np.minimum(phi, float(m[1]))),
    (
        re.compile(rf"clip\(phi-({_NUMBER}),0,({_NUMBER})\)"),
        lambda phi, m: np.clip(phi - float(m[1]), 0.0, float(m[2])),
    ),
)


def _hinge_at(match: re.Match[str]) -> float:
    return (-1.0 if match[1] == "+" else 1.0) * float(match[2] or 0.0)


def is_known_term(name: str) -> bool:
    """Tell whether a name is one whose function is known.

    Parameters
    ----------
    name : str
        E.g. ``"phi^2"``, ``"relu(phi-0.05)"``, ``"phi^2[phi<0]"``.
    """
    return _rule(name) is not None


def evaluate_terms(names: list[str], phi: ArrayLike) -> FloatArray:
    """Return the terms s_i(φ), of shape (n, n_terms).

    Parameters
    ----------
    names : list of str
        Names of the terms.
    phi : array-like of shape (n,)
        Flow coefficient.

    Raises
    ------
    InputError
        For a name whose function is not known.
    """
    points = np.asarray(phi, dtype=np.float64)
    columns = []
    for name in names:
        rule = _rule(name)
        if rule is None:
            raise InputError(
                f"term {name}",
                expected="1, phi, phi^2, relu(phi-0.05), phi^2[phi<0], exp(-phi/0.1), "
                "min(phi,0.1) or clip(phi-0.1,0,0.2)",
                found="a name of another form",
            )
        columns.append(rule(points))
    return np.column_stack(columns) if columns else np.zeros((points.size, 0))


def _rule(name: str) -> Callable[[FloatArray], FloatArray] | None:
    for pattern, function in _RULES:
        match = pattern.fullmatch(name)
        if match is not None:
            return lambda phi, f=function, m=match: f(phi, m)  # type: ignore[misc]
    return None
