"""How small an effect may be and still be named: the numbers, and how they are reported."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from surge_core.rounding import significant

# The check plants this many times the limit.
CHECKED_AT = 1.5
# How an effect is computed, and nothing of the machine.
UNTOLD = ("prolonged", "intervals", "phi_from", "phi_to")
WORDS = {("lagged", 1.0): "behind the lag", ("lagged", 0.0): "not lagged"}


@dataclass(frozen=True)
class Limit:
    """The smallest size of one effect that would have been named.

    Parameters
    ----------
    effect : str
        Its name.
    parameter, unit : str
        Which of its parameters is its size, and the unit.
    size : float
        The limit; NaN where there is none.
    excess_sigma : float
        Rms that an effect of that size leaves once the model without it is fitted again, in
        standard deviations of the noise.
    at : mapping of str to float
        Its other parameters, where it was planted.
    named, trials : int
        How often it was named at that size.
    check_size : float
        The size of the check.
    check_named, check_trials : int
        How often it was named in fresh trials at that size.
    why_none : str
        Why there is no limit; empty where there is one.
    runs : int
        Workflows that it took.
    seconds : float
        And their time.
    """

    effect: str
    parameter: str
    unit: str
    size: float = math.nan
    excess_sigma: float = math.nan
    at: Mapping[str, float] | None = None
    named: int = 0
    trials: int = 0
    check_size: float = math.nan
    check_named: int = 0
    check_trials: int = 0
    why_none: str = ""
    runs: int = 0
    seconds: float = 0.0

    @property
    def found(self) -> bool:
        """Whether there is a limit."""
        return math.isfinite(self.size)

    def to_json(self) -> dict[str, Any]:
        """Return the row as plain JSON types; null where nothing is known."""
        return {
            "effect": self.effect,
            "parameter": self.parameter,
            "unit": self.unit,
            "size": self.size if self.found else None,
            "excess_sigma": self.excess_sigma if math.isfinite(self.excess_sigma) else None,
            "at": dict(self.at or {}),
            "named": self.named,
            "trials": self.trials,
            "check_size": self.check_size if self.found else None,
            "check_named": self.check_named,
            "check_trials": self.check_trials,
            "why_none": self.why_none,
            "runs": self.runs,
            "seconds": self.seconds,
        }


@dataclass(frozen=True)
class Limits:
    """The limits of all effects on one set of records.

    Parameters
    ----------
    rows : tuple of Limit
        One an effect, in the order of the catalogue.
    share : float
        Share of the trials in which an effect of its limit is named.
    trials, seed : int
        Trials a size, and their seed.
    seconds : float
        Time that it took.
    whole_runs : bool
        Whether the records are whole runs, whose twins show the limits without a trial.
    """

    rows: tuple[Limit, ...]
    share: float
    trials: int
    seed: int
    seconds: float
    whole_runs: bool = False

    def __getitem__(self, effect: str) -> Limit:
        """Return the limit of an effect."""
        return next(row for row in self.rows if row.effect == effect)

    @property
    def lines(self) -> tuple[str, ...]:
        """What the limits say, a line an effect."""
        words = [_cells(row) for row in self.rows if row.found]
        widths = [max((len(cells[i]) for cells in words), default=0) for i in range(3)]
        table = [
            f"{name:<{widths[0]}}  {size:<{widths[1]}}  {excess:>{widths[2]}}  {check}"
            for name, size, excess, check in words
        ]
        none = [f"{row.effect}: no limit, {row.why_none}" for row in self.rows if not row.found]
        named = sum(row.check_named for row in self.rows)
        checked = sum(row.check_trials for row in self.rows)
        check = (
            f"check: {CHECKED_AT:g} times the limit, planted in fresh trials, was named in {named} "
            f"of {checked}; a limit whose check had failed was raised"
        )
        head = (
            f"Smallest effect that would have been named in {100 * self.share:.0f} % of "
            f"{self.trials} trials on these records:"
        )
        if self.whole_runs:
            head = "Smallest effect that stands out of twins of these records:"
        return (head, *table, *none, *((check,) if checked else ()))

    def to_json(self) -> dict[str, Any]:
        """Return the limits as plain JSON types."""
        return {
            "share": self.share,
            "trials": self.trials,
            "seed": self.seed,
            "seconds": self.seconds,
            "whole_runs": self.whole_runs,
            "effects": [row.to_json() for row in self.rows],
        }


def _cells(row: Limit) -> tuple[str, str, str, str]:
    from comparisons.missing_effect.quantities import symbol

    listed = {name: value for name, value in (row.at or {}).items() if name not in UNTOLD}
    at = ", ".join(WORDS.get((n, v), f"{symbol(n)} {v:.3g}") for n, v in listed.items())
    size = f"{symbol(row.parameter)} = {size_words(row.size, row.unit)}{f' ({at})' if at else ''}"
    check = f"{row.check_named} of {row.check_trials} at {CHECKED_AT:g} times that"
    excess = f"{row.excess_sigma:.2f} σ" if math.isfinite(row.excess_sigma) else ""
    return row.effect, size, excess, check if row.check_trials else ""


def size_words(value: float, unit: str) -> str:
    """Return a size in the unit that is easiest read, to the two digits that are known of it.

    Parameters
    ----------
    value : float
        The size.
    unit : str
        SI; ``"1"`` without one.
    """
    if unit == "s" and value < 1.0:
        return f"{significant(1e3 * value, 2)} ms"
    if unit == "s^2" and value < 1e-2:
        return f"{significant(1e6 * value, 2)} ms²"
    return f"{significant(value, 2)} {_unit(unit)}".rstrip()


def _unit(unit: str) -> str:
    return "" if unit == "1" else unit
