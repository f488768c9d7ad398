"""A file of saved models, read as data and checked key by key: each fault is one sentence."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from surge_core.errors import InputError
from surge_core.files import write_whole

__all__ = ["Fields", "ModelFormat", "read_models", "write_models"]


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
        """How to mend a key that cannot be used."""
        return f"save the model anew with `{self.writer}`"


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
        How to mend what is wrong in it.
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
        """Return the error of a key.

        Parameters
        ----------
        key, expected, found : str
            The key, what was expected of it, and what it has.
        """
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
        if isinstance(value, int | float) and not isinstance(value, bool):
            try:
                number = float(value)
            except OverflowError:
                number = math.inf
            if math.isfinite(number) and number > above and number >= least:
                return number
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
    document = {
        "schema": form.schema,
        "models": {name: model.to_json() for name, model in models.items()},
    }
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
        raise refused("a folder" if file.is_dir() else "no such file")
    document = _json(file, form)
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


# Of a value that is longer no more is shown.
LONGEST = 60


def _json(file: Path, form: ModelFormat) -> Any:
    try:
        return json.loads(file.read_text("utf-8"))
    except UnicodeDecodeError:
        found = "bytes that are no text in UTF-8"
    except json.JSONDecodeError as error:
        empty = not error.doc.strip()
        found = "an empty file" if empty else f"what is no JSON from line {error.lineno} on"
    except RecursionError:
        found = "values nested too deeply"
    except ValueError:
        # Python refuses to read a whole number of more digits.
        found = "a number of more than 4300 digits"
    raise InputError(str(file), expected=form.expected, found=found)


def _shown(value: object) -> str:
    """Return a value as the file has it: JSON has names of its own for three of them."""
    if value is None:
        return "null"
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else f"{'-' if value < 0.0 else ''}infinity"
    if isinstance(value, Mapping):
        return "a table"
    text = repr(value) if isinstance(value, str) else str(value).lower()
    return text if len(text) <= LONGEST else text[: LONGEST - 1] + "…"
