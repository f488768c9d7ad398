"""Terms without a name: what would be found where no name fits, and a user's own library."""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Callable
from functools import lru_cache

from comparisons.missing_effect.systems.model import Model
from comparisons.missing_effect.systems.places import Number, SystemEffect
from comparisons.missing_effect.systems.roles import (
    Places,
    alone,
    always,
    at_outputs,
    every_signal,
    fixed,
    on,
    on_products,
    on_square_products,
)
from comparisons.missing_effect.systems.shapes import Kind, Map, Term
from surge_core.errors import InputError

_FUNCTIONS = {
    name: getattr(math, name) for name in ("sin", "cos", "tan", "tanh", "exp", "log", "sqrt")
} | {"abs": abs}
_NODES = (
    ast.Expression, ast.BinOp, ast.UnaryOp, ast.Call, ast.Name, ast.Constant, ast.Load,
    ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Pow, ast.USub,
)  # fmt: skip


def _open(
    name: str,
    kind: Kind,
    code: int,
    equation: str,
    places: Places,
    *,
    centred: bool = False,
    simple_form_of: tuple[str, ...] = (),
    expression: Callable[[Model], Callable[..., float]] | None = None,
) -> SystemEffect:
    return SystemEffect(
        f"open_{name}",
        kind,
        code,
        equation,
        "a term without a name",
        (Number("c", -50.0, 50.0),),
        places,
        fixed([0.0]),
        always,
        "",
        unnamed=True,
        simple_form_of=simple_form_of,
        centred=centred,
        expression=expression,
    )


def _both(name: str, code: Term, equation: str, places: Places) -> tuple[SystemEffect, ...]:
    """Return a term, and the same about the means of signals that keep their sign."""
    centred = f"centred_{name}"
    return (
        _open(name, Kind.TERM, code, equation, places, simple_form_of=(f"open_{centred}",)),
        _open(centred, Kind.TERM, code, equation, places, centred=True),
    )


# All terms up to degree three of one and two signals, and readings with a bend.
OPEN_TERMS: tuple[SystemEffect, ...] = (
    *_both("product", Term.PRODUCT, "+ c {s}·{o}", on_products),
    *_both("square_product", Term.SQUARE_PRODUCT, "+ c {s}²·{o}", on_square_products),
    _open("linear", Kind.TERM, Term.LINEAR, "+ c {s}", on(every_signal)),
    *_both("square", Term.SQUARE, "+ c {s}²", on(every_signal)),
    *_both("cube", Term.CUBE, "+ c {s}³", on(every_signal)),
    _open("reading_square", Kind.OUTPUT_MAP, Map.SQUARE, "y + c y²", at_outputs),
    _open("reading_cube", Kind.OUTPUT_MAP, Map.CUBE, "y + c y³", at_outputs),
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
    if function is not None:
        given = function
        return _open(
            written, Kind.TERM, Term.CALLED, f"+ c {written}", alone, expression=lambda _: given
        )
    tree = _parsed(written)

    @lru_cache(maxsize=8)
    def expression(model: Model) -> Callable[..., float]:
        return _of_model(tree, written, model)

    return _open(written, Kind.TERM, Term.CALLED, f"+ c {written}", alone, expression=expression)


def _parsed(written: str) -> ast.Expression:
    """Return the tree of a term; refuse what is no arithmetic of names and numbers."""
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
    return tree


def _of_model(tree: ast.Expression, written: str, model: Model) -> Callable[..., float]:
    """Return a term as a function of (t, x, u, p) that can be compiled."""
    homes = {
        name: group
        for group, names in (("x", model.states), ("u", model.inputs), ("p", model.params))
        for name in names
    }

    class _Named(ast.NodeTransformer):
        def visit_Call(self, node: ast.Call) -> ast.AST:
            node.args = [self.visit(argument) for argument in node.args]
            return node

        def visit_Name(self, node: ast.Name) -> ast.AST:
            if node.id not in homes:
                raise InputError(
                    f"library: {written}", expected=", ".join(homes), found=f"'{node.id}'"
                )
            home = ast.Name(homes[node.id], ast.Load())
            return ast.copy_location(ast.Attribute(home, node.id, ast.Load()), node)

    body = ast.unparse(_Named().visit(ast.parse(ast.unparse(tree), mode="eval")))
    # Only names of the model, numbers and the functions above reach this source.
    made: Callable[..., float] = eval(f"lambda t, x, u, p: {body}", dict(_FUNCTIONS))
    return made
