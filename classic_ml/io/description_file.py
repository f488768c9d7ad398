"""test.toml, read into a TestDescription; all that is missing or wrong is listed at once."""

from __future__ import annotations

import os
from collections.abc import Mapping
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from classic_ml.description import (
    PLAUSIBLE_BIAS,
    PLAUSIBLE_BIAS_K,
    Compressor,
    Converter,
    FileLayout,
    NearStall,
    PressureChannel,
    ProbePair,
    TemperatureChannel,
    TestDescription,
)
from classic_ml.io.description_schema import (
    MODELS,
    Document,
    InCounts,
    Probe,
    Temperature,
    tag_of,
)
from classic_ml.units import COUNT
from surge_core.errors import InputError
from surge_core.models import read_toml, validated

__all__ = ["read_test_description"]


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
    document = validated(Document, _with_defaults(values, source), source)
    near_stall = NearStall(**document.near_stall.model_dump())
    channels = document.channels.items()
    pressures = tuple(
        PressureChannel(**_fields(name, channel))
        for name, channel in channels
        if isinstance(channel, Probe)
    )
    temperatures = tuple(
        TemperatureChannel(**_fields(name, channel))
        for name, channel in channels
        if isinstance(channel, Temperature)
    )
    window = document.window
    description = TestDescription(
        **document.test.model_dump(),
        compressor=Compressor(**document.compressor.model_dump()),
        areas_m2={25: document.planes.inlet.area_m2, 31: document.planes.exit.area_m2},
        converter=None if document.adc is None else Converter(**document.adc.model_dump()),
        near_stall=near_stall,
        pressures=pressures,
        temperatures=temperatures,
        **document.segmentation.model_dump(),
        window_s=None if window is None else (window.from_s, window.to_s),
        limits={name: (low, high) for name, (low, high) in document.limits.items()},
        near_stall_shifts=document.near_stall_shifts or {},
        file=FileLayout(**document.file.model_dump()),
        source=source,
    )
    if document.near_stall_shifts is not None:
        _check_shifts(description)
    _check_columns_apart(description)
    _check_probes(description)
    return description


def _fields(name: str, channel: Probe | Temperature) -> dict[str, Any]:
    values = channel.model_dump(exclude={"kind"})
    if isinstance(channel, InCounts):
        values["unit"] = COUNT
    return {"name": name, **values}


def _with_defaults(values: Mapping[str, Any], source: str) -> dict[str, Any]:
    """Return the file with what ``[defaults]`` says of several channels written into each.

    A table of it is for a kind (``[defaults.pressure]``), a plane (``[defaults.25]``) or a pattern
    of names (``[defaults."P25_*"]``); the later of these three prevails, and a channel's own table
    over them all. What a channel has no use for is left out of it, as a calibration of counts
    where it is recorded as a pressure.
    """
    rest = {key: table for key, table in values.items() if key != "defaults"}
    defaults, channels = values.get("defaults", {}), values.get("channels", {})
    if not defaults or not isinstance(channels, Mapping):
        return rest
    _check_defaults(defaults, channels, source)
    filled: dict[str, Any] = {}
    for name, own in channels.items():
        if not isinstance(own, Mapping):
            filled[name] = own
            continue
        stated: dict[str, Any] = {}
        for pattern, table in defaults.items():
            if pattern not in _GROUPS and fnmatchcase(name, pattern):
                stated |= table
        known = {**stated, **own}
        for group in ("plane", "kind"):
            stated = {**defaults.get(str(known.get(group)), {}), **stated}
        keys = MODELS[tag_of({**stated, **own})].model_fields
        filled[name] = {**{k: v for k, v in stated.items() if k in keys}, **own}
    return {**rest, "channels": filled}


_GROUPS = ("pressure", "temperature", "25", "31")


def _check_defaults(defaults: Any, channels: Mapping[str, Any], source: str) -> None:
    """Refuse defaults for no channel, and keys that none has: a misspelt one would be ignored."""
    known = {key for model in MODELS.values() for key in model.model_fields}
    for name, table in defaults.items() if isinstance(defaults, Mapping) else [("", defaults)]:
        strange = [key for key in table if key not in known] if isinstance(table, Mapping) else []
        unused = name not in _GROUPS and not any(fnmatchcase(c, name) for c in channels)
        if not isinstance(table, Mapping) or strange or unused:
            raise InputError(
                f"{source}: defaults.{name}".rstrip("."),
                expected="keys of channels, for a kind, a plane or a pattern of their names",
                found=", ".join(strange) if strange else "a pattern of no name" * unused or "none",
            )


def _check_shifts(test: TestDescription) -> None:
    """Refuse a shift near stall for what is not matched, or beyond what a match would take out."""
    most = {p.name: PLAUSIBLE_BIAS * test.near_stall.pressure_Pa(p.plane) for p in test.pressures}
    most |= {
        c.name: PLAUSIBLE_BIAS_K * test.near_stall.temperature_K(c.plane) for c in test.temperatures
    }
    aft = {probe.name for probe in test.pressures if probe.facing == "aft"}
    where = f"{test.source}: near_stall_shifts"
    if not test.near_stall_shifts:
        raise InputError(where, expected="a shift for each channel", found="none")
    for name, shift in test.near_stall_shifts.items():
        if name not in most or name in aft:
            raise InputError(
                f"{where}.{name}",
                expected="the name of a forward probe or a thermocouple",
                found="an aft probe" if name in aft else "no such channel in [channels]",
                remedy="it moves with its forward mate" if name in aft else "",
            )
        if abs(shift) > most[name]:
            raise InputError(
                f"{where}.{name}",
                expected=f"{-most[name]:g} to {most[name]:g}",
                found=f"{shift:g}",
                remedy="it is added to the calibrated reading, in Pa or K",
            )


def _check_columns_apart(test: TestDescription) -> None:
    """Refuse a column that would feed two channels: one of them would be a copy."""
    taken = {} if test.file.clock == "from rate" else {test.file.time: "the clock"}
    channels: list[PressureChannel | TemperatureChannel] = [*test.pressures, *test.temperatures]
    for channel in channels:
        if channel.file_column in taken:
            raise InputError(
                f"{test.source}: channels.{channel.name}.column",
                expected="a column of its own",
                found=f"'{channel.file_column}', which feeds {taken[channel.file_column]} too",
            )
        taken[channel.file_column] = channel.name


def _check_probes(test: TestDescription) -> None:
    """Refuse a plane without probes, probes without a mate, and pairs of two calibrations."""
    lacking = [
        f"{what} at plane {plane}"
        for plane, what, there in (
            *((p, "pressure probes", any(c.plane == p for c in test.pressures)) for p in (25, 31)),
            (25, "a thermocouple", bool(test.thermocouples(25))),
        )
        if not there
    ]
    if lacking:
        where = f"{test.source}: channels"
        raise InputError(where, expected=" and ".join(lacking), found="none")
    alone = []
    for plane, rake, immersion in sorted({(c.plane, c.rake, c.immersion) for c in test.pressures}):
        here = [
            c for c in test.pressures if (c.plane, c.rake, c.immersion) == (plane, rake, immersion)
        ]
        if sorted(c.facing for c in here) != ["aft", "forward"]:
            alone += [f"{c.name} ({c.facing})" for c in here]
    if alone:
        raise InputError(
            f"{test.source}: channels",
            expected="one forward and one aft probe at each rake and immersion",
            found=", ".join(alone),
            remedy="leave out both probes of a pair, in the table too, when one is dead",
        )
    for pair in (*test.pairs(25), *test.pairs(31)):
        _check_pair(test, pair)


def _check_pair(test: TestDescription, pair: ProbePair) -> None:
    for key in ("probe_slope", "probe_offset"):
        slopes = getattr(pair.forward, key), getattr(pair.aft, key)
        if slopes[0] != slopes[1]:
            raise InputError(
                f"{test.source}: channels.{pair.forward.name}.{key}",
                expected=f"that of its mate {pair.aft.name} (Eq 2 holds for the pair)",
                found=f"{slopes[0]:g} and {slopes[1]:g}",
            )
