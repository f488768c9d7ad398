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


def _hinge(phi: FloatArray, sign: str | None, at: str | None) -> FloatArray:
    return np.maximum(phi + (1.0 if sign == "+" else -1.0) * float(at or 0.0), 0.0)


# How names look, and the function of φ and of what the brackets of the pattern hold.
_RULES: dict[str, Callable[..., FloatArray]] = {
    r"1": np.ones_like,
    rf"phi(?:\^{_EXPONENT})?": _power,
    rf"phi(?:\^{_EXPONENT})?\[phi<0\]": lambda phi, n: np.where(phi < 0.0, _power(phi, n), 0.0),
    rf"relu\(phi(?:([-+])({_NUMBER}))?\)": _hinge,
    rf"exp\(-phi/({_NUMBER})\)": lambda phi, scale: np.exp(-phi / float(scale)),
    rf"min\(phi,({_NUMBER})\)": lambda phi, top: np.minimum(phi, float(top)),
    rf"clip\(phi-({_NUMBER}),0,({_NUMBER})\)": lambda phi, low, high: np.clip(
        phi - float(low), 0.0, float(high)
    ),
}


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
        function, held = rule
        columns.append(function(points, *held))
    return np.column_stack(columns) if columns else np.zeros((points.size, 0))


def _rule(name: str) -> tuple[Callable[..., FloatArray], tuple[str | None, ...]] | None:
    for pattern, function in _RULES.items():
        if match := re.fullmatch(pattern, name):
            return function, match.groups()
    return None
