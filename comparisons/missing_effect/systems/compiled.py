"""The functions of a user's model as machine code, behind addresses that kernels call.

The kernels are compiled once an installation and cached; only the two short functions of the
model are compiled again in each process.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from types import CellType, FunctionType
from typing import Any, TypeAlias

import numpy as np
from llvmlite import ir
from numba import carray, njit, types  # type: ignore[attr-defined]
from numba.core.errors import NumbaError
from numba.extending import intrinsic

from comparisons.missing_effect.systems.model import Model, as_numbers
from comparisons.missing_effect.systems.pointers import AtAddress, compiled_at
from surge_core.errors import InputError

Expression: TypeAlias = Callable[[Model], Callable[..., float]]


def _call_at(
    typing: Any, address: Any, t: Any, x: Any, u: Any, p: Any, out: Any
) -> tuple[Any, Any]:
    """Call a function of a model at an address; x, u, p and out are arrays."""
    # Whole arrays are passed, not the addresses of their data: an array that is not used again
    # would be freed before the call.
    signature = types.void(types.int64, types.float64, x, u, p, out)

    def codegen(context: Any, builder: Any, sig: Any, arguments: Any) -> Any:
        pointer = ir.DoubleType().as_pointer()
        function = ir.FunctionType(ir.VoidType(), [ir.DoubleType(), *[pointer] * 4])
        callee = builder.inttoptr(arguments[0], function.as_pointer())
        arrays = [
            context.make_array(kind)(context, builder, value).data
            for kind, value in zip(sig.args[2:], arguments[2:], strict=True)
        ]
        builder.call(callee, [arguments[1], *arrays])
        return context.get_dummy_value()

    return signature, codegen


# numba gives the typing context itself: to callers the function has one argument less.
call_at: Any = intrinsic(_call_at)


@lru_cache(maxsize=64)
def compiled(model: Model) -> tuple[Any, Any]:
    """Return right-hand side and output compiled, each with its address; a model is compiled once.

    Refused is what cannot be compiled.
    """
    return _cfunc(model, "rhs", model.rhs), _cfunc(model, "output", model.output)


@lru_cache(maxsize=512)
def compiled_term(model: Model, expression: Expression) -> Any:
    """Return a term of the user's own compiled for the model whose signals it reads."""
    return _cfunc(model, "library", expression(model))


def _cfunc(model: Model, part: str, user: Any) -> Any:
    """Compile a function as ``void (t, x*, u*, p*, out*)``, unless it is machine code already."""
    if isinstance(user, AtAddress):
        return user
    own, n_p = model.own_states, len(model.params)
    groups = dict(zip(("x", "u", "p"), model.group_kinds, strict=True))
    read = {
        "x": [
            f"cells[{at.start}:{at.stop}]" if isinstance(at, slice) else f"x[{at}]"
            for at in model.state_groups.values()
        ],
        "u": [f"u[{i}]" for i in range(len(model.inputs))],
        # Parameters of records are states behind those of the model.
        "p": [f"p[{i}]" for i in range(n_p)]
        + [f"x[{own + i}]" for i in range(len(model.per_record))],
    }
    given = [f"{name}_group({', '.join(fields)})" for name, fields in read.items()]
    lines = ["def wrapped(t, x, u, p, out):", f"    cells = carray(x, ({own},))"]
    lines.append(f"    found = user(t, {', '.join(given)})")
    with np.errstate(all="ignore"):
        tried = user(0.0, *model.groups(*model.trial))
    lines += _filling(tried)
    constant = len(model.per_record) if part == "rhs" else 0
    lines += [f"    out[{own + i}] = 0.0" for i in range(constant)]
    # Only names that were checked to be identifiers reach this source, and none of them does:
    # fields are read by number.
    space: dict[str, Any] = {f"{name}_group": group for name, group in groups.items()}
    space["carray"] = carray
    try:
        space["user"] = _machine_code(user)
        exec("\n".join(lines), space)
        return AtAddress(compiled_at(space["wrapped"]), len(as_numbers(tried)) + constant)
    except (NumbaError, TypeError, ValueError, NotImplementedError) as error:
        raise InputError(
            f"model: {part}",
            expected="arithmetic, math, numpy functions of numbers, and if",
            found=_first_line(error),
            remedy="write it with numbers only, without objects or closures over arrays",
        ) from error


def _machine_code(user: Any) -> Any:
    """Compile a user's function, with the plain functions that it calls."""
    # As numpy does: a division by zero is an infinity that the integrator sees, no exception.
    compiler = njit(error_model="numpy")
    if not isinstance(user, FunctionType):
        return compiler(user)

    def own(value: Any) -> Any:
        plain = isinstance(value, FunctionType) and value is not user
        return _machine_code(value) if plain else value

    code, known = user.__code__, user.__globals__
    called = {name: own(known[name]) for name in code.co_names if name in known}
    cells = tuple(CellType(own(cell.cell_contents)) for cell in user.__closure__ or ())
    known = {**known, **called}
    return compiler(FunctionType(code, known, user.__name__, user.__defaults__, cells))


def _filling(found: Any) -> list[str]:
    """Return the lines that fill ``out``: with numbers and arrays, in a tuple or bare."""
    many = isinstance(found, (tuple, list))
    lines, at = [], 0
    for i, part in enumerate(found if many else (found,)):
        name, size = f"found[{i}]" if many else "found", int(np.size(part))
        if np.ndim(part):
            lines += [f"    for i in range({size}):", f"        out[{at} + i] = {name}[i]"]
        else:
            lines.append(f"    out[{at}] = {name}")
        at += size
    return lines


def _first_line(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    kept = [line for line in lines if not line.startswith(("Failed in", "During", "<source"))]
    return (kept or lines or [type(error).__name__])[0][:200]
