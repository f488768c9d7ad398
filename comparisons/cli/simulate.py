"""The command `sindy-surge simulate`: the simulated rig and its raw record."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from pathlib import Path

from comparisons.cli.command import Command
from comparisons.cli.options import argument, number, seed

# What a rig lacks, by the name of the option.
_LACKS = {"lumped": ("draw",), "distributed": ("case", "hide", "hide_size")}


def _run(given: argparse.Namespace) -> Iterable[str]:
    from surge_core.progress import shown_steps

    _check_options(given)
    write = _distributed if given.rig == "distributed" else _lumped
    with shown_steps([2.0, 0.3]) as begin:
        begin("running the rig")
        finish = write(given)
        begin("writing")
        finish()
    return (
        f"raw record: {given.out / 'raw.csv'} with {given.out / 'test.toml'}",
        f"truth:      {given.out / 'truth'}",
    )


def _check_options(given: argparse.Namespace) -> None:
    from surge_core.errors import InputError

    for name in _LACKS[given.rig]:
        value = getattr(given, name)
        if value not in (None, False):
            raise InputError(
                "--" + name.replace("_", "-"),
                expected=f"none with --rig {given.rig}, which has no such option",
                found="it" if value is True else repr(value),
            )


def _lumped(given: argparse.Namespace) -> Callable[[], None]:
    from comparisons.rig import simulate, write_run

    run = simulate(
        given.case or "985",
        seed=given.seed,
        duration_s=given.duration,
        hide=given.hide,
        hide_size=given.hide_size,
    )
    return lambda: write_run(run, given.out)


def _distributed(given: argparse.Namespace) -> Callable[[], None]:
    from comparisons.rig_distributed import draw_run, simulate, write_run

    if given.draw:
        run = draw_run(given.seed, duration_s=given.duration)
    else:
        run = simulate(seed=given.seed, duration_s=given.duration)
    return lambda: write_run(run, given.out)


COMMAND = Command(
    "simulate",
    help="run the simulated test rig and write its raw record",
    description="Run the simulated test rig: DIR/raw.csv and DIR/test.toml as a real rig would "
    "leave them, and apart from them the truth in DIR/truth.",
    arguments=(
        argument(
            "--rig",
            choices=tuple(_LACKS),
            default="lumped",
            help="lumped: volumes and orifices; distributed: another machine, by other equations: "
            "ducts by the Euler equations, stall cell after Moore and Greitzer (default: lumped)",
        ),
        argument(
            "--draw",
            action="store_true",
            help="draw the machine and its instruments at random, by the seed (distributed)",
        ),
        argument(
            "--case",
            help="parameter set of the lumped rig: 985, 90, 95, 985-second, blowdown or 75-stall "
            "(default: 985)",
        ),
        seed(),
        argument(
            "--duration",
            type=number,
            default=4.0,
            metavar="SECONDS",
            help="length, 0.2 to 120 (default: 4)",
        ),
        argument(
            "--hide",
            metavar="EFFECT",
            help="hide an effect in the record, such as flow_inertia, which only DIR/truth names; "
            "an unknown name lists them",
        ),
        argument(
            "--hide-size",
            type=number,
            metavar="NUMBER",
            help="its size, in the unit that DIR/truth/truth.toml states (default: one per effect)",
        ),
        argument("-o", "--out", type=Path, required=True, metavar="DIR", help="folder"),
    ),
    run=_run,
)
