"""Tables and figures of the study of missing effects, from its rows alone.

A row is one test and what was said of it, as `effect_study.py` writes it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import beta

from comparisons.rig.coefficient_effects import EFFECTS

Row = dict[str, Any]

NOISE_EFFECT = "flow_noise"
NAMES = (*EFFECTS, NOISE_EFFECT)
FIRM = ("named", "alias_set")
PHI_NOISES = ("phi1", "phi3")
# Heads of the columns of what is ranked first: names, and verdicts in place of one.
_HEADS = """delay heat droop hyst rever shape 2nd amplt asymm flowd inert thermo sens bias ripple
flow~"""
SHORT = dict(zip(NAMES, _HEADS.split(), strict=True)) | {
    "unnamed_term": "open",
    "unexplained_structure": "unexpl",
    "noise_model_wrong": "noise",
    "nothing_missing": "none",
    "error": "error",
}
# The truth is in the set that is named.
INSIDE = ("unique", "set", "extra", "prov. right")
OUTCOMES = (*INSIDE, "prov. other", "WRONG", "unnamed", "unexpl.", "noise", "missed", "error")
_OTHER_VERDICTS = {
    "unnamed_term": "unnamed",
    "unexplained_structure": "unexpl.",
    "noise_model_wrong": "noise",
    "nothing_missing": "missed",
}


def names_of(row: Row) -> list[dict[str, Any]]:
    """Return what was named that is in the catalogue."""
    return [item for item in row["missing"] if item["effect"] in NAMES]


def firm_names(row: Row) -> list[str]:
    """Return the names that a user would take for an answer."""
    if row["verdict"] not in FIRM:
        return []
    return [item["effect"] for item in names_of(row) if not item["provisional"]]


def first_ranked(row: Row) -> str:
    """Return the first name, else the verdict that stands in its place."""
    if row["error"]:
        return "error"
    named = names_of(row)
    if row["verdict"] == "unnamed_term" or (row["missing"] and row["missing"][0] not in named):
        return "unnamed_term"
    return str(named[0]["effect"]) if named else str(row["verdict"])


def outcome(row: Row) -> str:
    """Return how a test with one planted effect came out.

    "unique": the truth alone is named; "set": with its aliases; "extra": rightly named, and a
    further effect that is not there beside it; "WRONG": something else is named firmly.
    """
    if row["error"]:
        return "error"
    truth = row["planted"][0]
    hits = [item for item in names_of(row) if truth in item["alias_set"]]
    if row["verdict"] in FIRM:
        if not hits:
            return "WRONG"
        if len(hits) < len(names_of(row)):
            return "extra"
        alone = len(hits) == 1 and len(set(hits[0]["alias_set"])) == 1
        return "unique" if alone else "set"
    if row["verdict"] == "provisional":
        return "prov. right" if hits else "prov. other"
    return _OTHER_VERDICTS[row["verdict"]]


def false_names(row: Row) -> list[str]:
    """Return the firm names of a test in which nothing is missing."""
    known_noise = NOISE_EFFECT if row["noise"] in PHI_NOISES else None
    return [name for name in firm_names(row) if name != known_noise]


def pair_outcome(row: Row) -> str:
    """Return how a test with two planted effects came out.

    "both": each in a set, and nothing else; "both +": and something else; "one", "none"; with
    "prov. " before it where the verdict is not firm.
    """
    if row["error"]:
        return "error"
    named = names_of(row)
    found = [any(t in item["alias_set"] for item in named) for t in row["planted"]]
    extra = any(not set(row["planted"]) & set(item["alias_set"]) for item in named)
    word = "both" if all(found) else "one" if any(found) else "none"
    return ("" if row["verdict"] in FIRM else "prov. ") + word + (" +" if extra else "")


def tau_error_before(row: Row) -> float:
    """Return the error of τ before, in per cent."""
    return 100.0 * abs(row["tau_before_s"] / row["tau_true_s"] - 1.0)


def tau_error_after(row: Row) -> float:
    """Return the error of τ after, in per cent."""
    return 100.0 * abs(row["tau_after_s"] / row["tau_true_s"] - 1.0)


def gap_closed(row: Row) -> float:
    """Return the share of the held-out gap that is closed, with the true noise for its floor."""
    gap = row["before_rms"] ** 2 - row["sigma"] ** 2
    won = row["before_rms"] ** 2 - row["after_rms"] ** 2
    return float(won / gap) if gap > 0.0 else float("nan")


def measured(rows: Iterable[Row]) -> pd.DataFrame:
    """Return what is measured of each row; NaN where the diagnosis broke."""
    table = pd.DataFrame(list(rows))
    done = table["error"] == ""
    for name, of in (
        ("gap closed", gap_closed),
        ("tau before %", tau_error_before),
        ("tau after %", tau_error_after),
    ):
        table[name] = [of(row) if good else np.nan for row, good in zip(rows, done, strict=True)]
    table["planted"] = [" + ".join(row["planted"]) for row in rows]
    return table


def text_of(table: pd.DataFrame) -> str:
    """Return a table of counts and numbers, with a dot for a count of none."""
    whole = table.select_dtypes("integer")
    shown = table.assign(**whole.astype(object).replace(0, "."))
    return shown.to_string(float_format="%.2f", na_rep="-")


def confusion(rows: Sequence[Row], label: Callable[[Row], str], title: str) -> str:
    """Return a matrix of counts: what was planted by what was ranked first."""
    labels = pd.Series([label(row) for row in rows], name=title)
    first = pd.Series([SHORT[first_ranked(row)] for row in rows])
    counts = pd.crosstab(labels, first).reindex(dict.fromkeys(labels))
    return text_of(counts.reindex(columns=SHORT.values(), fill_value=0).rename_axis(columns=title))


def per_effect(rows: Sequence[Row]) -> str:
    """Return how each effect came out, with the errors of τ, and all together."""
    table = measured(rows)
    groups = table.groupby("planted", sort=False)
    counts = pd.crosstab(table["planted"], pd.Series([outcome(row) for row in rows]))
    shown = counts.reindex(index=list(groups.groups), columns=OUTCOMES, fill_value=0)
    shown.insert(0, "n", groups.size())
    measures = ["tau before %", "tau after %", "gap closed", "seconds"]
    shown = shown.join(groups[measures].median())
    shown.loc["all"] = [*shown.drop(columns=measures).sum(), *table[measures].median()]
    return text_of(shown.astype(dict.fromkeys(("n", *OUTCOMES), int)))


def per_noise(rows: Sequence[Row]) -> str:
    """Return how often something was named where nothing is missing, by kind of noise."""
    false = pd.Series([bool(false_names(row)) for row in rows])
    shown = false.groupby([row["noise"] for row in rows], sort=False).agg(["size", "sum"])
    hits, n = int(false.sum()), len(rows)
    # Clopper and Pearson.
    most = 1.0 if hits >= n else float(beta.ppf(0.95, hits + 1, n - hits))
    rate = f"false names in 1000: {1000 * hits / n:.1f}, 95 % bound {1000 * most:.1f}"
    return f"{text_of(shown.set_axis(['n', 'false'], axis=1))}\n{rate}"


def per_outside(rows: Sequence[Row]) -> str:
    """Return what was said of effects not in the catalogue: no firm name is the right answer."""
    planted = pd.Series([row["planted"][0] for row in rows], name="not in the catalogue")
    shown = pd.crosstab(planted, [row["verdict"] or "error" for row in rows], colnames=[""])
    shown.insert(0, "firm names", pd.Series(map(len, map(firm_names, rows))).groupby(planted).sum())
    return text_of(shown)


def pairs_table(rows: Sequence[Row]) -> str:
    """Return how the pairs came out."""
    table = measured(rows)
    counts = pd.crosstab(table["planted"], [pair_outcome(row) for row in rows], colnames=[""])
    medians = table.groupby("planted", sort=False)[["tau before %", "tau after %"]].median()
    return text_of(counts.join(medians))


def report(rows: Sequence[Row]) -> str:
    """Return all tables that the rows allow, and what is counted against the diagnosis."""
    parts = []
    for name, label, title, table in (
        ("effect", lambda r: r["planted"][0], "planted \\ ranked first", per_effect),
        ("null", lambda r: r["noise"], "nothing missing, noise", per_noise),
        ("outside", lambda r: r["planted"][0], "outside the catalogue", per_outside),
        ("left_out", lambda r: r["planted"][0], "taken out of the catalogue", per_outside),
        ("pair", lambda r: " + ".join(r["planted"]), "pairs", pairs_table),
    ):
        if some := [row for row in rows if row["kind"] == name]:
            parts += [confusion(some, label, title), table(some)]
    against = [line for row in rows if (line := _against(row))]
    return "\n\n".join([*parts, *(["counted against it:", *against] if against else [])])


def _against(row: Row) -> str:
    """Return the line of a row that counts against the diagnosis, so that it can be run again."""
    bad = row["error"]
    if not bad and row["kind"] == "effect":
        bad = outcome(row) if outcome(row) not in ("unique", "set", "prov. right") else ""
    elif not bad and row["kind"] in ("null", "outside", "left_out"):
        bad = ", ".join(false_names(row) if row["kind"] == "null" else firm_names(row))
    sets = "; ".join("|".join(item["alias_set"]) for item in row["missing"])
    where = f"seed {row['seed']} {'+'.join(row['planted'])} {row['strength']:g} {row['noise']}"
    return f"  {where}: {bad}: {row['verdict']} {sets}" if bad else ""
