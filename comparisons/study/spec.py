"""The declaration of a study: a TOML file, checked before anything is computed.

Under ``[record]``, ``[reduction]`` and ``[fit]`` a single value holds for all cells and a list is
an axis: the grid has every combination. A random design draws from the lists, and
from ranges ``{from = 0.1, to = 5.0, log = true}``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, get_type_hints

from pydantic import (
    BeforeValidator,
    Field,
    WrapValidator,
    create_model,
    field_validator,
    model_validator,
)

from classic_ml.reduction_settings import ReductionSettings
from comparisons.rig import CASES, HIDEABLE
from comparisons.rig.coefficient_effects import EFFECTS, OUTSIDE
from comparisons.rig.coefficient_tests import NOISES
from comparisons.study.scores import SCORES
from surge_core.errors import InputError, require
from surge_core.models import Table, read_toml, validated

BUILT_IN = ("classic_ml", "sindy", "paper", "classic_ml_arx", "classic_ml_output_error")
MOST_CELLS = 1_000_000
CLASS = r"^[A-Za-z_][\w.]*:[A-Za-z_]\w*$"
TABLES = ("record", "reduction", "fit")

Scalar = float | int | str | bool | None


class Range(Table):
    """An interval that values of a random design are drawn from.

    Parameters
    ----------
    low, high : float
        Its ends, ``from`` and ``to`` in the file.
    log : bool
        Whether the logarithm is drawn evenly.
    """

    low: float = Field(alias="from")
    high: float = Field(alias="to")
    log: bool = False

    @model_validator(mode="after")
    def _in_order(self) -> Range:
        if not self.low < self.high:
            raise InputError("", expected="'from' below 'to'", found=f"{self.low:g}, {self.high:g}")
        if self.log and self.low <= 0.0:
            raise InputError("from", expected="more than 0 with log = true", found=f"{self.low:g}")
        return self

    def at(self, share: float) -> float:
        """Return the value at a share of the way from low to high."""
        if self.log:
            return float(self.low * (self.high / self.low) ** share)
        return self.low + share * (self.high - self.low)


def _axis(given: Any, check: Callable[[Any], Any]) -> Any:
    """Return a range, or the values of an axis, each checked as a value of the setting."""
    if isinstance(given, Mapping):
        interval = validated(Range, given, "")
        if not all(isinstance(end, float) for end in check([interval.low, interval.high])):
            raise InputError("", expected="a range for numbers alone", found="a range")
        return interval
    values = tuple(check(given if isinstance(given, list) else [given]))
    if not values or len(set(values)) != len(values):
        raise InputError("", expected="one value or several, each once", found=repr(given))
    return values


def _axis_of(kind: Any) -> Any:
    return Annotated[list[kind], WrapValidator(_axis)]


def _or_none(kind: Any) -> Any:
    return Annotated[kind | None, BeforeValidator(lambda given: None if given == "none" else given)]


def _one_of(names: Iterable[str]) -> Any:
    return Literal[tuple(names)]


def _axes(name: str, kinds: Mapping[str, Any], **others: Any) -> type[Table]:
    """Return a table whose settings are axes of values of some kinds."""
    axes: dict[str, Any] = {key: (_axis_of(kind), None) for key, kind in kinds.items()}
    return create_model(name, __base__=Table, **axes, **others)


Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
Count = Annotated[int, Field(ge=1)]
Degree = Annotated[int, Field(ge=1, le=20)]
_COEFFICIENTS = {
    "hide": _or_none(_one_of(("none", *EFFECTS, *OUTSIDE))),
    "strength": NotNegative,
    "noise": _one_of(NOISES),
    "noise_percent": NotNegative,
    "duration_s": Positive,
    "sample_period_s": Positive,
    "n_records": Count,
    "degree": Literal[2, 3],
    "gaps": bool,
}
_RIG = {
    "case": _one_of(CASES),
    "hide": _or_none(_one_of(("none", *HIDEABLE))),
    "hide_size": _or_none(float),
    "duration_s": Positive,
    "noise_percent": NotNegative,
}
_PATH = Field(description="a series file, or a folder of a raw record")
_Record: Any = Annotated[
    _axes("coefficientsAxes", _COEFFICIENTS, source=(Literal["coefficients"], ...))
    | _axes("rigAxes", _RIG, source=(Literal["rig"], ...))
    | _axes("machinesAxes", {"rig": str}, source=(Literal["machines"], ...))
    | _axes("filesAxes", {}, source=(Literal["files"], ...), path=(_axis_of(str), _PATH)),
    Field(discriminator="source"),
]
_switches = get_type_hints(ReductionSettings)
_Reduction: Any = _axes(
    "Reduction", {n: _or_none(kind) for n, kind in _switches.items() if n != "window_s"}
)
_Fit: Any = _axes("Fit", {"degree": Degree, "hold": Literal["zero", "first"]})


class Random(Table):
    """A design of points drawn at random.

    Parameters
    ----------
    random : int
        Number of draws.
    seed : int
        Of the draws.
    """

    random: int = Field(ge=1, le=MOST_CELLS)
    seed: int = Field(0, ge=0)


class Method(Table):
    """An estimator of a study.

    Parameters
    ----------
    name : str
        How it is called in the table.
    import_path : str
        ``module:Class`` of an estimator that follows scikit-learn's contract (``class`` in the
        file); empty for one of `BUILT_IN`.
    parameters : dict of str and value
        What the class is made with.
    """

    name: str = Field(min_length=1)
    import_path: str = Field("", alias="class", pattern=CLASS, description="'package.module:Class'")
    parameters: dict[str, Any] = Field({})

    @model_validator(mode="after")
    def _known(self) -> Method:
        if not self.import_path and (self.name not in BUILT_IN or self.parameters):
            raise InputError(
                "",
                expected=f"a name out of {', '.join(BUILT_IN)}, or a 'class' beside the name",
                found=f"'{self.name}'" + (" with parameters" if self.parameters else ""),
            )
        return self


class StudySpec(Table):
    """A study, checked; its fields are the keys of the file.

    Parameters
    ----------
    title : str
        What it is about.
    seeds : list of int
        Seeds of the records; a number stands for so many from 0 on.
    scores : list of str
        Out of `SCORES`; those that the report compares.
    reference : str, optional
        Method that the others are compared with; None: the best.
    by : list of str
        Axes that the report splits by.
    margin : float
        Share of the reference's loss within which two methods are equivalent.
    design : Random, optional
        So many points drawn at random; None ("grid" in the file): every combination.
    method : list of Method
        Estimators.
    record, reduction, fit : Table
        Settings; one value or several of each, or a `Range`.
    """

    study_schema: Literal["sindy-surge/study/1"] = Field("sindy-surge/study/1", alias="schema")
    title: str = Field("Study", min_length=1)
    seeds: list[Annotated[int, Field(ge=0, lt=2**63)]] = Field(1, validate_default=True)
    scores: list[_one_of(SCORES)] = Field(  # type: ignore[valid-type]
        ["tau_error_ms", "curve_rms_error", "held_out_rms"],
        min_length=1,
        description=f"one or more of {', '.join(SCORES)}",
    )
    reference: str | None = None
    by: list[str] = Field([])
    margin: float = Field(0.1, gt=0.0)
    design: Annotated[
        Random | None, BeforeValidator(lambda given: None if given == "grid" else given)
    ] = Field(None, description='"grid" or { random = N, seed = S }')
    method: list[Method] = Field(
        [{"name": "classic_ml"}, {"name": "sindy"}], validate_default=True, min_length=1
    )
    record: _Record = Field({}, validate_default=True)
    reduction: _Reduction = _Reduction()
    fit: _Fit = _Fit()

    @field_validator("seeds", mode="before")
    @classmethod
    def _numbered(cls, given: Any) -> Any:
        """Return the seeds of a number of them."""
        if isinstance(given, list):
            return given
        if type(given) is not int or not 1 <= given <= MOST_CELLS:
            raise InputError(
                "", expected="a whole number from 1 on, or a list of seeds", found=repr(given)
            )
        return list(range(given))

    @field_validator("record", mode="before")
    @classmethod
    def _of_coefficients(cls, given: Any) -> Any:
        return {"source": "coefficients", **given} if isinstance(given, Mapping) else given

    @model_validator(mode="after")
    def _consistent(self) -> StudySpec:
        """Refuse keys that do not go together."""
        names = [method.name for method in self.method]
        references = [] if self.reference is None else [self.reference]
        for key, given, allowed in (("reference", references, names), ("by", self.by, self.axes)):
            if unknown := [value for value in given if value not in allowed]:
                listed = "out of " + (", ".join(allowed) or "the axes, of which there are none")
                raise InputError(key, expected=listed, found=repr(unknown[0]))
        for key, several in (("method", names), ("seeds", self.seeds)):
            if len(set(several)) != len(several):
                raise InputError(key, expected="each once", found=repr(several))
        one = self.source != "files" or len(self.seeds) == 1
        require(one, "seeds", "one, since files are what they are", f"{len(self.seeds)}")
        counts = self.source != "coefficients" or not self.reduction.model_fields_set
        raw = "it with raw records (record.source = 'rig', 'machines' or 'files')"
        found = "record.source = 'coefficients', which has no counts to reduce"
        require(counts, "reduction", raw, found)
        points = 1 if self.design is None else self.design.random
        for name, values in self.settings.items() if self.design is None else ():
            if isinstance(values, Range):
                expected = "a list of values in a grid, or a random design"
                raise InputError(name, expected=expected, found="a range")
            points *= len(values)
        if (cells := points * len(self.seeds) * len(names)) > MOST_CELLS:
            raise InputError("", expected=f"at most {MOST_CELLS} cells", found=f"{cells}")
        return self

    @property
    def source(self) -> str:
        """Where records come from: "coefficients", "rig", "machines" or "files"."""
        return str(self.record.source)

    @property
    def settings(self) -> dict[str, tuple[Scalar, ...] | Range]:
        """Values of each setting that was given, by its dotted name."""
        tables = [(name, getattr(self, name)) for name in TABLES]
        return {
            f"{name}.{key}": values
            for name, table in tables
            for key, values in table
            if key in table.model_fields_set and key != "source"
        }

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the settings that vary."""
        return tuple(n for n, v in self.settings.items() if isinstance(v, Range) or len(v) > 1)


def read_spec(path: Path | str) -> StudySpec:
    """Read a study's declaration.

    Parameters
    ----------
    path : path
        TOML file.

    Raises
    ------
    InputError
        Naming the file and all that is wrong in it.
    """
    return spec_from(read_toml(Path(path), "a study's TOML file"), str(path))


def spec_from(given: Mapping[str, Any], where: str = "study") -> StudySpec:
    """Return the study that a declaration is, as `tomllib` reads it, or refuse all that is wrong.

    Errors begin with `where`, the file that it comes from.
    """
    if not given:
        raise InputError(where, expected="a study", found="an empty file")
    return validated(StudySpec, given, where)
