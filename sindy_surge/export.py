"""The identified equation as code: source that needs numpy alone, and a function to integrate."""

from __future__ import annotations

import keyword
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from sindy_surge.text import FUNCTIONS, EquationParts, formula, symbol_of
from surge_core.errors import InputError
from surge_core.types import FloatArray

if TYPE_CHECKING:
    import sympy

__all__ = ["RateFunction", "TermValues", "python_source"]

# From the inputs (n, n_inputs), delayed already, and ψ' (n,) to the terms (n, n_terms) in order.
TermValues = Callable[[FloatArray, FloatArray], FloatArray]

# Names the written module needs for itself.
_RESERVED = FUNCTIONS | {"numpy", "characteristic", "rate", "right_side"}
# A knot is named with 12 digits; a term that is something else differs by far more.
_SAME = 1e-9
_PROBES = 64


@dataclass(frozen=True)
class RateFunction:
    """The fitted dψ'/dt = (Σ β_i s_i(φ(t − d), ψ') − ψ')/τ, to be called or integrated.

    Parameters
    ----------
    parts : EquationParts
        The equation; not a static one.
    evaluate : callable
        From inputs (n, n_inputs) and ψ' (n,) to the terms (n, n_terms) of `parts`.
    """

    parts: EquationParts
    evaluate: TermValues

    def __call__(self, psi_p: ArrayLike, *inputs: ArrayLike) -> Any:
        """Return dψ'/dt in 1/s, of the common shape of the arguments.

        Parameters
        ----------
        psi_p : float or array-like
            Pressure coefficient now.
        *inputs : float or array-like
            φ, or every input in the order of the columns, the dead time `parts.dead_time_s` ago.
        """
        names = self.parts.input_names
        if len(inputs) != len(names):
            raise InputError(
                "inputs",
                expected=f"one argument for each of {', '.join(names)}",
                found=f"{len(inputs)}",
            )
        state, *columns = np.broadcast_arrays(
            *(np.asarray(value, dtype=np.float64) for value in (psi_p, *inputs))
        )
        flat = state.ravel()
        values = self.evaluate(np.column_stack([column.ravel() for column in columns]), flat)
        rates = (values @ np.array(self.parts.coef) - flat) / self.parts.time_constant_s
        return rates.reshape(state.shape) if state.ndim else float(rates[0])


def python_source(parts: EquationParts, evaluate: TermValues, feature_range: FloatArray) -> str:
    """Write a module that needs numpy alone: constants, `characteristic` and `rate`.

    The numbers keep every digit. Each term is checked against the library, for a name may not
    say all: behind a scaler, ``phi^2`` is the square of something else.

    Parameters
    ----------
    parts : EquationParts
        The equation.
    evaluate : callable
        From inputs (n, n_inputs) and ψ' (n,) to the terms (n, n_terms) of `parts`.
    feature_range : ndarray of shape (2, n_inputs)
        Least and greatest value of each input for that check.

    Returns
    -------
    str
        ``characteristic(phi)`` is ψ'_QS, left out where a term holds ψ'; ``rate(psi_p, phi)`` is
        dψ'/dt in 1/s of φ DEAD_TIME_S ago, left out of a static fit. Columns whose names are no
        Python names are called x0, x1, …

    Raises
    ------
    InputError
        If a term cannot be written as code, or is not what its name says.
    """
    import sympy
    from sympy.printing.numpy import NumPyPrinter

    class Printer(NumPyPrinter):
        def _print_Max(self, expr: sympy.Max) -> str:
            return f"numpy.maximum({', '.join(map(self._print, expr.args))})"

    expressions = _checked(parts, evaluate, feature_range)
    codes = {name: _identifier(name, number) for number, name in enumerate(parts.names)}
    symbols = {symbol_of(name): sympy.Symbol(code, real=True) for name, code in codes.items()}
    state, inputs = codes[parts.output_name], ", ".join(codes[n] for n in parts.input_names)
    printer = Printer({"fully_qualified_modules": True})
    total = "\n        + ".join(
        f"{value!r} * {printer.doprint(one.xreplace(symbols))}"
        for value, one in zip(parts.coef, expressions, strict=True)
    )
    held = any(symbol_of(parts.output_name) in one.free_symbols for one in expressions)
    source = _MODULE.format(
        tau="numpy.nan" if parts.is_static else repr(float(parts.time_constant_s)),
        dead=repr(float(parts.dead_time_s)),
        state=state,
        inputs=inputs,
        total=total or "0.0",
        first=inputs.split(",")[0],
    )
    if not held:
        source += _CHARACTERISTIC.format(state=state, inputs=inputs)
    return source if parts.is_static else source + _RATE.format(state=state, inputs=inputs)


_MODULE = """\
\"\"\"Lag model tau dpsi'/dt + psi' = psi'_QS; times in s, phi and psi' without unit.\"\"\"

import numpy

TIME_CONSTANT_S = {tau}
DEAD_TIME_S = {dead}


def right_side({state}, {inputs}):
    \"\"\"Return the sum of the terms.\"\"\"
    return (
        {total}
        + 0.0 * {first}
    )
"""

_CHARACTERISTIC = """

def characteristic({inputs}):
    \"\"\"Return the quasi-steady psi'_QS: the psi' at rest.\"\"\"
    return right_side(0.0, {inputs})
"""

_RATE = """

def rate({state}, {inputs}):
    \"\"\"Return dpsi'/dt in 1/s from {inputs} as of DEAD_TIME_S ago.\"\"\"
    return (right_side({state}, {inputs}) - {state}) / TIME_CONSTANT_S
"""


def _identifier(name: str, number: int) -> str:
    usable = name.isascii() and name.isidentifier() and not keyword.iskeyword(name)
    return name if usable and name not in _RESERVED else f"x{number}"


def _checked(
    parts: EquationParts, evaluate: TermValues, feature_range: FloatArray
) -> list[sympy.Expr]:
    """Read the terms, and refuse one whose name does not say what its values are."""
    from sympy import lambdify

    rng = np.random.default_rng(0)
    low, high = np.asarray(feature_range, dtype=np.float64)
    inputs = low + (high - low) * rng.uniform(size=(_PROBES, low.size))
    psi_p = rng.uniform(-1.0, 1.0, _PROBES)
    symbols = [symbol_of(name) for name in parts.names]
    expressions = []
    for term, values in zip(parts.terms, evaluate(inputs, psi_p).T, strict=True):
        one = formula(term, parts.names)
        if one is not None:
            with np.errstate(all="ignore"):
                written = lambdify(symbols, one)(*inputs.T, psi_p)
            if np.all(np.abs(written - values) <= _SAME * np.max(np.abs(values))):
                expressions.append(one)
                continue
        raise InputError(
            f"term {term!r}",
            expected="powers, products and named functions of the inputs, as its name says",
            found="a name that cannot be written as code"
            if one is None
            else "other values from the library",
            remedy="use the estimator's own `characteristic` (a scaler before the terms, or a "
            "function under another's name, does not show in the source)",
        )
    return expressions
