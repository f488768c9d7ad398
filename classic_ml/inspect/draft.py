"""A test.toml to begin with: the channels of a file, what their names say, and what is missing."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path

from classic_ml.inspect.facts import ChannelFacts, ClockFacts, Inspection
from classic_ml.units import COUNT, kind_of_unit, split_reference

__all__ = ["draft_test_toml"]

_HEAD = """\
# Description of a test, drafted from {source}.
# Lines that begin with "#" hold what the file does not say: fill them in and take the "#" away.
# What was guessed from the names of the columns is marked so: check it.
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

[file]
{layout}
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
_PROBE_KEYS = """\
# probe_slope =                 # a and b of Eq 2, alike for both of a pair
# probe_offset =
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
_COUPLE_KEYS = """\
# recovery_factor =             # indicated over total temperature
# time_constant_s =             # of the junction
"""
_FACING = {
    **dict.fromkeys(("forward", "fwd", "fore", "for", "front"), "forward"),
    **dict.fromkeys(("aft", "rear"), "aft"),
}
_GUESSED = "    # guessed from the name"


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
        TOML; what the file does not say is left in comments.
    """
    clock = inspection.clock
    channels = [c for c in inspection.channels if clock is None or c.name != clock.name]
    guessed = {channel.name: _guesses(channel) for channel in channels}
    known = [channel for channel in channels if guessed[channel.name]["kind"]]
    others = [channel for channel in channels if channel not in known]
    rate = "# sample_rate_hz ="
    if clock is not None and clock.rate_hz > 0.0:
        rate = f"sample_rate_hz = {float(f'{clock.rate_hz:.6g}')!r}"
    head = _HEAD.format(
        source=" ".join(inspection.source.split()),
        name=_text(Path(inspection.source).stem),
        rate=rate,
        layout=_layout(clock, group, bool(others)),
    )
    in_counts = any(_is_codes(channel, guessed[channel.name]) for channel in known)
    keys: set[str] = set()
    tables = [_channel(channel, guessed[channel.name], keys) for channel in known]
    if others:
        tables.append(
            "\n# Columns whose names do not say what they are: describe them as above, or leave "
            "them out.\n" + "".join(f"# {_described(channel)}\n" for channel in others)
        )
    return "".join((head, _ADC if in_counts else "", _NEAR_STALL, *tables))


def _layout(clock: ClockFacts | None, group: str | None, has_others: bool) -> str:
    lines = [] if group is None else [f"group = {_text(group)}"]
    if clock is None:
        lines.append('clock = "from rate"')
        lines.append("# start_s =                     # facility clock at the first row")
    else:
        lines += [f"time = {_text(clock.name)}", f"time_unit = {_text(clock.unit)}"]
    return "\n".join([*lines, 'other_columns = "ignore"'] if has_others else lines)


def _guesses(channel: ChannelFacts) -> dict[str, str]:
    """Return what the name of a column says of its kind and place; empty where it does not."""
    name = _without_unit(channel.name)
    words = [word for word in re.split(r"[^A-Za-z]+", name) if word]
    lower = [word.lower() for word in words]
    plane = re.search(r"(?<!\d)(25|31)(?!\d)", name)
    kind = kind_of_unit(channel.unit)
    if kind not in ("pressure", "temperature"):
        kind = {"p": "pressure", "t": "temperature"}.get(name[:1].lower(), "") if plane else ""
        kind = "temperature" if name[:2].lower() == "tc" else kind
    after = re.search(r"(?:25|31)[\s_-]*(?:rake[\s_-]*)?([A-Za-z])(?![A-Za-z])", name)
    rakes = [word.upper() for word in words if len(word) == 1 and word.upper() not in "PT"]
    return {
        "kind": kind,
        "plane": plane[1] if plane else "",
        "rake": after[1].upper() if after else (rakes[0] if len(rakes) == 1 else ""),
        "immersion": next((word for word in ("hub", "tip") if word in lower), ""),
        "facing": next((_FACING[word] for word in lower if word in _FACING), ""),
    }


def _channel(channel: ChannelFacts, guessed: Mapping[str, str], taken: set[str]) -> str:
    """Return the table of a channel, under a key that is not taken yet."""
    key = re.sub(r"[^A-Za-z0-9_-]+", "_", _without_unit(channel.name)).strip("_") or "channel"
    while key in taken:
        key += "_"
    taken.add(key)
    lines = [f"\n[channels.{key}]    # {_described(channel)}"]
    if key != channel.name:
        lines.append(f"column = {_text(channel.name)}")
    lines.append(f'kind = "{guessed["kind"]}"{_GUESSED}')
    lines.append(_unit(channel, guessed))
    choices = {"plane": "25 or 31", "rake": "its letter"}
    if guessed["kind"] == "pressure":
        choices |= {"immersion": '"hub" or "tip"', "facing": '"forward" or "aft"'}
    for name, choice in choices.items():
        shown = guessed[name] if name == "plane" else _text(guessed[name])
        blank = f"# {name} =".ljust(32) + f"# {choice}"
        lines.append(f"{name} = {shown}{_GUESSED}" if guessed[name] else blank)
    text = "\n".join(lines) + "\n"
    if guessed["kind"] == "temperature":
        return text + _COUPLE_KEYS
    if _is_codes(channel, guessed):
        return text + _PROBE_KEYS + _COUNT_KEYS
    is_absolute = split_reference(channel.unit)[1] == "absolute"
    return text + _PROBE_KEYS + ("" if is_absolute else _OPEN_REFERENCE)


def _unit(channel: ChannelFacts, guessed: Mapping[str, str]) -> str:
    kind = kind_of_unit(channel.unit)
    if kind in (guessed["kind"], COUNT):
        unit = COUNT if kind == COUNT else channel.unit
        return f"unit = {_text(unit)}    # as the file states"
    if _is_codes(channel, guessed):
        return 'unit = "count"    # guessed: whole numbers'
    couple = guessed["kind"] == "temperature"
    choices = '"K", "degC", "degF"' if couple else '"count", "psia", "kPa abs"'
    return f"# unit =                        # {choices}"


def _is_codes(channel: ChannelFacts, guessed: Mapping[str, str]) -> bool:
    if channel.unit:
        return kind_of_unit(channel.unit) == COUNT
    return guessed["kind"] == "pressure" and channel.whole_numbers


def _described(channel: ChannelFacts) -> str:
    unit = f" {channel.unit}" if channel.unit else ""
    name = " ".join(channel.name.split())
    return f"{name}: {channel.minimum:.6g} to {channel.maximum:.6g}{unit}"


def _without_unit(name: str) -> str:
    # Without a leading \s*, which would look at long runs of spaces over and over.
    return re.sub(r"[(\[{][^()\[\]{}]*[)\]}]\s*$", "", name).rstrip()


def _text(value: str) -> str:
    """Return a TOML string, whose escapes are those of JSON."""
    return json.dumps(value, ensure_ascii=False)
