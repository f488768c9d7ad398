"""A test.toml to begin with: the channels of a file with their units, and the keys to fill in."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from classic_ml.description import (
    Compressor,
    Converter,
    CountChannel,
    NearStall,
    PressureChannel,
    TemperatureChannel,
)
from classic_ml.inspect.facts import ChannelFacts, ClockFacts, Inspection
from classic_ml.io.description_file import Plane, TestTable
from classic_ml.series import CLOCK_TOLERANCE
from classic_ml.units import COUNT, kind_of_unit, split_reference
from surge_core.models import Table

_HEAD = """\
# Description of a test, drafted from {source}.
# Lines that begin with "#" hold what the file does not say: fill them in and take the "#" away.
# An absolute pressure or a temperature may be a text with its unit: "7.98 psia", "-0.67 degF".
"""
# A column without a unit is of this kind by its name: P25_A, PT31 B, TC 3.
_NAMED = re.compile(r"(?P<letter>[pt])[a-z]{0,2}[ _-]?\d", re.IGNORECASE)
_KINDS = {"p": "pressure", "t": "temperature"}
# Where a probe is, by the parts of its name: whole words, or the codes TF, TA, HF and HA.
_PLACES: dict[str, dict[str, Any]] = {
    "25": {"plane": 25},
    "31": {"plane": 31},
    "tip": {"immersion": "tip"},
    "hub": {"immersion": "hub"},
    "forward": {"facing": "forward"},
    "fwd": {"facing": "forward"},
    "for": {"facing": "forward"},
    "aft": {"facing": "aft"},
    "tf": {"immersion": "tip", "facing": "forward"},
    "ta": {"immersion": "tip", "facing": "aft"},
    "hf": {"immersion": "hub", "facing": "forward"},
    "ha": {"immersion": "hub", "facing": "aft"},
}
# What probes at one plane and immersion share, and what thermocouples do.
_SHARED = {
    "pressure": ("probe_slope", "probe_offset"),
    "temperature": ("recovery_factor", "time_constant_s"),
}


def draft_test_toml(
    inspection: Inspection, *, group: str | None = None, units: Sequence[str] = ()
) -> str:
    """Return a commented test.toml with the channels of a file.

    Parameters
    ----------
    inspection : Inspection
        What the file holds.
    group : str, optional
        The group that was looked into.
    units : sequence of str
        Of the columns for which the file states none: one of pressure, one of temperature.

    Returns
    -------
    str
        TOML; what the file does not say is left in comments.
    """
    clock = inspection.clock
    channels = [c for c in inspection.channels if clock is None or c.name != clock.name]
    assumed = {kind_of_unit(unit): unit for unit in units}
    channels = [replace(c, unit=assumed.get(_kind_by_name(c), c.unit)) for c in channels]
    models = {channel.name: _model(channel) for channel in channels}
    others = [channel for channel in channels if models[channel.name] is None]
    known = [f"name = {_text(Path(inspection.source).stem)}"]
    rate_hz = 1.0 / (inspection.stated_step_s or math.inf) if clock is None else clock.rate_hz
    if rate_hz > 0.0:
        known.append(f"sample_rate_hz = {float(f'{rate_hz:.6g}')!r}")
    tables = [
        _HEAD.format(source=" ".join(inspection.source.split())),
        _table("test", TestTable, known),
        _table("compressor", Compressor),
        _table("planes.25", Plane),
        _table("planes.31", Plane),
        _table("file", Table, list(_layout(clock, group, bool(others)))),
        _table("near_stall", NearStall),
    ]
    if CountChannel in models.values():
        tables.append(_table("adc", Converter))
    taken: set[str] = set()
    shared: dict[str, str] = {}
    kept = [(channel, model) for channel in channels if (model := models[channel.name])]
    described = [_channel(channel, model, taken, shared) for channel, model in kept]
    tables += [*shared.values(), *described]
    if others:
        tables.append(
            "# Columns that are no pressure and no temperature by unit or name: describe them as "
            "above, or leave\n# them out.\n" + "".join(f"# {_described(c)}\n" for c in others)
        )
    return "\n".join(tables)


def _table(
    path: str, model: type[Table], known: Sequence[str] = (), keys: Collection[str] | None = None
) -> str:
    """Return a table of TOML: what is known, then in comments the keys that it must have beside."""
    lines = [f"[{path}]", *known]
    stated = {line.partition(" = ")[0] for line in lines}
    for key, field in model.model_fields.items():
        wanted = keys is None or key in keys
        if wanted and key not in stated and field.is_required():
            blank = f"# {key} ="
            lines.append(f"{blank:<32s}# {field.description}" if field.description else blank)
    return "\n".join(lines) + "\n"


def _layout(clock: ClockFacts | None, group: str | None, has_others: bool) -> Iterator[str]:
    if group is not None:
        yield f"group = {_text(group)}"
    if clock is None:
        yield 'clock = "from rate"'
    else:
        yield f"time = {_text(clock.name)}"
        yield f"time_unit = {_text(clock.unit)}"
        if clock.jitter > CLOCK_TOLERANCE and "gap" not in clock.troubles:
            yield 'clock = "from rate"'
    if has_others:
        yield 'other_columns = "ignore"'


def _model(channel: ChannelFacts) -> type[Table] | None:
    """Return what a column is by its unit, or without one by its name; None where neither says."""
    named = _kind_by_name(channel)
    in_counts = named == "pressure" and channel.whole_numbers
    kind = COUNT if in_counts else named or kind_of_unit(channel.unit)
    models: dict[str, type[Table]] = {
        COUNT: CountChannel,
        "pressure": PressureChannel,
        "temperature": TemperatureChannel,
    }
    return models.get(kind)


def _kind_by_name(channel: ChannelFacts) -> str:
    """Return the kind of a column without a unit as its name has it; else nothing."""
    named = _NAMED.match(channel.name)
    return "" if channel.unit or named is None else _KINDS[named["letter"].lower()]


def _place(name: str) -> tuple[dict[str, Any], str]:
    """Return what a name says of a probe's place, and the pattern of its plane and immersion."""
    place: dict[str, Any] = {}
    pattern = "*"
    for part in re.findall(r"[A-Za-z]+|[0-9]+", name):
        found = _PLACES.get(part.lower(), {})
        if not found and place and "rake" not in place and re.fullmatch("[A-Za-z]", part):
            found = {"rake": part}
        if "plane" in found or "immersion" in found:
            # Forward and aft probes share their constants: TF and TA are one pattern.
            pattern += f"{part[0]}[FfAa]*" if "facing" in found else f"{part}*"
        place = {**found, **place}
    return place, pattern


def _channel(
    channel: ChannelFacts, model: type[Table], taken: set[str], shared: dict[str, str]
) -> str:
    """Return the table of a channel, under a key that is not taken yet.

    What it shares with others is put into a table of ``[defaults]`` instead, once.
    """
    bare = re.sub(r"[(\[{][^()\[\]{}]*[)\]}]\s*$", "", channel.name).rstrip()
    key = re.sub(r"[^A-Za-z0-9_-]+", "_", bare).strip("_") or "channel"
    while key in taken:
        key += "_"
    taken.add(key)
    known = [f"# {_described(channel)}"]
    if key != channel.name:
        known.append(f"column = {_text(channel.name)}")
    kind = "temperature" if model is TemperatureChannel else "pressure"
    known.append(f'kind = "{kind}"')
    unit = COUNT if model is CountChannel else channel.unit
    if unit:
        known.append(f"unit = {_text(unit)}")
    place, pattern = _place(key)
    known += [
        f"{name} = {place[name] if name == 'plane' else _text(place[name])}"
        for name in model.model_fields
        if name in place
    ]
    common, keys = _SHARED[kind], None
    if kind == "temperature" or {"plane", "immersion"} <= place.keys():
        head = f"defaults.{kind if kind == 'temperature' else _text(pattern)}"
        shared.setdefault(head, _table(head, model, keys=common))
        keys = [name for name in model.model_fields if name not in common]
    table = _table(f"channels.{key}", model, known, keys)
    if model is PressureChannel and split_reference(unit)[1] != "absolute":
        table += "# reference_Pa =                # what a reading of 0 stands for; 0 if absolute\n"
    return table


def _described(channel: ChannelFacts) -> str:
    unit = f" {channel.unit}" if channel.unit else ""
    name = " ".join(channel.name.split())
    return f"{name}: {channel.minimum:.6g} to {channel.maximum:.6g}{unit}"


def _text(value: str) -> str:
    """Return a TOML string, whose escapes are those of JSON."""
    return json.dumps(value, ensure_ascii=False)
