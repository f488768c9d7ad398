"""The command `sindy-surge simulate`: the simulated rig and its raw record."""

from __future__ import annotations

import argparse
from pathlib import Path

from comparisons.cli.shared import Commands, number, whole

__all__ = ["add_parser", "run"]


def add_parser(commands: Commands) -> None:
    """Add the command.

    Parameters
    ----------
    commands : argparse sub-parsers
        Those of `sindy-surge`.
    """
    parser = commands.add_parser(
        "simulate",
        help="run the simulated test rig and write its raw record",
        description="Run the simulated test rig: DIR/raw.csv and DIR/test.toml as a real rig "
        "would leave them, and apart from them the truth in DIR/truth.",
    )
    parser.add_argument(
        "--case",
        default="985",
        help="parameter set: 985, 90, 95, 985-second, blowdown or 75-stall (default: 985)",
    )
    parser.add_argument(
        "--seed", type=whole(0, 2**32 - 1), default=0, help="seed of the sensors (default: 0)"
    )
    parser.add_argument(
        "--duration",
        type=number,
        default=4.0,
        metavar="SECONDS",
        help="length, 0.2 to 120 (default: 4)",
    )
    parser.add_argument(
        "--hide",
        metavar="EFFECT",
        help="hide an effect in the record, such as flow_inertia, which only DIR/truth names; an "
        "unknown name lists them",
    )
    parser.add_argument(
        "--hide-size",
        type=number,
        metavar="NUMBER",
        help="its size, in the unit that DIR/truth/truth.toml states (default: one per effect)",
    )
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="DIR", help="folder")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Run the simulated rig and write its record and its truth.

    Parameters
    ----------
    arguments : argparse.Namespace
        Of the command.
    """
    from comparisons.rig import simulate, write_run
    from surge_core.progress import shown_steps

    with shown_steps(2) as begin:
        begin("running the rig")
        rig = simulate(
            arguments.case,
            seed=arguments.seed,
            duration_s=arguments.duration,
            hide=arguments.hide,
            hide_size=arguments.hide_size,
        )
        begin("writing")
        write_run(rig, arguments.out)
    print(f"raw record: {arguments.out / 'raw.csv'} with {arguments.out / 'test.toml'}")
    print(f"truth:      {arguments.out / 'truth'}")
