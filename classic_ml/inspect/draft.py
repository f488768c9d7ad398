"""A test.toml to begin with: the channels of a file, what their names tell, and what is missing."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from classic_ml.inspect.clock import ClockFacts
from classic_ml.inspect.facts import ChannelFacts, Inspection
from classic_ml.units import is_count, kind_of_unit, pressure_reference

__all__ = ["draft_test_toml"]

_HEAD = """\
# Description of a test, drafted from {source}.
# Lines that begin with "#" hold what the file does not tell: fill them in and take the "#" away.
# What was guessed from the names of the columns is marked so: check it.
"""
_TEST = """\
[test]
name = {name}
{rate}
# rotor_speed_rpm =             # physical speed
# design_corrected_speed_rpm =  # 100 % corrected speed

[compressor]
# mean_radius_m =               # of the mean rotor velocity
# inertia_per_m =               # integral of dx/A from plane 25 to plane 31, 1/m
# internal_volume_m3 =          # between the planes
gamma = 1.4
gas_constant_J_kg_K = 287.05

[planes.25]
# area_m2 =

[planes.31]
# area_m2 =
"""
_ADC = """
[adc]                           # not needed where no channel is in counts
# bits =
# low_V =
# high_V =
"""
_NEAR_STALL = """
[near_stall]                    # the facility's steady reading before the surge
# from_s =                      # part of the record with that state
# to_s =
# P25_Pa =                      # plane averages, absolute; a text with a unit will do: "7.98 psia"
# T25_K =                       # or "-0.67 degF"
# P31_Pa =
# T31_K =
"""
_COUNT_KEYS = """\
# zoc_reference_Pa =            # pressure on the reference side of the transducer
# zero_count =                  # mean code of the zero reading
# calibrate_count =             # mean code of the calibrate reading
# calibrate_pressure_Pa =       # differential pressure that was applied for it
"""
_OPEN_REFERENCE = """\
# reference_Pa =                # of a reading of 0: the barometer of a gauge, 0 if absolute
"""
_FACING = {
    **dict.fromkeys(("forward", "fwd", "fore", "for", "front"), "forward"),
    **dict.fromkeys(("aft", "rear"), "aft"),
}
_GUESSED = "    # guessed from the name"
_WIDTH = 32


@dataclass(frozen=True)
class _Place:
    """What the name of a column tells of its place; empty where it does not."""

    kind: str
    plane: str
    rake: str
    immersion: str
    facing: str


def draft_test_toml(inspection: Inspection, *, group: str | None = None) -> str:
    """Return a commented test.toml with the channels of a file.

    Parameters
    ----------
    inspection : Inspection
        What the file holds.
    group : str, optional
        The group that was looked into.

    Returns
    -------
    str
        TOML; what the file does not tell is left in comments.
    """
    clock = inspection.clock
    channels = [c for c in inspection.channels if clock is None or c.name != clock.name]
    places = {channel.name: _place(channel) for channel in channels}
    known = [channel for channel in channels if places[channel.name].kind]
    others = [channel for channel in channels if not places[channel.name].kind]
    keys: set[str] = set()
    parts = [
        _HEAD.format(source=_comment(inspection.source)),
        _TEST.format(name=_text(Path(inspection.source).stem), rate=_rate(clock)),
        _file(clock, group, others),
        *_other_groups(inspection),
    ]
    if any(_is_codes(channel, places[channel.name]) for channel in channels):
        parts.append(_ADC)
    parts.append(_NEAR_STALL)
    parts += [_channel(channel, places[channel.name], keys) for channel in known]
    if others:
        parts.append(
            "\n# Columns whose names do not tell what they are: describe them as above, or leave "
            "them out.\n" + "".join(f"# {_described(channel)}\n" for channel in others)
        )
    return "".join(parts)


def _rate(clock: ClockFacts | None) -> str:
    if clock is None or not clock.rate_hz > 0.0:
        return "# sample_rate_hz ="
    return f"sample_rate_hz = {float(f'{clock.rate_hz:.6g}')!r}"


def _file(clock: ClockFacts | None, group: str | None, others: list[ChannelFacts]) -> str:
    lines = []
    if group is not None:
        lines.append(f"group = {_text(group)}")
    if clock is None:
        lines.append('clock = "from rate"')
        lines.append("# start_s =                     # facility clock at the first row")
    else:
        lines.append(f"time = {_text(clock.name)}")
        lines.append(f"time_unit = {_text(clock.unit)}")
    if others:
        lines.append('other_columns = "ignore"')
    return "\n[file]\n" + "\n".join(lines) + "\n"


def _other_groups(inspection: Inspection) -> Iterator[str]:
    """Yield comments on the groups of the file that are not in the draft."""
    if inspection.other_groups:
        yield (
            "# Groups of the file that are not described here, since a record has one length and "
            "rate:\n# resample what is needed of them, or draft one by itself with --group.\n"
        )
    for name, what in inspection.other_groups.items():
        yield f"# {_comment(f'{name}: {what}')}\n"


def _channel(channel: ChannelFacts, place: _Place, taken: set[str]) -> str:
    key = re.sub(r"[^A-Za-z0-9_-]+", "_", _without_unit(channel.name)).strip("_") or "channel"
    while key in taken:
        key += "_"
    taken.add(key)
    lines = [f"\n[channels.{key}]    # {_described(channel)}"]
    if key != channel.name:
        lines.append(f"column = {_text(channel.name)}")
    lines.append(f'kind = "{place.kind}"' + _GUESSED)
    lines.append(_unit(channel, place))
    lines.append(_guess("plane", place.plane, "25 or 31", quoted=False))
    lines.append(_guess("rake", place.rake, "its letter"))
    if place.kind == "temperature":
        lines.append("# recovery_factor =             # indicated over total temperature")
        lines.append("# time_constant_s =             # of the junction")
        return "\n".join(lines) + "\n"
    lines.append(_guess("immersion", place.immersion, '"hub" or "tip"'))
    lines.append(_guess("facing", place.facing, '"forward" or "aft"'))
    lines.append("# probe_slope =                 # a and b of Eq 2, alike for both of a pair")
    lines.append("# probe_offset =")
    text = "\n".join(lines) + "\n"
    if _is_codes(channel, place):
        return text + _COUNT_KEYS
    return text if pressure_reference(channel.unit) == "absolute" else text + _OPEN_REFERENCE


def _guess(key: str, value: str, choices: str, *, quoted: bool = True) -> str:
    if not value:
        return f"# {key} =".ljust(_WIDTH) + f"# {choices}"
    return f"{key} = {_text(value) if quoted else value}" + _GUESSED


def _unit(channel: ChannelFacts, place: _Place) -> str:
    if channel.unit and kind_of_unit(channel.unit) in (place.kind, "count"):
        unit = "count" if is_count(channel.unit) else channel.unit
        return f"unit = {_text(unit)}    # as the file states"
    if _is_codes(channel, place):
        return 'unit = "count"    # guessed: whole numbers'
    return "# unit =                        # " + (
        '"K", "degC", "degF"' if place.kind == "temperature" else '"count", "psia", "kPa abs"'
    )


def _is_codes(channel: ChannelFacts, place: _Place) -> bool:
    if channel.unit:
        return is_count(channel.unit)
    return place.kind == "pressure" and channel.whole_numbers


def _described(channel: ChannelFacts) -> str:
    unit = f" {channel.unit}" if channel.unit else ""
    name = " ".join(channel.name.split())
    return _comment(f"{name}: {channel.minimum:.6g} to {channel.maximum:.6g}{unit}")


def _place(channel: ChannelFacts) -> _Place:
    name = _without_unit(channel.name)
    words = [word for word in re.split(r"[^A-Za-z]+", name) if word]
    lower = [word.lower() for word in words]
    plane = re.search(r"(?<!\d)(25|31)(?!\d)", name)
    kind = kind_of_unit(channel.unit) if channel.unit else ""
    if kind not in ("pressure", "temperature"):
        kind = {"p": "pressure", "t": "temperature"}.get(name[:1].lower(), "") if plane else ""
        if name[:2].lower() == "tc":
            kind = "temperature"
    after = re.search(r"(?:25|31)[\s_-]*(?:rake[\s_-]*)?([A-Za-z])(?![A-Za-z])", name)
    rakes = [word.upper() for word in words if len(word) == 1 and word.upper() not in "PT"]
    return _Place(
        kind,
        plane[1] if plane else "",
        after[1].upper() if after else (rakes[0] if len(rakes) == 1 else ""),
        next((word for word in ("hub", "tip") if word in lower), ""),
        next((_FACING[word] for word in lower if word in _FACING), ""),
    )


def _without_unit(name: str) -> str:
    # Without a leading \s*, which would look at long runs of spaces over and over.
    return re.sub(r"[(\[{][^()\[\]{}]*[)\]}]\s*$", "", name).rstrip()


def _text(value: str) -> str:
    """Return a TOML string, whose escapes are those of JSON."""
    text = value.encode("utf-8", "replace").decode("utf-8")
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _comment(text: str) -> str:
    """Return a text as a comment can hold it: in one line, nothing in it but what is printed."""
    return "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode("ascii")
        for letter in text
    )
