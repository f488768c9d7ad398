"""τ and curve on machines drawn at random, as `reduce` and `compare` read them from raw records.

Each record comes from a machine of its own: volumes, ducts, cells, hub-tip deficit and profile, τ,
curve, loss in reversed flow, law of the probes near zero flow, noise, sample rate, number of rakes
and of immersions are drawn; some curves are no parabola. The truth is known, and with it what makes
a record hard: the share of loops in stall, the spread of the recoveries, and the Cramér-Rao bound
on log τ from the true signals. The column `band` adds up the share of φ at which the curve's own
95 % interval holds the truth.

    python benchmarks/random_machines.py --machines 60 --seed S [--jobs N] [--json FILE]
    python benchmarks/random_machines.py --records FOLDER    # of records, each with truth.json

With --shapes: does `sindy` leave the parabola where the in-stall curve is none, and only there? The
bend acts in the plant, or is added to what is measured, behind the lag, so that the flow stays that
of the parabola: in the plant a kink takes away the loops in stall that would show it. Pairs are one
machine at two speeds.

    python benchmarks/random_machines.py --shapes --machines 60 --seed S
"""

from __future__ import annotations

import argparse
import glob
import json
import math
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.signal import lfilter

from classic_ml.io.raw import read_raw
from classic_ml.io.series import read_series, write_series
from classic_ml.reduction import reduce_record
from comparisons.harness.compare import compare_records
from comparisons.harness.estimators import default_estimators
from comparisons.harness.sparse_whole_run import fit_sparse_whole_runs
from comparisons.rig import CASES, write_run
from comparisons.rig.drawn import SHAPES, SPEEDS, draw_run, shaped
from comparisons.rig.gas import CP_J_KG_K
from surge_core.errors import InputError

# An answer is within if it is off by less than the larger of these.
WITHIN_S, WITHIN_SHARE = 0.002, 0.10
GROSS_SHARE, CURVE = 0.30, 0.15
# Errors of ψ' this far apart count as independent in the bound.
INDEPENDENT_S = 0.003
# Before the surge, where the fourth difference of ψ' is noise alone (its gain on noise: √70).
NEAR_STALL_S = 0.14
FIXED = ("name", "true_s", "answer_s", "low_s", "high_s", "share", "state", "refused")
FIXED += ("curve", "band")


def draw(
    seed: int, number: int, folder: Path, speed: str | None = None, shape: str | None = None
) -> dict[str, Any]:
    """Draw machines until one surges, simulate its record into a folder and return the truth.

    ``shape``, out of ``SHAPES``, is what the in-stall curve has beside its parabola.
    """
    rng = np.random.default_rng([seed, number])
    run, about = draw_run(rng, speed or SPEEDS[number % 3], shape)
    write_run(run, folder)
    truth = {name: run.truth[name] for name in ("phi", "psi_p", "in_stall")}
    about["truth"] = run.truth
    return about | _hardness(truth, about["tau_s"], run.truth.sample_period_s)


def _hardness(truth: dict[str, Any], tau_s: float, period_s: float) -> dict[str, float]:
    """Return what makes a record hard, from the true signals."""
    phi, stalled = truth["phi"], truth["in_stall"] > 0.5
    reversals = np.flatnonzero((phi[1:] < 0.0) & (phi[:-1] >= 0.0))
    if reversals.size < 2:
        return {"mild_share": math.nan, "recovery_spread": math.nan, "bound": math.inf}
    recoveries = np.flatnonzero(stalled[:-1] & ~stalled[1:])
    between = np.searchsorted(recoveries, reversals)
    inside = slice(int(reversals[0]), None)
    phi, stalled, psi_p = phi[inside], stalled[inside], truth["psi_p"][inside]
    columns = [stalled * phi**k for k in range(3)] + [~stalled * phi**k for k in range(3)]
    columns += [stalled * np.minimum(phi, 0.0) ** 2]
    inputs = np.column_stack(columns)[:, [np.ptp(c) > 0.0 for c in columns]]
    scored = phi > 0.02

    def answers(tau: float) -> Any:
        a = math.exp(-period_s / tau)
        return lfilter([1.0 - a], [1.0, -a], inputs, axis=0)

    responses = answers(tau_s)
    weights = np.linalg.lstsq(responses[scored], psi_p[scored])[0]
    slope = (answers(1.01 * tau_s) - answers(0.99 * tau_s)) @ weights / 0.02
    own, moved = responses[scored], slope[scored]
    left = moved - own @ np.linalg.lstsq(own, moved)[0]
    rows = period_s / INDEPENDENT_S
    # Per unit of noise on ψ': that of the record multiplies it in `answered`.
    return {
        "mild_share": float(np.mean(np.diff(between) == 0)),
        "recovery_spread": float(np.std(truth["phi"][recoveries])) if recoveries.size else 0.0,
        "bound": 1.0 / math.sqrt(max(rows * float(left @ left), 1e-12)),
    }


def answered(folder: Path, truth: dict[str, Any], n_twins: int) -> dict[str, Any]:
    """Reduce and compare one record, through the series file, against its truth."""
    row: dict[str, Any] = dict.fromkeys(FIXED)
    row |= {k: v for k, v in truth.items() if k not in ("beta", "tau_s", "curve", "truth")}
    row |= {"name": folder.name, "true_s": truth["tau_s"], "shape": truth.get("curve", "parabola")}
    try:
        series = reduce_record(*read_raw(folder / "raw.csv", folder / "test.toml")).series
        with tempfile.TemporaryDirectory() as place:
            write_series(series, Path(place) / "series.csv")
            series = read_series(Path(place) / "series.csv")
        if "bound" in row and series.psi_p_unfiltered is not None:
            quiet = series.psi_p_unfiltered[: round(NEAR_STALL_S * series.sample_rate_hz)]
            row["bound"] *= float(np.std(np.diff(quiet, n=4))) / math.sqrt(70.0)
        wanted = [s for s in default_estimators(n_twins=n_twins) if s.name == "classic_ml"]
        result = compare_records([series], estimators=wanted).result("classic_ml")
    except InputError as error:
        return row | {"state": "refused", "refused": str(error)}
    except Exception as error:
        return row | {"state": "crash", "refused": f"{type(error).__name__}: {error}"}
    model = result.model
    row["state"] = result.state
    if not math.isfinite(model.time_constant_s):
        return row | {"refused": result.advice}
    low_s, high_s = model.ci95_s
    row |= {"answer_s": model.time_constant_s, "low_s": low_s, "high_s": high_s}
    row["share"] = model.time_constant_stderr_s / model.time_constant_s
    if truth.get("beta") is not None:
        phi = np.linspace(*model.valid_phi, 41)
        apart = model.quasi_steady(phi) - np.polynomial.polynomial.polyval(phi, truth["beta"])
        row["curve"] = float(np.sqrt(np.mean(apart**2)))
        assert result.whole_run is not None
        stderr = result.whole_run.characteristic(phi)[1]
        row["band"] = float(np.mean(np.abs(apart) <= 1.96 * stderr))
    return row


def drawn(number: int, seed: int, n_twins: int) -> dict[str, Any]:
    """Draw one machine and return what is read from its record."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / f"{seed}-{number}"
        return answered(folder, draw(seed, number, folder), n_twins)


def folders_of(named: list[str]) -> list[str]:
    """Return the folders of records among those that are named, or one folder below."""
    folders = [Path(match) for name in named for match in glob.glob(name)]
    records = [raw for one in folders for raw in (*one.glob("raw.csv"), *one.glob("*/raw.csv"))]
    return sorted(str(raw.parent) for raw in records)


def found(folder: str, n_twins: int) -> dict[str, Any]:
    """Return what is read from the record in a folder."""
    truth = json.loads((Path(folder) / "truth.json").read_text("utf-8"))
    return answered(Path(folder), {"curve": "parabola", **truth}, n_twins)


def bent_series(seed: int, number: int, speed: str, shape: str, added: bool) -> tuple[Any, Any]:
    """Draw a machine; return its series and the true in-stall curve."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "record"
        truth = draw(seed, number, folder, speed, "parabola" if added else shape)
        series = reduce_record(*read_raw(folder / "raw.csv", folder / "test.toml")).series
    kink, cubic = SHAPES[shape]
    bent = shaped(replace(CASES[speed], pressure_terms=(0.0, 0.0, 0.0)), kink, cubic)
    terms = np.array(truth["beta"]) + (bent.pressure_terms if added else 0.0)

    def bend(phi: Any, powers: Any = terms) -> Any:
        kinked = kink * np.maximum(phi - bent.kink_phi, 0.0)
        return np.polynomial.polynomial.polyval(phi, powers) + kinked + cubic * phi**3

    if added:
        plant = truth["truth"]
        a = math.exp(-plant.sample_period_s / truth["tau_s"])
        target = plant["stall_blend"] * bend(plant["phi"], bent.pressure_terms)
        more = lfilter([0.5 * (1.0 - a)] * 2, [1.0, -a], target)
        head = bent.rotor_velocity_m_s**2 / (2.0 * CP_J_KG_K * plant["T25_K"])
        rise = 1.0 + plant["psi_p"] * head
        exit_Pa = plant["P25_Pa"] * ((rise + more * head) ** 3.5 - rise**3.5)
        more, exit_Pa = (np.interp(series.time_s, plant.time_s, v) for v in (more, exit_Pa))
        rakes = {k: v + exit_Pa * k.startswith("Pt31") for k, v in series.rakes.items()}
        psi_p = series.psi_p_unfiltered + more
        series = replace(series, psi_p_unfiltered=psi_p, rakes=rakes)
    return series, bend


def shape_found(job: tuple[str, bool, bool, int], seed: int) -> dict[str, Any] | None:
    """Return what `sindy` says of the shape of one record or pair; None where it has no answer."""
    shape, added, pair, number = job
    speeds = [SPEEDS[(number + i) % 3] for i in range(1 + pair)]
    try:
        drawn = [bent_series(seed, number, speed, shape, added) for speed in speeds]
        records = [series for series, _ in drawn]
        fit = fit_sparse_whole_runs(records)
        parabola = fit_sparse_whole_runs(records, max_terms=3)
    except (InputError, ZeroDivisionError):
        # A plant that diverges, or two speeds drawn with unlike sample rates.
        return None
    found = fit.departure_
    if found is None or not math.isfinite(fit.time_constant_s_):
        return None
    phi = np.linspace(*np.percentile(fit.trusted_phi, [5.0, 95.0]), 41)
    apart = [
        float(np.sqrt(np.mean((one.characteristic(phi)[0] - drawn[0][1](phi)) ** 2)))
        for one in (fit, parabola)
    ]
    low, high = found.cubic
    held = low <= SHAPES[shape][1] <= high
    return {
        "shape": shape, "added": added, "pair": pair, "number": number, "gain": found.gain,
        "needed": found.needed, "finding": found.finding, "ratio": apart[0] / apart[1],
        "held": held, "terms": fit.terms_,
    }  # fmt: skip


def shapes_table(rows: list[dict[str, Any]]) -> str:
    """Return the table of what was found, by shape."""
    table = pd.DataFrame(rows)
    table["kink"], table["either"] = (
        table["finding"] == name for name in ("kink", "kink or cubic")
    )
    table["left"] = table["kink"] | table["either"]
    groups = table.groupby(["pair", "shape", "added"], sort=False)
    shown = groups[["left", "kink", "either", "held"]].sum()
    shown.insert(0, "records", groups.size())
    return shown.join(groups["ratio"].median()).to_string(float_format="%.2f")


def strata(rows: list[dict[str, Any]]) -> str:
    """Return the table of what came out, of all records and by stratum."""
    table = pd.DataFrame(rows)
    drawn = ["mild_share", "bound", "noise", "rakes", "immersions", "rate_hz", "ramp"]
    table = table.reindex(columns=[*FIXED, *drawn, "shape"])
    numbers = [name for name in table if name not in ("name", "state", "refused", "shape")]
    table[numbers] = table[numbers].astype(float)
    off, true = (table["answer_s"] - table["true_s"]).abs(), table["true_s"]
    held = (table["low_s"] <= true) & (true <= table["high_s"])
    counted = pd.DataFrame({
        "records": np.ones(len(table), bool),
        "answers": off.notna(),
        "within": off <= np.fmax(WITHIN_S, WITHIN_SHARE * true),
        "covered": held,
        "gross": (off > GROSS_SHARE * true) & ~held,
        "curve": table["curve"] <= CURVE,
        "of curves": table["curve"].notna(),
        "band": table["band"].fillna(0.0),
        "refused": off.isna() & (table["state"] != "crash"),
        "crashes": table["state"] == "crash",
    })  # fmt: skip
    strata = {
        "all": off.notna() | off.isna(),
        "stated sd up to 8 %": table["share"] <= 0.08,
        "τ up to 16 ms": true <= 0.016,
        "loops in stall, 5 % and more": table["mild_share"] >= 0.05,
        "deep cycles alone": table["mild_share"] < 0.05,
        "bound on log τ up to 5 %": table["bound"] <= 0.05,
        "noise of 0.3 % and more": table["noise"] >= 0.3,
        "one rake": table["rakes"] == 1,
        "one rake, bound up to 5 %": (table["rakes"] == 1) & (table["bound"] <= 0.05),
        "one immersion": table["immersions"] == 1,
        "0.5 kHz": table["rate_hz"] == 500.0,
        "2 kHz": table["rate_hz"] == 2000.0,
        "no jump in the probes' law": table["ramp"] > 0.0,
        "a bent curve": table["shape"] == "bent",
    }
    shown = {label: counted[chosen].sum() for label, chosen in strata.items() if chosen.any()}
    return pd.DataFrame(shown).T.to_string(float_format="%.3g")


def main() -> None:
    """Print the table, and each record that is off or refused."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--machines", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--records", nargs="+", help="folders of raw.csv, test.toml, truth.json")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--no-twins", action="store_true")
    parser.add_argument("--quick", action="store_true", help="two machines, two twins")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--shapes", action="store_true", help="`sindy` on curves of each shape")
    given = parser.parse_args()
    n_twins = 0 if given.no_twins else 2 if given.quick else 20
    with ProcessPoolExecutor(given.jobs) as pool:
        if given.shapes:
            few = 2 if given.quick else given.machines // 3
            jobs = [("parabola", False, False, i) for i in range(3 * few)]
            jobs += [(s, a, False, i) for s in SHAPES for a in (True, False) for i in range(few)
                     if s != "parabola"]  # fmt: skip
            jobs += [(s, True, True, i) for s in ("parabola", "kink 25") for i in range(few)]
            rows = []
            for row in filter(None, pool.map(partial(shape_found, seed=given.seed), jobs)):
                rows.append(row)
                print(*row.values(), flush=True)
            print(shapes_table(rows))
            return
        if given.records:
            jobs = pool.map(partial(found, n_twins=n_twins), folders_of(given.records))
        else:
            one = partial(drawn, seed=given.seed, n_twins=n_twins)
            jobs = pool.map(one, range(2 if given.quick else given.machines))
        rows = []
        for row in jobs:
            rows.append(row)
            print(_line(row), flush=True)
    print()
    print(strata(rows))
    if given.json:
        given.json.write_text(json.dumps(rows, indent=1), "utf-8")


def _line(row: dict[str, Any]) -> str:
    true = f"{row['name']:14s} true {1e3 * row['true_s']:5.1f} ms"
    if row["answer_s"] is None:
        return f"{true}  {row['state']}: {str(row['refused'])[:110]}"
    low, value, high = (1e3 * row[key] for key in ("low_s", "answer_s", "high_s"))
    share = 100.0 * row["share"]
    return f"{true}  {value:5.1f} ({low:.1f} to {high:.1f})  {row['state']}  {share:.0f} %"


if __name__ == "__main__":
    main()
