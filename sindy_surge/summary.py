"""What is shown of a fitted model: one list of fields and tables, for text, HTML and pages."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from sindy_surge.selection import PathRow
from sindy_surge.text import FUNCTIONS, EquationParts, write_equation
from sindy_surge.weak import WeakLag
from surge_core.display import Field, Grid, Sheet
from surge_core.fit_state import FitState
from surge_core.rounding import NOT_KNOWN, round_like, round_to_error, significant
from surge_core.terms import pretty_term
from surge_core.types import FloatArray

__all__ = ["ModelSummary", "interval95"]

_NORMAL_95 = 1.959963984540054  # two-sided 95 % of the normal distribution
# Functions whose value carries a unit if their argument does.
_KEEP_UNIT = {"relu", "abs", "sqrt"}


def interval95(value: float, stderr: float, *, positive: bool = False) -> tuple[float, float]:
    """Return the 95 % interval of a value.

    Parameters
    ----------
    value, stderr : float
        The value and its standard error.
    positive : bool
        Whether the value is above zero by its nature: the interval is then symmetric in its
        logarithm where the error is small against the value, and cut at zero where it is not.

    Returns
    -------
    tuple of float
        The bounds; nan where the error is not known.
    """
    reach = _NORMAL_95 * stderr
    if not math.isfinite(reach):
        return math.nan, math.nan
    if positive and reach <= 0.5 * value:
        factor = math.exp(reach / value)
        return value / factor, value * factor
    low = max(0.0, value - reach) if positive else value - reach
    return low, value + reach


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
    n_candidates : int
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
    input_ranges : ndarray of shape (2, n_inputs) or None
        Least and greatest value of each input.
    cautions : sequence of str
        What to know before the numbers are used.
    """

    parts: EquationParts
    state: FitState
    name: str = "SparseLagRegressor"
    n_candidates: int = 0
    inclusion: Sequence[float] | None = None
    rivals: Sequence[Sequence[str]] | None = None
    aliases: Sequence[Sequence[str]] | None = None
    noise: tuple[float, Sequence[float]] | None = None
    weak: WeakLag | None = None
    path: Sequence[PathRow] = ()
    input_ranges: FloatArray | None = None
    cautions: Sequence[str] = ()

    def sheet(self) -> Sheet:
        """Return the fields and tables: the terms, and the structures by size where known."""
        tone = "good" if self.state is FitState.OK else "advice"
        fields = [
            Field("equation", write_equation(self.parts)),
            Field("state", f"{self.state}: {self.state.advice}", tone),
            *self._times(),
            *self._inputs(),
            Field("rivals", _ledger(self.rivals, ", ", "the data cannot tell from it:")),
            Field("aliases", _ledger(self.aliases, " = ", "the same on this data:")),
            *([Field("cautions", tuple(self.cautions))] if self.cautions else []),
        ]
        grids = (self._terms(), _path_grid(self.path)) if self.path else (self._terms(),)
        return Sheet(self.name, tuple(fields), grids)

    def _times(self) -> list[Field]:
        parts = self.parts
        tau, error = parts.time_constant_s, parts.time_constant_stderr_s
        fields = []
        if parts.is_static:
            fields.append(Field("time constant τ", "none: the fit is static"))
        else:
            bounds = interval95(tau, error, positive=True)
            fields.append(Field("time constant τ", f"{round_to_error(tau, error)} s"))
            fields.append(Field("τ, 95 % interval", f"{_interval(bounds, error)} s"))
        if parts.has_dead_time:
            dead, error = parts.dead_time_s, parts.dead_time_stderr_s
            fields.append(Field("dead time d", f"{round_to_error(dead, error)} s"))
            bounds = interval95(dead, error)
            fields.append(Field("d, 95 % interval", f"{_interval(bounds, error)} s"))
        if self.weak is not None:
            readings = {
                "forward": self.weak.forward_s,
                "reverse": self.weak.reverse_s,
                "noise taken off": self.weak.compensated_s,
            }
            fields += [
                Field(f"weak τ, {name}", f"{significant(value)} s")
                for name, value in readings.items()
                if math.isfinite(value)
            ]
            fields.append(Field("weak gap (noise)", f"{significant(100 * self.weak.gap, 3)} %"))
        return fields

    def _inputs(self) -> list[Field]:
        names = [pretty_term(name) for name in (self.parts.output_name, *self.parts.input_names)]
        fields = []
        if self.noise is not None:
            levels = (self.noise[0], *self.noise[1])
            fields += [
                Field(f"noise of {name} (std)", f"{level:.3g}")
                for name, level in zip(names, levels, strict=True)
            ]
        if self.input_ranges is not None:
            low, high = np.asarray(self.input_ranges, dtype=np.float64)
            fields += [
                Field(f"range of {name}", f"{a:.4g} to {b:.4g}")
                for name, a, b in zip(names[1:], low, high, strict=True)
            ]
        return fields

    def _terms(self) -> Grid:
        parts = self.parts
        rows = [
            (
                pretty_term(term),
                round_to_error(value, error),
                _interval(interval95(value, error), error),
                _unit_of(term, parts),
            )
            for term, value, error in zip(parts.terms, parts.coef, parts.stderr, strict=True)
        ]
        header: tuple[str, ...] = ("term", "coefficient ± std error", "95 % interval", "unit")
        cells: list[tuple[str, ...]] = list(rows)
        if self.inclusion is not None:
            header = (*header, "inclusion probability")
            known = [f"{p:.2f}" if math.isfinite(p) else NOT_KNOWN for p in self.inclusion]
            cells = [(*row, p) for row, p in zip(rows, known, strict=True)]
        title = f"Terms of {pretty_term(parts.output_name)}_QS: {len(rows)}"
        title += f" of {self.n_candidates} candidates"
        return Grid(title, header, tuple(cells), frozenset({0, 3}))


def _interval(bounds: tuple[float, float], stderr: float) -> str:
    if not all(map(math.isfinite, bounds)):
        return NOT_KNOWN
    return " to ".join(round_like(bound, stderr) for bound in bounds)


def _ledger(groups: Sequence[Sequence[str]] | None, glue: str, heading: str) -> tuple[str, ...]:
    if groups is None:
        return ("not looked for",)
    written = [glue.join(map(pretty_term, group)) for group in groups]
    return (heading, *written) if written else ("none",)


def _unit_of(term: str, parts: EquationParts) -> str:
    """Return the unit of a coefficient: only φ, ψ' and functions as exp are known to have none."""
    bare = re.sub(r"\[[^\]]*\]", "", term)
    bare = re.sub(rf"\b(?:{'|'.join(set(FUNCTIONS) - _KEEP_UNIT)})\([^()]*\)", "", bare)
    words = set(re.findall(r"[^\W\d]\w*", bare)) - set(FUNCTIONS)
    return "1" if words <= {"phi", parts.output_name} else f"per {pretty_term(term)}"


def _path_grid(path: Sequence[PathRow]) -> Grid:
    """Tabulate the best structure of each size, and the chosen one wherever it stands."""
    held_out = any(math.isfinite(row.held_out_rms) for row in path)

    def rank(row: PathRow) -> tuple[float, float]:
        # Where cycles were left out they decide, and the score of the likelihood means little.
        values = (row.held_out_rms, row.score)
        return values[0] if math.isfinite(values[0]) else math.inf, np.nan_to_num(
            values[1], nan=math.inf
        )

    shown: list[PathRow] = []
    for size in sorted({row.size for row in path}):
        ranked = sorted((row for row in path if row.size == size), key=rank)
        shown += [row for row in ranked if row.chosen or row is ranked[0]]
    write: list[tuple[str, Callable[[PathRow], str]]] = [
        ("size", lambda row: str(row.size)),
        ("chosen", lambda row: "yes" if row.chosen else ""),
        ("terms", lambda row: ", ".join(map(pretty_term, row.terms))),
        ("score", lambda row: f"{row.score:.1f}" if math.isfinite(row.score) else NOT_KNOWN),
        ("score about", lambda row: "own fit" if row.refitted else "all terms"),
    ]
    if held_out:
        write.append(("held-out rms", lambda row: significant(row.held_out_rms)))
    return Grid(
        f"Structures by size: the best of {len(path)} tried",
        tuple(head for head, _ in write),
        tuple(tuple(cell(row) for _, cell in write) for row in shown),
        frozenset({1, 2, 4}),
        next((number for number, row in enumerate(shown) if row.chosen), None),
        folded=True,
    )
