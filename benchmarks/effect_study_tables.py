"""Tables and figures of the study of missing effects, from its rows alone.

A row is one test and what was said of it, as `effect_study.py` writes it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import beta

from comparisons.rig.coefficient_effects import EFFECTS

Row = dict[str, Any]

# A bump is a smooth function that the base lacks, but in no form that a catalogue could hold.
NOT_EXACT = "characteristic_shape"
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


def kind(rows: Iterable[Row], name: str) -> list[Row]:
    """Return the rows of one part of the study."""
    return [row for row in rows if row["kind"] == name]


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
    """Return how each effect came out, with the errors of τ."""
    table = measured(rows)
    groups = table.groupby("planted", sort=False)
    counts = pd.crosstab(table["planted"], pd.Series([outcome(row) for row in rows]))
    shown = counts.reindex(index=list(groups.groups), columns=OUTCOMES, fill_value=0)
    shown.insert(0, "n", groups.size())
    medians = groups[["tau before %", "tau after %", "gap closed"]].median()
    return text_of(shown.join(medians))


def upper_bound(hits: int, n: int) -> float:
    """Return the 95 % upper bound of a rate (Clopper and Pearson)."""
    return 1.0 if hits >= n else float(beta.ppf(0.95, hits + 1, n - hits))


def figures(rows: Sequence[Row], strength: float = 1.5) -> str:
    """Return the figures that the study is for, each with what is wanted of it."""
    lines = []
    effects = kind(rows, "effect")
    for title, mine in (
        ("exact-form effects", [r for r in effects if r["planted"][0] != NOT_EXACT]),
        ("a bump in the characteristic", [r for r in effects if r["planted"][0] == NOT_EXACT]),
    ):
        if mine:
            lines += [f"{title}, {len(mine)} tests", *_naming_figures(mine)]
    lines += _null_figures(kind(rows, "null"))
    outside = kind(rows, "outside")
    if outside:
        firm = sum(bool(firm_names(row)) for row in outside)
        lines.append(f"outside the catalogue, {len(outside)} tests")
        lines.append(f"  firm names                     {firm}   (wanted: none)")
    lines += _numbers(effects, strength)
    weak = Counter(
        row["planted"][0]
        for row in effects + outside
        if any(got < 0.98 * row["strength"] for got in row["reached"].values())
    )
    if weak:
        lines.append(f"weaker than asked, for it cannot be made stronger: {dict(weak)}")
    return "\n".join(lines)


def _naming_figures(rows: Sequence[Row]) -> list[str]:
    n = len(rows)
    count = Counter(outcome(row) for row in rows)
    firm = count["unique"] + count["set"] + count["extra"]
    inside = firm + count["prov. right"]
    wrong = count["WRONG"] + count["extra"]
    largest = max((len(set(i["alias_set"])) for r in rows for i in names_of(r)), default=0)
    return [
        f"  truth inside the named set     {100 * inside / n:.1f} %   (wanted: 99; firmly "
        f"{100 * firm / n:.1f})",
        f"  named uniquely and rightly     {100 * count['unique'] / n:.1f} %   (wanted: 70)",
        f"  largest set                    {largest}   (wanted: at most 3)",
        f"  wrong names                    {100 * wrong / n:.2f} %   (wanted: at most 0.3; "
        f"{count['extra']} of {wrong} beside the right one)",
    ]


def _null_figures(rows: Sequence[Row]) -> list[str]:
    if not rows:
        return []
    lines = [f"nothing missing, {len(rows)} tests: false names"]
    for noise, mine in _by(rows, lambda row: row["noise"]):
        hits = sum(bool(false_names(row)) for row in mine)
        lines.append(f"  {noise:<10}{hits:>4} of {len(mine):<5} {_verdicts(mine, false_names)}")
    total = sum(bool(false_names(row)) for row in rows)
    lines.append(
        f"  in 1000                        {1000 * total / len(rows):.1f}   (wanted: at most 2; "
        f"95 % bound {1000 * upper_bound(total, len(rows)):.1f})"
    )
    return lines


def _by(rows: Iterable[Row], label: Callable[[Row], Any]) -> Iterator[tuple[Any, list[Row]]]:
    """Yield the rows of each label, in the order in which the labels come."""
    groups: dict[Any, list[Row]] = {}
    for row in rows:
        groups.setdefault(label(row), []).append(row)
    yield from groups.items()


def _verdicts(rows: Sequence[Row], names: Callable[[Row], list[str]]) -> str:
    """Return how often each verdict was given, and each name that counts against it."""
    given = _counted(row["verdict"] or "error" for row in rows)
    counted = Counter(name for row in rows for name in names(row))
    return f"[{given}]" + (f"   {dict(counted)}" if counted else "")


def _counted(words: Iterable[str], most: int | None = None) -> str:
    return ", ".join(f"{word} {n}" for word, n in Counter(words).most_common(most))


def _numbers(rows: Sequence[Row], strength: float) -> list[str]:
    done = [row for row in rows if not row["error"]]
    if not done:
        return []
    table = measured(done)
    at = table[table["strength"] == strength]
    lines = []
    if len(at):
        lines.append(
            f"held-out gap closed at {strength:g} sigma  {100 * at['gap closed'].median():.1f} %   "
            f"(median, wanted: 95; by its own floor {100 * at['shrink'].median():.1f})"
        )
    lines.append(
        f"error of tau after               {table['tau after %'].median():.3f} %   "
        f"(median, wanted: at most 0.2; before {table['tau before %'].median():.3f})"
    )
    lines.append(
        f"processor seconds a diagnosis    {table['seconds'].median():.2f}   "
        f"(median, wanted: at most 1; most {table['seconds'].max():.2f})"
    )
    return lines


def pairs_table(rows: Sequence[Row]) -> str:
    """Return how the pairs came out."""
    table = measured(rows)
    table["outcomes"] = [pair_outcome(row) for row in rows]
    groups = table.groupby("planted", sort=False)
    shown = groups[["tau before %", "tau after %"]].median()
    shown.insert(0, "n", groups.size())
    return text_of(shown.join(groups["outcomes"].apply(_counted)))


def report(rows: Sequence[Row]) -> str:
    """Return all tables that the rows allow."""
    parts = []
    effects, nulls, outside = (kind(rows, name) for name in ("effect", "null", "outside"))
    if effects:
        parts.append(confusion(effects, lambda r: r["planted"][0], "planted \\ ranked first"))
    if nulls:
        parts.append(confusion(nulls, lambda r: r["noise"], "nothing missing, noise"))
    if outside:
        parts.append(confusion(outside, lambda r: r["planted"][0], "outside the catalogue"))
        parts.append(
            "\n".join(
                f"{name:<25}{len(mine):>4}  {_verdicts(mine, firm_names)}"
                for name, mine in _by(outside, lambda row: row["planted"][0])
            )
        )
    for some, table in (
        (effects, per_effect),
        (kind(rows, "pair"), pairs_table),
    ):
        if some:
            parts.append(table(some))
    parts += [figures(rows), failures(rows)]
    return "\n\n".join(part for part in parts if part)


def failures(rows: Sequence[Row]) -> str:
    """List every row that a figure counts against, so that it can be run again."""
    lines = []
    for row in rows:
        bad = row["error"]
        if not bad and row["kind"] == "effect":
            bad = outcome(row) if outcome(row) not in ("unique", "set", "prov. right") else ""
        elif not bad and row["kind"] == "null":
            bad = "false name" if false_names(row) else ""
        elif not bad and row["kind"] == "outside":
            bad = "firm name" if firm_names(row) else ""
        if bad:
            sets = "; ".join("|".join(item["alias_set"]) for item in row["missing"])
            planted = "+".join(row["planted"]) or "nothing"
            lines.append(
                f"  seed {row['seed']:<5} {planted:<25} {row['strength']:g} {row['noise']:<8} "
                f"{bad}: {row['verdict']} {sets}"
            )
    return "counted against it:\n" + "\n".join(lines) if lines else ""
