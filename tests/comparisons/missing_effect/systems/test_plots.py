"""Pictures of a diagnosis: every kind is drawn, and what is drawn are its numbers."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from made_systems import made_diagnosis
from matplotlib.colors import to_hex

from comparisons.missing_effect.scales import scale_of
from comparisons.missing_effect.systems.plots import (
    AFTER,
    BEFORE,
    draw_candidates,
    draw_errors,
    draw_residuals,
    draw_runs,
)
from comparisons.missing_effect.systems.results import SystemDiagnosis


def ran_away() -> SystemDiagnosis:
    d = made_diagnosis()
    gone = tuple(replace(run, before=np.full_like(run.before, np.nan)) for run in d.checks)
    return replace(d, checks=gone)


KINDS: dict[str, Callable[[], SystemDiagnosis]] = {
    "nothing": lambda: made_diagnosis(nothing=True),
    "text that is no formula": lambda: made_diagnosis(runs={"p$25": "training", "$": "check"}),
    "ran away": ran_away,
    "no round": lambda: replace(made_diagnosis(nothing=True), rounds=(), checks=(), floor=()),
}


@pytest.mark.parametrize("kind", KINDS)
def test_every_diagnosis_is_drawn(kind: str) -> None:
    d = KINDS[kind]()
    drawn = [draw_errors, draw_candidates]
    if d.checks:
        drawn += [draw_runs, draw_residuals]
    for draw in drawn:
        draw(d).savefig(io.BytesIO(), format="png")


def test_dumbbells_end_at_the_errors() -> None:
    d = made_diagnosis()
    runs = (*d.training, *d.checks)
    for j, (ax, factor) in enumerate(zip(draw_errors(d).axes, (1e3, 1.0, 1e6), strict=True)):
        lines = {
            to_hex(str(line.get_color())): line for line in ax.lines if line.get_marker() == "o"
        }
        before, after = lines[BEFORE.lower()].get_xdata(), lines[AFTER.lower()].get_xdata()
        assert before == pytest.approx([factor * run.before_rms[j] for run in runs])
        assert after == pytest.approx([factor * run.after_rms[j] for run in runs])


@pytest.mark.parametrize(
    ("unit", "size", "told"),
    [
        ("m", 0.0123, "12.3 mm"),
        ("m²", 0.02, "0.0200 m²"),
        ("kN", 2e-5, "20.0·10⁻⁶ kN"),
        ("1", 3e-4, "0.300·10⁻³"),
    ],
)
def test_small_numbers_are_told_in_a_unit_that_reads_well(
    unit: str, size: float, told: str
) -> None:
    assert scale_of(unit, [size, float("nan")]).text(size) == told
