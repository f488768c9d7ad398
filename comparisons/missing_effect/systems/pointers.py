"""Addresses: pointers for compiled kernels, and functions that stand behind one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import cfunc, njit, types
from numba.extending import intrinsic

from surge_core.types import FloatArray

NUMBERS: Any = types.CPointer(types.float64)  # type: ignore[no-untyped-call]
# Kernels that make no array need not count who holds one, which took four fifths of their time: a
# right-hand side of two states takes 0.06 µs without it, and 0.31 with it.
kernel: Any = njit(cache=True, error_model="numpy", _nrt=False)  # type: ignore[call-overload]

# ``void (t, x*, u*, p*, out*)``: how kernels call the functions of a model.
_FUNCTION = types.void(types.float64, NUMBERS, NUMBERS, NUMBERS, NUMBERS)


def _number_pointer(typing: Any, address: Any) -> tuple[Any, Any]:
    """Return the pointer to numbers at an address."""

    def codegen(context: Any, builder: Any, sig: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], context.get_value_type(sig.return_type))

    return NUMBERS(types.int64), codegen


# numba gives the typing context itself: to callers it has one argument.
numbers_at: Any = intrinsic(_number_pointer)


@dataclass(frozen=True, eq=False)
class AtAddress:
    """A function of a model that is machine code already: ``void (t, x*, u*, p*, out*)``.

    It gives so many numbers as ``count`` says; what is kept must live as long as it.
    """

    function: Any
    count: int
    kept: Any = None

    @property
    def address(self) -> int:
        """Where it is."""
        return int(self.function.address)

    def __call__(self, t: float, x: Any, u: Any, p: Any) -> tuple[float, ...]:
        """Return its numbers at one point."""
        import ctypes

        out: FloatArray = np.full(self.count, np.nan)
        given = [np.array(group, dtype=np.float64) for group in (x, u, p)]
        pointer = ctypes.POINTER(ctypes.c_double)
        self.function.ctypes(t, *(array.ctypes.data_as(pointer) for array in (*given, out)))
        return tuple(out.tolist())


def compiled_at(function: Any) -> Any:
    """Return a function compiled as ``void (t, x*, u*, p*, out*)``."""
    return cfunc(_FUNCTION)(function)
