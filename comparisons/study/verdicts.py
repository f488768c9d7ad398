"""What paired differences of methods to a reference say: better, worse, equivalent, undecided."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from scipy.stats import t as student_t

LEVEL = 0.05


@dataclass(frozen=True)
class Paired:
    """A method against the reference over the cells that both could score.

    Parameters
    ----------
    n_pairs, n_records : int
        Cells that both could score, and the independent records that they come from.
    difference, stderr : float
        Mean loss minus that of the reference, and its standard error clustered by record, in the
        unit of the score; the error is NaN with one record.
    """

    n_pairs: int = 0
    n_records: int = 0
    difference: float = math.nan
    stderr: float = math.nan


def verdicts_of(against: Mapping[str, Paired], margin: float, tests: int = 0) -> dict[str, str]:
    """Return what the paired differences of methods to a reference say.

    "better" and "worse" are two-sided tests by Student's t over records, at 5 % over all together
    (Holm, Scandinavian Journal of Statistics 6, 1979); "equivalent" is two one-sided tests at 5 %
    each (Schuirmann, Journal of Pharmacokinetics and Biopharmaceutics 15, 1987), and goes first.

    Parameters
    ----------
    against : mapping of str to Paired
        Differences, by method.
    margin : float
        Half the width of what counts as equal, in the unit of the loss.
    tests : int
        Comparisons that these were chosen from, where there were more.
    """
    found = {}
    known = {n: p for n, p in against.items() if p.n_records > 1 and math.isfinite(p.stderr)}
    left, rejecting = max(tests, len(known)), True
    for name in sorted(known, key=lambda name: _two_sided(known[name])):
        pair = known[name]
        rejecting = rejecting and _two_sided(pair) * left <= LEVEL
        left -= 1
        room = margin - abs(pair.difference)
        if room > 0.0 and 0.5 * _two_sided(replace(pair, difference=room)) <= LEVEL:
            found[name] = "equivalent"
        elif rejecting:
            found[name] = "worse" if pair.difference > 0.0 else "better"
        else:
            found[name] = "undecided"
    single = [name for name, pair in against.items() if pair.n_pairs and name not in known]
    return found | dict.fromkeys(single, "undecided")


def _two_sided(pair: Paired) -> float:
    """Return the p-value of a difference of zero."""
    if pair.stderr == 0.0:
        return 1.0 if pair.difference == 0.0 else 0.0
    return float(2.0 * student_t.sf(abs(pair.difference) / pair.stderr, pair.n_records - 1))
