"""Terms without a name: what would be found where no name fits, and a user's own library."""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Callable
from functools import lru_cache

from comparisons.missing_effect.systems.model import Model
from comparisons.missing_effect.systems.places import Number, SystemEffect
from comparisons.missing_effect.systems.roles import PLACES, always, fixed
from comparisons.missing_effect.systems.shapes import Kind, Map, Term
from surge_core.errors import InputError, require

Expression = Callable[[Model], Callable[..., float]]
# A name in a term that is no function's.
NAME = re.compile(r"\b[^\W\d]\w*\b(?!\s*\()")
_FUNCTIONS = {
    name: getattr(math, name) for name in ("sin", "cos", "tan", "tanh", "exp", "log", "sqrt")
} | {"abs": abs}
_NODES = (
    ast.Expression, ast.BinOp, ast.UnaryOp, ast.Call, ast.Name, ast.Constant, ast.Load,
    ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Pow, ast.USub,
)  # fmt: skip


def _open(
    name: str,
    code: int,
    places: str,
    equation: str,
    *,
    kind: Kind = Kind.TERM,
    centred: bool = False,
    simple_form_of: tuple[str, ...] = (),
    expression: Expression | None = None,
) -> SystemEffect:
    return SystemEffect(
        f"open_{name}",
        kind,
        code,
        equation,
        "a term without a name",
        (Number("c", -50.0, 50.0),),
        PLACES[places],
        fixed([0.0]),
        always,
        "",
        unnamed=True,
        simple_form_of=simple_form_of,
        centred=centred,
        expression=expression,
    )


def _both(name: str, code: Term, places: str, equation: str) -> tuple[SystemEffect, ...]:
    """Return a term, and the same about the means of signals that keep their sign."""
    centred = f"centred_{name}"
    return (
        _open(name, code, places, equation, simple_form_of=(f"open_{centred}",)),
        _open(centred, code, places, equation, centred=True),
    )


# What a term in proportion may be taken for, where the model has none.
BENT_LAWS = (
    *("dead_zone", "quadratic_stiffness", "cubic_stiffness"),
    *("quadratic_drag", "softening_damping", "asymmetric_damping"),
)
# All terms up to degree three of one and two signals, and readings with a bend.
OPEN_TERMS: tuple[SystemEffect, ...] = (
    *_both("product", Term.PRODUCT, "on_products", "+ c {s}·{o}"),
    *_both("square_product", Term.SQUARE_PRODUCT, "on_square_products", "+ c {s}²·{o}"),
    _open("linear", Term.LINEAR, "on_signals", "+ c {s}", simple_form_of=BENT_LAWS),
    *_both("square", Term.SQUARE, "on_signals", "+ c {s}²"),
    *_both("cube", Term.CUBE, "on_signals", "+ c {s}³"),
    _open("reading_square", Map.SQUARE, "at_outputs", "y + c y²", kind=Kind.OUTPUT_MAP),
    _open("reading_cube", Map.CUBE, "at_outputs", "y + c y³", kind=Kind.OUTPUT_MAP),
)


def open_effect(written: str, function: Callable[..., float] | None = None) -> SystemEffect:
    """Return a term of one's own for `diagnose_model`'s library, tried in each free equation.

    Parameters
    ----------
    written : str
        The term in the names of states, inputs and parameters: ``"x^2 v"``, ``"sin(q)·i"``; or
        only what it is called, beside a function.
    function : callable, optional
        ``function(t, x, u, p)`` gives its value, as the functions of a model do.

    Raises
    ------
    InputError
        When the text is no term; later, when a model has no signal of that name.
    """
    expression = _expression(written) if function is None else lambda _: function
    return _open(written, Term.CALLED, "alone", f"+ c {written}", expression=expression)


def _expression(written: str) -> Expression:
    """Return a term as functions of (t, x, u, p); refuse what is no arithmetic of names."""
    text = written.replace("·", "*").replace("^", "**").replace("²", "**2").replace("³", "**3")
    # A space between two factors is a product: "x^2 v".
    text = re.sub(r"(?<=[\w)])\s+(?=[^\W\d])", "*", text.strip())
    wrong = InputError(
        f"library: {written}",
        expected="names, numbers, + - * / ^ and " + ", ".join(_FUNCTIONS),
        found="what is no such term",
    )
    try:
        tree = ast.parse(text, mode="eval")
    except (SyntaxError, ValueError) as error:
        raise wrong from error
    for node in ast.walk(tree):
        bad_call = isinstance(node, ast.Call) and (
            not isinstance(node.func, ast.Name) or node.func.id not in _FUNCTIONS or node.keywords
        )
        bad_number = isinstance(node, ast.Constant) and type(node.value) not in (int, float)
        if bad_call or bad_number or not isinstance(node, _NODES):
            raise wrong

    @lru_cache(maxsize=8)
    def of_model(model: Model) -> Callable[..., float]:
        groups = (("x", model.states), ("u", model.inputs), ("p", model.params))
        homes = {name: f"{group}.{name}" for group, names in groups for name in names}
        for name in NAME.findall(text):
            require(name in homes, f"library: {written}", ", ".join(homes), f"'{name}'")
        body = NAME.sub(lambda found: homes[found[0]], text)
        # Only names of the model, numbers and the functions above reach this source.
        made: Callable[..., float] = eval(f"lambda t, x, u, p: {body}", dict(_FUNCTIONS))
        return made

    return of_model
