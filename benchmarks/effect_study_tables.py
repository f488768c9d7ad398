"""Tables and figures of the study of missing effects, from its rows alone.

A row is one test and what was said of it, as `effect_study.py` writes it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from scipy.stats import beta

from comparisons.rig.coefficient_effects import EFFECTS

Row = dict[str, Any]

# A bump is a smooth function that the base lacks, but in no form that a catalogue could hold.
NOT_EXACT = "characteristic_shape"
NOISE_EFFECT = "flow_noise"
NAMES = (*EFFECTS, NOISE_EFFECT)
FIRM = ("named", "alias_set")
PHI_NOISES = ("phi1", "phi3")
SHORT = {
    "transport_delay": "delay",
    "facility_heating": "heat",
    "speed_droop": "droop",
    "hysteresis": "hyst",
    "reverse_flow_branch": "rever",
    "characteristic_shape": "shape",
    "second_order_lag": "2nd",
    "amplitude_dependent_lag": "amplt",
    "asymmetric_lag": "asymm",
    "flow_dependent_lag": "flowd",
    "flow_inertia": "inert",
    "thermocouple_lag": "thermo",
    "sensitivity_drift": "sens",
    "bias_drift": "bias",
    "rotating_stall_ripple": "ripple",
    NOISE_EFFECT: "flow~",
    "unnamed_term": "open",
    "unexplained_structure": "unexpl",
    "noise_model_wrong": "noise",
    "nothing_missing": "none",
    "error": "error",
}
OUTCOMES = (
    "unique",
    "set",
    "extra",
    "prov. right",
    "prov. other",
    "WRONG",
    "unnamed",
    "unexpl.",
    "noise",
    "missed",
    "error",
)
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
    """Return the rows of one part of the study that a diagnosis was made of."""
    return [row for row in rows if row["kind"] == name and row["verdict"] is not None]


def confusion(rows: Sequence[Row], label: Callable[[Row], str], title: str) -> str:
    """Return a matrix of counts: what was planted by what was ranked first."""
    columns = list(SHORT)
    counts: dict[str, Counter[str]] = {}
    for row in rows:
        counts.setdefault(label(row), Counter())[first_ranked(row)] += 1
    lines = [f"{title:<25}" + "".join(f"{SHORT[c]:>7}" for c in columns)]
    for name, count in counts.items():
        cells = "".join(f"{count[c] or '.':>7}" for c in columns)
        lines.append(f"{name:<25}{cells}")
    return "\n".join(lines)


def per_effect(rows: Sequence[Row]) -> str:
    """Return how each effect came out, with the errors of τ and the column of pysindy."""
    effects = list(dict.fromkeys(row["planted"][0] for row in rows))
    lines = [
        f"{'planted':<25}{'n':>4}"
        + "".join(f"{name:>12}" for name in OUTCOMES)
        + f"{'tau before %':>14}{'after %':>9}{'gap closed':>12}{'pysindy':>9}"
    ]
    for effect in effects:
        mine = [row for row in rows if row["planted"][0] == effect]
        done = [row for row in mine if row["verdict"] is not None]
        count = Counter(outcome(row) for row in done)
        text = f"{effect:<25}{len(mine):>4}"
        text += "".join(f"{count[name] or '.':>12}" for name in OUTCOMES)
        text += f"{_median(done, tau_error_before):>14.2f}{_median(done, tau_error_after):>9.2f}"
        text += f"{_median(done, gap_closed):>12.3f}{_pysindy_cell(mine):>9}"
        lines.append(text)
    return "\n".join(lines)


def _pysindy_cell(rows: Sequence[Row]) -> str:
    answered = [row["pysindy"]["right"] for row in rows if row.get("pysindy")]
    if not answered:
        return ""
    if answered[0] is None:
        return "no term"
    return f"{sum(map(bool, answered))}/{len(answered)}"


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


def _median(rows: Iterable[Row], of: Callable[[Row], float]) -> float:
    values = [of(row) for row in rows if not row["error"]]
    values = [value for value in values if np.isfinite(value)]
    return float(np.median(values)) if values else float("nan")


def upper_bound(hits: int, n: int) -> float:
    """Return the 95 % upper bound of a rate (Clopper and Pearson)."""
    return 1.0 if hits >= n else float(beta.ppf(0.95, hits + 1, n - hits))


def strengths_table(rows: Sequence[Row]) -> str:
    """Return the outcomes of all effects together by strength."""
    lines = [
        f"{'strength':<10}{'n':>5}{'detected %':>12}{'first right %':>15}{'in set %':>10}"
        f"{'unique %':>10}{'gap closed, p10':>18}{'tau before %':>22}{'tau after %':>22}"
    ]
    for strength in sorted({row["strength"] for row in rows}):
        mine = [row for row in rows if row["strength"] == strength and not row["error"]]
        if not mine:
            continue
        detected = sum(row["verdict"] != "nothing_missing" for row in mine)
        first = sum(first_ranked(row) == row["planted"][0] for row in mine)
        outcomes = Counter(outcome(row) for row in mine)
        inside = sum(outcomes[k] for k in ("unique", "set", "extra", "prov. right"))
        gaps = [g for g in map(gap_closed, mine) if np.isfinite(g)] or [float("nan")]
        text = f"{strength:<10g}{len(mine):>5}"
        for count, width in ((detected, 12), (first, 15), (inside, 10), (outcomes["unique"], 10)):
            text += f"{100 * count / len(mine):>{width}.1f}"
        text += f"{np.median(gaps):>10.3f}{np.quantile(gaps, 0.1):>8.3f}"
        for of in (tau_error_before, tau_error_after):
            errors = [of(row) for row in mine]
            cells = (np.median(errors), np.quantile(errors, 0.9), max(errors))
            text += f"{'/'.join(f'{c:.2f}' for c in cells):>22}"
        lines.append(text)
    lines.append("(tau: median / 90 % / largest error)")
    return "\n".join(lines)


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
    weak = Counter(row["planted"][0] for row in effects + outside if _weaker(row))
    if weak:
        lines.append(f"weaker than asked, for it cannot be made stronger: {dict(weak)}")
    return "\n".join(lines)


def _weaker(row: Row) -> bool:
    return any(got < 0.98 * row["strength"] for got in row["reached"].values())


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
    total = 0
    for noise in dict.fromkeys(row["noise"] for row in rows):
        mine = [row for row in rows if row["noise"] == noise]
        false = [name for row in mine for name in false_names(row)]
        hits = sum(bool(false_names(row)) for row in mine)
        total += hits
        verdicts = Counter(row["verdict"] or "error" for row in mine)
        told = ", ".join(f"{name} {count}" for name, count in verdicts.most_common())
        which = f"   {dict(Counter(false))}" if false else ""
        lines.append(f"  {noise:<10}{hits:>4} of {len(mine):<5} [{told}]{which}")
    lines.append(
        f"  in 1000                        {1000 * total / len(rows):.1f}   (wanted: at most 2; "
        f"95 % bound {1000 * upper_bound(total, len(rows)):.1f})"
    )
    return lines


def _numbers(rows: Sequence[Row], strength: float) -> list[str]:
    done = [row for row in rows if not row["error"]]
    if not done:
        return []
    at = [row for row in done if row["strength"] == strength]
    lines = []
    if at:
        own = _median(at, lambda row: float(row["shrink"]))
        lines.append(
            f"held-out gap closed at {strength:g} sigma  {100 * _median(at, gap_closed):.1f} %   "
            f"(median, wanted: 95; by its own floor {100 * own:.1f})"
        )
    lines.append(
        f"error of tau after               {_median(done, tau_error_after):.3f} %   "
        f"(median, wanted: at most 0.2; before {_median(done, tau_error_before):.3f})"
    )
    seconds = [row["seconds"] for row in done]
    lines.append(
        f"processor seconds a diagnosis    {np.median(seconds):.2f}   (median, wanted: at most 1; "
        f"most {max(seconds):.2f})"
    )
    return lines


def pairs_table(rows: Sequence[Row]) -> str:
    """Return how the pairs came out."""
    lines = [f"{'pair':<50}{'n':>4}  {'tau before %':>13}{'after %':>9}   outcomes"]
    for pair in dict.fromkeys(tuple(row["planted"]) for row in rows):
        mine = [row for row in rows if tuple(row["planted"]) == pair]
        count = Counter(pair_outcome(row) for row in mine)
        told = ", ".join(f"{name} {n}" for name, n in count.most_common())
        before, after = _median(mine, tau_error_before), _median(mine, tau_error_after)
        lines.append(f"{' + '.join(pair):<50}{len(mine):>4}  {before:>13.2f}{after:>9.2f}   {told}")
    return "\n".join(lines)


def speed_table(rows: Sequence[Row]) -> str:
    """Return the seconds of a diagnosis by length of the records, and their exponent."""
    lengths = sorted({row["n_samples"] for row in rows})
    medians = [
        _median([r for r in rows if r["n_samples"] == n], lambda r: float(r["seconds"]))
        for n in lengths
    ]
    lines = [f"{'rows a record':<15}" + "".join(f"{n:>9}" for n in lengths)]
    lines.append(f"{'CPU seconds':<15}" + "".join(f"{value:>9.2f}" for value in medians))
    if len(lengths) > 1:
        slope = np.polyfit(np.log(lengths), np.log(medians), 1)[0]
        lines.append(f"grows with the power {slope:.2f} of the length   (wanted: at most 1)")
    return "\n".join(lines)


def pysindy_nulls(rows: Sequence[Row]) -> str:
    """Return what pysindy says where nothing is missing."""
    lines = []
    for noise in dict.fromkeys(row["noise"] for row in rows):
        mine = [row["pysindy"]["terms"] for row in rows if row["noise"] == noise]
        first = Counter(terms[0] for terms in mine if terms)
        some = sum(map(bool, mine))
        told = ", ".join(f"{name} {count}" for name, count in first.most_common(4))
        lines.append(f"  {noise:<10}{some:>4} of {len(mine)} return a term: {told}")
    return "\n".join(lines)


def report(rows: Sequence[Row]) -> str:
    """Return all tables that the rows allow."""
    parts = []
    effects, nulls = kind(rows, "effect"), kind(rows, "null")
    outside, pairs, speed = kind(rows, "outside"), kind(rows, "pair"), kind(rows, "speed")
    if effects:
        parts.append(confusion(effects, lambda r: r["planted"][0], "planted \\ ranked first"))
    if nulls:
        parts.append(confusion(nulls, lambda r: r["noise"], "nothing missing, noise"))
    if outside:
        parts.append(confusion(outside, lambda r: r["planted"][0], "outside the catalogue"))
        parts.append(_outside_firm(outside))
    planted = [row for row in rows if row["kind"] == "effect"]
    if planted:
        parts.append(per_effect(planted))
    if effects:
        parts.append(strengths_table(effects))
    if pairs:
        parts.append(pairs_table(pairs))
    if speed:
        parts.append(speed_table(speed))
    asked = [row for row in rows if row["kind"] == "null" and row.get("pysindy")]
    if asked:
        parts.append("pysindy where nothing is missing\n" + pysindy_nulls(asked))
    parts.append(figures(rows))
    parts.append(failures(rows))
    return "\n\n".join(part for part in parts if part)


def _outside_firm(rows: Sequence[Row]) -> str:
    lines = []
    for name in dict.fromkeys(row["planted"][0] for row in rows):
        mine = [row for row in rows if row["planted"][0] == name]
        firm = Counter(n for row in mine for n in firm_names(row))
        verdicts = Counter(row["verdict"] or "error" for row in mine)
        told = ", ".join(f"{v} {n}" for v, n in verdicts.most_common())
        named = f"   firm: {dict(firm)}" if firm else ""
        lines.append(f"{name:<25}{len(mine):>4}  [{told}]{named}")
    return "\n".join(lines)


def failures(rows: Sequence[Row]) -> str:
    """List every row that a figure counts against, so that it can be run again."""
    lines = []
    for row in rows:
        bad = row["error"]
        if not bad and row["verdict"] is None:
            continue
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
