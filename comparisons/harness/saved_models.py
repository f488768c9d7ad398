"""A file of saved models: data that is checked as it is read, nothing of it executed."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Generic, Literal, NamedTuple, TypeVar

import numpy as np
from pydantic import AfterValidator, ConfigDict, Field, WrapValidator

from classic_ml.series import CoefficientSeries
from comparisons.results import FittedLag, LagModel
from surge_core.errors import InputError
from surge_core.files import to_strict_json, write_whole
from surge_core.models import Table, validated

MODEL_SCHEMA = "sindy-surge/model/1"


class ModelFormat(NamedTuple):
    """A kind of file of saved models: its schema, what it is, and the command that writes one."""

    schema: str
    what: str
    writer: str


MODEL_FORMAT = ModelFormat(MODEL_SCHEMA, "a model file", "sindy-surge compare --save")


def _nan_for_null(value: Any, checked: Callable[[Any], float]) -> float:
    return math.nan if value is None else checked(value)


def _span(values: list[float]) -> tuple[float, float]:
    low, high = values
    if not low < high:
        raise ValueError("values that do not rise")
    return low, high


def _point(row: list[float]) -> tuple[float, float, float]:
    if len(row) != 3:
        raise ValueError("φ, value and standard error")
    return row[0], row[1], row[2]


# NaN in the model where the file has null.
NULLABLE = WrapValidator(_nan_for_null)
StandardError = Annotated[float, Field(ge=0.0), NULLABLE]
Span = Annotated[
    list[float],
    Field(min_length=2, max_length=2, description="two numbers, the smaller first"),
    AfterValidator(_span),
]
Point = Annotated[list[Annotated[float, NULLABLE]], AfterValidator(_point)]


class Saved(Table):
    """A table of a file of models; keys that were added for readers do not count."""

    model_config = ConfigDict(extra="ignore")


class SavedTerm(Saved):
    """A term of a characteristic."""

    name: str
    coefficient: float = Field(description="a coefficient, a finite number")
    stderr: StandardError = Field(description="a standard error, or null")


class SavedModel(Saved):
    """What models with effects and without have in common."""

    estimator: str
    time_constant_stderr_s: StandardError = Field(description="a standard error in s, or null")
    terms: list[SavedTerm]
    valid_phi: Span
    n_blocks: int = Field(ge=0, description="a whole number of blocks from 0 on")
    characteristic: list[Point] = Field(min_length=1, description="rows of φ, value and error")

    def common(self) -> dict[str, Any]:
        """Return the arguments that models with effects and without have in common."""
        return {
            "estimator": self.estimator,
            "time_constant_stderr_s": self.time_constant_stderr_s,
            "terms": tuple(term.name for term in self.terms),
            "coefficients": tuple(term.coefficient for term in self.terms),
            "stderr": tuple(term.stderr for term in self.terms),
            "valid_phi": self.valid_phi,
            "table": tuple(self.characteristic),
            "n_blocks": self.n_blocks,
        }


class SavedLag(SavedModel):
    """A plain lag model."""

    target: Literal["psi_p", "psi"] = Field(description='"psi_p" or "psi"')
    # Null is a time constant that was not identified; such a model runs without its lag.
    time_constant_s: Annotated[float, Field(gt=0.0), NULLABLE] = Field(
        description="a time constant above 0 s, or null"
    )
    hold: Literal["zero", "first"] = Field(description='the hold "zero" or "first"')
    dead_time_s: float = Field(default=0.0, description="a dead time in s")
    covariance: list[float] = Field(default=[], description="of τ and each term, row by row")
    rows: Literal["filtered", "unfiltered"] = "filtered"
    free_run_rms: Annotated[float, Field(ge=0.0), NULLABLE] = math.nan

    def lag(self) -> FittedLag:
        """Return the model as a value."""
        return FittedLag(
            target=self.target,
            time_constant_s=self.time_constant_s,
            hold=self.hold,
            dead_time_s=self.dead_time_s,
            covariance=tuple(self.covariance),
            rows=self.rows,
            free_run_rms=self.free_run_rms,
            **self.common(),
        )


M = TypeVar("M", bound=SavedModel)


class _Document(Saved, Generic[M]):
    models: dict[str, M] = Field(min_length=1, description="a table of models")
    recommended: str | None = Field(default=None, description="the name of a model, or null")
    # Mean φ of each record that they were fitted to, by which it is known again.
    fitted_to: dict[str, float] = Field(default={}, description="mean φ of each record, by name")


def save_models(
    models: Mapping[str, LagModel],
    path: str | Path,
    recommended: str | None = None,
    records: Sequence[CoefficientSeries] = (),
    form: ModelFormat = MODEL_FORMAT,
) -> None:
    """Write models as JSON that :func:`load_models` reads, whole or not at all.

    Parameters
    ----------
    models : mapping of str to LagModel
        By name.
    path : str or path
        Target.
    recommended : str, optional
        The model to believe.
    records : sequence of CoefficientSeries
        What they were fitted to.
    form : ModelFormat
        What the file is.
    """
    tables = {name: model.to_json() for name, model in models.items()}
    fitted = {record.source: float(np.mean(record.phi)) for record in records}
    about = {"schema": form.schema, "recommended": recommended, "fitted_to": fitted}
    write_whole(Path(path), to_strict_json({**about, "models": tables}))


def read_models(path: str | Path, form: ModelFormat, kind: type[M]) -> dict[str, M]:
    """Read the models of a file, by name and at least one; nothing in it is executed.

    Parameters
    ----------
    path : str or path
        The file.
    form : ModelFormat
        What it must be.
    kind : type of SavedModel
        What each of its models must be.

    Raises
    ------
    InputError
        When it is missing, no JSON, of another kind, without a model, or one cannot be used.
    """
    file = Path(path)
    expected = f"{form.what} written by `{form.writer}`"
    try:
        document = json.loads(file.read_text("utf-8"))
        found = f"the schema '{document['schema']}'"
    except FileNotFoundError:
        document, found = {}, "no such file"
    except (KeyError, TypeError):
        document, found = {}, "JSON without a schema"
    except (OSError, ValueError, RecursionError) as error:
        document, found = {}, f"no JSON ({error})"
    if not document or document["schema"] != form.schema:
        raise InputError(str(file), expected=expected, found=found)
    kinds = _Document[kind]  # type: ignore[valid-type]
    return validated(kinds, document, str(file)).models


def about_models(path: str | Path) -> tuple[str | None, frozenset[float]]:
    """Return the model of a file that `compare` recommended, and mean φ of the fitted records."""
    document = json.loads(Path(path).read_text("utf-8"))
    return document.get("recommended"), frozenset(document.get("fitted_to", {}).values())


def load_models(path: str | Path) -> dict[str, FittedLag]:
    """Read models that :func:`save_models` wrote.

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
