"""Cautions of a comparison: those that say the same of many channels, said once."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from classic_ml.records import LedgerEntry

if TYPE_CHECKING:
    from comparisons.harness.compare import Comparison

__all__ = [
    "grouped_cautions",
    "low_pass_before_flow",
    "ranking_caution",
    "ranking_meaning",
    "tau_caution",
    "unknown_work",
]

_NUMBER = re.compile(r"\d+(?:\.\d+)?")
_SPAN = re.compile(rf"({_NUMBER.pattern}) to ({_NUMBER.pattern}) s\b")
# What the choice of channels adds to a finding that the inspection has already told.
_OUTSIDE = "faulty rows outside the window only"
_INSIDE = re.compile(r"\d+ faulty rows in the window, few enough to keep it")


@dataclass(frozen=True)
class _Finding:
    """A caution taken apart: where and on which channel, and what."""

    where: str
    channel: str
    what: str

    @classmethod
    def of(cls, caution: str) -> _Finding | None:
        """Take a caution apart, or return None where it names no channel."""
        *where, channel, what = ("", "", *caution.split(": "))
        place = ": ".join(where[2:])
        return cls(place, channel, what) if place and channel and " " not in channel else None


def grouped_cautions(cautions: Sequence[str]) -> tuple[str, ...]:
    """Say once what several cautions say of different channels or with other numbers.

    Parameters
    ----------
    cautions : sequence of str
        E.g. ``"raw.csv: P25_A_tip: 40 rows clipped"``: where, what, and the finding.

    Returns
    -------
    tuple of str
        Single cautions first, then one for each kind that came up on several channels: with the
        number of channels in place of their names, and numbers from the least to the greatest.
        That a channel's faults lie outside the window is told with the fault.
    """
    singles: list[str] = []
    findings: list[_Finding] = []
    for caution in dict.fromkeys(cautions):
        finding = _Finding.of(caution)
        if finding is None:
            singles.append(caution)
        else:
            findings.append(finding)
    kinds: dict[tuple[str, str], list[_Finding]] = {}
    for finding in _with_window(findings):
        kinds.setdefault((finding.where, _NUMBER.sub("#", finding.what)), []).append(finding)
    several: list[str] = []
    for (where, _), members in kinds.items():
        said = f"{where}: {_summed_up([(member.channel, member.what) for member in members])}"
        (several if len(members) > 1 else singles).append(said)
    return (*singles, *several)


def ranking_meaning(target: str) -> str:
    """Say what the held-out error ranks, and what not.

    Parameters
    ----------
    target : {"psi_p", "psi"}
        The coefficient.
    """
    symbol = "ψ'" if target == "psi_p" else "ψ"
    return (
        f"held-out rms ranks how well {symbol} is predicted from this record's φ, not how near "
        "the characteristic is"
    )


def ranking_caution(comparison: Comparison) -> str | None:
    """Say what the held-out error ranks, where the best of the ranking failed a residual check.

    What a model lacks repeats in every cycle: a flexible curve learns it, and is rewarded on
    held-out cycles too.

    Parameters
    ----------
    comparison : Comparison
        Estimators side by side.

    Returns
    -------
    str or None
        The caution; None where the best passed all checks.
    """
    best = comparison.result(comparison.table[0].estimator)
    if all(check.passed for check in best.checks):
        return None
    return ranking_meaning(comparison.rows.target)


def unknown_work(history: Sequence[LedgerEntry]) -> str | None:
    """Say why ψ is not known, where a ledger shows that it is not.

    Parameters
    ----------
    history : sequence of LedgerEntry
        Ledger of a record.

    Returns
    -------
    str or None
        E.g. ``"ψ is not known: no T31 that counts, so no W31 (T31_A and T31_B: …)"``; None where
        ψ is known or the ledger does not speak of it.
    """
    why = [
        dropped.why
        for entry in history
        if entry.step == "work coefficient"
        for dropped in entry.dropped
        if dropped.what == "ψ" and entry.did == "ψ is not known"
    ]
    if not why:
        return None
    lost = [
        (dropped.what, dropped.why)
        for entry in history
        if entry.step == "choose channels"
        for dropped in entry.dropped
        if dropped.what.startswith("T31")
    ]
    kinds: dict[str, list[tuple[str, str]]] = {}
    for channel, reason in lost:
        kinds.setdefault(_NUMBER.sub("#", reason), []).append((channel, reason))
    channels = "; ".join(_summed_up(members) for members in kinds.values())
    return f"ψ is not known: {why[0]}" + (f" ({channels})." if channels else ".")


def tau_caution(
    histories: Iterable[Sequence[LedgerEntry]],
    *,
    target: str = "psi_p",
    from_whole_runs: Sequence[str] = (),
) -> str | None:
    """Say what the τ of ψ' can be trusted for, where a ledger shows a low-pass before Eq 1 to 4.

    Parameters
    ----------
    histories : iterable of sequence of LedgerEntry
        Ledgers of the records.
    target : {"psi_p", "psi"}
        The coefficient whose τ it is: only that of ψ' was measured to come out high.
    from_whole_runs : sequence of str
        Estimators that were fitted to unfiltered signals instead.

    Returns
    -------
    str or None
        The caution; None for ψ, and where no ledger shows such a filter.
    """
    if target != "psi_p":
        return None
    cutoffs = {low_pass_before_flow(history) for history in histories} - {None}
    if not cutoffs:
        return None
    at = " and ".join(f"{cutoff:g}" for cutoff in sorted(c for c in cutoffs if c is not None))
    # 29 to 31 ms over seeds of the simulated rig, whose truth is 18 ms, with armax and the
    # default reduction (zero phase); the demo prints it beside the truth.
    known = (
        f"the pressures were low-passed at {at} Hz before the flow equation, and on data "
        "low-passed at 48 Hz there the τ of ψ' is known to come out high (about 30 ms where 18 ms "
        "is true, on a rig with known truth at 98.5 % speed: “sindy-surge demo” prints it). "
        "Standard errors and intervals state scatter and do not contain this bias"
    )
    if from_whole_runs:
        names = " and ".join(from_whole_runs)
        return (
            f"which τ to quote: that of {names}, which comes from one free run through the "
            f"unfiltered signals. For the others {known}."
        )
    return (
        f"what τ can be trusted for: {known}: compare estimators on the same data, but do not "
        "quote this τ as the time constant of the compressor."
    )


def low_pass_before_flow(history: Sequence[LedgerEntry]) -> float | None:
    """Return the cut-off of the low-pass that the pressures passed before the flow equation.

    Parameters
    ----------
    history : sequence of LedgerEntry
        Ledger of a record.

    Returns
    -------
    float or None
        In hertz; None where the ledger shows no such filter.
    """
    for entry in history:
        cutoff = entry.parameters.get("cutoff_hz")
        if (
            entry.step == "filter"
            and entry.parameters.get("phase") != "none"
            and isinstance(cutoff, int | float)
        ):
            return float(cutoff)
    return None


def _with_window(findings: Sequence[_Finding]) -> list[_Finding]:
    """Tell with each fault where it lies to the window, in place of a finding of its own."""
    places: dict[tuple[str, str], str] = {}
    for finding in findings:
        if finding.what == _OUTSIDE:
            places[finding.where, finding.channel] = "outside the window"
        elif _INSIDE.fullmatch(finding.what):
            places[finding.where, finding.channel] = finding.what
    faults = [f for f in findings if f.what != _OUTSIDE and not _INSIDE.fullmatch(f.what)]
    told = {(fault.where, fault.channel) for fault in faults}
    merged = []
    for finding in findings:
        key = finding.where, finding.channel
        if finding in faults:
            place = f" ({places[key]})" if key in places else ""
            merged.append(_Finding(finding.where, finding.channel, finding.what + place))
        elif key not in told:
            merged.append(finding)
    return merged


def _summed_up(members: Sequence[tuple[str, str]]) -> str:
    """Say of several channels what is said of each, in the same words but for the numbers."""
    channels = list(dict.fromkeys(channel for channel, _ in members))
    findings = [finding for _, finding in members]
    if len(channels) == 1:
        return f"{channels[0]}: {'; '.join(dict.fromkeys(findings))}"
    names = (
        " and ".join(channels)
        if len(channels) == 2
        else f"{channels[0]} and {len(channels) - 1} more channels"
    )
    return f"{names}: {_merged(findings).replace('beyond its limits', 'beyond their limits')}"


def _merged(findings: Sequence[str]) -> str:
    """Return one finding in which each number is the range of its values."""
    # A span in time becomes the one that holds them all, not a range of starts to one of ends.
    spans = zip(*(_SPAN.findall(finding) for finding in findings), strict=True)
    parts = [
        _ranges(same)
        for same in zip(*(_SPAN.sub("\n", f).split("\n") for f in findings), strict=True)
    ]
    text = parts[0]
    for same, part in zip(spans, parts[1:], strict=True):
        start, end = min((s for s, _ in same), key=float), max((e for _, e in same), key=float)
        text += f"{start} to {end} s{part}"
    return text


def _ranges(texts: Sequence[str]) -> str:
    numbers = zip(*(_NUMBER.findall(text) for text in texts), strict=True)
    words = _NUMBER.split(texts[0])
    text = words[0]
    for values, word in zip(numbers, words[1:], strict=True):
        low, high = min(values, key=float), max(values, key=float)
        text += (low if float(low) == float(high) else f"{low} to {high}") + word
    return text
