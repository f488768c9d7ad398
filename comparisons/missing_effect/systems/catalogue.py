"""The general catalogue, of `catalogue.toml`: effects that a model of any system may lack."""

from __future__ import annotations

import tomllib
from importlib.resources import files
from typing import Any

from comparisons.missing_effect.systems import roles
from comparisons.missing_effect.systems.places import Neutral, Number, SystemEffect
from comparisons.missing_effect.systems.shapes import Kind, Map, Term


def _effect(entry: dict[str, Any], measurements: dict[str, str]) -> SystemEffect:
    """Return one entry: names stand for shapes, places and tests, and for shared measurements."""
    kind = Kind[entry.pop("kind")]
    shape, starts, neutral = (entry.pop(key, None) for key in ("shape", "starts", "neutral"))
    shapes = Term if kind is Kind.TERM else Map
    if neutral is not None:
        neutral = Neutral(**{key: text.format(**measurements) for key, text in neutral.items()})
    return SystemEffect(
        kind=kind,
        code=shapes[shape] if shape else 0,
        numbers=tuple(Number(*number) for number in entry.pop("numbers")),
        places=roles.PLACES[entry.pop("places")],
        starts=roles.quantiles(**starts) if isinstance(starts, dict) else roles.fixed(*starts),
        refused=getattr(roles, entry.pop("refused", "always")),
        confirm=entry.pop("confirm").format(**measurements),
        simple_form_of=tuple(entry.pop("simple_form_of", ())),
        neutral=neutral,
        **entry,
    )


def _catalogue() -> tuple[SystemEffect, ...]:
    given = tomllib.loads(files(__package__).joinpath("catalogue.toml").read_text("utf-8"))
    return tuple(_effect(entry, given["measurements"]) for entry in given["effect"])


SYSTEM_CATALOGUE = _catalogue()
