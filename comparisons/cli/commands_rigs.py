"""The commands on simulated tests: what is typed."""

from __future__ import annotations

from pathlib import Path

from comparisons.cli.command import Command
from comparisons.cli.options import (
    JSON,
    METHOD,
    RAW,
    REPORT,
    argument,
    folder,
    number,
    reads,
    seed,
    whole,
    writes,
)

# How the cells of a study are run, `bench` among them.
OF_CELLS = (
    argument("--resume", action="store_true", help="go on with what is in DIR; finished fits stay"),
    argument(
        "--jobs",
        type=whole(1, 1024),
        default=0,
        metavar="N",
        help="worker processes on this machine (default: one a core; 1: none)",
    ),
    argument(
        "--scheduler",
        metavar="ADDRESS",
        help="Dask scheduler whose workers do the work instead",
    ),
)
DEMO = Command(
    "demo",
    help="simulate a surge test, reduce it, fit both estimators, write a report",
    description="Simulate an E3-like surge test at 98.5 % and 90 % speed, reduce the raw "
    "counts, run the estimators, look for a hidden effect and write one HTML report.",
    arguments=(
        folder("--out", default=Path("demo"), help="folder (default: demo)"),
        # The second test has the next seed.
        seed(highest=2**32 - 2),
    ),
)
SIMULATE = Command(
    "simulate",
    help="run the simulated test rig and write its raw record",
    description="Run the simulated test rig: DIR/raw.csv and DIR/test.toml as a real rig would "
    "leave them, and apart from them the truth in DIR/truth.",
    arguments=(
        argument(
            "--rig",
            choices=("lumped", "distributed"),
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
)
REPRODUCE = Command(
    "reproduce",
    help="check the paper claim by claim on four simulated instabilities",
    description="Simulate the paper's four instabilities and its steady rotating stall, reduce "
    "the raw counts and fit them the paper's way, and print each claim of the paper with the "
    "number it states, the number found and whether it holds.",
    arguments=(JSON, REPORT, seed()),
)
STUDY = Command(
    "study",
    help="compare methods over a declared design: thousands of fits into one table",
    description="Run every cell of a study: DIR/results.parquet with one row a fit and "
    "DIR/report.html. Finished cells are kept in DIR/cells.jsonl as they come; --resume runs "
    "the rest, and those that failed.",
    arguments=(
        argument("spec", type=Path, metavar="SPEC.toml", help="what is compared over what"),
        argument("--out", type=Path, required=True, metavar="DIR", help="folder"),
        *OF_CELLS,
        argument("--dry-run", action="store_true", help="say how many cells there are, and stop"),
    ),
)
BENCH = Command(
    "bench",
    help="methods on machines drawn at random, scored against a truth that they never see",
    description="Draw machines from every rig that is installed, give each method the same raw "
    "records, and score what it states against the truth, which the scores alone read. DIR has the "
    "table of all fits (results.parquet), what is printed as HTML, CSV and LaTeX, and the "
    "critical-difference plot. The numbers are the same wherever it is run.",
    arguments=(
        argument(
            "--machines", type=whole(1, 100_000), default=100, metavar="N",
            help="machines in all, as many of each rig (default: 100)",
        ),
        argument("--seed", type=whole(0, 2**31), default=0, metavar="S", help="default: 0"),
        METHOD,
        argument(
            "--rig", action="append", metavar="NAME", help="of this rig alone; may be repeated"
        ),
        folder("--out", default=Path("bench"), help="default: bench"),
        *OF_CELLS,
        JSON,
    ),
)  # fmt: skip
TOTAL_SYSTEM = Command(
    "total-system",
    help="fit a lumped model of the whole facility, the rival of the component method",
    description="Simulate compressor, plenums, throttle and supply, and adjust the characteristic "
    "and the time constant until P31, P25 and W25 agree with the measured ones. Needs the "
    "facility's numbers and the surge start, which the component method does not.",
    arguments=(
        *RAW,
        reads(
            "--facility",
            metavar="FILE.toml",
            help="the facility's numbers; may be left out for a record of `simulate`",
        ),
        writes(
            "--save-facility",
            metavar="FILE.toml",
            help="write the facility's numbers that were used, as a pattern for one's own",
        ),
        argument(
            "--table",
            action="store_true",
            help="table of what wrong starts (2, 10, 40 ms) and a wrong volume (10 %%) do to this "
            "method and to the component method; takes a minute",
        ),
        JSON,
    ),
)
