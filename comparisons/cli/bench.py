"""The command `sindy-surge bench`: methods on machines drawn at random."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from comparisons.cli.command import Command, check_folder, command_line, write_asked
from comparisons.cli.options import JSON, METHOD, argument, whole
from comparisons.cli.study import OF_CELLS, run_cells

BENCH_SCHEMA = "sindy-surge/bench/1"


def _run(given: argparse.Namespace) -> Iterator[str]:
    from comparisons.missing_effect.firm_names import FirmNames
    from comparisons.page.blocks import Part, Picture, Table, Words
    from comparisons.page.html import render_page
    from comparisons.show.figures import write_figures
    from comparisons.study.bench import COUNTS, bench_rows, bench_spec, draw_ranks, ranks_of
    from comparisons.study.run import check_study
    from surge_core.display import Grid
    from surge_core.files import write_whole
    from surge_core.rounding import significant

    folder = check_folder(given.out)
    naming = f"{FirmNames.__module__}:{FirmNames.__name__}"
    spec = bench_spec(given.machines, given.seed, given.method, given.rig or (), naming)
    check_study(spec, folder, resume=given.resume)
    table = run_cells(given, spec)
    rows, ranks = bench_rows(table), ranks_of(table)
    cells = tuple(
        tuple(
            value if isinstance(value, str) else str(value) if isinstance(value, int)
            else significant(value, 3) for value in row.values()
        )
        for row in rows
    )  # fmt: skip
    grid = Grid(spec.title, tuple(COUNTS.values()), cells, frozenset({0}))
    mean = ", ".join(f"{m} {r:.2f}" for m, r in zip(ranks.methods, ranks.mean, strict=True))
    said = (
        f"mean rank by |error of τ|, a refusal last: {mean}; critical difference "
        f"{ranks.critical_difference:.2f} (Nemenyi, 5 %); chance of such ranks if all were alike "
        f"{significant(ranks.p_value, 2)} (Friedman)"
    )
    picture = Picture("Mean ranks", draw_ranks(ranks), said, said)
    parts = (Part("", (Table.of(grid), Words(said), picture)),)
    pages = [("Methods on machines drawn at random", parts)]
    write_whole(
        folder / "report.html", render_page(pages, title=spec.title, command=command_line())
    )
    n = write_figures(pages, folder)
    document = {
        "schema": BENCH_SCHEMA,
        "machines": rows[0]["machines"],
        "seed": given.seed,
        "methods": rows,
        "ranks": asdict(ranks),
    }
    yield from (grid.title, *grid.lines(), "", said, "")
    yield f"report, table and figure: {folder} ({n + 2} files)"
    yield from write_asked(given, json=lambda: document)


COMMAND = Command(
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
        argument("--out", type=Path, default=Path("bench"), metavar="DIR", help="default: bench"),
        *OF_CELLS,
        JSON,
    ),
    run=_run,
)  # fmt: skip
