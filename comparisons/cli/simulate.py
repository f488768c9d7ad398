"""The command `sindy-surge simulate`: the simulated rig and its raw record."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

from comparisons import rig, rig_distributed
from surge_core.errors import InputError
from surge_core.progress import shown_steps

# What a rig lacks, by the name of the option.
_LACKS = {"lumped": ("draw",), "distributed": ("case", "hide", "hide_size")}


def run(given: argparse.Namespace) -> Iterable[str]:
    """Run a rig, and write its raw record and its truth."""
    for name in _LACKS[given.rig]:
        value = getattr(given, name)
        if value not in (None, False):
            raise InputError(
                "--" + name.replace("_", "-"),
                expected=f"none with --rig {given.rig}, which has no such option",
                found="it" if value is True else repr(value),
            )
    with shown_steps([2.0, 0.3]) as begin:
        begin("running the rig")
        write = _lumped(given) if given.rig == "lumped" else _distributed(given)
        begin("writing")
        write(given.out)
    return (
        f"raw record: {given.out / 'raw.csv'} with {given.out / 'test.toml'}",
        f"truth:      {given.out / 'truth'}",
    )


def _lumped(given: argparse.Namespace) -> Callable[[Path], None]:
    case, hidden = given.case or "985", {"hide": given.hide, "hide_size": given.hide_size}
    made = rig.simulate(case, seed=given.seed, duration_s=given.duration, **hidden)
    return partial(rig.write_run, made)


def _distributed(given: argparse.Namespace) -> Callable[[Path], None]:
    make = rig_distributed.draw_run if given.draw else rig_distributed.simulate
    return partial(rig_distributed.write_run, make(seed=given.seed, duration_s=given.duration))
