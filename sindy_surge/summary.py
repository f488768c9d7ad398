"""What is told of a fitted model: one list of fields and tables, for text and HTML alike."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from sindy_surge.equations import (
    FUNCTIONS,
    EquationParts,
    pretty_term,
    round_to_error,
    write_equation,
)
from surge_core.fit_state import FitState

if TYPE_CHECKING:
    from sindy_surge.selection import PathRow
    from sindy_surge.weak_form import WeakLag

__all__ = ["Field", "ModelSummary", "Table", "interval95", "summary_fields", "summary_tables"]

_NORMAL_95 = 1.959963984540054  # two-sided 95 % of the normal distribution
_NOT_KNOWN = "n/a"
# Functions whose value carries a unit if their argument does.
_KEEP_UNIT = {"relu", "abs", "sqrt"}


@dataclass(frozen=True)
class ModelSummary:
    """What is shown of a fitted model.

    Parameters
    ----------
    parts : EquationParts
        The equation with its errors.
    state : FitState
        What became of the fit.
    name : str
        Name of the estimator.
    n_candidates : int or None
        Number of terms in the library.
    inclusion : sequence of float or None
        Probability that a term belongs, one for each term.
    rivals : sequence of sequences of str or None
        Structures that the data cannot tell from the chosen one; None if not looked for.
    aliases : sequence of sequences of str or None
        Groups of terms that are the same thing on this data; None if not looked for.
    noise : tuple of (float, sequence of float) or None
        Standard deviation found for the noise of ψ' and of each input.
    weak : WeakLag or None
        The two weak estimates of τ.
    path : sequence of PathRow
        Structures tried.
    input_ranges : array-like of shape (2, n_inputs) or None
        Least and greatest value of each input.
    quantile : float
        Two-sided 95 % quantile of an error: normal, or Student's t where few cycles gave it.
    cautions : sequence of str
        What to know before the numbers are used.
    """

    parts: EquationParts
    state: FitState
    name: str = "SparseLagRegressor"
    n_candidates: int | None = None
    inclusion: Sequence[float] | None = None
    rivals: Sequence[Sequence[str]] | None = None
    aliases: Sequence[Sequence[str]] | None = None
    noise: tuple[float, Sequence[float]] | None = None
    weak: WeakLag | None = None
    path: Sequence[PathRow] = ()
    input_ranges: ArrayLike | None = None
    quantile: float = _NORMAL_95
    cautions: Sequence[str] = ()


@dataclass(frozen=True)
class Field:
    """One quantity of the summary.

    Parameters
    ----------
    label : str
        What it is.
    value : tuple of str
        Its value, in one line or several.
    unit : str
        Unit of the value; empty for words, "1" for a number without one.
    """

    label: str
    value: tuple[str, ...]
    unit: str = ""

    @property
    def lines(self) -> tuple[str, ...]:
        """The value with its unit."""
        unit = f" {self.unit}" if self.unit not in ("", "1") else ""
        return tuple(f"{line}{unit}" for line in self.value)


@dataclass(frozen=True)
class Table:
    """A table of the summary.

    Parameters
    ----------
    title : str
        What the rows are.
    header : tuple of str
        Name of each column.
    rows : tuple of tuple of str
        The cells; the first of each row names it.
    words : frozenset of int
        Columns of words; all others are numbers.
    marked : int or None
        Index of the row that was chosen.
    folded : bool
        Whether a notebook shows only the title until it is opened.
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    words: frozenset[int]
    marked: int | None = None
    folded: bool = False


def interval95(
    value: float, stderr: float, quantile: float = _NORMAL_95, *, positive: bool = False
) -> tuple[float, float]:
    """Return the 95 % interval of a value.

    Parameters
    ----------
    value, stderr : float
        The value and its standard error.
    quantile : float
        Two-sided 95 % quantile of the error.
    positive : bool
        Whether the value is above zero by its nature: the interval is then symmetric in its
        logarithm where the value is well told from zero, and cut at zero where it is not.

    Returns
    -------
    tuple of float
        The bounds; nan where the error is not known.
    """
    reach = quantile * stderr
    if not math.isfinite(reach):
        return math.nan, math.nan
    if positive and reach <= 0.5 * value:
        factor = math.exp(reach / value)
        return value / factor, value * factor
    low = max(0.0, value - reach) if positive else value - reach
    return low, value + reach


def _uncertain(value: float, stderr: float) -> str:
    if not math.isfinite(value):
        return _NOT_KNOWN
    text, error = round_to_error(value, stderr)
    return f"{text} ± {error or '?'}"


def _interval(bounds: tuple[float, float], stderr: float) -> str:
    if not all(map(math.isfinite, bounds)):
        return _NOT_KNOWN
    low, high = (round_to_error(bound, stderr)[0] for bound in bounds)
    return f"{low} to {high}"


def _number(value: float, digits: int = 3) -> str:
    return f"{value:.{digits}g}" if math.isfinite(value) else _NOT_KNOWN


def _probability(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else _NOT_KNOWN


def _structure(terms: Sequence[str]) -> str:
    return ", ".join(map(pretty_term, terms))


def _equals(terms: Sequence[str]) -> str:
    return " = ".join(map(pretty_term, terms))


def _ledger(
    groups: Sequence[Sequence[str]] | None, write: Callable[[Sequence[str]], str], heading: str
) -> tuple[str, ...]:
    if groups is None:
        return ("not looked for",)
    return (heading, *map(write, groups)) if groups else ("none",)


def _unit_of(term: str, parts: EquationParts) -> str:
    """Return the unit of a coefficient: only φ, ψ' and functions as exp are known to have none."""
    bare = re.sub(r"\[[^\]]*\]", "", term)
    bare = re.sub(rf"\b(?:{'|'.join(set(FUNCTIONS) - _KEEP_UNIT)})\([^()]*\)", "", bare)
    words = set(re.findall(r"[^\W\d]\w*", bare)) - set(FUNCTIONS)
    return "1" if words <= {"phi", parts.output_name} else f"per {pretty_term(term)}"


def summary_fields(summary: ModelSummary) -> tuple[Field, ...]:
    """List the quantities of a fitted model.

    Parameters
    ----------
    summary : ModelSummary
        The fitted model.

    Returns
    -------
    tuple of Field
        Equation, state, times, noise and what cannot be told apart; a ledger is listed even
        when it is empty.
    """
    parts = summary.parts
    return (
        Field("equation", (write_equation(parts),)),
        Field("state", (f"{summary.state}: {summary.state.advice}",)),
        *_time_fields(summary),
        *_input_fields(summary),
        Field("rivals", _ledger(summary.rivals, _structure, "the data cannot tell from it:")),
        Field("aliases", _ledger(summary.aliases, _equals, "the same on this data:")),
        *([Field("cautions", tuple(summary.cautions))] if summary.cautions else []),
    )


def _time_fields(summary: ModelSummary) -> list[Field]:
    parts = summary.parts
    tau, error = parts.time_constant_s, parts.time_constant_stderr_s
    fields = []
    if parts.is_static:
        fields.append(Field("time constant τ", ("none: the fit is static",)))
    else:
        bounds = interval95(tau, error, summary.quantile, positive=True)
        fields.append(Field("time constant τ", (_uncertain(tau, error),), "s"))
        fields.append(Field("τ, 95 % interval", (_interval(bounds, error),), "s"))
    if parts.has_dead_time:
        dead, error = parts.dead_time_s, parts.dead_time_stderr_s
        fields.append(Field("dead time d", (_uncertain(dead, error),), "s"))
        bounds = interval95(dead, error, summary.quantile)
        fields.append(Field("d, 95 % interval", (_interval(bounds, error),), "s"))
    if summary.weak is not None:
        forward, reverse = summary.weak.forward_s, summary.weak.reverse_s
        gap = f"{100 * summary.weak.gap:.3g} %" if math.isfinite(summary.weak.gap) else _NOT_KNOWN
        fields.append(Field("weak τ, forward", (_number(forward, 4),), "s"))
        fields.append(Field("weak τ, reverse", (_number(reverse, 4),), "s"))
        if math.isfinite(summary.weak.compensated_s):
            value = _number(summary.weak.compensated_s, 4)
            fields.append(Field("weak τ, noise taken off", (value,), "s"))
        fields.append(Field("weak gap (noise)", (gap,)))
    return fields


def _input_fields(summary: ModelSummary) -> list[Field]:
    parts = summary.parts
    fields = []
    if summary.noise is not None:
        output, inputs = summary.noise
        fields.append(
            Field(f"noise of {pretty_term(parts.output_name)} (std)", (_number(output),), "1")
        )
        fields += [
            Field(f"noise of {pretty_term(name)} (std)", (_number(level),), _input_unit(name))
            for name, level in zip(parts.input_names, inputs, strict=True)
        ]
    if summary.input_ranges is not None:
        low, high = np.asarray(summary.input_ranges, dtype=np.float64)
        fields += [
            Field(f"range of {pretty_term(name)}", (f"{a:.4g} to {b:.4g}",), _input_unit(name))
            for name, a, b in zip(parts.input_names, low, high, strict=True)
        ]
    return fields


def _input_unit(name: str) -> str:
    return "1" if name == "phi" else ""


def summary_tables(summary: ModelSummary) -> tuple[Table, ...]:
    """List the tables of a fitted model: its terms, and the structures by size.

    Parameters
    ----------
    summary : ModelSummary
        The fitted model.

    Returns
    -------
    tuple of Table
        The tables; without a path there is only the first.
    """
    terms = _terms_table(summary)
    return (terms, _path_table(summary.path)) if summary.path else (terms,)


def _terms_table(summary: ModelSummary) -> Table:
    parts, inclusion = summary.parts, summary.inclusion
    rows = []
    for number, (term, value, error) in enumerate(
        zip(parts.terms, parts.coef, parts.stderr, strict=True)
    ):
        text, spread = round_to_error(value, error)
        bounds = interval95(value, error, summary.quantile)
        interval = _interval(bounds, error)
        row = (pretty_term(term), text, spread or _NOT_KNOWN, interval, _unit_of(term, parts))
        rows.append(row if inclusion is None else (*row, _probability(inclusion[number])))
    of = "" if summary.n_candidates is None else f" of {summary.n_candidates} candidates"
    header = ("term", "coefficient", "std error", "95 % interval", "unit")
    return Table(
        f"Terms of {pretty_term(summary.parts.output_name)}_QS: {len(rows)}{of}",
        header if inclusion is None else (*header, "inclusion probability"),
        tuple(rows),
        frozenset({0, 4}),
    )


def _path_table(path: Sequence[PathRow]) -> Table:
    """Tabulate the best structure of each size, and the chosen one wherever it stands."""
    held_out = any(math.isfinite(row.held_out_rms) for row in path)

    def rank(row: PathRow) -> tuple[bool, float, bool, float]:
        # Where cycles were left out they decide, and the score of the likelihood means little.
        return (
            not math.isfinite(row.held_out_rms),
            row.held_out_rms if math.isfinite(row.held_out_rms) else 0.0,
            not math.isfinite(row.score),
            row.score if math.isfinite(row.score) else 0.0,
        )

    shown: list[PathRow] = []
    for size in sorted({row.size for row in path}):
        ranked = sorted((row for row in path if row.size == size), key=rank)
        shown += [row for row in ranked if row.chosen or row is ranked[0]]
    rows = []
    for row in shown:
        cells: tuple[str, ...] = (
            str(row.size),
            "yes" if row.chosen else "",
            _structure(row.terms),
            _score(row.score),
            "own fit" if row.refitted else "all terms",
        )
        rows.append((*cells, _number(row.held_out_rms, 4)) if held_out else cells)
    header = ("size", "chosen", "terms", "score", "score about")
    return Table(
        f"Structures by size: the best of {len(path)} tried",
        (*header, "held-out rms") if held_out else header,
        tuple(rows),
        frozenset({1, 2, 4}),
        next((number for number, row in enumerate(shown) if row.chosen), None),
        folded=True,
    )


def _score(value: float) -> str:
    return f"{value:.1f}" if abs(value) < 1e6 else _number(value, 4)
