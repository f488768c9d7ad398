"""The identified equation as code: source that needs numpy alone, and a function to integrate."""

from __future__ import annotations

import ast
import keyword
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sindy_surge.candidate_terms import CandidateTerms
from sindy_surge.equations import FUNCTIONS, EquationParts, read_term, require_rate
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["RateFunction", "SelectedTerms", "TermValues", "python_source"]

# From ψ' (n,) and the inputs (n, n_inputs), delayed already, to the terms (n, n_terms) in order.
TermValues = Callable[[FloatArray, FloatArray], FloatArray]

# Names the written module needs for itself.
_RESERVED = {"np", "characteristic", "rate", "right_side", "gap", "slope"}
# A knot is named with 12 digits; a term that is something else differs by far more.
_SAME = 1e-9
_PROBES = 64


@dataclass(frozen=True)
class SelectedTerms:
    """Evaluate chosen terms of a library.

    Parameters
    ----------
    candidates : CandidateTerms
        The library, its terms with ψ' in ψ' itself.
    columns : tuple of int
        The columns chosen.
    """

    candidates: CandidateTerms
    columns: tuple[int, ...]

    def __call__(self, psi_p: FloatArray, inputs: FloatArray) -> FloatArray:
        """Return the chosen terms.

        Parameters
        ----------
        psi_p : ndarray of shape (n,)
            Pressure coefficient.
        inputs : ndarray of shape (n, n_inputs)
            The inputs.

        Returns
        -------
        ndarray of shape (n, n_terms)
            The terms.
        """
        rising = sorted(self.columns)
        values = self.candidates(inputs, psi_p, rising)
        return values[:, [rising.index(column) for column in self.columns]]


@dataclass(frozen=True)
class RateFunction:
    """The fitted dψ'/dt = (Σ β_i s_i(φ(t − d), ψ') − ψ')/τ, to be called or integrated.

    Parameters
    ----------
    parts : EquationParts
        The equation; not a static one.
    evaluate : callable
        From ψ' (n,) and inputs (n, n_inputs) to the terms (n, n_terms) of `parts`.
    """

    parts: EquationParts
    evaluate: TermValues

    def __post_init__(self) -> None:
        """Refuse a static fit."""
        require_rate(self.parts)

    def __call__(self, psi_p: ArrayLike, *inputs: ArrayLike) -> Any:
        """Return dψ'/dt.

        Parameters
        ----------
        psi_p : float or array-like
            Pressure coefficient now.
        *inputs : float or array-like
            φ, or every input in the order of the columns, the dead time `parts.dead_time_s` ago;
            they broadcast with `psi_p`.

        Returns
        -------
        float or ndarray
            dψ'/dt in 1/s, of the common shape.

        Raises
        ------
        InputError
            If there is not one argument for each input.
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
        values = self.evaluate(flat, np.column_stack([column.ravel() for column in columns]))
        rates = (values @ np.array(self.parts.coef) - flat) / self.parts.time_constant_s
        return rates.reshape(state.shape) if state.ndim else float(rates[0])


def python_source(
    parts: EquationParts,
    evaluate: TermValues | None = None,
    feature_range: ArrayLike | None = None,
) -> str:
    """Write a module that needs numpy alone: constants, `characteristic` and `rate`.

    The numbers keep every digit. With `evaluate`, each term is checked against the library, for
    a name may not say all: behind a scaler, ``phi^2`` is the square of something else.

    Parameters
    ----------
    parts : EquationParts
        The equation.
    evaluate : callable or None
        From ψ' (n,) and inputs (n, n_inputs) to the terms (n, n_terms) of `parts`.
    feature_range : array-like of shape (2, n_inputs) or None
        Least and greatest value of each input for that check; None takes 0 to 1.

    Returns
    -------
    str
        ASCII source. ``characteristic(phi)`` is ψ'_QS, with terms in ψ' the ψ' at rest;
        ``rate(psi_p, phi)`` is dψ'/dt in 1/s of φ DEAD_TIME_S ago, left out of a static fit.
        Column names that are no Python names are renamed, with a comment.

    Raises
    ------
    InputError
        If a term cannot be written as code, or is not what its name says.
    """
    arguments = _identifiers(parts)
    codes = [_expression(term, arguments) for term in parts.terms]
    if evaluate is not None:
        _check(parts, codes, arguments, evaluate, feature_range)
    inputs = [arguments[name] for name in parts.input_names]
    state = arguments[parts.output_name]
    renamed = [
        f"# The column {name!a} is called {code} here.\n"
        for name, code in arguments.items()
        if name != code
    ]
    reads_state = any(_reads(code, state) for code in codes)
    functions = (
        _with_state(parts, codes, state, inputs)
        if reads_state
        else _without_state(parts, codes, state, inputs)
    )
    return (
        '"""Lag model tau dpsi\'/dt + psi\' = psi\'_QS; times in s, phi and psi\' without unit."""'
        "\n\nimport numpy as np\n\n"
        + "".join(renamed)
        + f"TIME_CONSTANT_S = {_literal(parts.time_constant_s)}\n"
        + f"DEAD_TIME_S = {_literal(parts.dead_time_s)}\n"
        + "".join(f"\n\n{function}" for function in functions)
    )


def _identifiers(parts: EquationParts) -> dict[str, str]:
    """Give every input and ψ' a name that Python and any editor's encoding can take."""
    names = (*parts.input_names, parts.output_name)
    if len(set(names)) < len(names):
        raise InputError(
            "names of the inputs",
            expected=f"different names, none of them {parts.output_name!r}",
            found=", ".join(map(repr, parts.input_names)),
            remedy="rename the columns, or use the estimator's own `characteristic`",
        )
    good = {name: name for name in names if _is_identifier(name)}
    for number, name in enumerate(names):
        if name not in good:
            stem = "psi_p" if name == parts.output_name else f"x{number}"
            while stem in good.values():
                stem += "_"
            good[name] = stem
    return {name: good[name] for name in names}


def _is_identifier(name: str) -> bool:
    plain = name.isascii() and name.isidentifier() and not name.startswith("__")
    return plain and not keyword.iskeyword(name) and name not in _RESERVED | set(FUNCTIONS)


def _expression(term: str, arguments: Mapping[str, str]) -> ast.expr:
    """Return the syntax tree of a term; nothing but known names, numbers and functions is in it."""
    tokens = read_term(term, tuple(arguments))
    try:
        if not tokens:
            raise SyntaxError
        parsed = ast.parse(_python_words(tokens, arguments), mode="eval").body
        tree: ast.expr = ast.fix_missing_locations(_Formula().visit(parsed))
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise InputError(
            f"term {term!r}",
            expected="powers, products and named functions of the inputs",
            found="a name that cannot be written as code",
            remedy="use the estimator's own `characteristic`, or name the term by its formula",
        ) from None
    return tree


def _python_words(tokens: list[tuple[Any, str]], arguments: Mapping[str, str]) -> str:
    """Write the tokens in Python: ``^`` as a power, brackets as a condition, spaces as products."""
    plain = {"^": "**", "[": "(", "]": ")"}
    words: list[str] = []
    in_bars = False
    operand_before = False
    for kind, text in tokens:
        if kind == "space":
            continue
        closes = text in (")", "]") or (text == "|" and in_bars)
        opens = kind != "operator" or text in ("(", "[") or (text == "|" and not in_bars)
        if operand_before and opens:
            words.append("*")
        if kind == "name":
            words.append(arguments[text])
        elif kind == "function":
            words.append("relu" if text == "relu" else f"np.{text}")
        elif text == "|":
            words.append(")" if in_bars else "np.abs(")
            in_bars = not in_bars
        else:
            words.append(plain.get(text, text))
        operand_before = kind in ("name", "number") or closes
    return " ".join(words)


class _Formula(ast.NodeTransformer):
    """Let formulas through, one argument to a function, and write relu(x) as np.maximum(x, 0.0)."""

    _allowed = (
        *(ast.BinOp, ast.UnaryOp, ast.Compare, ast.Call, ast.Name, ast.Attribute, ast.Constant),
        *(ast.operator, ast.unaryop, ast.cmpop, ast.expr_context),
    )

    def generic_visit(self, node: ast.AST) -> ast.AST:
        """Refuse what is no part of a formula; numpy cannot chain comparisons either."""
        chained = isinstance(node, ast.Compare) and len(node.ops) > 1
        if chained or not isinstance(node, self._allowed):
            raise SyntaxError
        return super().generic_visit(node)

    def visit_Call(self, node: ast.Call) -> ast.AST:
        """Replace the one call that numpy does not know."""
        if len(node.args) != 1:
            raise SyntaxError
        self.generic_visit(node)
        if isinstance(node.func, ast.Name):
            maximum = ast.Attribute(ast.Name("np", ast.Load()), "maximum", ast.Load())
            return ast.Call(maximum, [*node.args, ast.Constant(0.0)], [])
        return node


def _check(
    parts: EquationParts,
    codes: list[ast.expr],
    arguments: Mapping[str, str],
    evaluate: TermValues,
    feature_range: ArrayLike | None,
) -> None:
    """Compare every term's code with the library at points over the range."""
    size = len(parts.input_names)
    low, high = np.asarray(
        [[0.0] * size, [1.0] * size] if feature_range is None else feature_range, dtype=np.float64
    )
    rng = np.random.default_rng(0)
    inputs = low + (high - low) * rng.uniform(size=(_PROBES, size))
    psi_p = rng.uniform(-1.0, 1.0, _PROBES)
    values = np.asarray(evaluate(psi_p, inputs), dtype=np.float64)
    points = {arguments[n]: inputs[:, j] for j, n in enumerate(parts.input_names)}
    points[arguments[parts.output_name]] = psi_p
    for number, (term, code) in enumerate(zip(parts.terms, codes, strict=True)):
        written = _value(code, points)
        scale = float(np.max(np.abs(values[:, number]), initial=0.0))
        if not np.all(np.abs(written - values[:, number]) <= _SAME * max(scale, 1e-300)):
            raise InputError(
                f"term {term!r}",
                expected="a term that is what its name says",
                found="other values from the library",
                remedy="use the estimator's own `characteristic` (a scaler before the terms, or a "
                "function under another's name, does not show in the source)",
            )


def _value(code: ast.expr, points: Mapping[str, FloatArray]) -> FloatArray:
    # Only what `_expression` let through is evaluated: the arguments, numbers and numpy functions.
    compiled = compile(ast.Expression(code), "<term>", "eval")
    with np.errstate(all="ignore"):
        return np.asarray(eval(compiled, {"np": np, "__builtins__": {}}, dict(points)))


def _reads(code: ast.expr, name: str) -> bool:
    return any(isinstance(node, ast.Name) and node.id == name for node in ast.walk(code))


def _literal(value: float) -> str:
    return repr(float(value)) if np.isfinite(value) else f'float("{float(value)}")'


def _body(parts: EquationParts, codes: list[ast.expr], arguments: list[str]) -> str:
    lines = [f"    {name} = np.asarray({name}, dtype=float)\n" for name in arguments]
    factors = [
        _literal(value)
        if isinstance(code, ast.Constant) and code.value == 1
        else ast.unparse(ast.BinOp(ast.parse(_literal(value), mode="eval").body, ast.Mult(), code))
        for value, code in zip(parts.coef, codes, strict=True)
    ]
    if not any(_reads(code, name) for code in codes for name in arguments):
        # A constant is as long as what it is asked for.
        factors.append(f"np.zeros(np.shape({arguments[0]}))")
    joined = "\n        + ".join(factors)
    return "".join(lines) + f"    return (\n        {joined}\n    )\n"


def _without_state(
    parts: EquationParts, codes: list[ast.expr], state: str, inputs: list[str]
) -> list[str]:
    arguments = ", ".join(inputs)
    functions = [
        f"def characteristic({arguments}):\n"
        '    """Return the quasi-steady psi\'_QS."""\n' + _body(parts, codes, inputs)
    ]
    if not parts.is_static:
        functions.append(
            f"def rate({state}, {arguments}):\n"
            f'    """Return dpsi\'/dt in 1/s from {arguments} as of DEAD_TIME_S ago."""\n'
            f"    return (characteristic({arguments}) - {state}) / TIME_CONSTANT_S\n"
        )
    return functions


def _with_state(
    parts: EquationParts, codes: list[ast.expr], state: str, inputs: list[str]
) -> list[str]:
    arguments = ", ".join(inputs)
    step = 1e-6  # of ψ', which is of order one
    functions = [
        f"def right_side({state}, {arguments}):\n"
        '    """Return the sum of the terms in phi and psi\'."""\n'
        + _body(parts, codes, [state, *inputs]),
        f"def characteristic({arguments}):\n"
        '    """Return the psi\' at rest that Newton finds from psi\' = 0; nan if none."""\n'
        '    with np.errstate(all="ignore"):\n'
        f"        {state} = right_side(0.0, {arguments})\n"
        "        for _ in range(60):\n"
        f"            gap = right_side({state}, {arguments}) - {state}\n"
        f"            slope = right_side({state} + {step}, {arguments})\n"
        f"            slope = slope - right_side({state} - {step}, {arguments})\n"
        f"            {state} = {state} - gap / (slope / {2 * step} - 1.0)\n"
        f"        gap = right_side({state}, {arguments}) - {state}\n"
        f"        return np.where(np.abs(gap) < 1e-9 * (1.0 + np.abs({state})), {state}, np.nan)\n",
    ]
    if not parts.is_static:
        functions.insert(
            1,
            f"def rate({state}, {arguments}):\n"
            f'    """Return dpsi\'/dt in 1/s from {arguments} as of DEAD_TIME_S ago."""\n'
            f"    return (right_side({state}, {arguments}) - {state}) / TIME_CONSTANT_S\n",
        )
    return functions
