"""The command `sindy-surge simulate`: the simulated rig and its raw record."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path

from comparisons.cli.shared import Command, argument, number, seed

__all__ = ["COMMAND"]


def _run(given: argparse.Namespace) -> Iterable[str]:
    from comparisons.rig import simulate, write_run
    from surge_core.progress import shown_steps

    with shown_steps(2) as begin:
        begin("running the rig")
        rig = simulate(
            given.case,
            seed=given.seed,
            duration_s=given.duration,
            hide=given.hide,
            hide_size=given.hide_size,
        )
        begin("writing")
        write_run(rig, given.out)
    return (
        f"raw record: {given.out / 'raw.csv'} with {given.out / 'test.toml'}",
        f"truth:      {given.out / 'truth'}",
    )


COMMAND = Command(
    "simulate",
    help="run the simulated test rig and write its raw record",
    description="Run the simulated test rig: DIR/raw.csv and DIR/test.toml as a real rig would "
    "leave them, and apart from them the truth in DIR/truth.",
    arguments=(
        argument(
            "--case",
            default="985",
            help="parameter set: 985, 90, 95, 985-second, blowdown or 75-stall (default: 985)",
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
