"""The rows of a comparison, and how well a prediction matches them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

from surge_core.segments import runs_of
from surge_core.types import BoolArray, FloatArray, IntArray

# Gives terms, of shape (n, q), at φ of shape (n,).
Terms = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class FitRows:
    """Rows to be fitted, with their segments.

    Parameters
    ----------
    phi, measured : ndarray of shape (n,)
        Flow coefficient and the coefficient that is modelled.
    time_s : ndarray of shape (n,)
        Facility clock.
    labels : ndarray of int, shape (n,)
        Segment of each row, counted through over all records.
    record : ndarray of int, shape (n,)
        Index of the record of each row.
    sample_period_s : float
        Sample period, in seconds.
    target : {"psi_p", "psi"}
        Which coefficient ``measured`` is.
    train : ndarray of bool, shape (n,)
        Rows that the held-out score is fitted to; the rest is held out.
    averaged : callable, optional
        Of rows that are averages of unfiltered signals: returns terms of the unfiltered φ,
        averaged as ``measured`` was.
    reduced : bool
        Whether the reduction made the signals, so that they are low-passed.
    """

    phi: FloatArray
    measured: FloatArray
    time_s: FloatArray
    labels: IntArray
    record: IntArray
    sample_period_s: float
    target: str
    train: BoolArray
    averaged: Callable[[Terms], FloatArray] | None = None
    reduced: bool = True

    @property
    def kind(self) -> Literal["filtered", "unfiltered"]:
        """Which signals they hold."""
        return "filtered" if self.averaged is None else "unfiltered"

    @property
    def called(self) -> str:
        """What a reader calls them: a series without a ledger may never have been filtered."""
        return self.kind if self.reduced else "given"

    def terms(self, at: Terms) -> FloatArray:
        """Return terms of φ in these rows, of shape (n, q)."""
        return at(self.phi) if self.averaged is None else self.averaged(at)

    @property
    def X(self) -> FloatArray:
        """φ as the one column scikit-learn's estimators take."""
        return self.phi[:, None]

    @property
    def runs(self) -> list[slice]:
        """Rows of each segment."""
        return runs_of(self.labels, self.labels.size)

    @property
    def n_segments(self) -> int:
        """Number of segments."""
        return len(self.runs)

    def part(self, keep: BoolArray) -> FitRows:
        """Return some of the filtered rows."""
        columns = ("phi", "measured", "time_s", "labels", "record", "train")
        return replace(self, **{name: getattr(self, name)[keep] for name in columns})


@dataclass(frozen=True)
class FitScore:
    """How well a prediction matches a measurement.

    Parameters
    ----------
    rms : float
        Root mean square of measurement minus prediction.
    fit_percent : float
        100 (1 - ||y - ŷ|| / ||y - mean y||).
    r2 : float
        Share of the variance explained; negative when the mean would do better.
    n_rows : int
        Rows that were scored.
    """

    rms: float
    fit_percent: float
    r2: float
    n_rows: int

    def to_json(self) -> dict[str, float]:
        """Return rms, fit_percent and r2."""
        return {"rms": self.rms, "fit_percent": self.fit_percent, "r2": self.r2}
