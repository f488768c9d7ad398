"""A record as a fit and a diagnosis read it: its rows, what is taken for granted, the state."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from classic_ml.twin import Twin, twin_of
from classic_ml.whole_record.branches import (
    BranchFit,
    Specification,
    fit_branches,
    specification,
    specifications,
)
from classic_ml.whole_record.passes import Passes, passes_of
from classic_ml.whole_record.rakes import RakeSignals
from classic_ml.whole_record.stall_state import StallLevels, estimated_state, refined_state
from surge_core.types import BoolArray, FloatArray


@dataclass(frozen=True)
class RecordReading:
    """The signals of a record and what a fit takes for granted of them."""

    signals: RakeSignals
    window: slice | None  # Rows to stay in
    passes: Passes
    spec: Specification
    in_stall: BoolArray  # The state
    levels: StallLevels | None  # Its flows; None where the state is the one by hub and tip
    # State of all rows as the reduction sees it, for records with one immersion
    stalled: BoolArray | None = None
    # Whether state and levels come from hub and tip flow alone, for a diagnosis: what is missing in
    # ψ' would move levels that ψ' had a say in, and with them hide
    by_flow: bool = True

    @classmethod
    def of(
        cls,
        signals: RakeSignals,
        window: slice | None = None,
        degree: int = 2,
        stalled: BoolArray | None = None,
        *,
        by_flow: bool = True,
    ) -> RecordReading:
        """Read a record, or refuse one that has no rows to fit."""
        passes = _passes(signals, window, stalled)
        spec = specification(signals, passes, degree)
        state, levels = estimated_state(passes, spec, by_flow=by_flow)
        return cls(signals, window, passes, spec, state, levels, stalled, by_flow)

    def fit(self, *, scored: BoolArray | None = None, near_s: float | None = None) -> BranchFit:
        """Fit τ and both branches; see `fit_branches`."""
        return fit_branches(self.passes, self.spec, self.in_stall, scored=scored, near_s=near_s)

    def with_psi_p(self, psi_p: FloatArray) -> RecordReading:
        """Return the record with another ψ' on the rows of ``passes``."""
        return replace(self, passes=replace(self.passes, psi_p=psi_p))

    def twin(self, psi_p: FloatArray) -> Twin:
        """Return the twin of the record under the lag model fitted to a ψ'.

        It is on the rows of ``passes``, without what is not to be in the twin.
        """
        other = self.with_psi_p(psi_p)
        return other.twin_under(other.fit())

    def twin_under(self, fit: BranchFit) -> Twin:
        """Return the twin of the record under a fitted model."""
        return twin_of(self.signals, self.passes, self.spec, self.in_stall, fit)

    def again(
        self, twin: Twin, rng: np.random.Generator, near_s: float = math.nan
    ) -> RecordReading:
        """Return the reading of a twin, measured and read as the record was; its τ is near."""
        return self._read(twin.measured(rng), near_s)

    def varied(self) -> tuple[RecordReading, ...]:
        """Return the record under what could as well have been taken for granted."""
        specs = [spec for spec in specifications(self.spec) if spec.degree == self.spec.degree]
        return (self.by_hub_and_tip(), *(replace(self, spec=spec) for spec in specs))

    def by_hub_and_tip(self) -> RecordReading:
        """Return the record with the state as hub and tip alone show it."""
        return replace(self, in_stall=self.passes.in_stall)

    def with_inertia(self, factor: float) -> RecordReading:
        """Return the record reduced with another ∫dx/A, by a factor of the one stated."""
        chain = self.signals.chain
        per_m = factor * chain.compressor.inertia_per_m
        machine = chain.compressor.model_copy(update={"inertia_per_m": per_m})
        return self._read(replace(self.signals, chain=replace(chain, compressor=machine)))

    def _read(self, signals: RakeSignals, near_s: float = math.nan) -> RecordReading:
        passes = _passes(signals, self.window, self.stalled)
        state = refined_state(passes, self.spec, self.levels, near_s, by_flow=self.by_flow)
        return replace(self, signals=signals, passes=passes, in_stall=state)


def _passes(signals: RakeSignals, window: slice | None, stalled: BoolArray | None) -> Passes:
    passes = passes_of(signals, window)
    if passes.shift is None and stalled is not None:
        passes = replace(passes, in_stall=stalled[passes.row])
    return passes
