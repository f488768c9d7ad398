"""From raw counts to a name: what `diagnose` says of records, untouched and altered in the counts.

Records come from machines drawn at random (`random_machines.py`), or from folders with raw.csv and
test.toml. Each is diagnosed as it is, and with one thing about it altered where it happens: the
∫dx/A that test.toml states x 1.5, P31 late by 5 ms, a P31 sensitivity that ramps 3 % a second. The
files alone pass from the making to the naming. The loss in reversed flow acts without the lag on
all rigs: `reverse_flow_branch` is never false.

Columns: records; refused; what was altered in a firm set; a firm name of its kind; said that
the record does not decide; neither; records with a wrong firm name, and which; share in the set
of those that are decided; median processor seconds.

    python benchmarks/hidden_on_the_rig.py --machines 24 --seed S [--jobs N] [--json FILE]
    python benchmarks/hidden_on_the_rig.py --records FOLDER
"""

from __future__ import annotations

import argparse
import csv
import json
import re
import shutil
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import random_machines

from surge_core.errors import InputError

INERTIA_FACTOR, LATE_S, RAMP_PER_S, RAMP_COUNT = 1.5, 0.005, 0.03, 2048.0
HIGHEST_COUNT = 4095.0
ALTERED = ("flow_inertia", "transport_delay", "sensitivity_drift")
REAL = "reverse_flow_branch"
DRIFTS = frozenset({"sensitivity_drift", "bias_drift", "facility_heating", "speed_droop"})
SLOW = frozenset({"transport_delay", "second_order_lag"})
# Names of the same kind: in one record of a few seconds nothing may separate them.
KIN = {**dict.fromkeys(DRIFTS, DRIFTS), **dict.fromkeys(SLOW, SLOW)}

Row = dict[str, Any]
# Where a record comes from, its seed, its number, and what is altered.
Job = tuple[str, int, int, str | None]


def make(job: Job, folder: Path) -> None:
    """Write ``raw.csv`` and ``test.toml`` of a record, altered or not."""
    source, seed, number, hidden = job
    if source == "drawn":
        random_machines.draw(seed, number, folder)
    else:
        shutil.copytree(source, folder)
    if hidden is not None:
        _alter(folder, hidden)


def _alter(folder: Path, hidden: str) -> None:
    """Alter one thing about a record where it happens: in its counts or in what is stated."""
    if hidden == "flow_inertia":
        text, n = re.subn(
            r"(?m)^(inertia_per_m\s*=\s*)(\S+)",
            lambda found: f"{found[1]}{float(found[2]) * INERTIA_FACTOR:.6g}",
            (folder / "test.toml").read_text("utf-8"),
        )
        assert n == 1
        (folder / "test.toml").write_text(text, "utf-8")
        return
    with (folder / "raw.csv").open(newline="", encoding="utf-8") as file:
        names, *lines = csv.reader(file)
    table = np.array(lines, dtype=np.float64)
    time_s = table[:, names.index("time_s")]
    late = round(LATE_S / float(np.median(np.diff(time_s))))
    growth = 1.0 + RAMP_PER_S * (time_s - time_s[0])
    for column in (i for i, name in enumerate(names) if name.startswith("P31")):
        counts = table[:, column]
        if hidden == "transport_delay":
            table[:, column] = np.concatenate([np.full(late, counts[0]), counts[:-late]])
        else:
            drifted = RAMP_COUNT + (counts - RAMP_COUNT) * growth
            table[:, column] = np.clip(drifted, 0.0, HIGHEST_COUNT)
    head = ",".join(names)
    np.savetxt(folder / "raw.csv", table, fmt="%.10g", delimiter=",", header=head, comments="")


def answered(job: Job) -> Row:
    """Make a record, diagnose it and hold the answer against what was hidden."""
    from classic_ml.io import read_raw
    from classic_ml.reduction import reduce_record
    from comparisons.missing_effect import diagnose

    source, seed, number, hidden = job
    row: Row = {"source": Path(source).name, "seed": seed, "number": number, "hidden": hidden}
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "run"
        make(job, folder)
        try:
            series = reduce_record(*read_raw(folder / "raw.csv", folder / "test.toml")).series
            begun = time.process_time()
            d = diagnose([series])
        except InputError as error:
            return row | {"refused": str(error)}
    names = [
        {
            "set": list(item.alias_set),
            "firm": not item.provisional,
            "value": item.parameters[0].value,
        }
        for item in d.missing
        if item.effect != REAL
    ]
    kin = KIN.get(str(hidden), frozenset({str(hidden)}))
    firm = [item["set"] for item in names if item["firm"]]
    return row | {
        "verdict": d.verdict,
        "names": names,
        "in_set": any(hidden in members for members in firm),
        "kin": any(kin & set(members) for members in firm),
        "untold": hidden in {item.effect for item in d.untold},
        "wrong": [members for members in firm if not kin & set(members)],
        "tau_ms": [1e3 * d.tau_before_s, 1e3 * d.tau_after_s],
        "cpu_s": time.process_time() - begun,
    }


def table(rows: Sequence[Row]) -> str:
    """Return one line for each source and each thing that was altered."""
    every = pd.DataFrame(rows)
    every["source"] = every["source"].str[:1]
    every["hidden"] = every["hidden"].fillna("untouched")
    columns = {"refused", "in_set", "kin", "untold", "wrong", "cpu_s"}
    every = every.reindex(columns=[*every, *columns.difference(every)])
    lines = {}
    for place, group in every.groupby(["source", "hidden"], sort=False):
        said = group[group["refused"].isna()]
        known = said[["in_set", "kin", "untold"]].astype(bool)
        open_ = int((known["untold"] & ~known["kin"]).sum())
        in_set, kin, rest = int(known["in_set"].sum()), int(known["kin"].sum()), len(said) - open_
        altered = place[1] != "untouched"
        wrong = Counter(" = ".join(members) for several in said["wrong"] for members in several)
        lines[place] = {
            "n": len(group),
            "refused": len(group) - len(said),
            "in set": in_set if altered else "",
            "kin": kin if altered else "",
            "open": open_ if altered else "",
            "missed": rest - kin if altered else "",
            "wrong": sum(map(bool, said["wrong"])),
            "in set / rest": f"{100 * in_set / rest:.0f} %" if altered and rest else "",
            "s": f"{said['cpu_s'].median():.0f}" if len(said) else "",
            "": ", ".join(f"{n} x {what}" for what, n in wrong.items()),
        }
    return pd.DataFrame(lines).T.to_string()


def main() -> None:
    """Print a line a record, then the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    add = parser.add_argument
    add("--machines", type=int, default=8, help="drawn at random")
    add("--seed", type=int, default=1)
    add("--records", nargs="+", help="folders of raw.csv and test.toml")
    add("--jobs", type=int, default=2, help="records at a time")
    add("--json", type=Path, metavar="FILE", help="write the rows")
    add("--quick", action="store_true", help="one record, untouched and late")
    given = parser.parse_args()
    sources = random_machines.folders_of(given.records) if given.records else ["drawn"]
    numbers = range(1 if given.records or given.quick else given.machines)
    wanted = (None, "transport_delay") if given.quick else (None, *ALTERED)
    jobs = [(s, given.seed, number, h) for s in sources for number in numbers for h in wanted]
    rows = []
    with ProcessPoolExecutor(given.jobs, mp_context=get_context("spawn")) as pool:
        for row in pool.map(answered, jobs):
            rows.append(row)
            said = row.get("refused") or f"{row['verdict']}: {row['names']}"
            print(f"{row['source']}-{row['number']} {row['hidden']}: {said[:150]}", flush=True)
    print("\n" + table(rows))
    if given.json:
        given.json.write_text(json.dumps(rows, indent=1), "utf-8")


if __name__ == "__main__":
    main()
