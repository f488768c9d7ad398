"""From raw counts to a name: what `diagnose` says of records of the rig, untouched and altered.

Each record is made as counts with its test description (98.5, 95 and 90 % on the rig of this
project, and a record of a rig that shares no code with it), read back, reduced with the default
settings and diagnosed. Nothing but those two files passes from the making to the naming; truth and
answer meet in `judged` alone. Tables:

    untouched    what effects explain where nothing is hidden; the limits of
                 `comparisons.missing_effect.whole_runs` and `whole_run_diagnosis` stand on it
    hidden       effects hidden physically on 98.5 and 90 %, at their default sizes
    independent  the other rig's record: ∫dx/A x 1.5, a P31 sensitivity that ramps 3 % a second,
                 P31 late by 5 ms

The loss in reversed flow acts without the lag on both rigs: `reverse_flow_branch` is never false.
Columns: records; truth in a set named; truth or a name of its kind; truth as first name; set of one
name; mean size of the set; verdict not provisional; false names. Medians over records: τ in ms
(true: 18) and its largest error, error of cycles left out and measurement noise. Size hidden, and
found where the truth came first; the two are in one unit only where the effect is the same thing in
ψ' (a time constant, a share, a power, a loss).

    python benchmarks/hidden_on_the_rig.py [--seeds 5] [--first-seed 9000] [--jobs 2] [--quick]
        [--only untouched,hidden,independent] [--effects NAME,...] [--size X] [--json FILE]
"""

from __future__ import annotations

import argparse
import csv
import json
import re
import shutil
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from comparisons.rig import HIDEABLE, simulate, write_run

PARTS = ("untouched", "hidden", "independent")
CASES = ("985", "95", "90")
HIDING_CASES = ("985", "90")
EFFECTS = (
    "flow_inertia",
    "thermocouple_lag",
    "sensitivity_drift",
    "facility_heating",
    "transport_delay",
    "reverse_flow_branch",
    "rotating_stall_ripple",
    "second_order_lag",
    "bias_drift",
    "speed_droop",
)
QUICK_EFFECTS = ("flow_inertia", "transport_delay")
REAL = "reverse_flow_branch"
DRIFTS = frozenset({"sensitivity_drift", "bias_drift", "facility_heating", "speed_droop"})
SLOW = frozenset({"transport_delay", "second_order_lag"})
# Names of the same kind: in one record of a few seconds nothing may tell them apart.
KIN = {**dict.fromkeys(DRIFTS, DRIFTS), **dict.fromkeys(SLOW, SLOW)}

INDEPENDENT = Path(__file__).resolve().parents[2] / "shared" / "data" / "independent_rig_985"
# Stated beside that record.
INDEPENDENT_TRUTH = {"tau_ms": 18.0, "reverse_loss": 1443.0}
INERTIA_FACTOR = 1.5
RAMP_PER_S = 0.03
RAMP_COUNT = 2048.0
LATE_SAMPLES = 5
ALTERED = {
    "flow_inertia": INERTIA_FACTOR,
    "sensitivity_drift": RAMP_PER_S,
    "transport_delay": 1e-3 * LATE_SAMPLES,
}

Row = dict[str, Any]


@dataclass(frozen=True)
class Job:
    """One record to make and to diagnose.

    Parameters
    ----------
    source : str
        A case of the rig, or "independent".
    seed : int
        Of the rig.
    hidden : str, optional
        What to hide.
    size : float, optional
        Its size.
    """

    source: str
    seed: int
    hidden: str | None = None
    size: float | None = None


def make(job: Job, folder: Path) -> Row:
    """Write ``raw.csv`` and ``test.toml`` into a new folder and return the truth."""
    if job.source == "independent":
        _copy_altered(folder, job.hidden)
        truth: Row = {**INDEPENDENT_TRUTH, "size": ALTERED.get(job.hidden or "")}
    else:
        run = simulate(job.source, seed=job.seed, hide=job.hidden, hide_size=job.size)
        write_run(run, folder)
        # The truth is for `judged`: what reads the record shall not find it.
        shutil.rmtree(folder / "truth")
        known = run.truth_parameters
        truth = {
            "tau_ms": 1e3 * known["tau_s"],
            "reverse_loss": known["reverse_loss"],
            "size": known.get("hidden", {}).get("size"),
        }
    return {"source": job.source, "seed": job.seed, "hidden": job.hidden, **truth}


def _copy_altered(folder: Path, hidden: str | None) -> None:
    """Copy the independent record, with one thing about it altered."""
    folder.mkdir()
    with (INDEPENDENT / "raw.csv").open(newline="", encoding="utf-8") as file:
        names, *lines = csv.reader(file)
    table = np.array(lines, dtype=np.float64)
    time_s = table[:, names.index("time_s")]
    for column, name in enumerate(names):
        if not name.startswith("P31"):
            continue
        counts = table[:, column]
        if hidden == "sensitivity_drift":
            table[:, column] = RAMP_COUNT + (counts - RAMP_COUNT) * (1.0 + RAMP_PER_S * time_s)
        elif hidden == "transport_delay":
            first = np.full(LATE_SAMPLES, counts[0])
            table[:, column] = np.concatenate([first, counts[:-LATE_SAMPLES]])
    np.savetxt(
        folder / "raw.csv", table, fmt="%.10g", delimiter=",", header=",".join(names), comments=""
    )
    text = (INDEPENDENT / "test.toml").read_text("utf-8")
    if hidden == "flow_inertia":
        text = re.sub(
            r"(?m)^(inertia_per_m\s*=\s*)(\S+)",
            lambda found: f"{found[1]}{float(found[2]) * INERTIA_FACTOR:.6g}",
            text,
        )
    (folder / "test.toml").write_text(text, "utf-8")


def recovered(folder: Path) -> Row:
    """Return what the reduction and the diagnosis make of two files."""
    from classic_ml.io import read_raw
    from classic_ml.reduction import reduce_record
    from comparisons.missing_effect import diagnose
    from comparisons.missing_effect.uncertainty import fitted_parameters

    series = reduce_record(*read_raw(folder / "raw.csv", folder / "test.toml")).series
    d = diagnose([series])
    first = d.rounds[0]
    mean_psi_p = float(np.mean(np.abs(d.data.measured[d.data.scored()])))
    inertia = next((c for c in first.candidates if c.name == "flow_inertia"), None)
    found = None
    if inertia is not None:
        found = fitted_parameters(inertia.fit, first.bench)["flow_inertia"][0].value
    return {
        "verdict": d.verdict,
        "names": [
            {
                "name": item.effect,
                "set": list(item.alias_set),
                "value": item.parameters[0].value,
                "unit": item.parameters[0].unit,
            }
            for item in d.missing
        ],
        "tau_before_ms": 1e3 * d.tau_before_s,
        "tau_after_ms": 1e3 * d.tau_after_s,
        "gap_before": d.gap.before_rms,
        "gap_after": d.gap.after_rms,
        "floor": d.gap.floor_rms,
        "model_error": first.noise.sigma / mean_psi_p,
        "model_error_after": d.noise.sigma / mean_psi_p,
        "share": {c.name: float(c.evidence.share) for c in first.candidates},
        "inertia_s": found,
    }


def judged(truth: Row, answer: Row) -> Row:
    """Hold an answer against the truth."""
    hidden = truth["hidden"]
    kin = KIN.get(hidden, frozenset({hidden}))
    sets = [set(item["set"]) for item in answer["names"]]
    holding = next((i for i, names in enumerate(sets) if hidden in names), None)
    false = [
        item["name"]
        for item, names in zip(answer["names"], sets, strict=True)
        if not names & kin and item["name"] != REAL
    ]
    at = None if holding is None else answer["names"][holding]
    return {
        **truth,
        **answer,
        "named": holding is not None,
        "firm": holding is not None and answer["verdict"] != "provisional",
        "kin_named": any(names & kin for names in sets),
        "first": at is not None and at["name"] == hidden,
        "set_size": None if at is None else len(at["set"]),
        "value": at["value"] if at is not None and at["name"] == hidden else None,
        "false": false,
    }


def one_row(job: Job) -> Row:
    """Make a record, diagnose it and hold the answer against the truth."""
    with tempfile.TemporaryDirectory() as folder:
        truth = make(job, Path(folder) / "run")
        return judged(truth, recovered(Path(folder) / "run"))


def jobs_of(options: argparse.Namespace) -> list[Job]:
    """Return what is to be done."""
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    out = []
    if "untouched" in options.only:
        out += [Job(case, seed) for case in CASES for seed in seeds]
    if "hidden" in options.only:
        out += [
            Job(case, seed, effect, options.size)
            for case in HIDING_CASES
            for effect in options.effects
            for seed in seeds
        ]
    if INDEPENDENT.is_dir():
        if "untouched" in options.only:
            out.append(Job("independent", 0))
        if "independent" in options.only:
            out += [Job("independent", 0, effect) for effect in ALTERED]
    return out


def untouched_tables(rows: Sequence[Row]) -> list[str]:
    """Return what effects explain where nothing is hidden, and what was named there."""
    sources = list(dict.fromkeys(row["source"] for row in rows))
    groups = {source: [row for row in rows if row["source"] == source] for source in sources}
    names = sorted(
        {name for row in rows for name in row["share"]},
        key=lambda name: -max(_shares(rows, name)),
    )
    lines = [
        "Untouched records: share of the squared errors that one effect explains, mean and max",
        f"{'':24s}" + "".join(f"{source:>16s}" for source in (*sources, "all")),
    ]
    for name in names:
        cells = [_shares(group, name) for group in (*groups.values(), rows)]
        text = "".join(f"{np.mean(c):10.3f}{max(c):6.3f}" if c else f"{'-':>16s}" for c in cells)
        lines.append(f"{name:24s}{text}")
    lines += [
        "",
        f"{'':12s}{'n':>4s}{'error / mean psi_p':>20s}{'l of flow_inertia, ms':>24s}"
        f"{'tau, ms':>16s}{'loss c: true':>14s}{'found':>12s}{'false':>7s}  verdicts; false names",
    ]
    for source, group in (*groups.items(), ("all", rows)):
        inertia = [1e3 * row["inertia_s"] for row in group if row["inertia_s"] is not None]
        error = _column(group, "model_error")
        tau = [row["tau_after_ms"] for row in group]
        losses = sorted({row["reverse_loss"] for row in group})
        alone = len(losses) == 1
        lines.append(
            f"{source:12s}{len(group):4d}{min(error):12.4f} -{max(error):6.4f}"
            f"{_mean_sd(inertia, 2):>24s}{_mean_sd(tau, 2):>16s}"
            f"{f'{losses[0]:g}' if alone else '':>14s}"
            f"{_mean_sd(_losses(group), 0) if alone else '':>12s}"
            f"{sum(bool(row['false']) for row in group):7d}  {_counted(group)}"
        )
    return [*lines, "", *_limits(rows)]


def _losses(rows: Iterable[Row]) -> list[float]:
    return [item["value"] for row in rows for item in row["names"] if item["name"] == REAL]


def _limits(rows: Sequence[Row]) -> list[str]:
    """Say whether the limits of the workflow hold on these records."""
    from comparisons.missing_effect.whole_run_diagnosis import CHAIN_ERROR, LARGEST_MODEL_ERROR
    from comparisons.missing_effect.whole_runs import CHAIN_INERTIA_S, CHAIN_REACH, LEAST_SHARE

    best = [(share, name) for row in rows for name, share in row["share"].items()]
    share, name = max(pair for pair in best if pair[1] != "flow_inertia")
    error = max(row["model_error"] for row in rows)
    inertia = np.array([row["inertia_s"] for row in rows if row["inertia_s"] is not None])
    mean, spread = CHAIN_INERTIA_S
    outside = np.abs(inertia - mean) > CHAIN_REACH * spread
    explains = np.array([r["share"]["flow_inertia"] for r in rows if r["inertia_s"] is not None])
    sd = float(inertia.std(ddof=1)) if inertia.size > 1 else float("nan")
    return [
        f"LEAST_SHARE {LEAST_SHARE}: the largest share but of flow_inertia is {share:.3f} ({name})",
        f"CHAIN_INERTIA_S {mean} and {spread}, reach {CHAIN_REACH}: here {inertia.mean():.4f} and "
        f"{sd:.4f}, {inertia.min():.4f} to {inertia.max():.4f}; {outside.sum()} of {inertia.size} "
        f"beyond it, {np.sum(outside & (explains >= LEAST_SHARE))} of them with share enough",
        f"CHAIN_ERROR {CHAIN_ERROR}, LARGEST_MODEL_ERROR {LARGEST_MODEL_ERROR}: the largest error "
        f"is {error:.4f}",
    ]


def hidden_table(rows: Sequence[Row], title: str) -> list[str]:
    """Return one line for each source and each effect hidden in it, then the sets named."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["source"], row["hidden"]), []).append(row)
    lines = [
        title,
        f"{'':12s}{'hidden':22s}{'n':>3s}{'named':>7s}{'kin':>5s}{'first':>6s}{'alone':>6s}"
        f"{'set':>5s}{'firm':>5s}{'false':>6s}{'tau before':>12s}{'after':>7s}{'worst':>9s}"
        f"{'gap before':>12s}{'after':>8s}{'noise':>8s}{'size':>8s}  found",
    ]
    for (source, hidden), group in groups.items():
        sizes = [row["set_size"] for row in group if row["set_size"]]
        values = [row["value"] for row in group if row["value"] is not None]
        after = _column(group, "tau_after_ms")
        worst = float(np.max(np.abs(after - _column(group, "tau_ms"))))
        lines.append(
            f"{source:12s}{hidden:22s}{len(group):3d}{_sum(group, 'named'):7d}"
            f"{_sum(group, 'kin_named'):5d}{_sum(group, 'first'):6d}{sizes.count(1):6d}"
            f"{np.mean(sizes) if sizes else np.nan:5.1f}{_sum(group, 'firm'):5d}"
            f"{sum(len(row['false']) for row in group):6d}"
            f"{_middle(group, 'tau_before_ms'):12.2f}{_middle(group, 'tau_after_ms'):7.2f}"
            f"{worst:9.2f}{_middle(group, 'gap_before'):12.4f}{_middle(group, 'gap_after'):8.4f}"
            f"{_middle(group, 'floor'):8.4f}{_true_size(group[0]):>8s}  {_mean_sd(values, 4)}"
        )
    lines += ["", "Sets named"]
    for (source, hidden), group in groups.items():
        lines.append(f"{source:12s}{hidden:22s}  {_sets(group)}")
    return lines


def _true_size(row: Row) -> str:
    """Return the size hidden, in the unit of the name where the two are the same thing."""
    if row["source"] != "independent" and row["hidden"] == REAL:
        return f"{row['size'] * row['reverse_loss']:.4g}"
    return f"{row['size']:g}"


def _sets(group: Sequence[Row]) -> str:
    """Return how often which set of names was found, the real loss alone left out."""
    counts = Counter(
        " = ".join(sorted(item["set"]))
        for row in group
        for item in row["names"]
        if item["set"] != [REAL] or row["hidden"] == REAL
    )
    return ", ".join(f"{n} x {names}" for names, n in counts.most_common()) or "none"


def _counted(group: Sequence[Row]) -> str:
    verdicts = Counter(row["verdict"] for row in group)
    false = Counter(name for row in group for name in row["false"])
    said = ", ".join(f"{n} x {name}" for name, n in verdicts.most_common())
    return f"{said}; " + (", ".join(f"{n} x {name}" for name, n in false.items()) or "none")


def _shares(rows: Iterable[Row], name: str) -> list[float]:
    return [row["share"][name] for row in rows if name in row["share"]]


def _column(rows: Sequence[Row], key: str) -> np.ndarray:
    return np.array([row[key] for row in rows], dtype=np.float64)


def _middle(rows: Sequence[Row], key: str) -> float:
    return float(np.median(_column(rows, key)))


def _sum(rows: Sequence[Row], key: str) -> int:
    return sum(bool(row[key]) for row in rows)


def _mean_sd(values: Sequence[float], digits: int) -> str:
    if not values:
        return "-"
    sd = f" ± {np.std(values, ddof=1):.{digits}f}" if len(values) > 1 else ""
    return f"{np.mean(values):.{digits}f}{sd}"


def worked(jobs: Sequence[Job], n_jobs: int) -> list[Row]:
    """Do the jobs, several at a time."""
    if n_jobs == 1:
        return [one_row(job) for job in jobs]
    with ProcessPoolExecutor(n_jobs, mp_context=get_context("spawn")) as pool:
        return list(pool.map(one_row, jobs))


def _names(known: Iterable[str]) -> Callable[[str], tuple[str, ...]]:
    def read(text: str, known: frozenset[str]) -> tuple[str, ...]:
        names = tuple(text.split(","))
        if unknown := [name for name in names if name not in known]:
            raise argparse.ArgumentTypeError(f"expected {', '.join(sorted(known))}: {unknown}")
        return names

    return partial(read, known=frozenset(known))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    add = parser.add_argument
    add("--seeds", type=int, default=5, help="records of each case, or of each case and effect")
    add("--first-seed", type=int, default=9000)
    add("--jobs", type=int, default=2, help="records at a time")
    add("--only", type=_names(PARTS), default=PARTS, help="tables, joined by commas")
    add("--effects", type=_names(HIDEABLE), default=EFFECTS, help="names, joined by commas")
    add("--size", type=float, help="of what is hidden; one of --effects alone")
    add("--json", type=Path, metavar="FILE", help="write the rows")
    add("--quick", action="store_true", help="one seed, two effects: for its working alone")
    options = parser.parse_args()
    if options.quick:
        options.seeds, options.effects = 1, QUICK_EFFECTS
    if options.size is not None and len(options.effects) != 1:
        parser.error("--size: expected with one of --effects")
    rows = worked(jobs_of(options), options.jobs)
    untouched = [row for row in rows if row["hidden"] is None]
    hidden = [row for row in rows if row["hidden"] and row["source"] != "independent"]
    altered = [row for row in rows if row["hidden"] and row["source"] == "independent"]
    tables = []
    if untouched:
        tables.append(untouched_tables(untouched))
    if hidden:
        tables.append(hidden_table(hidden, "Hidden on the rig"))
    if altered:
        tables.append(hidden_table(altered, "The independent record, altered"))
    print("\n\n".join("\n".join(lines) for lines in tables))
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1), "utf-8")


if __name__ == "__main__":
    main()
