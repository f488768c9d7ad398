"""The command `sindy-surge bench`: methods on machines drawn at random."""

from __future__ import annotations

import argparse
from collections.abc import Iterator

from comparisons.cli.output import page, write_asked
from comparisons.cli.study import run_cells
from comparisons.missing_effect.diagnosis import FirmNames
from comparisons.page.blocks import Part, Picture, Words
from comparisons.show.figures import write_figures
from comparisons.study.bench import COUNTS, bench_rows, bench_spec, draw_ranks, ranks_of
from comparisons.study.run import check_study
from surge_core.display import Grid
from surge_core.files import write_whole
from surge_core.rounding import significant

BENCH_SCHEMA = "sindy-surge/bench/1"


def run(given: argparse.Namespace) -> Iterator[str]:
    """Draw machines, run the methods on them, and score what they state."""
    folder = given.out
    naming = f"{FirmNames.__module__}:{FirmNames.__name__}"
    spec = bench_spec(given.machines, given.seed, given.method, given.rig or (), naming)
    check_study(spec, folder, resume=given.resume)
    table = run_cells(given, spec)
    rows, ranks = bench_rows(table), ranks_of(table)
    cells = tuple(
        tuple(significant(v, 3) if isinstance(v, float) else str(v) for v in row.values())
        for row in rows
    )
    grid = Grid(spec.title, tuple(COUNTS.values()), cells, frozenset({0}))
    mean = ", ".join(f"{m} {r:.2f}" for m, r in zip(ranks["methods"], ranks["mean"], strict=True))
    reach, p_value = ranks["critical_difference"], ranks["p_value"]
    said = (
        f"mean rank by |error of τ|, a refusal last: {mean}; critical difference "
        f"{reach:.2f} (Nemenyi, 5 %); chance of such ranks if all were alike "
        f"{significant(p_value, 2)} (Friedman)"
    )
    picture = Picture("Mean ranks", draw_ranks(ranks), said, said)
    parts = (Part("", (grid, Words(said), picture)),)
    pages = [("Methods on machines drawn at random", parts)]
    write_whole(folder / "report.html", page(spec.title, pages))
    n = write_figures(pages, folder)
    document = {
        "schema": BENCH_SCHEMA,
        "machines": rows[0]["machines"],
        "seed": given.seed,
        "methods": rows,
        "ranks": ranks,
    }
    yield from (grid.title, *grid.lines(), "", said, "")
    yield f"report, table and figure: {folder} ({n + 2} files)"
    yield from write_asked(given, json=lambda: document)
