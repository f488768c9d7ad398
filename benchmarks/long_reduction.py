"""How many times real time is a file reduced, and in how much memory?

A rig record of 10 s is drawn out to minutes or hours by repeating its surge cycles, written as
Parquet and as CSV, and reduced by the command `sindy-surge reduce` on one core, as a process of its
own. Printed are the seconds of the whole process, its start included, by the clock and of the
processor; how many times real time that is by the clock; and the peak of its resident memory.

    python benchmarks/long_reduction.py [--minutes 10 60] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import chain
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import csv, parquet

from classic_ml.readers import read_raw
from classic_ml.records import Record
from classic_ml.reduction import reduce_record
from comparisons.rig import simulate, write_run

CASE = "985"
RIG_S = 10.0
PIECE_ROWS, ROW_GROUP = 1 << 20, 1 << 16
SHORT_ROWS = 20_000
FORMATS = ((".parquet", ".nc"), (".csv", ".nc"), (".csv", ".csv"))
# The command on one core; it leaves behind what it took of the processor and of memory.
PROCESS = """
import json, os, sys, time
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
stated = sys.argv.pop(1)
from comparisons.cli import main as run
code = run()
peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))
with open(stated, "w") as out:
    json.dump({"cpu": time.process_time(), "peak": 1024 * int(peak.split()[1])}, out)
sys.exit(code)
"""


@dataclass(frozen=True)
class Cost:
    """What one run of the command took.

    Parameters
    ----------
    rows : int
        Rows of the record.
    raw, series : str
        Suffix of the file read and of the file written.
    seconds, cpu_seconds : float
        By the clock, and of the processor.
    times_real_time : float
        Length of the record over the seconds by the clock.
    peak_mb : float
        Peak of resident memory.
    """

    rows: int
    raw: str
    series: str
    seconds: float
    cpu_seconds: float
    times_real_time: float
    peak_mb: float


def drawn_out(record: Record, window: slice, n_rows: int) -> Iterator[pa.Table]:
    """Yield a longer record piece by piece: its cycles over and over behind its beginning.

    Counts are whole numbers, as a logger writes them, and the rest is float64.
    """
    n_cycles = window.stop - window.start
    for start in range(0, n_rows, PIECE_ROWS):
        number = np.arange(start, min(start + PIECE_ROWS, n_rows))
        rows = np.where(
            number < window.start, number, window.start + (number - window.start) % n_cycles
        )
        columns = {"time_s": np.round(number / record.sample_rate_hz, 6)}
        for name in record.channels:
            values = record[name][rows]
            columns[name] = values.astype(np.int16) if name[0] == "P" else values
        yield pa.table(columns)


def write_table(pieces: Iterator[pa.Table], file: Path) -> None:
    """Write a table piece by piece."""
    first = next(pieces)
    make = parquet.ParquetWriter if file.suffix == ".parquet" else csv.CSVWriter
    with make(file, first.schema) as writer:
        for piece in chain([first], pieces):
            if file.suffix == ".parquet":
                writer.write_table(piece, row_group_size=ROW_GROUP)
            else:
                writer.write_table(piece)


def run(folder: Path, raw: str, series: str) -> tuple[float, dict[str, float]]:
    """Run the command, and return the seconds by the clock and what the process left."""
    stated, out = folder / "stated.json", folder / f"{raw[1:]}{series}"
    arguments = ["reduce", f"raw{raw}", "--test", "test.toml", "-o", str(out)]
    one_thread = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    # Modules are kept compiled, as those of an installed package are.
    one_thread["PYTHONDONTWRITEBYTECODE"] = ""
    begun = time.perf_counter()
    subprocess.run(
        [sys.executable, "-c", PROCESS, str(stated), *arguments],
        cwd=folder,
        env=os.environ | one_thread,
        stdout=subprocess.DEVNULL,
        check=True,
    )
    return time.perf_counter() - begun, json.loads(stated.read_text())


def costs_of(
    record: Record, window: slice, n_rows: int, folder: Path, formats: tuple[tuple[str, str], ...]
) -> list[Cost]:
    """Run each format."""
    costs: list[Cost] = []
    for raw, series in formats:
        write_table(drawn_out(record, window, n_rows), folder / f"raw{raw}")
        seconds, stated = run(folder, raw, series)
        (folder / f"{raw[1:]}{series}").unlink()
        (folder / f"raw{raw}").unlink()
        speed = n_rows / record.sample_rate_hz / seconds
        costs.append(Cost(n_rows, raw, series, seconds, stated["cpu"], speed, stated["peak"] / 1e6))
        print(line(costs[-1]), flush=True)
    return costs


HEAD = "     rows  raw       series       s   cpu s  x real time  peak MB"


def line(cost: Cost) -> str:
    """Return one row of the table."""
    return (
        f"{cost.rows:9d}  {cost.raw:8s}  {cost.series:6s}  {cost.seconds:6.2f}  "
        f"{cost.cpu_seconds:6.2f}  {cost.times_real_time:11.0f}  {cost.peak_mb:7.0f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, nargs="+", default=[10.0, 60.0])
    parser.add_argument("--folder", type=Path, help="where the files lie (default: TMPDIR)")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--quick", action="store_true", help="half a minute, Parquet alone")
    options = parser.parse_args()
    costs: list[Cost] = []
    with tempfile.TemporaryDirectory(dir=options.folder) as name:
        folder = Path(name)
        write_run(simulate(CASE, seed=0, duration_s=RIG_S), folder)
        record, test = read_raw(folder / "raw.csv", folder / "test.toml")
        window = record.rows_between(*reduce_record(record, test).window_s)
        write_table(drawn_out(record, window, SHORT_ROWS), folder / "raw.parquet")
        run(folder, *FORMATS[0])
        print(HEAD)
        for minutes in [0.5] if options.quick else options.minutes:
            n_rows = round(60.0 * minutes * record.sample_rate_hz)
            formats = FORMATS[:1] if options.quick else FORMATS
            costs += costs_of(record, window, n_rows, folder, formats)
    if options.json:
        options.json.write_text(json.dumps([asdict(cost) for cost in costs]))


if __name__ == "__main__":
    main()
