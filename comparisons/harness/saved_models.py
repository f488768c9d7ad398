"""A file of saved models, read as data and checked key by key: each fault is one sentence."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol

from comparisons.results import FittedLag, is_known_term
from surge_core.errors import InputError
from surge_core.files import write_whole
from surge_core.lag import Hold

__all__ = [
    "MODEL_SCHEMA",
    "MOST_BLOCKS",
    "Fields",
    "ModelFormat",
    "lag_from_json",
    "load_models",
    "read_models",
    "save_models",
    "write_models",
]

MODEL_SCHEMA = "sindy-surge/model/1"
# More than any record has.
MOST_BLOCKS = 10**9
LONGEST_SHOWN = 40
_HOLDS: dict[str, Hold] = {"zero": "zero", "first": "first"}


@dataclass(frozen=True)
class ModelFormat:
    """A kind of file of saved models.

    Parameters
    ----------
    schema : str
        What it states of itself.
    what : str
        What it is, in words.
    writer : str
        The command that writes one.
    """

    schema: str
    what: str
    writer: str

    @property
    def expected(self) -> str:
        """What is expected of a file that is none."""
        return f"{self.what} written by `{self.writer}`"

    @property
    def remedy(self) -> str:
        """What to do about a key that cannot be used."""
        return f"save the model again with `{self.writer}`"


MODEL_FORMAT = ModelFormat(MODEL_SCHEMA, "a model file", "sindy-surge compare --save")


@dataclass(frozen=True)
class Fields:
    """A table of a file of models, whose keys are taken out by what they must be.

    Parameters
    ----------
    values : mapping
        The table.
    where : str
        File and key of the table, for errors.
    remedy : str
        What to do about what is wrong in it.
    """

    values: Mapping[str, Any]
    where: str
    remedy: str = ""

    @classmethod
    def of(cls, values: object, where: str, remedy: str = "") -> Fields:
        """Return a value as a table, or refuse one that is none."""
        if not isinstance(values, Mapping):
            raise InputError(where, expected="a table", found=_shown(values), remedy=remedy)
        return cls(values, where, remedy)

    def refuse(self, key: str, expected: str, found: str) -> InputError:
        """Return the error of a key: what was expected of it, and what it has."""
        return InputError(f"{self.where}.{key}", expected=expected, found=found, remedy=self.remedy)

    def text(self, key: str, what: str, choices: tuple[str, ...] = ()) -> str:
        """Return a text, one of the choices where there are any."""
        value = self._value(key, what)
        if not isinstance(value, str) or (choices and value not in choices):
            raise self.refuse(key, what, _shown(value))
        return value

    def number(
        self, key: str, what: str, *, above: float = -math.inf, least: float = -math.inf
    ) -> float:
        """Return a finite number above one bound and not below another."""
        return self._number(key, what, self._value(key, what), above, least)

    def maybe(
        self, key: str, what: str, *, above: float = -math.inf, least: float = -math.inf
    ) -> float:
        """Return a number; NaN where the file has null, since it was not identified."""
        value = self._value(key, what)
        return math.nan if value is None else self._number(key, what, value, above, least)

    def whole(self, key: str, what: str, most: int) -> int:
        """Return a whole number from 0 to the most."""
        value = self._value(key, what)
        if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= most:
            raise self.refuse(key, f"{what}, a whole number from 0 on", _shown(value))
        return value

    def numbers(self, key: str, what: str) -> tuple[float, ...]:
        """Return a list of finite numbers."""
        return tuple(
            self._number(f"{key}[{i}]", what, value)
            for i, value in enumerate(self._list(key, what))
        )

    def range(self, key: str) -> tuple[float, float]:
        """Return two finite numbers, the smaller one first."""
        what = "two numbers, the smaller first"
        edges = self.numbers(key, what)
        if len(edges) != 2 or not edges[0] < edges[1]:
            raise self.refuse(key, what, _shown(list(edges)))
        return edges[0], edges[1]

    def points(self, key: str) -> tuple[tuple[float, float, float], ...]:
        """Return rows of φ, value and standard error; the last two are NaN where they are null."""
        what = "rows of φ, value and standard error"
        out = []
        for i, row in enumerate(self._list(key, what)):
            place = f"{key}[{i}]"
            if not isinstance(row, list) or len(row) != 3:
                raise self.refuse(place, what, _shown(row))
            phi, *others = row
            value, stderr = (
                math.nan if v is None else self._number(place, "a number or null", v)
                for v in others
            )
            out.append((self._number(place, "a number for φ", phi), value, stderr))
        return tuple(out)

    def table(self, key: str) -> Fields:
        """Return a table within."""
        return Fields.of(self._value(key, "a table"), f"{self.where}.{key}", self.remedy)

    def tables(self, key: str) -> tuple[Fields, ...]:
        """Return a list of tables within."""
        return tuple(
            Fields.of(value, f"{self.where}.{key}[{i}]", self.remedy)
            for i, value in enumerate(self._list(key, "a list of tables"))
        )

    def _value(self, key: str, what: str) -> Any:
        if key not in self.values:
            raise self.refuse(key, what, "no such key")
        return self.values[key]

    def _list(self, key: str, what: str) -> list[Any]:
        value = self._value(key, what)
        if not isinstance(value, list):
            raise self.refuse(key, f"a list: {what}", _shown(value))
        return value

    def _number(
        self,
        key: str,
        what: str,
        value: Any,
        above: float = -math.inf,
        least: float = -math.inf,
    ) -> float:
        number = isinstance(value, int | float) and not isinstance(value, bool)
        # A whole number of 309 digits and more is no float.
        if number and abs(value) < 1e308 and value > above and value >= least:
            return float(value)
        raise self.refuse(key, what, _shown(value))


class _Writable(Protocol):
    """A model that can be written."""

    def to_json(self) -> dict[str, Any]:
        """Return its table."""


def write_models(models: Mapping[str, _Writable], path: str | Path, form: ModelFormat) -> None:
    """Write models as JSON that :func:`read_models` reads, whole or not at all.

    Parameters
    ----------
    models : mapping of str to model
        By name; each has a method ``to_json``.
    path : str or path
        Target.
    form : ModelFormat
        What the file is.
    """
    tables = {name: model.to_json() for name, model in models.items()}
    document = {"schema": form.schema, "models": tables}
    write_whole(Path(path), json.dumps(document, indent=1, allow_nan=False) + "\n")


def read_models(path: str | Path, form: ModelFormat) -> dict[str, Fields]:
    """Read the models of a file as tables; nothing in it is executed.

    Parameters
    ----------
    path : str or path
        The file.
    form : ModelFormat
        What it must be.

    Returns
    -------
    dict of str to Fields
        By name, at least one.

    Raises
    ------
    InputError
        When it is missing, no JSON, of another kind, or without a model.
    """
    file = Path(path)

    def refused(found: str) -> InputError:
        return InputError(str(file), expected=form.expected, found=found)

    if not file.is_file():
        raise refused("no such file" if not file.exists() else "a folder, a device or a pipe")
    try:
        document = json.loads(file.read_text("utf-8"))
    except OSError as error:
        raise refused(f"a file that cannot be read ({error.strerror})") from None
    except (ValueError, RecursionError) as error:
        # No UTF-8, no JSON, or numbers and nests that Python does not take.
        raise refused(f"no JSON ({error})") from None
    if not isinstance(document, Mapping):
        raise refused(f"JSON of another kind, {_shown(document)}")
    schema = document.get("schema")
    if schema != form.schema:
        raise refused(f"the schema {_shown(schema)}" if "schema" in document else "no schema")
    models = document.get("models")
    if not isinstance(models, Mapping):
        raise refused("no table of models")
    if not models:
        raise refused("a file without a model")
    return {
        name: Fields.of(values, f"{file}: models.{name}", form.remedy)
        for name, values in models.items()
    }


def save_models(models: Mapping[str, FittedLag], path: str | Path) -> None:
    """Write fitted models as JSON, whole or not at all.

    Parameters
    ----------
    models : mapping of str to FittedLag
        By estimator.
    path : str or path
        Target.
    """
    write_models(models, path, MODEL_FORMAT)


def load_models(path: str | Path) -> dict[str, FittedLag]:
    """Read models that :func:`save_models` wrote; the file is data, nothing in it is executed.

    Parameters
    ----------
    path : str or path
        The file.

    Raises
    ------
    InputError
        When it is missing or is not a model file.
    """
    return {name: _from_fields(fields) for name, fields in read_models(path, MODEL_FORMAT).items()}


def lag_from_json(data: Mapping[str, Any], where: str = "model") -> FittedLag:
    """Build a model from what :meth:`~comparisons.results.FittedLag.to_json` gave.

    Parameters
    ----------
    data : mapping
        Plain JSON types.
    where : str
        File and key of the model, for errors.

    Raises
    ------
    InputError
        Naming the key that cannot be used.
    """
    return _from_fields(Fields.of(data, where, MODEL_FORMAT.remedy))


def _from_fields(fields: Fields) -> FittedLag:
    """Return a model from its table in a file, every number of it checked."""
    terms = fields.tables("terms")
    names = tuple(term.text("name", "the name of a term") for term in terms)
    table = fields.points("characteristic")
    if not all(map(is_known_term, names)) and not _is_curve(table):
        raise fields.refuse(
            "characteristic",
            "rows of rising φ with values, from which terms of unknown names are run",
            f"{len(table)} row{'' if len(table) == 1 else 's'} that make no curve",
        )
    late = fields.number("dead_time_s", "a dead time in s") if "dead_time_s" in fields.values else 0
    return FittedLag(
        fields.text("estimator", "the name of an estimator"),
        fields.text("target", '"psi_p" or "psi"', ("psi_p", "psi")),
        # Null is a time constant that was not identified; such a model runs without its lag.
        fields.maybe("time_constant_s", "a time constant above 0 s, or null", above=0.0),
        fields.maybe("time_constant_stderr_s", "a standard error in s, or null", least=0.0),
        names,
        tuple(term.number("coefficient", "a coefficient, a finite number") for term in terms),
        tuple(term.maybe("stderr", "a standard error, or null", least=0.0) for term in terms),
        _HOLDS[fields.text("hold", 'the hold "zero" or "first"', tuple(_HOLDS))],
        fields.range("valid_phi"),
        table,
        fields.whole("n_blocks", "a number of blocks", MOST_BLOCKS),
        float(late),
    )


def _is_curve(table: tuple[tuple[float, float, float], ...]) -> bool:
    phi, value = ([row[k] for row in table] for k in (0, 1))
    rises = all(before < after for before, after in pairwise(phi))
    return bool(table) and rises and all(map(math.isfinite, value))


def _shown(value: object) -> str:
    """Return a value as the file has it, cut where it is long."""
    if isinstance(value, Mapping):
        return "a table"
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= LONGEST_SHOWN else f"{text[:LONGEST_SHOWN]}…"
