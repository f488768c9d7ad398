"""The declaration of a study: a TOML file, checked before anything is computed.

Under ``[record]``, ``[reduction]``, ``[series]`` and ``[fit]`` a single value holds for all cells
and a list is an axis: the grid has every combination. A random design draws from the lists, and
from ranges ``{from = 0.1, to = 5.0, log = true}``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from comparisons.study.scores import SCORES
from comparisons.study.settings import SOURCES, TABLES, Setting
from surge_core.errors import InputError
from surge_core.models import read_toml

__all__ = ["SCHEMA", "Design", "Method", "Range", "Scalar", "StudySpec", "read_spec"]

SCHEMA = "sindy-surge/study/1"
MOST_CELLS = 1_000_000
MOST_SEED = 2**63
DEFAULT_SCORES = ("tau_error_ms", "curve_rms_error", "held_out_rms")
DEFAULT_METHODS = ("classic_ml", "sindy")
TOP = ("schema", "title", "seeds", "first_seed", "scores", "reference", "by", "design", "method")

Scalar = float | int | str | bool | None


@dataclass(frozen=True)
class Range:
    """An interval that values are drawn from, or laid over in equal steps.

    Parameters
    ----------
    low, high : float
        Its ends.
    log : bool
        Whether the logarithm is drawn evenly.
    steps : int, optional
        Number of values in a grid, ends included.
    """

    low: float
    high: float
    log: bool = False
    steps: int | None = None

    def at(self, share: float) -> float:
        """Return the value at a share of the way from low to high."""
        if self.log:
            return float(self.low * (self.high / self.low) ** share)
        return self.low + share * (self.high - self.low)

    def values(self) -> tuple[float, ...]:
        """Return the values of a grid."""
        steps = self.steps or 2
        return tuple(self.at(i / (steps - 1)) for i in range(steps))


@dataclass(frozen=True)
class Method:
    """An estimator of a study.

    Parameters
    ----------
    name : str
        How it is called in the table.
    built_in : str
        Name of an estimator of `comparisons.harness.estimators`; empty for another class.
    import_path : str
        ``module:Class`` of an estimator that follows scikit-learn's contract; empty for a built-in.
    parameters : tuple of tuple of str and value
        What the class is made with.
    """

    name: str
    built_in: str = ""
    import_path: str = ""
    parameters: tuple[tuple[str, Any], ...] = ()


@dataclass(frozen=True)
class Design:
    """How the points of a study are laid.

    Parameters
    ----------
    kind : {"grid", "random"}
        Every combination, or so many drawn at random.
    points : int
        Number of draws, for "random".
    seed : int
        Of the draws.
    """

    kind: str = "grid"
    points: int = 0
    seed: int = 0


@dataclass(frozen=True)
class StudySpec:
    """A study, checked.

    Parameters
    ----------
    title : str
        What it is about.
    source : {"coefficients", "rig", "files"}
        Where records come from.
    settings : mapping of str to tuple or Range
        Values of each setting that was given, by its dotted name.
    seeds : tuple of int
        Seeds of the records.
    methods : tuple of Method
        Estimators.
    scores : tuple of str
        Out of `SCORES`; those that the report compares.
    reference : str or None
        Method that the others are compared with; None: the best.
    by : tuple of str
        Axes that the report splits by.
    design : Design
        Grid or random.
    """

    title: str
    source: str
    settings: Mapping[str, tuple[Scalar, ...] | Range]
    seeds: tuple[int, ...]
    methods: tuple[Method, ...]
    scores: tuple[str, ...]
    reference: str | None
    by: tuple[str, ...]
    design: Design

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the settings that vary."""
        return tuple(n for n, v in self.settings.items() if isinstance(v, Range) or len(v) > 1)


def read_spec(path: Path) -> StudySpec:
    """Read a study's declaration.

    Parameters
    ----------
    path : path
        TOML file.

    Raises
    ------
    InputError
        Naming the file and the key at fault.
    """
    return spec_from(read_toml(path, "a study's TOML file"), str(path))


def spec_from(given: Mapping[str, Any], where: str = "study") -> StudySpec:
    """Check the content of a declaration.

    Parameters
    ----------
    given : mapping
        As `tomllib` reads it.
    where : str
        What errors name.

    Raises
    ------
    InputError
        Naming the key at fault.
    """
    if not given:
        raise InputError(where, expected="a study", found="an empty file")
    _known(given, (*TOP, *TABLES), where)
    schema = given.get("schema", SCHEMA)
    if schema != SCHEMA:
        raise InputError(f"{where}: schema", expected=SCHEMA, found=repr(schema))
    design = _design(given.get("design", "grid"), where)
    tables = {name: _table(given.get(name, {}), f"{where}: [{name}]") for name in TABLES}
    source = tables["record"].pop("source", "coefficients")
    if not isinstance(source, str) or source not in SOURCES:
        raise InputError(
            f"{where}: record.source", expected="one of " + ", ".join(SOURCES), found=repr(source)
        )
    settings = _settings(tables, source, design, where)
    methods = _methods(given.get("method", []), where)
    seeds = _seeds(given, where)
    if source == "files" and len(seeds) > 1:
        raise InputError(
            f"{where}: seeds", expected="one, since files are what they are", found=f"{len(seeds)}"
        )
    if max(seeds) >= MOST_SEED:
        raise InputError(f"{where}: seeds", expected=f"below {MOST_SEED}", found=f"{max(seeds)}")
    spec = StudySpec(
        _text(given.get("title", "Study"), f"{where}: title"),
        source,
        settings,
        seeds,
        methods,
        _some(given.get("scores", DEFAULT_SCORES), SCORES, f"{where}: scores"),
        _reference(given.get("reference"), methods, where),
        (),
        design,
    )
    by = _among(given.get("by", ()), spec.axes, f"{where}: by")
    checked = StudySpec(**{**spec.__dict__, "by": by})
    _check_size(checked, where)
    return checked


def _known(given: Mapping[str, Any], names: Sequence[str], where: str) -> None:
    for key in given:
        if key not in names:
            raise InputError(
                where, expected="keys out of " + ", ".join(names), found=f"the key '{key}'"
            )


def _table(value: Any, where: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise InputError(where, expected="a table", found=type(value).__name__)
    return dict(value)


def _text(value: Any, where: str) -> str:
    if not isinstance(value, str) or not value.strip() or not value.isprintable():
        raise InputError(where, expected="a text of one line", found=repr(value))
    return value


def _whole(value: Any, where: str, least: int = 0) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < least:
        raise InputError(where, expected=f"a whole number from {least} on", found=repr(value))
    return value


def _design(value: Any, where: str) -> Design:
    if value == "grid":
        return Design()
    named = f"{where}: design"
    if not isinstance(value, dict):
        raise InputError(named, expected='"grid" or { random = N, seed = S }', found=repr(value))
    _known(value, ("random", "seed"), named)
    points = _whole(value.get("random"), f"{named}.random", least=1)
    return Design("random", points, _whole(value.get("seed", 0), f"{named}.seed"))


def _seeds(given: Mapping[str, Any], where: str) -> tuple[int, ...]:
    value = given.get("seeds", 1)
    first = _whole(given.get("first_seed", 0), f"{where}: first_seed")
    if isinstance(value, list):
        if "first_seed" in given:
            raise InputError(
                f"{where}: first_seed",
                expected="it beside a number of seeds",
                found="a list of seeds",
            )
        seeds = tuple(_whole(seed, f"{where}: seeds") for seed in value)
        if not seeds or len(set(seeds)) != len(seeds):
            raise InputError(f"{where}: seeds", expected="seeds, each once", found=repr(value))
        return seeds
    count = _whole(value, f"{where}: seeds", least=1)
    if count > MOST_CELLS:
        raise InputError(f"{where}: seeds", expected=f"at most {MOST_CELLS}", found=f"{count}")
    return tuple(range(first, first + count))


def _among(value: Any, names: Sequence[str] | Mapping[str, Any], where: str) -> tuple[str, ...]:
    listed = list(names)
    values = [value] if isinstance(value, str) else value
    if not isinstance(values, list | tuple) or any(v not in listed for v in values):
        raise InputError(
            where,
            expected="out of " + (", ".join(listed) or "the axes, of which there are none"),
            found=repr(value),
        )
    return tuple(dict.fromkeys(values))


def _some(value: Any, names: Mapping[str, Any], where: str) -> tuple[str, ...]:
    found = _among(value, names, where)
    if not found:
        raise InputError(where, expected="one or more of " + ", ".join(names), found="none")
    return found


def _reference(value: Any, methods: Sequence[Method], where: str) -> str | None:
    if value is None:
        return None
    where = f"{where}: reference"
    return _among(_text(value, where), [m.name for m in methods], where)[0]


def _settings(
    tables: Mapping[str, Mapping[str, Any]], source: str, design: Design, where: str
) -> dict[str, tuple[Scalar, ...] | Range]:
    out: dict[str, tuple[Scalar, ...] | Range] = {}
    for table, values in tables.items():
        known = SOURCES[source] if table == "record" else TABLES[table]
        if values and table == "reduction" and source == "coefficients":
            raise InputError(
                f"{where}: [reduction]",
                expected="it with raw records (record.source = 'rig' or 'files')",
                found="record.source = 'coefficients', which has no counts to reduce",
            )
        for key, value in _flat(values, known).items():
            name = f"{table}.{key}"
            if key not in known:
                raise InputError(
                    f"{where}: [{table}]",
                    expected="settings out of " + ", ".join(known),
                    found=f"'{key}'",
                )
            out[name] = _values(value, known[key], f"{where}: {name}", design)
    for key, setting in (SOURCES[source]).items():
        if setting.required and f"record.{key}" not in out:
            raise InputError(
                f"{where}: record.{key}", expected=setting.says, found="nothing", remedy="add it"
            )
    return out


def _flat(values: Mapping[str, Any], known: Mapping[str, Setting]) -> dict[str, Any]:
    """Return the settings of a table with those of tables within it under dotted names."""
    out: dict[str, Any] = {}
    groups = {key.split(".")[0] for key in known if "." in key}
    for key, value in values.items():
        if key in groups and isinstance(value, dict):
            out.update({f"{key}.{inner}": v for inner, v in value.items()})
        else:
            out[key] = value
    return out


def _values(value: Any, setting: Setting, where: str, design: Design) -> tuple[Scalar, ...] | Range:
    if isinstance(value, dict):
        return _range(value, setting, where, design)
    listed = value if isinstance(value, list) else [value]
    checked = tuple(setting.checked(v, where) for v in listed)
    if not checked:
        raise InputError(where, expected="a value or a list of some", found="an empty list")
    if len(set(checked)) != len(checked):
        raise InputError(where, expected="each value once", found=repr(listed))
    return checked


def _range(value: Mapping[str, Any], setting: Setting, where: str, design: Design) -> Range:
    _known(value, ("from", "to", "log", "steps"), where)
    if setting.kind is not float:
        raise InputError(where, expected="a range for numbers alone", found=repr(dict(value)))
    low, high = (setting.checked(value.get(end), f"{where}.{end}") for end in ("from", "to"))
    log = value.get("log", False)
    if not isinstance(low, float) or not isinstance(high, float) or not low < high:
        raise InputError(where, expected="'from' below 'to'", found=repr(dict(value)))
    if not isinstance(log, bool) or (log and low <= 0.0):
        raise InputError(where, expected="log = true with 'from' above 0", found=repr(dict(value)))
    steps = value.get("steps")
    if design.kind == "grid":
        steps = _whole(steps, f"{where}.steps (a grid needs it)", least=2)
    return Range(low, high, log, steps)


def _methods(value: Any, where: str) -> tuple[Method, ...]:
    if not isinstance(value, list):
        raise InputError(f"{where}: method", expected="[[method]] tables", found=repr(value))
    methods = tuple(_method(entry, f"{where}: method {i}") for i, entry in enumerate(value, 1))
    names = [method.name for method in methods]
    if len(set(names)) != len(names):
        raise InputError(f"{where}: method", expected="a name of its own each", found=repr(names))
    return methods or tuple(Method(name, built_in=name) for name in DEFAULT_METHODS)


def _method(entry: Any, where: str) -> Method:
    from comparisons.study.methods import BUILT_IN

    table = _table(entry, where)
    _known(table, ("name", "class", "parameters"), where)
    name = _text(table.get("name"), f"{where}: name")
    parameters = _table(table.get("parameters", {}), f"{where}: parameters")
    if "class" not in table:
        if name not in BUILT_IN or parameters:
            raise InputError(
                where,
                expected="a name out of " + ", ".join(BUILT_IN) + ", or a 'class' beside the name",
                found=f"'{name}'" + (" with parameters" if parameters else ""),
            )
        return Method(name, built_in=name)
    path = _text(table["class"], f"{where}: class")
    module, _, attribute = path.partition(":")
    if not attribute or not all(part.isidentifier() for part in (*module.split("."), attribute)):
        raise InputError(f"{where}: class", expected="'package.module:Class'", found=repr(path))
    return Method(name, import_path=path, parameters=tuple(sorted(parameters.items())))


def _check_size(spec: StudySpec, where: str) -> None:
    if spec.design.kind == "random":
        points = spec.design.points
    else:
        lengths = [
            (v.steps or 2) if isinstance(v, Range) else len(v) for v in spec.settings.values()
        ]
        points = math.prod(lengths)
    cells = points * len(spec.seeds) * len(spec.methods)
    if cells > MOST_CELLS:
        raise InputError(where, expected=f"at most {MOST_CELLS} cells", found=f"{cells}")
