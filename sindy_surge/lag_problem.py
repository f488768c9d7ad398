"""The data of a fit, and which rows of them a dead time leaves usable."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sindy_surge.candidate_terms import CandidateTerms, polynomial_degree
from sindy_surge.free_run import FreeModel
from sindy_surge.noise import NoiseLevels
from sindy_surge.segments import Segments
from surge_core.lag import FirstOrderLag, Hold
from surge_core.types import FloatArray, IndexArray

# τ below a thousandth of the sample period is no lag at all: e^-1000 = 0.
_SHORTEST_LAG_SAMPLES = 1e-3
# Part of a sample of dead time that is rounding.
_WHOLE = 1e-9


@dataclass(frozen=True)
class UsableRows:
    """The rows of the record that have every input their equation needs."""

    rows: IndexArray  # (n_usable,): Rows of the record
    segments: Segments  # Their runs, counted within `rows`
    home: IndexArray  # (n_runs,): Segment of the record that each run lies in

    @property
    def later(self) -> IndexArray:
        """Positions within `rows` that have a predecessor: one equation each."""
        return self.segments.later

    @property
    def ends(self) -> IndexArray:
        """Row of the record at which each equation ends."""
        return self.rows[self.later]


@dataclass(frozen=True)
class LagProblem:
    """The data and everything that stays the same from structure to structure."""

    inputs: FloatArray  # (n_rows, n_inputs): Measured inputs (φ)
    output: FloatArray  # (n_rows,): Measured ψ'
    segments: Segments  # The runs of rows
    sample_period_s: float  # Sample period in seconds
    hold: Hold  # How the terms run between two samples
    terms: CandidateTerms  # The library
    # (n_columns,): The terms of the library that this data can separate, those with ψ' last
    columns: IndexArray
    noise: NoiseLevels  # The measurement noise
    # The dead time in seconds, given or the start of its fit; positive where ψ' is late
    dead_time_s: float = 0.0
    fits_dead_time: bool = False  # Whether it is a parameter of the fit

    @property
    def longest_lag_s(self) -> float:
        """A lag three times the longest segment looks like an integrator."""
        return 3.0 * float(self.segments.lengths.max()) * self.sample_period_s

    @property
    def shortest_lag_s(self) -> float:
        """The shortest τ tried, in seconds."""
        return _SHORTEST_LAG_SAMPLES * self.sample_period_s

    @property
    def n_without_state(self) -> int:
        """Number of usable terms that do not hold ψ'; they come first."""
        return int(np.count_nonzero(self.columns < self.terms.n_without_state))

    def holds_state(self, support: Sequence[int]) -> bool:
        """Return whether a structure has a term that holds ψ'."""
        return any(i >= self.n_without_state for i in support)

    def names(self, support: Sequence[int]) -> list[str]:
        """Return the names of some usable terms."""
        return [self.terms.names[i] for i in self.columns[list(support)]]

    @cached_property
    def every_name(self) -> list[str]:
        """Names of all usable terms."""
        return self.names(range(self.columns.size))

    @cached_property
    def degrees(self) -> list[int | None]:
        """Degrees of the usable terms; None for those that are no polynomials of the inputs."""
        return [polynomial_degree(name, self.terms.input_names) for name in self.every_name]

    def lag(self, time_constant_s: float, dead_time_s: float = 0.0) -> FirstOrderLag:
        """Return the discrete lag for one τ and dead time, in seconds."""
        return FirstOrderLag(time_constant_s, self.sample_period_s, self.hold, dead_time_s)

    @cached_property
    def dead_time_range_s(self) -> tuple[float, float]:
        """Least and greatest dead time that the usable rows allow a fit to reach."""
        if not self.fits_dead_time:
            return self.dead_time_s, self.dead_time_s
        whole, period = self.lag(1.0, self.dead_time_s).whole_samples, self.sample_period_s
        return (whole - 1) * period, (whole + 2 - 1e-6) * period

    @cached_property
    def usable(self) -> UsableRows:
        """The rows that have every input within reach of the dead time, segment by segment."""
        whole = self.lag(1.0, self.dead_time_s).whole_samples
        part = self.dead_time_s / self.sample_period_s - whole
        first, last = (whole - 1, whole + 1) if self.fits_dead_time else (whole, whole)
        taps = 3 if self.fits_dead_time or part > _WHOLE else 2
        before, after = max(0, last + taps - 2), max(0, -first)
        starts = self.segments.starts + before
        lengths = self.segments.stops - after - starts
        # A run of one row still counts where no row is lost: it has a state, but no equation.
        home = np.flatnonzero(lengths >= (1 if before + after == 0 else 2))
        rows = [np.arange(starts[i], starts[i] + lengths[i]) for i in home]
        edges = np.concatenate(([0], np.cumsum(lengths[home]))).astype(np.intp)
        return UsableRows(
            np.concatenate(rows) if rows else np.empty(0, dtype=np.intp),
            Segments(edges[:-1], edges[1:]),
            home,
        )

    def with_dead_time(self, seconds: float, fitted: bool) -> LagProblem:
        """Return the problem with another dead time, and the rows that it leaves."""
        return replace(self, dead_time_s=seconds, fits_dead_time=fitted)

    def with_colour(self, colour: FloatArray) -> LagProblem:
        """Return the problem with another colour of the noise."""
        return replace(self, noise=replace(self.noise, colour=colour))

    def late(self, values: FloatArray) -> FloatArray:
        """Return columns as they act at each row: straight lines between rows, d earlier."""
        samples = self.dead_time_s / self.sample_period_s
        if samples == 0.0:
            return values
        whole = int(np.floor(samples))
        part = samples - whole
        at = np.arange(self.output.size) - whole
        result: FloatArray = (1 - part) * values[self.segments.within(at)]
        result += part * values[self.segments.within(at - 1)]
        return result

    def model(
        self, support: Sequence[int], coefficients: FloatArray, tau_s: float, dead_time_s: float
    ) -> FreeModel:
        """Return a structure with its numbers as a model that runs on its own."""
        return FreeModel(
            self.terms,
            self.columns[list(support)],
            coefficients,
            self.lag(tau_s, dead_time_s),
            (float(self.output.min()), float(self.output.max())),
        )

    def mean_gain(self, model: FreeModel) -> float:
        """Return ∂(Σ β_i s_i)/∂ψ' at the mean point of the record; 0 if no term holds ψ'."""
        middle = self.inputs.mean(axis=0, keepdims=True)
        return float(model.gain(middle, np.array([self.output.mean()]))[0])
