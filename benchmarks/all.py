"""Everything in one table: the ML fit, the sparse fit, the diagnosis and the reduction, by peers.

    python benchmarks/all.py [--quick] [--only ml,sparse,diagnosis,reduction] [--seeds N]
                             [--json FILE]

A line for ours and one for each peer: accuracy (against the Cramer-Rao bound where there is one),
processor time as a ratio to ours taken in the same run, and memory. What cannot be had is "-" with
a note below. Each block runs in a process of its own with one thread, each peer of the ML fit in an
environment of its own (`python benchmarks/peers/run.py --setup`); one that is not installed is a
line with its reason. `--quick` is for its working alone.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from gathered.table import LEGEND, Line, Notes, header, printed
from resident import ONE_THREAD

BLOCKS = ("ml", "sparse", "diagnosis", "reduction")


def measure(block: str, quick: bool, seeds: int | None) -> list[Line]:
    """Run one block in a process of its own, whose memory nothing else has touched."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "lines.json"
        command = [sys.executable, __file__, "--measure", block, str(file)]
        command += ["--quick"] if quick else []
        command += ["--seeds", str(seeds)] if seeds is not None else []
        subprocess.run(command, env={**os.environ, **ONE_THREAD}, check=True)
        return [Line.of(values) for values in json.loads(file.read_text("utf-8"))]


def options_of(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="a few short records of each block")
    parser.add_argument("--only", metavar="BLOCK,...", help=f"of {','.join(BLOCKS)}")
    parser.add_argument("--seeds", type=int, metavar="N", help="records of each kind in a block")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the lines as JSON")
    parser.add_argument("--measure", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    wanted = options.only.split(",") if options.only else BLOCKS
    unknown = sorted(set(wanted) - set(BLOCKS))
    if unknown:
        parser.error(f"--only: expected some of {','.join(BLOCKS)}; found {', '.join(unknown)}")
    if options.seeds is not None and options.seeds < 1:
        parser.error(f"--seeds: expected a whole number from 1 on; found {options.seeds}")
    options.only = [block for block in BLOCKS if block in wanted]
    return options


def main(arguments: Sequence[str] | None = None) -> None:
    options = options_of(arguments)
    if options.measure:
        block, file = options.measure
        lines = importlib.import_module(f"gathered.{block}").lines(options.quick, options.seeds)
        Path(file).write_text(json.dumps([asdict(line) for line in lines]), "utf-8")
        return
    print(header())
    rows, notes = [], Notes()
    for block in options.only:
        for line in measure(block, options.quick, options.seeds):
            rows.append(line.numbers())
            print(printed(line, notes), flush=True)
    print(f"\n{notes.text()}\n\n" + "\n".join(LEGEND))
    if options.json is not None:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
