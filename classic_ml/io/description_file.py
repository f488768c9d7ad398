"""test.toml, read into a TestDescription; all that is missing or wrong is listed at once."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from difflib import get_close_matches
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag, model_validator

from classic_ml.description import (
    COUNT_KEYS,
    Compressor,
    Converter,
    CountChannel,
    FileLayout,
    NearStall,
    PressureChannel,
    TemperatureChannel,
    TestDescription,
    Text,
    Window,
    key,
)
from classic_ml.io.stations import as_written, at_stations, station_names, wrong_immersions
from classic_ml.units import COUNT, kind_of_unit
from surge_core.errors import InputError
from surge_core.models import Table, read_toml, validated

_SPEED = "a speed of 100 to 200 000 revolutions a minute"
# What a table of [defaults] may be for, beside a plane and a pattern of names.
_KINDS = ("pressure", "temperature")
_MODELS: dict[str, type[Table]] = {
    model.__name__: model for model in (CountChannel, PressureChannel, TemperatureChannel)
}


class TestTable(Table):
    """The table `[test]`."""

    name: Text
    sample_rate_hz: float = key("a number above 0", gt=0.0)
    # A fan of 10 m turns above 100, a micro turbine below 2e5.
    rotor_speed_rpm: float = key(_SPEED, "is it in Hz or rad/s?", ge=100.0, le=2e5)
    design_corrected_speed_rpm: float = key(_SPEED, "is it in Hz or rad/s?", ge=100.0, le=2e5)


class Plane(Table):
    """A table `[planes.NAME]`."""

    area_m2: float = key(
        "an area of 0.0001 to 10 m²", "is it in cm² or square inches?", ge=1e-4, le=10.0
    )
    station: Literal["inlet", "exit"] | None = None
    immersions: list[Text] = Field(default=["hub", "tip"], min_length=1)


class Planes(Table):
    """The table `[planes]`."""

    inlet: Plane = Field(alias="25", description="a table")
    exit: Plane = Field(alias="31", description="a table")


def _threshold(value: Any) -> Any:
    # Here, since pydantic would say of each of the types by itself what is wrong.
    is_number = isinstance(value, float | int) and not isinstance(value, bool) and value > 0.0
    if value != "none" and not is_number:
        raise InputError("", expected='a number above 0 or "none"', found=repr(value))
    return value


class Segmentation(Table):
    """The table `[segmentation]`."""

    threshold_lbm_s: Annotated[float | Literal["none"] | None, BeforeValidator(_threshold)] = None
    hysteresis_lbm_s: float = key("a number from 0 on", default=0.0, ge=0.0)


def _model_of(table: Any) -> str:
    """Return which model a channel's table is of, by its kind and its unit."""
    values: Mapping[str, Any] = table if isinstance(table, Mapping) else {}
    if values.get("kind") == "temperature":
        return TemperatureChannel.__name__
    in_counts = kind_of_unit(str(values.get("unit", ""))) == COUNT
    return CountChannel.__name__ if in_counts else PressureChannel.__name__


def _low_to_high(ends: list[float]) -> list[float]:
    if ends[0] >= ends[1]:
        raise InputError("", expected="a range [low, high]", found=f"{ends}")
    return ends


_Range = Annotated[list[float], Field(min_length=2, max_length=2), AfterValidator(_low_to_high)]
_AnyChannel = Annotated[
    Annotated[CountChannel, Tag("CountChannel")]
    | Annotated[PressureChannel, Tag("PressureChannel")]
    | Annotated[TemperatureChannel, Tag("TemperatureChannel")],
    Discriminator(_model_of),
]


class Document(Table):
    """The whole file, with ``[defaults]`` written into the channels."""

    test: TestTable = key("a table")
    compressor: Compressor = key("a table")
    planes: Planes = key("a table")
    near_stall: NearStall = key("a table")
    channels: dict[Text, _AnyChannel] = key("a table of tables")
    adc: Converter | None = None
    near_stall_shifts: dict[str, float] = Field(default_factory=dict)
    limits: dict[str, _Range] = Field(default_factory=dict)
    segmentation: Segmentation = Field(default_factory=Segmentation)
    window: Window | None = None
    file: FileLayout = Field(default_factory=FileLayout)
    defaults: dict[str, dict[str, Any]] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _agrees(self) -> Document:
        """Refuse what no table shows for itself, all of it at once."""
        _refuse([*_wrong_names(self), *_wrong_probes(self)])
        return self


def read_test_description(path: str | os.PathLike[str]) -> TestDescription:
    """Read and check test.toml.

    Parameters
    ----------
    path : str or path
        The file.

    Returns
    -------
    TestDescription
        The checked description.

    Raises
    ------
    InputError
        Naming the file, and each table and key at fault.
    """
    source = str(path)
    values = read_toml(Path(path), "the description of the test (test.toml)")
    stations = station_names(values, source)
    values = _with_defaults(values, stations)
    errors = [*_wrong_defaults(*_defaults_of(values), stations, source)]
    errors += wrong_immersions(values, source)
    try:
        document = validated(Document, at_stations(values, stations), source)
    except InputError as error:
        errors.append(as_written(error, stations))
    _refuse(errors)
    window, channels = document.window, tuple(document.channels.values())
    return TestDescription(
        **document.test.model_dump(),
        compressor=document.compressor,
        areas_m2={25: document.planes.inlet.area_m2, 31: document.planes.exit.area_m2},
        converter=document.adc,
        near_stall=document.near_stall,
        pressures=tuple(c for c in channels if isinstance(c, PressureChannel)),
        temperatures=tuple(c for c in channels if isinstance(c, TemperatureChannel)),
        **document.segmentation.model_dump(),
        window_s=None if window is None else (window.from_s, window.to_s),
        limits={name: (low, high) for name, (low, high) in document.limits.items()},
        near_stall_shifts=document.near_stall_shifts,
        file=document.file,
        source=source,
    )


def _refuse(errors: Sequence[InputError]) -> None:
    """Raise errors as one that lists them all, if there are any."""
    if errors:
        first, also = errors[0], "; ".join(map(str, errors[1:]))
        remedy = "; ".join(part for part in (first.remedy, also) if part)
        raise InputError(first.where, expected=first.expected, found=first.found, remedy=remedy)


def _defaults_of(values: Mapping[str, Any]) -> tuple[dict[str, Any], Mapping[str, Any]]:
    """Return the tables of ``[defaults]`` and ``[channels]``, without what is no table."""
    stated, channels = (values.get(name) for name in ("defaults", "channels"))
    tables = stated.items() if isinstance(stated, Mapping) else ()
    defaults = {name: table for name, table in tables if isinstance(table, Mapping)}
    return defaults, channels if isinstance(channels, Mapping) else {}


def _with_defaults(values: Mapping[str, Any], planes: Collection[str]) -> dict[str, Any]:
    """Return the file with what ``[defaults]`` says of several channels written into each.

    A table of it is for a kind (``[defaults.pressure]``), a plane (``[defaults.25]``) or a pattern
    of names (``[defaults."P25_*"]``); the later of these three prevails, and a channel's own table
    over them all. What a channel has no use for is left out of it, as a calibration of counts
    where it is recorded as a pressure.
    """
    defaults, channels = _defaults_of(values)
    if not channels:
        return dict(values)
    filled: dict[str, Any] = {}
    for name, own in channels.items():
        if not isinstance(own, Mapping):
            filled[name] = own
            continue
        stated: dict[str, Any] = {}
        for pattern, table in defaults.items():
            if pattern not in (*_KINDS, *planes) and fnmatchcase(name, pattern):
                stated |= table
        known = {**stated, **own}
        for group in ("plane", "kind"):
            stated = {**defaults.get(str(known.get(group)), {}), **stated}
        model = _MODELS[_model_of({**stated, **own})]
        useless = () if model is CountChannel else COUNT_KEYS
        used = {k: v for k, v in stated.items() if k in model.model_fields and k not in useless}
        filled[name] = {**used, **own, "name": name}
    # Counts have a converter: without its table all its keys are missing.
    counts = CountChannel.__name__ in map(_model_of, filled.values())
    return {**({"adc": {}} if counts else {}), **values, "channels": filled}


def _wrong_defaults(
    defaults: Mapping[str, Any], channels: Mapping[str, Any], planes: Collection[str], source: str
) -> Iterator[InputError]:
    """Find defaults for no channel, and keys that none has: a misspelt one would be ignored."""
    known = {name for model in _MODELS.values() for name in model.model_fields} - {"name"}
    for name, table in defaults.items():
        found = [key for key in table if key not in known]
        is_group = name in (*_KINDS, *planes)
        if not is_group and not any(fnmatchcase(channel, name) for channel in channels):
            found.append("a pattern of no name")
        if found:
            yield InputError(
                f"{source}: defaults.{name}",
                expected="keys of channels, for a kind, a plane or a pattern of their names",
                found=", ".join(found),
            )


def _wrong_names(document: Document) -> Iterator[InputError]:
    """Find tables by channel that name none, and a column that would feed two channels."""
    channels = document.channels
    moved = [name for name, c in channels.items() if getattr(c, "facing", "") != "aft"]
    tables = (
        ("limits", document.limits, list(channels), "channel"),
        ("near_stall_shifts", document.near_stall_shifts, moved, "forward probe or thermocouple"),
    )
    for table, stated, names, what in tables:
        for name in stated:
            if name not in names:
                near = get_close_matches(name, names, n=1)
                found = "another name" + (f" (is '{near[0]}' meant?)" if near else "")
                yield InputError(f"{table}.{name}", expected=f"the name of a {what}", found=found)
    clock = [] if document.file.clock == "from rate" else [document.file.time]
    columns = Counter([*clock, *(channel.file_column for channel in channels.values())])
    for name, channel in channels.items():
        if columns[channel.file_column] > 1:
            yield InputError(
                f"channels.{name}.column",
                expected="a column of its own",
                found=f"'{channel.file_column}', which feeds another channel or the clock too",
            )


def _wrong_probes(document: Document) -> Iterator[InputError]:
    """Find a plane without probes, probes without a mate, and pairs of two calibrations."""
    channels = document.channels.values()
    probes = [channel for channel in channels if isinstance(channel, PressureChannel)]
    lacking = [f"pressure probes at plane {p}" for p in {25, 31} - {c.plane for c in probes}]
    if not any(isinstance(c, TemperatureChannel) and c.plane == 25 for c in channels):
        lacking.append("a thermocouple at plane 25")
    if lacking:
        yield InputError("channels", expected=" and ".join(sorted(lacking)), found="none")
    pairs: dict[tuple[object, ...], list[PressureChannel]] = {}
    for probe in probes:
        pairs.setdefault((probe.plane, probe.rake, probe.immersion), []).append(probe)
    odd = [p for p in pairs.values() if sorted(probe.facing for probe in p) != ["aft", "forward"]]
    if odd:
        # One place used twice leaves another without its mate.
        twice = max(odd, key=len)
        remedy = "leave out both probes of a pair, in the table too, when one is dead"
        if len({probe.facing for probe in twice}) < len(twice):
            place = f"plane {twice[0].plane}, rake {twice[0].rake}, {twice[0].immersion}"
            remedy = f"{place} is stated twice: correct the place of one of its probes"
        yield InputError(
            "channels",
            expected="one forward and one aft probe at each rake and immersion",
            found=", ".join(f"{probe.name} ({probe.facing})" for pair in odd for probe in pair),
            remedy=remedy,
        )
    for one, other in (pair for pair in pairs.values() if len(pair) == 2):
        for name in ("probe_slope", "probe_offset"):
            values = getattr(one, name), getattr(other, name)
            if values[0] != values[1]:
                yield InputError(
                    f"channels.{one.name}.{name}",
                    expected=f"that of its mate {other.name} (Eq 2 holds for the pair)",
                    found=f"{values[0]:g} and {values[1]:g}",
                )
