"""A file of saved models: data that is checked as it is read, nothing of it executed."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Generic, Literal, Protocol, TypeVar

from pydantic import AfterValidator, ConfigDict, Field, model_validator

from comparisons.results import FittedLag, is_known_term
from surge_core.errors import InputError
from surge_core.files import write_whole
from surge_core.models import Table, validated

__all__ = [
    "MODEL_SCHEMA",
    "ModelFormat",
    "Saved",
    "SavedModel",
    "Span",
    "known",
    "load_models",
    "read_models",
    "save_models",
    "write_models",
]

MODEL_SCHEMA = "sindy-surge/model/1"
# More than any record has.
MOST_BLOCKS = 10**9


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


class Saved(Table):
    """A table of a file of models; keys that were added for readers do not count."""

    model_config = ConfigDict(extra="ignore")


def _rising(values: list[float]) -> list[float]:
    if not all(before < after for before, after in pairwise(values)):
        raise ValueError("values that do not rise")
    return values


def _three(row: list[float | None]) -> list[float | None]:
    if len(row) != 3 or row[0] is None:
        raise ValueError("φ, value and standard error")
    return row


Span = Annotated[
    list[float],
    Field(min_length=2, max_length=2, description="two numbers, the smaller first"),
    AfterValidator(_rising),
]
Row = Annotated[list[float | None], AfterValidator(_three)]


class SavedTerm(Saved):
    """A term of a characteristic."""

    name: str = Field(description="the name of a term")
    coefficient: float = Field(description="a coefficient, a finite number")
    stderr: float | None = Field(ge=0.0, description="a standard error, or null")


class SavedModel(Saved):
    """What models with effects and without have in common."""

    estimator: str = Field(description="the name of an estimator")
    time_constant_stderr_s: float | None = Field(
        ge=0.0, description="a standard error in s, or null"
    )
    terms: list[SavedTerm] = Field(description="a list of terms")
    valid_phi: Span
    n_blocks: int = Field(ge=0, le=MOST_BLOCKS, description="a whole number of blocks from 0 on")
    characteristic: list[Row] = Field(description="rows of φ, value and standard error")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the terms."""
        return tuple(term.name for term in self.terms)

    @property
    def coefficients(self) -> tuple[float, ...]:
        """Their coefficients."""
        return tuple(term.coefficient for term in self.terms)

    @property
    def stderr(self) -> tuple[float, ...]:
        """Standard errors of these, NaN where they are not known."""
        return tuple(known(term.stderr) for term in self.terms)

    @property
    def span(self) -> tuple[float, float]:
        """Range of φ in which the curve can be trusted."""
        low, high = self.valid_phi
        return low, high

    @property
    def curve(self) -> tuple[tuple[float, float, float], ...]:
        """The characteristic as (φ, value, standard error)."""
        return tuple((known(a), known(b), known(c)) for a, b, c in self.characteristic)


class SavedLag(SavedModel):
    """A plain lag model."""

    target: Literal["psi_p", "psi"] = Field(description='"psi_p" or "psi"')
    # Null is a time constant that was not identified; such a model runs without its lag.
    time_constant_s: float | None = Field(gt=0.0, description="a time constant above 0 s, or null")
    hold: Literal["zero", "first"] = Field(description='the hold "zero" or "first"')
    dead_time_s: float = Field(default=0.0, description="a dead time in s")

    @model_validator(mode="after")
    def _runs(self) -> SavedLag:
        if not all(map(is_known_term, self.names)):
            values = [(phi, value) for phi, value, _ in self.curve]
            rises = all(before[0] < after[0] for before, after in pairwise(values))
            if not (values and rises and all(math.isfinite(a + b) for a, b in values)):
                raise InputError(
                    "characteristic",
                    expected="rows of rising φ with values, from which terms of unknown names run",
                    found=f"{len(values)} that make no curve",
                )
        return self

    def lag(self) -> FittedLag:
        """Return the model as a value."""
        return FittedLag(
            self.estimator,
            self.target,
            known(self.time_constant_s),
            known(self.time_constant_stderr_s),
            self.names,
            self.coefficients,
            self.stderr,
            self.hold,
            self.span,
            self.curve,
            self.n_blocks,
            self.dead_time_s,
        )


M = TypeVar("M", bound=SavedModel)


class _Document(Saved, Generic[M]):
    models: dict[str, M] = Field(description="a table of models")


class _Writable(Protocol):
    """A model that can be written."""

    def to_json(self) -> dict[str, Any]:
        """Return its table."""


def known(value: float | None) -> float:
    """Return a number of a file, NaN where it has null."""
    return math.nan if value is None else value


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


def read_models(path: str | Path, form: ModelFormat, kind: type[M]) -> dict[str, M]:
    """Read the models of a file; nothing in it is executed.

    Parameters
    ----------
    path : str or path
        The file.
    form : ModelFormat
        What it must be.
    kind : type of SavedModel
        What each of its models must be.

    Returns
    -------
    dict of str to SavedModel
        By name, at least one.

    Raises
    ------
    InputError
        When it is missing, no JSON, of another kind, without a model, or one cannot be used.
    """
    file = Path(path)

    def refused(found: str) -> InputError:
        return InputError(str(file), expected=form.expected, found=found)

    if not file.is_file():
        raise refused("a folder, a device or a pipe" if file.exists() else "no such file")
    try:
        document = json.loads(file.read_text("utf-8"))
    except OSError as error:
        raise refused(f"a file that cannot be read ({error.strerror})") from None
    except (ValueError, RecursionError) as error:
        # No UTF-8, no JSON, or numbers and nests that Python does not take.
        raise refused(f"no JSON ({error})") from None
    schema = document.get("schema") if isinstance(document, dict) else None
    if schema != form.schema:
        raise refused(
            f"the schema '{schema}'" if isinstance(schema, str) else "another kind of JSON"
        )
    if not isinstance(document.get("models"), dict) or not document["models"]:
        raise refused("a file without a model")
    try:
        return validated(_Document[kind], document, str(file)).models  # type: ignore[valid-type]
    except InputError as error:
        raise InputError(
            error.where, expected=error.expected, found=error.found, remedy=form.remedy
        ) from None


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
    saved = read_models(path, MODEL_FORMAT, SavedLag)
    return {name: model.lag() for name, model in saved.items()}
