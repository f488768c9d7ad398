"""Functional mock-up units: the equations of a model that another tool exported.

A unit of model exchange gives derivatives and outputs for a time, states, inputs and parameters; a
short trampoline in machine code puts it behind the address that the kernels call.
"""

from __future__ import annotations

import ctypes
import os
import re
import shutil
import tempfile
import weakref
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numba import carray, njit  # type: ignore[attr-defined]

from comparisons.missing_effect.systems.pointers import AtAddress, compiled_at, numbers_at
from surge_core.errors import InputError, require
from surge_core.types import FloatArray

# From this status on a call of a unit has failed: discard, error, fatal.
DISCARDED = 2
_ADDRESS, _NUMBER, _FLAG = ctypes.c_size_t, ctypes.c_double, ctypes.c_int
Names = Sequence[str] | Mapping[str, str]


def unit_parts(
    path: str | os.PathLike[str], inputs: Names, outputs: Names, params: Sequence[str]
) -> dict[str, Any]:
    """Return what the model of a unit is made of: units of its signals, functions, name.

    ``params`` gives start, bounds and unit of each; see `Model.from_fmu`.
    """
    fmpy = _fmpy()
    file = Path(path)
    require(file.is_file(), str(file), "a functional mock-up unit", "no such file")
    with _said_by(file, "a functional mock-up unit (.fmu)"):
        described = fmpy.read_model_description(str(file), validate=False)
    _check_kind(file, described)
    known = {v.name: v for v in described.modelVariables}
    slopes = [unknown.variable for unknown in described.derivatives]
    groups = {
        "states": {_identifier(v.derivative.name): v.derivative for v in slopes},
        "inputs": _chosen(file, "inputs", inputs, known),
        "outputs": _chosen(file, "outputs", outputs, known),
        "params": _chosen(file, "params", params, known),
    }
    unit = _instance(fmpy, file, described)
    made: dict[str, Any] = {
        part: {name: _unit(v) for name, v in group.items()} for part, group in groups.items()
    }
    made["params"] = {name: _range(v) for name, v in groups["params"].items()}
    made["x0"] = {n: float(v.start) for n, v in groups["states"].items() if v.start is not None}
    references = [
        np.array([v.valueReference for v in groups[part].values()], dtype=np.uint32)
        for part in ("inputs", "params", "outputs")
    ]
    made["rhs"], made["output"] = _functions(unit, described, len(slopes), references)
    return {**made, "name": described.modelName or file.stem}


def _fmpy() -> ModuleType:
    try:
        import fmpy
    except ImportError as error:
        raise InputError(
            "functional mock-up units",
            expected="the package fmpy",
            found="none",
            remedy="install it with: pip install 'sindy-surge[fmu]'",
        ) from error
    return fmpy  # type: ignore[no-any-return]


def _check_kind(file: Path, described: Any) -> None:
    kind = "co-simulation" if described.coSimulation is not None else "another kind"
    require(
        described.fmiMajorVersion in (2, 3) and described.modelExchange is not None,
        str(file),
        "a unit for model exchange, of FMI 2 or 3",
        f"{kind}, of FMI {described.fmiVersion}",
        "export it for model exchange, or give Model.from_simulate a function that runs it",
    )
    indicators, clocked = described.numberOfEventIndicators, len(described.clockedStates)
    expected = "a unit without events, whose states run continuously"
    found = f"{indicators} event indicators, {clocked} clocked states"
    require(not indicators and not clocked, str(file), expected, found)
    require(bool(described.derivatives), str(file), expected, "no states")


@contextmanager
def _said_by(file: Path, expected: str) -> Iterator[None]:
    """Say in one sentence what fmpy stumbles over: it raises bare exceptions."""
    try:
        yield
    except Exception as error:
        said = " ".join(str(error).split())[:200]
        raise InputError(str(file), expected=expected, found=said or "another") from error


def _identifier(name: str) -> str:
    """Return a variable's name as a Python identifier: ``body.x[1]`` is ``body_x_1``."""
    return re.sub(r"\W+", "_", name).strip("_")


def _chosen(file: Path, part: str, names: Names, known: Mapping[str, Any]) -> dict[str, Any]:
    pairs = names if isinstance(names, Mapping) else {_identifier(name): name for name in names}
    reals = [n for n, v in known.items() if v.type in ("Real", "Float64")]
    expected = "real variables of the unit: " + ", ".join(reals[:20])
    for name in pairs.values():
        require(name in reals, f"{file}: {part}", expected, f"'{name}'")
    return {own: known[name] for own, name in pairs.items()}


def _unit(variable: Any) -> str:
    declared = variable.declaredType
    return str(variable.unit or (declared.unit if declared is not None else None) or "1")


def _range(variable: Any) -> tuple[float | None, float | None, float | None, str]:
    """Return start, bounds and unit as far as the unit gives them."""
    declared = variable.declaredType
    given = [
        getattr(variable, key) or getattr(declared, key, None) for key in ("start", "min", "max")
    ]
    start, low, high = (None if value is None else float(value) for value in given)
    return start, low, high, _unit(variable)


def _instance(fmpy: ModuleType, file: Path, described: Any) -> Any:
    """Return a unit that is loaded; its files stay as long as it runs."""
    module = import_module(f"fmpy.fmi{described.fmiMajorVersion}")
    folder = tempfile.mkdtemp(prefix="fmu")
    with ExitStack() as stack, _said_by(file, "a unit for this machine with all functions of FMI"):
        stack.callback(shutil.rmtree, folder, ignore_errors=True)
        fmpy.extract(str(file), folder)
        unit = getattr(module, f"FMU{described.fmiMajorVersion}Model")(
            guid=described.guid,
            modelIdentifier=described.modelExchange.modelIdentifier,
            unzipDirectory=folder,
            instanceName="unit",
        )
        unit.instantiate()
        stack.pop_all()
    weakref.finalize(unit, shutil.rmtree, folder, ignore_errors=True)
    return unit


def _call(unit: Any, name: str, *kinds: Any) -> Any:
    """Return a function of a unit's library; all pointers are numbers to the machine."""
    address = int(ctypes.cast(getattr(unit.dll, name), ctypes.c_void_p).value or 0)
    return ctypes.CFUNCTYPE(ctypes.c_int, _ADDRESS, *kinds)(address)


def _functions(
    unit: Any, described: Any, n_x: int, references: Sequence[Any]
) -> tuple[AtAddress, AtAddress]:
    """Return the trampolines of derivatives and outputs."""
    version = described.fmiMajorVersion
    component = int(unit.component if isinstance(unit.component, int) else unit.component.value)
    n_u, n_p, n_y = (r.size for r in references)
    u_at, p_at, y_at = (int(r.ctypes.data) for r in references)
    # The parameters that the unit was initialized with; room for what it says of events.
    known, said = np.full(max(n_p, 1), np.nan), np.zeros(16)
    begun, said_at = int(known.ctypes.data), int(said.ctypes.data)
    set_time = _call(unit, f"fmi{version}SetTime", _NUMBER)
    set_states = _call(unit, f"fmi{version}SetContinuousStates", _ADDRESS, _ADDRESS)
    slopes = "fmi2GetDerivatives" if version == 2 else "fmi3GetContinuousStateDerivatives"
    get_slopes = _call(unit, slopes, _ADDRESS, _ADDRESS)
    own = (_fmi2 if version == 2 else _fmi3)(unit, component, said_at)
    initialize, update, set_values, get_values = own
    reset, leave, run = (
        _call(unit, f"fmi{version}{name}")
        for name in ("Reset", "ExitInitializationMode", "EnterContinuousTimeMode")
    )

    @njit
    def prepared(t: float, x: Any, u: Any, p: Any) -> int:
        initialized = carray(numbers_at(begun), (max(n_p, 1),))
        values = carray(p, (n_p,))
        status = 0
        same = initialized[0] == 0.0 if n_p == 0 else True
        for i in range(n_p):
            same = same and initialized[i] == values[i]
        if not same:
            # Of a unit in use only tunable parameters may change; one that begins takes any.
            status = reset(component)
            if n_p > 0:
                status = max(status, set_values(p_at, n_p, values.ctypes.data))
            status = max(status, initialize(), leave(component), update(), run(component))
            initialized[0] = 0.0
            for i in range(n_p):
                initialized[i] = values[i]
        status = max(status, set_time(component, t))
        status = max(status, set_states(component, carray(x, (n_x,)).ctypes.data, n_x))
        if n_u > 0:
            status = max(status, set_values(u_at, n_u, carray(u, (n_u,)).ctypes.data))
        return int(status)

    def spoiled(status: int, values: FloatArray) -> None:
        if status >= DISCARDED:
            values[:] = np.nan
            # What failed is initialized at the next call.
            carray(numbers_at(begun), (1,))[0] = np.nan

    checked: Any = njit(spoiled)

    def rhs(t: Any, x: Any, u: Any, p: Any, out: Any) -> None:
        dx = carray(out, (n_x,))
        status = prepared(t, x, u, p)
        checked(max(status, get_slopes(component, dx.ctypes.data, n_x)), dx)

    def output(t: Any, x: Any, u: Any, p: Any, out: Any) -> None:
        y = carray(out, (n_y,))
        status = prepared(t, x, u, p)
        checked(max(status, get_values(y_at, n_y, y.ctypes.data)), y)

    kept = (unit, references, known, said)
    return AtAddress(compiled_at(rhs), n_x, kept), AtAddress(compiled_at(output), n_y, kept)


def _fmi2(unit: Any, component: int, said_at: int) -> tuple[Any, Any, Any, Any]:
    """Return what FMI 2 does in its own way: initialize, see to events, take and give values."""
    setup = _call(unit, "fmi2SetupExperiment", _FLAG, _NUMBER, _NUMBER, _FLAG, _NUMBER)
    enter = _call(unit, "fmi2EnterInitializationMode")
    update = _call(unit, "fmi2NewDiscreteStates", _ADDRESS)
    set_real, get_real = (_call(unit, f"fmi2{n}Real", *(_ADDRESS,) * 3) for n in ("Set", "Get"))
    return (
        njit(lambda: max(setup(component, 0, 0.0, 0.0, 0, 0.0), enter(component))),
        njit(lambda: update(component, said_at)),
        njit(lambda references, n, values: set_real(component, references, n, values)),
        njit(lambda references, n, values: get_real(component, references, n, values)),
    )


def _fmi3(unit: Any, component: int, said_at: int) -> tuple[Any, Any, Any, Any]:
    """Return what FMI 3 does in its own way."""
    flag, at = ctypes.c_uint8, said_at
    enter = _call(unit, "fmi3EnterInitializationMode", flag, _NUMBER, _NUMBER, flag, _NUMBER)
    update = _call(unit, "fmi3UpdateDiscreteStates", *(_ADDRESS,) * 6)
    set_, get = (_call(unit, f"fmi3{n}Float64", *(_ADDRESS,) * 4) for n in ("Set", "Get"))
    return (
        njit(lambda: enter(component, 0, 0.0, 0.0, 0, 0.0)),
        njit(lambda: update(component, at, at + 8, at + 16, at + 24, at + 32, at + 40)),
        njit(lambda references, n, values: set_(component, references, n, values, n)),
        njit(lambda references, n, values: get(component, references, n, values, n)),
    )
