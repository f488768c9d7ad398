"""How many times real time is an hour of 20 channels reduced, and in how much memory?

    python benchmarks/reduction_speed.py [--minutes 60] [--format parquet] [--json FILE]

A rig record of 10 s is drawn out by repeating its surge cycles, written as Parquet or CSV, and
reduced to netCDF by the command `sindy-surge reduce` as a process of its own on one core. Printed
are the seconds of the whole process by the clock, its start included, and of the processor; the
length of the record by the former; and the peak of resident memory.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd

from classic_ml.io import read_raw
from classic_ml.records import Record
from classic_ml.reduction import reduce_record
from comparisons.rig import simulate, write_run

RIG_S = 10.0
COMMAND = [sys.executable, "-m", "comparisons.cli", "reduce"]
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")


def drawn_out(record: Record, window: slice, n_rows: int) -> pd.DataFrame:
    """Return a record of so many rows: its cycles over and over behind its beginning.

    Counts are written as whole numbers, as a logger does; the window has the rows of the cycles.
    """
    number = np.arange(n_rows)
    length = window.stop - window.start
    rows = np.where(number < window.start, number, window.start + (number - window.start) % length)
    columns = {"time_s": np.round(number / record.sample_rate_hz, 6)}
    for name in record.channels:
        values = record[name][rows]
        columns[name] = values.astype(np.int16) if name[0] == "P" else values
    return pd.DataFrame(columns)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--format", choices=("parquet", "csv"), default="parquet")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--quick", action="store_true", help="half a minute, for its working alone")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    minutes = 0.5 if options.quick else options.minutes
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_run(simulate("985", seed=0, duration_s=RIG_S), folder / "rig")
        record, test = read_raw(folder / "rig" / "raw.csv", folder / "rig" / "test.toml")
        window = record.rows_between(*reduce_record(record, test).window_s)
        table = drawn_out(record, window, round(60.0 * minutes * record.sample_rate_hz))
        raw, out = folder / f"raw.{options.format}", folder / "series.nc"
        write = table.to_parquet if options.format == "parquet" else table.to_csv
        write(raw, index=False)
        length_s = len(table) / record.sample_rate_hz
        del table, record
        arguments = [str(raw), "--test", str(folder / "rig" / "test.toml"), "-o", str(out)]
        for _ in range(1 if options.quick else options.runs):
            before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
            subprocess.run(
                [*COMMAND, *arguments],
                env=os.environ | ONE_THREAD,
                stdout=subprocess.DEVNULL,
                check=True,
            )
            seconds = time.perf_counter() - begun
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            rows.append({
                "minutes": minutes,
                "format": options.format,
                "seconds": seconds,
                "processor_seconds": after.ru_utime + after.ru_stime
                - before.ru_utime - before.ru_stime,
                "times_real_time": length_s / seconds,
                "peak_MB": after.ru_maxrss / 1e3,
            })  # fmt: skip
    print(pd.DataFrame(rows).to_string(index=False, float_format="%.4g"))
    if options.json is not None:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
