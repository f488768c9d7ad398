"""The diagnosis as the bench asks it: which effects it names firmly on a record."""

from __future__ import annotations

from collections.abc import Sequence

from classic_ml.series import CoefficientSeries
from comparisons.missing_effect.diagnosis import diagnose
from comparisons.missing_effect.whole_runs import N_TWINS


class FirmNames:
    """Names effects as ``sindy-surge diagnose`` does, with its defaults."""

    def firm_names(self, records: Sequence[CoefficientSeries]) -> tuple[str, ...]:
        """Return the effects that are named firmly on records of one machine."""
        found = diagnose(list(records), n_twins=N_TWINS)
        return tuple(
            each.effect
            for each in found.missing
            if not (each.provisional or each.unnamed or len(each.alias_set) > 1)
        )
