"""Declarations that users write (test.toml, a study), checked by pydantic models.

A model declares each key once: its type, its range (``Field(ge=…, le=…)``) and, as ``description``,
what is expected there in words. `validated` turns everything that pydantic finds wrong into one
`InputError` that lists it all.
"""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic.fields import FieldInfo

from surge_core.errors import InputError

M = TypeVar("M", bound=BaseModel)

LONGEST_VALUE = 60
# Of places with one and the same mistake so many are named.
MOST_PLACES = 8
# What a key of a type holds.
KINDS = {float: "a number", int: "a whole number", str: "a text"}
PLAIN = {
    "a valid number": "a number",
    "a valid integer": "a whole number",
    "a valid integer, got a number with a fractional part": "a whole number",
    "a valid string": "a text",
    "a valid boolean": "true or false",
    "a valid list": "a list",
    "a valid tuple": "a list",
    "a valid array": "a list",
    "a valid dictionary": "a table",
}


class Table(BaseModel):
    """A table of a TOML file: no unknown keys, no text for a number, no infinite values."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class _Mistake(NamedTuple):
    where: str
    expected: str
    found: str
    remedy: str

    def known(self) -> str:
        """Return what was found, with its remedy."""
        return self.found + (f" ({self.remedy})" if self.remedy else "")


def read_toml(path: Path, what: str) -> dict[str, Any]:
    """Read a TOML file, or refuse it as no such file or no TOML; ``what`` it should be, in words.

    A byte-order mark, as Windows programs write it, does not count.
    """
    if not path.is_file():
        found = "a folder" if path.is_dir() else "no such file"
        raise InputError(str(path), expected=what, found=found)
    try:
        return tomllib.loads(path.read_bytes().decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise InputError(
            str(path), expected="a TOML file", found="bytes that are no text in UTF-8"
        ) from error
    except (ValueError, RecursionError) as error:
        raise InputError(str(path), expected="a TOML file", found=str(error)) from error


def validated(model: type[M], data: Mapping[str, Any], where: str) -> M:
    """Return a declaration, as `tomllib` reads it, as its model, or refuse all that is wrong.

    A field's ``description`` says what is expected there, as in "a radius of 0.02 to 2 m", and
    ``json_schema_extra={"remedy": …}`` how to correct it. A validator may raise `InputError`, whose
    `where` then names a key of its own table (or is empty), or a ValueError. The error names the
    file (``where``), each key at fault, what was expected there and what was found.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        mistakes = [_mistake(dict(one), model, data) for one in error.errors()]
    alike: dict[tuple[str, ...], list[str]] = {}
    for at, *words in dict.fromkeys(mistakes):
        alike.setdefault(tuple(words), []).append(at)
    first, *others = [_Mistake(_listed(places), *words) for words, places in alike.items()]
    named = ": ".join(part for part in (where, first.where) if part)
    if not others:
        raise InputError(named, expected=first.expected, found=first.found, remedy=first.remedy)
    also = "".join(
        f"; {m.where or where}: expected {m.expected}, found {m.known()}" for m in others
    )
    raise InputError(named, expected=first.expected, found=first.known() + also)


def _listed(places: list[str]) -> str:
    more = len(places) - MOST_PLACES
    return ", ".join(places[:MOST_PLACES]) + (f" and {more} more" if more > 0 else "")


def _mistake(error: Mapping[str, Any], model: type[BaseModel], data: Any) -> _Mistake:
    kind, cause = error["type"], error.get("ctx", {}).get("error")
    keys = _keys(error["loc"], data, last=kind == "missing")
    at = _spelled(keys)
    if kind == "extra_forbidden":
        names = list(_fields(model, error["loc"][:-1]))
        near = difflib.get_close_matches(str(keys[-1]), names, n=1)
        found = f"the key '{keys[-1]}'" + (f" (is '{near[0]}' meant?)" if near else "")
        return _Mistake(_spelled(keys[:-1]), "keys out of " + ", ".join(names), found, "")
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        tag = error["ctx"]["discriminator"].strip("'")
        found = repr(error["ctx"]["tag"]) if "tag" in error["ctx"] else "nothing"
        tags = error["ctx"].get("expected_tags")
        return _Mistake(_spelled(keys, tag), f"one of {tags}" if tags else "a value", found, "")
    if isinstance(cause, InputError):
        inner = _spelled(keys, cause.where) if cause.where else at
        return _Mistake(inner, cause.expected, cause.found, cause.remedy)
    field = next(map(_fields(model, error["loc"][:-1]).get, error["loc"][-1:]), None)
    expected = (field.description if field else None) or _expected(error["msg"])
    if kind == "missing":
        table: Any = field and field.annotation
        if [table] == _models_in(table):
            expected = f"a table with {', '.join(_own(table))}"
        elif table in KINDS and expected == "a value":
            expected = KINDS[table]
        return _Mistake(at, expected, "nothing", "")
    extra = field.json_schema_extra if field else None
    remedy = str(extra.get("remedy", "")) if isinstance(extra, dict) else ""
    if kind in ("float_type", "float_parsing"):
        remedy = "write the number alone"
    return _Mistake(at, expected, _shown(error["input"]), remedy)


def _expected(message: str) -> str:
    """Return what pydantic expected, without its opening words."""
    text = message.removeprefix("Value error, ").removeprefix("Input should ")
    if text == "Field required":
        return "a value"
    if not text.startswith("be "):
        return text.removeprefix("have ")
    text = text.removeprefix("be ").removeprefix("an instance of ")
    if text.startswith(("greater", "less")):
        return f"a value {text}"
    if text.startswith("'"):
        return f"one of {text}" if " or " in text else text
    return "a table" if text.startswith("a valid dictionary") else PLAIN.get(text, text)


def _shown(value: Any) -> str:
    if isinstance(value, Mapping):
        return "a table" if value else "an empty table"
    text = repr(value)
    return text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]}…"


def _keys(location: Sequence[str | int], data: Any, *, last: bool) -> list[str | int]:
    """Return those parts of a location that are keys of the file, without pydantic's own tags."""
    keys: list[str | int] = []
    for i, part in enumerate(location):
        entry = isinstance(data, list) and isinstance(part, int)
        if entry or (isinstance(data, Mapping) and part in data):
            data = data[part]
            keys.append(part)
        elif last and i == len(location) - 1:
            keys.append(part)
    return keys


def _spelled(keys: Sequence[str | int], *more: str) -> str:
    """Return ``method[2].name``: entries of a list are counted from 1, as people do."""
    text = ""
    for key in (*keys, *more):
        text += f"[{key + 1}]" if isinstance(key, int) else f".{key}"
    return text.removeprefix(".")


def _fields(model: type[BaseModel], location: Sequence[str | int]) -> dict[Any, FieldInfo]:
    """Return the fields of the table at a location, by their keys.

    Keys of a mapping, numbers in a list and the tags of a union name no field: they are passed
    over, the tag of a union choosing among its models.
    """
    choices: list[type[BaseModel]] = [model]
    for part in location:
        fields = [_own(one)[part] for one in choices if part in _own(one)]
        if fields:
            choices = _models_in(fields[0].annotation)
        else:
            choices = [one for one in choices if part in (one.__name__, *_tags(one))] or choices
    return _own(choices[0]) if choices else {}


def _own(model: type[BaseModel]) -> dict[Any, FieldInfo]:
    return {field.alias or name: field for name, field in model.model_fields.items()}


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models_in(part)]


def _tags(model: type[BaseModel]) -> list[Any]:
    """Return the values by which a discriminated union may choose a model."""
    return [tag for field in model.model_fields.values() for tag in get_args(field.annotation)]
