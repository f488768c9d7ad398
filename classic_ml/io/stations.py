"""The planes and immersions that test.toml names, as the stations that the reduction knows.

These are 25 and 31 with hub and tip, the names of the paper, of the columns and of the series.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

from surge_core.errors import InputError

STATIONS = {"inlet": 25, "exit": 31}
USUAL = {"25": "inlet", "31": "exit"}
HUB_TO_TIP = ["hub", "tip"]


def station_names(values: Mapping[str, Any], source: str) -> dict[str, int]:
    """Return the station of each plane by its name in the file.

    Refused where the tables of the planes do not say which is the inlet and which the exit.
    """
    planes = values.get("planes")
    named = {n: t for n, t in _table(planes).items() if isinstance(t, Mapping)}
    if named.keys() <= USUAL.keys() and not any("station" in t for t in named.values()):
        return {name: STATIONS[station] for name, station in USUAL.items()}
    found = {name: str(t.get("station", USUAL.get(name, ""))) for name, t in named.items()}
    if sorted(found.values()) != sorted(STATIONS):
        said = (f"{name} ({station or 'without a station'})" for name, station in found.items())
        raise InputError(
            f"{source}: planes",
            expected='two tables, [planes.NAME] with station = "inlet" and one with "exit"',
            found=", ".join(said),
            remedy="the names 25 and 31 need no station",
        )
    return {name: STATIONS[station] for name, station in found.items()}


def wrong_immersions(values: Mapping[str, Any], source: str) -> Iterator[InputError]:
    """Find immersions that the plane of a channel does not list, and lists that are of no use."""
    for name, plane in _table(values.get("planes")).items():
        listed = _immersions(values, name)
        between = [text for text in listed[1:-1] if not re.fullmatch("[A-Za-z0-9]+", text)]
        twice = len(set(listed)) < len(listed) or {*listed[1:-1]} & {*HUB_TO_TIP}
        if isinstance(plane, Mapping) and (between or twice):
            yield InputError(
                f"{source}: planes.{name}.immersions",
                expected="names from hub to tip, each once, those between of letters and digits, "
                'and not "hub" or "tip"',
                found=str(listed),
            )
    for name, channel in _table(values.get("channels")).items():
        stated = _table(channel).get("immersion")
        listed = _immersions(values, str(_table(channel).get("plane")))
        if isinstance(stated, str) and stated not in listed:
            yield InputError(
                f"{source}: channels.{name}.immersion",
                expected=" or ".join(f'"{each}"' for each in listed),
                found=repr(stated),
            )


def at_stations(values: Mapping[str, Any], stations: Mapping[str, int]) -> dict[str, Any]:
    """Return the file with its planes and immersions by their names inside."""
    out = dict(values)
    if isinstance(values.get("planes"), Mapping):
        out["planes"] = {str(stations.get(n, n)): t for n, t in values["planes"].items()}
    if isinstance(values.get("near_stall"), Mapping):
        keys = {
            f"{q[0]}{n}{q[1:]}": f"{q[0]}{s}{q[1:]}" for n, s in stations.items() for q in _READ
        }
        # The name of a station that is none in this file is not taken for it.
        aside = {key: f"{key} of no plane" for key in {*keys.values()} - {*keys}}
        out["near_stall"] = {(keys | aside).get(k, k): v for k, v in values["near_stall"].items()}
    if isinstance(values.get("channels"), Mapping):
        out["channels"] = {
            name: _at_station(table, values, stations) if isinstance(table, Mapping) else table
            for name, table in values["channels"].items()
        }
    return out


def as_written(error: InputError, stations: Mapping[str, int]) -> InputError:
    """Return an error with the planes by their names in the file."""
    names = {str(station): plane for plane, station in stations.items()}

    def name(text: str) -> str:
        inside = r"((?<=\bplanes\.)(25|31)\b|(?<=\b[PT])(25|31)(?=_Pa\b|_K\b)(?!\w+ of no plane))"
        text = re.sub(inside, lambda found: names[found[0]], text)
        return text.replace("25 or 31", " or ".join(stations))

    expected, found, remedy = map(name, (error.expected, error.found, error.remedy))
    return InputError(name(error.where), expected=expected, found=found, remedy=remedy)


# What the facility reads at a plane, without its name.
_READ = ("P_Pa", "T_K")


def _at_station(
    channel: Mapping[str, Any], values: Mapping[str, Any], stations: Mapping[str, int]
) -> dict[str, Any]:
    moved = dict(channel)
    if "plane" in channel:
        plane = channel["plane"]
        moved["plane"] = stations.get(str(plane), str(plane))
        listed = _immersions(values, str(plane))
        # Of one alone the outer name is taken.
        ends = {listed[0]: "hub", listed[-1]: "tip"}
        stated = channel.get("immersion")
        if isinstance(stated, str):
            moved["immersion"] = ends.get(stated, stated)
    return moved


def _immersions(values: Mapping[str, Any], plane: str) -> list[str]:
    """Return the immersions of a plane from hub to tip."""
    listed = _table(_table(values.get("planes")).get(plane)).get("immersions")
    if isinstance(listed, list) and listed and all(isinstance(name, str) for name in listed):
        return listed
    return HUB_TO_TIP


def _table(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}
