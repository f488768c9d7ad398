"""A record as a diagnosis reads it: its rows, and a state that no error of ψ' can move."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from classic_ml.twin import Twin, twin_of
from classic_ml.whole_record.branches import Specification, fit_branches, specification
from classic_ml.whole_record.interval import specifications
from classic_ml.whole_record.passes import Passes, passes_of
from classic_ml.whole_record.rakes import RakeSignals
from classic_ml.whole_record.stall_state import StallLevels, estimated_state, refined_state
from surge_core.types import BoolArray, FloatArray


@dataclass(frozen=True)
class RecordReading:
    """The signals of a record and what a fit takes for granted of them.

    Its state ``in_stall`` and the flow levels of recovery and entry come from hub and tip flow
    alone: what is missing in ψ' would move levels that ψ' had a say in, and with them hide.
    ``window`` holds the rows to stay in; ``stalled`` is the state of all rows as the reduction sees
    it, for records with one immersion.
    """

    signals: RakeSignals
    window: slice | None
    passes: Passes
    spec: Specification
    in_stall: BoolArray
    levels: StallLevels | None
    stalled: BoolArray | None = None

    @classmethod
    def of(
        cls,
        signals: RakeSignals,
        window: slice | None = None,
        degree: int = 2,
        stalled: BoolArray | None = None,
    ) -> RecordReading:
        """Read a record, or refuse one that has no rows to fit."""
        passes = _passes(signals, window, stalled)
        spec = specification(signals, passes, degree)
        state, levels = estimated_state(passes, spec, by_flow=True)
        return cls(signals, window, passes, spec, state, levels, stalled)

    def again(self, twin: Twin, rng: np.random.Generator) -> RecordReading:
        """Return the reading of a twin, measured and read as the record was."""
        return self._read(twin.measured(rng))

    def twin(self, psi_p: FloatArray) -> Twin:
        """Return the twin of the record under the lag model fitted to a ψ'.

        It is on the rows of ``passes``, without what is not to be in the twin.
        """
        passes = replace(self.passes, psi_p=psi_p)
        fit = fit_branches(passes, self.spec, self.in_stall)
        return twin_of(self.signals, passes, self.spec, self.in_stall, fit)

    def varied(self) -> tuple[RecordReading, ...]:
        """Return the record under what could as well have been taken for granted."""
        specs = [spec for spec in specifications(self.spec) if spec.degree == self.spec.degree]
        plain = replace(self, in_stall=self.passes.in_stall)
        return (plain, *(replace(self, spec=spec) for spec in specs))

    def with_inertia(self, factor: float) -> RecordReading:
        """Return the record reduced with another ∫dx/A, by a factor of the one stated."""
        chain = self.signals.chain
        per_m = factor * chain.compressor.inertia_per_m
        machine = chain.compressor.model_copy(update={"inertia_per_m": per_m})
        return self._read(replace(self.signals, chain=replace(chain, compressor=machine)))

    def _read(self, signals: RakeSignals) -> RecordReading:
        passes = _passes(signals, self.window, self.stalled)
        state = refined_state(passes, self.spec, self.levels, by_flow=True)
        return replace(self, signals=signals, passes=passes, in_stall=state)


def _passes(signals: RakeSignals, window: slice | None, stalled: BoolArray | None) -> Passes:
    passes = passes_of(signals, window)
    if passes.shift is None and stalled is not None:
        passes = replace(passes, in_stall=stalled[passes.row])
    return passes
