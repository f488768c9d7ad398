"""Pictures of a diagnosis: every kind is drawn, in units that read well."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from made_diagnosis import made_diagnosis as made_lag
from made_systems import made_diagnosis

from comparisons.missing_effect.plots import draw_diagnosis
from comparisons.missing_effect.results import Diagnosis
from comparisons.missing_effect.systems.results import SystemDiagnosis


def ran_away() -> SystemDiagnosis:
    d = made_diagnosis()
    gone = tuple(replace(run, before=np.full_like(run.before, np.nan)) for run in d.checks)
    return replace(d, checks=gone)


KINDS: dict[str, Callable[[], Diagnosis]] = {
    "a lag": lambda: made_lag("alias_set"),
    "a lag that lacks nothing": lambda: made_lag("nothing_missing"),
    "nothing": lambda: made_diagnosis(nothing=True),
    "text that is no formula": lambda: made_diagnosis(runs={"p$25": "training", "$": "check"}),
    "ran away": ran_away,
}


@pytest.mark.parametrize("kind", KINDS)
def test_every_diagnosis_is_drawn(kind: str) -> None:
    d = KINDS[kind]()
    draw_diagnosis(d).savefig(io.BytesIO(), format="png")
