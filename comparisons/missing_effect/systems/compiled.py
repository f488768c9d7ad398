"""The functions of a user's model as machine code, behind addresses that kernels call.

The kernels are compiled once an installation and cached; only the two short functions of the
model are compiled again in each process.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, TypeAlias

from llvmlite import ir
from numba import njit, types
from numba.core.errors import NumbaError
from numba.extending import intrinsic

from comparisons.missing_effect.systems.model import Model
from comparisons.missing_effect.systems.pointers import AtAddress, compiled_at
from surge_core.errors import InputError

__all__ = ["Compiled", "call_at", "compiled", "expression_address"]

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


@dataclass(frozen=True)
class Compiled:
    """A model whose functions are machine code.

    Parameters
    ----------
    model : Model
        The model.
    rhs, output : object
        Compiled functions; they are kept so that their addresses stay valid.
    """

    model: Model
    rhs: Any
    output: Any

    @property
    def addresses(self) -> tuple[int, int]:
        """Where the right-hand side and the output are."""
        return int(self.rhs.address), int(self.output.address)


@lru_cache(maxsize=64)
def compiled(model: Model) -> Compiled:
    """Return a model with its functions compiled; the same model is compiled once.

    Parameters
    ----------
    model : Model
        The model.

    Raises
    ------
    InputError
        When a function uses what cannot be compiled.
    """
    return Compiled(model, _function(model, "rhs"), _function(model, "output"))


@lru_cache(maxsize=512)
def _expression(model: Model, expression: Expression) -> Any:
    return _cfunc(model, "library", expression(model), 1, numbers=False)


def expression_address(model: Model, expression: Expression) -> int:
    """Return where a term of the user's own is, compiled for a model.

    Parameters
    ----------
    model : Model
        The model whose states, inputs and parameters it reads.
    expression : callable
        ``expression(model)`` gives it as a function of (t, x, u, p).

    Raises
    ------
    InputError
        When it uses what cannot be compiled.
    """
    return int(_expression(model, expression).address)


def _function(model: Model, part: str) -> Any:
    """Compile one function of a model, unless it is machine code already."""
    given = getattr(model, part)
    if isinstance(given, AtAddress):
        return given
    count = model.own_states if part == "rhs" else len(model.outputs)
    return _cfunc(model, part, given, count, numbers=_returns_tuple(model, part))


def _cfunc(model: Model, part: str, user: Any, count: int, *, numbers: bool) -> Any:
    """Compile a function as ``void (t, x*, u*, p*, out*)``."""
    own, n_p = model.own_states, len(model.params)
    groups = dict(zip(("x", "u", "p"), model.group_kinds, strict=True))
    lines = ["def wrapped(t, x, u, p, out):"]
    fields = {
        name: [f"{name}[{i}]" for i in range(len(group._fields))] for name, group in groups.items()
    }
    # Parameters of records are states behind those of the model.
    fields["p"] = fields["p"][:n_p] + [f"x[{own + i}]" for i in range(len(model.per_record))]
    given = [f"{name}_group({', '.join(read)})" for name, read in fields.items()]
    lines.append(f"    found = user(t, {', '.join(given)})")
    values = [f"found[{i}]" for i in range(count)] if numbers else ["found"]
    if part == "rhs":
        values += ["0.0"] * len(model.per_record)
    lines += [f"    out[{i}] = {value}" for i, value in enumerate(values)]
    # Only names that were checked to be identifiers reach this source, and none of them does:
    # fields are read by number.
    space: dict[str, Any] = {f"{name}_group": group for name, group in groups.items()}
    try:
        # As numpy does: a division by zero is an infinity that the integrator sees, no exception.
        space["user"] = njit(error_model="numpy")(user)
        exec("\n".join(lines), space)
        return compiled_at(space["wrapped"])
    except (NumbaError, TypeError, ValueError, NotImplementedError) as error:
        raise InputError(
            f"model: {part}",
            expected="arithmetic, math, numpy functions of numbers, and if",
            found=_first_line(error),
            remedy="write it with numbers only, without objects or closures over arrays",
        ) from error


def _returns_tuple(model: Model, part: str) -> bool:
    """Tell whether a function gives several numbers, or a bare one."""
    p = tuple(float(parameter.start) for parameter in model.params.values())
    given = model.groups((0.1,) * len(model.states), (0.1,) * len(model.inputs), p)
    return isinstance(getattr(model, part)(0.0, *given), (tuple, list))


def _first_line(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    kept = [line for line in lines if not line.startswith(("Failed in", "During", "<source"))]
    return (kept or lines or [type(error).__name__])[0][:200]
