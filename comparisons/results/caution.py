"""What a reader should know before using a result: a code, its numbers, and one sentence."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

# Of the findings of one step in one ledger so many are written out, the rest counted.
FINDINGS_SHOWN = 3

_BIAS = (
    "the pressures were low-passed at {cutoff_hz} Hz before the flow equation, which biases the τ "
    "of ψ' (“sindy-surge demo” shows it on a rig with known truth). Standard errors and intervals "
    "state scatter and do not contain this bias"
)
SENTENCES: Mapping[str, str] = {
    # Which τ to quote.
    "quote_tau": "which τ to quote: that of {estimators}, which comes from one free run through "
    "the unfiltered signals. For the others " + _BIAS,
    "tau_biased": "what τ can be trusted for: " + _BIAS + ": compare estimators on the same data, "
    "but do not quote this τ as the time constant of the compressor",
    # Of the records.
    "ledger": "{finding}",
    "no_ledger": "no ledger lies beside it, so it is not known how it was filtered; a low-pass "
    "before the flow equation biases τ",
    "one_segment": "all its rows are one segment: unstalled rows, if there are any, are fitted as "
    "in-stall",
    "speeds_apart": "one curve and one τ are fitted to records of different corrected speeds "
    "(at their first rows: {each}), and are those of none of them",
    "no_whole_run": "classic_ml (armax) and sindy were fitted to the rows: {records} without the "
    "unfiltered columns, scored rows and ledger that `sindy-surge reduce` writes",
    "rows_left_out": "{rows} rows without a known value or in a stretch of fewer than {fewest} "
    "were not fitted",
    "psi_unknown": "ψ is not known: {why}",
    "psi_by_rise": "no ψ_QS is stated from this series: its ψ is that of the temperature rise "
    "alone, which reads too high; `sindy-surge work` (or `run`) fits ψ_QS to the power, from the "
    "raw record",
    # Of the fits.
    "estimator": "{remark}",
    "taus_apart": "{who} put τ between {low_ms:.3g} and {high_ms:.3g} ms: what they disagree on is "
    "not measured by those rows",
    "shared_rows": "classic_ml and sindy are not independent evidence here. {shared}, so their "
    "agreement does not confirm the measurement.",
    "psi_low_passed": "the spectrum of ψ' is emptied from {psi_hz:.2g} Hz on, that of φ is not: ψ' "
    "was low-passed and φ was not, or differently; filter ψ' and every s_i(φ) alike",
    "corners_apart": "the spectrum of ψ' is emptied from {psi_hz:.2g} Hz on, that of φ from "
    "{phi_hz:.2g} Hz on: they were low-passed differently; filter ψ' and every s_i(φ) alike",
}


@dataclass(frozen=True)
class Caution:
    """One thing to know.

    Parameters
    ----------
    code : str
        What it is; a key of ``SENTENCES``.
    where : str
        The record or estimator that it concerns; empty where it concerns all.
    step : str
        Of the ledger, where it comes from one.
    numbers : mapping of str to float, int or str
        What its sentence states.
    """

    code: str
    where: str = ""
    step: str = ""
    numbers: Mapping[str, float | int | str] = field(default_factory=dict)

    @classmethod
    def of(cls, code: str, where: str = "", /, **numbers: float | int | str) -> Caution:
        """Return a caution with its numbers by name."""
        return cls(code, where, "", numbers)

    @property
    def text(self) -> str:
        """The sentence."""
        said = SENTENCES[self.code].format(**self.numbers)
        return f"{self.where}: {said}" if self.where else said

    def __str__(self) -> str:
        return self.text


def texts_of(cautions: Iterable[Caution]) -> tuple[str, ...]:
    """Return the sentences of cautions for a reader: each once, those of a ledger step together.

    Parameters
    ----------
    cautions : iterable of Caution
        In the order in which they are read.

    Returns
    -------
    tuple of str
        Of one step of one ledger the first findings, and how many more there are.
    """
    groups: dict[tuple[str, ...], list[str]] = {}
    for caution in cautions:
        key: tuple[str, ...] = (caution.text,)
        said = caution.text
        if caution.code == "ledger":
            key, said = (caution.where, caution.step), str(caution.numbers["finding"])
        known = groups.setdefault(key, [])
        if said not in known:
            known.append(said)
    texts = []
    for (where, *step), found in groups.items():
        more = len(found) - FINDINGS_SHOWN
        rest = [f"and {more} more of the step “{step[0]}” in the ledger"] if more > 0 else []
        texts.append(f"{where}: {'; '.join(found[:FINDINGS_SHOWN] + rest)}" if step else where)
    return tuple(texts)
