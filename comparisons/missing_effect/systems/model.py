"""A user's own simulation model: states, inputs, parameters, right-hand side and outputs."""

from __future__ import annotations

import keyword
import math
import os
from collections import namedtuple
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import product
from types import MappingProxyType
from typing import Any, Literal, get_args

import numpy as np

from surge_core.display import Displayed, Field, Grid, Sheet
from surge_core.errors import InputError, require

BetweenSamples = Literal["auto", "held", "linear", "cubic", "band"]
# What states and inputs may be, from a displacement to a temperature and a pressure.
TRIED, DRAWS = (1.0, 0.1, 300.0, 1e5), 20


@dataclass(frozen=True)
class P:
    """A parameter of a model: where its search starts, its bounds and its unit.

    Parameters
    ----------
    start, low, high : float
        In the parameter's own unit; ``low <= start <= high``.
    unit : str
        For example ``"kg"``; ``"1"`` without one.
    per_record : bool
        Whether each record has a value of its own, such as the bias of a sensor that was set up
        for it. A check record's is estimated from its first rows, with its start.
    """

    start: float
    low: float
    high: float
    unit: str = "1"
    per_record: bool = False


@dataclass(frozen=True, eq=False)
class Model(Displayed):
    """A simulation model dx/dt = f(t, x, u, p), y = g(t, x, u, p), as a value.

    Parameters
    ----------
    states, inputs, outputs : mapping of str to str
        Name and unit of each; names are Python identifiers, since ``rhs`` reads ``x.name``. A state
        may be a vector, ``{"T": ("K", 20)}``: ``x.T`` is an array then, its cells are called
        ``T_0`` to ``T_19``, and effects are not sought on single cells.
    params : mapping of str to P
        Parameters with start, bounds and unit.
    rhs : callable
        ``rhs(t, x, u, p)`` returns dx/dt, one number a state (an array a vector) in their order; t
        is the record's own clock, ``time_s``. Arithmetic, ``math``, numpy functions, tables with
        ``numpy.interp`` and ``if`` are compiled.
    output : callable
        ``output(t, x, u, p)`` returns the measured quantities, one number an output.
    exact : sequence of str
        States whose equation is a definition, such as dq/dt = v: nothing is ever added there.
    input_between_samples : {"auto", "held", "linear", "cubic", "band"}
        How inputs run between samples; ``"auto"``: held where all show it, else what foretells the
        check part best.
    x0 : mapping of str to float, (float, float) or "first"
        What is known of the state at the start of a record: a value, a value with its standard
        deviation, or the first sample of the output that reads it. The start is always estimated.
    balance : mapping of str to (str, str)
        ``{"v": ("M", "N")}`` says that the equation of v is M dv/dt = a sum of forces in N, so
        that effects in it are given in N.
    name : str
        How it is called in reports.
    per_record : mapping of str to P
        Parameters of records, as `with_record_parameters` lays them out; not to be given.
    simulate : callable, optional
        A simulation that is a black box, as of `from_simulate`.
    vectors : mapping of str to slice
        Where the cells of vectors are among the states; not to be given.

    Raises
    ------
    InputError
        When names, bounds or functions do not fit together.
    """

    states: Mapping[str, Any]
    inputs: Mapping[str, str]
    outputs: Mapping[str, str]
    params: Mapping[str, P]
    rhs: Callable[..., Any] | None
    output: Callable[..., Any] | None
    exact: tuple[str, ...] = ()
    input_between_samples: BetweenSamples = "auto"
    x0: Mapping[str, Any] = field(default_factory=dict)
    balance: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    name: str = "model"
    per_record: Mapping[str, P] = field(default_factory=dict)
    simulate: Callable[..., Any] | None = None
    vectors: Mapping[str, slice] = field(default_factory=dict)

    def __post_init__(self) -> None:
        parts = ("states", "inputs", "outputs", "params", "x0", "balance", "per_record", "vectors")
        for part in parts:
            value = getattr(self, part)
            mapping = isinstance(value, Mapping)
            _require(mapping, part, "a mapping of names", f"{type(value).__name__}")
            object.__setattr__(self, part, MappingProxyType(dict(value)))
        object.__setattr__(self, "exact", tuple(self.exact))
        _expand_vectors(self)
        _check_names(self)
        _check_params(self)
        _check_options(self)
        _check_functions(self)

    @classmethod
    def from_simulate(
        cls,
        simulate: Callable[..., Any],
        inputs: Mapping[str, str],
        outputs: Mapping[str, str],
        params: Mapping[str, P],
        **options: Any,
    ) -> Model:
        """Return the model of a simulation that is a black box.

        Effects are sought at its inputs and outputs and in its parameters; what acts inside is out
        of reach. It starts itself, and is run for every difference in a parameter.

        Parameters
        ----------
        simulate : callable
            ``simulate(t, u, p)`` returns the outputs, shape (n, n_y) or one array an output, for
            times t in seconds from the record's first row, inputs ``u.name`` of shape (n,) and
            parameters ``p.name``.
        inputs, outputs, params : mapping
            As of `Model`.
        **options
            ``input_between_samples`` and ``name``.

        Raises
        ------
        InputError
            When names or bounds do not fit together.
        """
        return cls({}, inputs, outputs, params, None, None, simulate=simulate, **options)

    @classmethod
    def from_fmu(
        cls,
        path: str | os.PathLike[str],
        inputs: Sequence[str] | Mapping[str, str],
        outputs: Sequence[str] | Mapping[str, str],
        params: Sequence[str] | Mapping[str, P],
        **options: Any,
    ) -> Model:
        """Return the model of a functional mock-up unit for model exchange, of FMI 2 or 3.

        Parameters
        ----------
        path : str or path
            The unit. It is a program: it is executed with all rights of the calling user.
        inputs, outputs : sequence of str, or mapping of str to str
            Its variables, or what they are called in the records and in the unit.
        params : sequence of str, or mapping of str to P
            Its variables that are fitted; without a `P` the unit's own start and bounds hold.
            In names dots and brackets become underscores.
        **options
            ``exact``, ``x0``, ``balance``, ``input_between_samples`` and ``name``.

        Raises
        ------
        InputError
            When it is no such unit, has events, or lacks a variable or a bound.
        """
        from comparisons.missing_effect.systems.fmu import unit_parts

        parts = unit_parts(path, inputs, outputs, tuple(params))
        given = list(params.values()) if isinstance(params, Mapping) else []
        made = {}
        for i, (name, (start, low, high, unit)) in enumerate(parts["params"].items()):
            at, p = f"params: {name}", given[i] if given else P(start, low, high, unit)
            _require(not p.per_record, at, "one value for all records", "per_record")
            known = None not in (p.start, p.low, p.high)
            _require(known, at, "P(start, low, high)", "no start and bounds in the unit")
            made[name] = p
        return cls(**{**parts, "params": made, **options})

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states, in order."""
        return tuple(self.states)

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs, in order."""
        return tuple(self.inputs)

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of the outputs, in order."""
        return tuple(self.outputs)

    @property
    def param_names(self) -> tuple[str, ...]:
        """Names of the parameters, in order."""
        return tuple(self.params)

    @property
    def own_states(self) -> int:
        """How many states are the model's; behind them are the parameters of records."""
        return len(self.states) - len(self.per_record)

    @property
    def trial(self) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]:
        """States, inputs and parameters at which its functions are tried, and give numbers."""
        n, starts = len(self.states), tuple(float(p.start) for p in self.params.values())
        # Apart from each other, in any order: roots and logarithms of differences are usual.
        rng = np.random.default_rng(0)
        for size, _ in product(TRIED, range(DRAWS)):
            values = (size * rng.uniform(0.5, 1.5, n + len(self.inputs))).tolist()
            point = tuple(values[:n]), tuple(values[n:]), starts
            with suppress(ArithmeticError, ValueError):
                if np.isfinite(np.concatenate(self.evaluate(0.0, *point))).all():
                    return point
        return point

    def with_record_parameters(self) -> Model:
        """Return the model whose parameters of records are states that stay as they start.

        Each run has a start of its own; so each record gets a value of its own.
        """
        own = {name: p for name, p in self.params.items() if p.per_record}
        if not own:
            return self
        return replace(
            self,
            states={**self.states, **{name: p.unit for name, p in own.items()}},
            params={name: p for name, p in self.params.items() if name not in own},
            exact=(*self.exact, *own),
            x0={**self.x0, **{name: p.start for name, p in own.items()}},
            per_record={**self.per_record, **own},
        )

    def evaluate(
        self, t: float, x: tuple[float, ...], u: tuple[float, ...], p: tuple[float, ...]
    ) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return dx/dt and y at one point, by the functions as they were written."""
        assert self.rhs is not None
        assert self.output is not None
        given = self.groups(x, u, p)
        with np.errstate(all="ignore"):
            dx, y = as_numbers(self.rhs(t, *given)), as_numbers(self.output(t, *given))
        return (*dx, *(0.0,) * len(self.per_record)), y

    @property
    def state_groups(self) -> dict[str, slice | int]:
        """Where in x each state of the user's is: a number, or the cells of a vector."""
        cells, starts = self.cells, {span.start: name for name, span in self.vectors.items()}
        groups: dict[str, slice | int] = {}
        for i, name in enumerate(self.state_names[: self.own_states]):
            if i in starts:
                groups[starts[i]] = self.vectors[starts[i]]
            elif i not in cells:
                groups[name] = i
        return groups

    @property
    def cells(self) -> frozenset[int]:
        """States that are cells of a vector."""
        spans = self.vectors.values()
        return frozenset(i for span in spans for i in range(span.start, span.stop))

    @property
    def group_kinds(self) -> tuple[Any, Any, Any]:
        """Named tuples of states, inputs and parameters, as the functions take them."""
        own = (*self.param_names, *self.state_names[self.own_states :])
        given = (tuple(self.state_groups), self.input_names, own)
        x, u, p = (namedtuple(kind, names) for kind, names in zip("xup", given, strict=True))
        return x, u, p

    def groups(
        self, x: tuple[float, ...], u: tuple[float, ...], p: tuple[float, ...]
    ) -> tuple[Any, Any, Any]:
        """Return states, inputs and parameters under their names, as the functions take them."""
        n, (states, inputs, params) = self.own_states, self.group_kinds
        own = [
            np.array(x[at]) if isinstance(at, slice) else x[at] for at in self.state_groups.values()
        ]
        return states(*own), inputs(*u), params(*p, *x[n:])

    def _sheet(self) -> Sheet:
        states = dict(list(self.states.items())[: self.own_states])
        signals = (("states", states), ("inputs", self.inputs), ("outputs", self.outputs))
        fields = tuple(
            Field(kind, ", ".join(f"{n} [{_shown(u)}]" for n, u in units.items()) or "none")
            for kind, units in signals
        )
        rows = tuple(
            (
                name + " (of each record)" * p.per_record,
                f"{p.start:g}",
                f"{p.low:g} to {p.high:g}",
                _shown(p.unit),
            )
            for name, p in {**self.params, **self.per_record}.items()
        )
        header = ("parameter", "start", "bounds", "unit")
        grid = Grid("Parameters", header, rows, frozenset({0, 3}))
        between = Field("inputs between samples", self.input_between_samples)
        return Sheet(f"Model: {self.name}", (*fields, between), (grid,) if rows else ())


def _shown(unit: str) -> str:
    return "-" if unit == "1" else unit


def as_numbers(value: Any) -> tuple[float, ...]:
    """Return what a function of a model gave as numbers: a bare number is a tuple of one."""
    parts = value if isinstance(value, (tuple, list)) else (value,)
    return tuple(float(number) for part in parts for number in np.atleast_1d(part))


def _expand_vectors(model: Model) -> None:
    """Write each vector among the states as its cells, also where it is exact or known at first."""
    states: dict[str, str] = {}
    vectors = dict(model.vectors)
    for name, unit in model.states.items():
        if not isinstance(unit, tuple):
            states[name] = unit
            continue
        good = len(unit) == 2 and isinstance(unit[1], int) and unit[1] >= 1
        _require(good, f"states: {name}", "a unit, or (unit, length)", f"{unit!r}")
        vectors[name] = slice(len(states), len(states) + unit[1])
        states.update({f"{name}_{i}": unit[0] for i in range(unit[1])})
    cells = {name: list(states)[span] for name, span in vectors.items()}
    x0: dict[str, Any] = {}
    for name, start in model.x0.items():
        own = cells.get(name, [name])
        many = name in cells and isinstance(start, (list, np.ndarray))
        starts = [start] * len(own)
        if many:
            starts = [one if isinstance(one, tuple) else float(one) for one in start]
        _require(len(starts) == len(own), f"x0: {name}", f"{len(own)} values", f"{len(starts)}")
        x0.update(zip(own, starts, strict=True))
    exact = tuple(cell for name in model.exact for cell in cells.get(name, [name]))
    for part, value in (("states", states), ("x0", x0), ("vectors", vectors)):
        object.__setattr__(model, part, MappingProxyType(value))
    object.__setattr__(model, "exact", exact)


def _check_names(model: Model) -> None:
    seen: set[str] = set()
    for part in ("states", "inputs", "outputs", "params"):
        given, output = getattr(model, part), part == "outputs"
        needed = output or (part == "states" and model.simulate is None)
        _require(bool(given) or not needed, part, "at least one", "none")
        for name, unit in given.items():
            good = isinstance(name, str) and name.isidentifier() and not name.startswith("_")
            good = good and not keyword.iskeyword(name)
            _require(good, part, "names that are Python identifiers", f"{name!r}")
            _require(output or name not in seen, part, "each name once", f"{name!r} twice")
            if not output:
                seen.add(name)
            good = part == "params" or (isinstance(unit, str) and bool(unit))
            _require(good, f"{part}: {name}", "a unit as text, '1' without one", f"{unit!r}")
    both = sorted(set(model.inputs) & set(model.outputs))
    _require(not both, "outputs", "no name that is an input as well", f"{both[:1]!r}")


def _check_params(model: Model) -> None:
    for name, p in model.params.items():
        at = f"params: {name}"
        _require(isinstance(p, P), at, "P(start, low, high, unit)", f"{p!r}")
        numbers = (p.start, p.low, p.high)
        _require(all(map(_is_finite, numbers)), at, "finite start, low and high", f"{numbers}")
        found = "start {:g}, low {:g}, high {:g}".format(*numbers)
        good = p.low <= p.start <= p.high and p.low < p.high
        _require(good, at, "low <= start <= high and low < high", found)


def _check_options(model: Model) -> None:
    known = f"states out of {', '.join(model.states)}"
    for part in ("exact", "x0", "balance"):
        for name in getattr(model, part):
            _require(name in model.states, part, known, f"{name!r}")
    choices, between = get_args(BetweenSamples), model.input_between_samples
    _require(between in choices, "input_between_samples", ", ".join(choices), f"{between!r}")
    for name, start in model.x0.items():
        pair = start if isinstance(start, tuple) else (start, 1.0)
        good = len(pair) == 2 and all(map(_is_finite, pair)) and pair[1] > 0.0
        expected = "'first', a value, or (value, standard deviation)"
        _require(start == "first" or good, f"x0: {name}", expected, f"{start!r}")
    for name, entry in model.balance.items():
        good = isinstance(entry, tuple) and len(entry) == 2 and entry[0] in model.params
        expected = "{state: (parameter, unit of the sum)}"
        _require(good, f"balance: {name}", expected, f"{entry!r}")


def _check_functions(model: Model) -> None:
    """Try both functions once, as Python, at the starts; a black box runs on records alone."""
    black_box = model.simulate is not None
    for part in ("simulate",) if black_box else ("rhs", "output"):
        function, signature = getattr(model, part), "(t, u, p)" if black_box else "(t, x, u, p)"
        _require(callable(function), part, f"a function of {signature}", f"{function!r}")
    if black_box:
        return
    try:
        dx, y = model.evaluate(0.0, *model.trial)
    except Exception as error:
        raise InputError(
            "model: rhs and output",
            expected="functions of (t, x, u, p) that give numbers",
            found=f"{type(error).__name__}: {error}",
        ) from error
    for part, got, names in (("rhs", dx, model.states), ("output", y, model.outputs)):
        expected = f"{len(names)} numbers ({', '.join(names)})"
        _require(len(got) == len(names), part, expected, f"{len(got)}")


def _is_finite(value: Any) -> bool:
    return isinstance(value, (int, float)) and math.isfinite(value)


def _require(good: bool, where: str, expected: str, found: str) -> None:
    require(good, f"model: {where}", expected, found)
