"""Pictures of a diagnosis: they hold its numbers, and nothing in them overlaps."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from made_systems import made_diagnosis
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox

from comparisons.missing_effect.systems.plots import (
    AFTER,
    BEFORE,
    PALE,
    draw_candidates,
    draw_errors,
    draw_residuals,
    draw_runs,
)
from comparisons.missing_effect.systems.results import SystemDiagnosis
from comparisons.missing_effect.systems.shown import (
    candidates_shown,
    scale_of,
)

HOSTILE = "p$25_{x}^2 \\frac 漢字 <b> and a name that is much longer than any panel"
DRAWN: tuple[Callable[[SystemDiagnosis], Figure], ...] = (
    draw_runs,
    draw_residuals,
    draw_candidates,
    draw_errors,
)


def many() -> SystemDiagnosis:
    names = {f"record {i:02d}": "check" if i > 1 else "training" for i in range(28)}
    return made_diagnosis(runs=names)


def ran_away() -> SystemDiagnosis:
    d = made_diagnosis()
    gone = tuple(replace(run, before=np.full_like(run.before, np.nan)) for run in d.checks)
    return replace(d, checks=gone)


def begun_only() -> SystemDiagnosis:
    return replace(made_diagnosis(nothing=True), rounds=(), checks=(), floor=())


KINDS: dict[str, Callable[[], SystemDiagnosis]] = {
    "nothing": lambda: made_diagnosis(nothing=True),
    "hostile": lambda: made_diagnosis(runs={HOSTILE: "training", HOSTILE + "2": "check"}),
    "ran away": ran_away,
    "no round": begun_only,
}


@pytest.mark.parametrize(
    ("kind", "draw"),
    [
        ("nothing", draw_runs),
        ("nothing", draw_residuals),
        ("nothing", draw_candidates),
        ("nothing", draw_errors),
        ("hostile", draw_runs),
        ("hostile", draw_errors),
        ("ran away", draw_runs),
        ("ran away", draw_residuals),
        ("ran away", draw_errors),
        ("no round", draw_candidates),
        ("no round", draw_errors),
    ],
)
def test_every_diagnosis_is_saved_without_a_warning(
    kind: str, draw: Callable[[SystemDiagnosis], Figure]
) -> None:
    assert inside(draw(KINDS[kind]()))


def shown_texts(figure: Figure) -> list[tuple[str, Bbox]]:
    """Return what is written and where, a pixel shaved off each side."""
    figure.savefig(io.BytesIO(), format="png")
    texts = [*figure.texts, *(t for one in figure.legends for t in one.get_texts())]
    texts += [t for t in (figure._supxlabel,) if t is not None]  # type: ignore[attr-defined]
    for ax in figure.axes:
        texts += [*ax.texts, ax.title, ax._left_title]  # type: ignore[attr-defined]
        texts += [ax.xaxis.label, ax.yaxis.label] if ax.axison else []
        texts += tick_labels(ax) if ax.axison else []
    found = []
    for text in dict.fromkeys(texts):
        if text.get_text().strip() and text.get_visible():
            box = text.get_window_extent()
            own = Bbox.from_extents(box.x0 + 1, box.y0 + 1, box.x1 - 1, box.y1 - 1)
            found.append((text.get_text(), own))
    return found


def tick_labels(ax: Axes) -> list[Text]:
    """Return the labels of ticks that lie within the limits of their axis."""
    found = []
    for axis, limits in ((ax.xaxis, sorted(ax.get_xlim())), (ax.yaxis, sorted(ax.get_ylim()))):
        for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()):
            if limits[0] <= tick.get_loc() <= limits[1] and tick.label1.get_visible():
                found.append(tick.label1)
    return found


def inside(figure: Figure) -> bool:
    """Tell whether all that is written lies in the picture."""
    whole = figure.bbox
    return all(
        box.x0 >= whole.x0 and box.x1 <= whole.x1 and box.y0 >= whole.y0 and box.y1 <= whole.y1
        for _, box in shown_texts(figure)
    )


def bars_of(ax: Axes) -> list[tuple[float, str, str | None]]:
    return [(p.get_width(), to_hex(p.get_facecolor()), p.get_hatch()) for p in ax.patches]


def test_bars_are_as_long_as_scores_and_tell_the_fate() -> None:
    d = made_diagnosis()
    panels = draw_candidates(d).axes
    assert len(panels) == 3
    for ax, step in zip(panels, d.rounds, strict=True):
        shown = candidates_shown(step)
        labels = [label.get_text() for label in ax.get_yticklabels()]
        assert labels == [c.placed.label(d.model) for c in shown]
        widths = [width for width, _, _ in bars_of(ax)]
        for width, candidate in zip(widths, shown, strict=True):
            if candidate.score > 1.0:
                assert width == pytest.approx(candidate.score)
    looks = [[(colour, hatch) for _, colour, hatch in bars_of(ax)] for ax in panels]
    assert looks[0][0] == (AFTER.lower(), None)
    assert looks[1][:2] == [(AFTER.lower(), None), (PALE, "////")]
    # The winner of the last round was not added.
    assert looks[2][0] == ("#ffffff", None)
    assert looks[0][-1] == ("#ffffff", None)


def test_dumbbells_end_at_the_errors_in_a_unit_that_reads_well() -> None:
    d = made_diagnosis()
    panels = draw_errors(d).axes
    runs = (*d.training, *d.checks)
    for j, (ax, factor) in enumerate(zip(panels, (1e3, 1.0, 1e6), strict=True)):
        lines = {
            to_hex(str(line.get_color())): line for line in ax.lines if line.get_marker() == "o"
        }
        before, after = lines[BEFORE.lower()].get_xdata(), lines[AFTER.lower()].get_xdata()
        assert before == pytest.approx([factor * run.before_rms[j] for run in runs])
        assert after == pytest.approx([factor * run.after_rms[j] for run in runs])
    assert [ax.get_xlabel() for ax in panels] == [
        "rms error [mm]",
        "rms error [A]",
        "rms error [10⁻⁶]",
    ]
    labels = [label.get_text() for label in panels[0].get_yticklabels()]
    assert labels[0] == "sweep up (training)"
    assert labels[-1] == "arrow (check)"


@pytest.mark.parametrize(
    ("unit", "size", "told"),
    [
        ("m", 0.0123, "12.3 mm"),
        ("V", 4.56e-5, "45.6 µV"),
        ("m/s", 0.02, "20.0 mm/s"),
        ("m²", 0.02, "0.0200 m²"),
        ("min", 0.02, "0.0200 min"),
        ("mm", 0.02, "0.0200 mm"),
        ("kN", 2e-5, "20.0·10⁻⁶ kN"),
        ("1", 3e-4, "0.300·10⁻³"),
        ("1", 0.5, "0.500"),
        ("m", 12.0, "12.0 m"),
        ("m", 0.0, "0.00 m"),
    ],
)
def test_small_numbers_are_told_in_a_unit_that_reads_well(
    unit: str, size: float, told: str
) -> None:
    assert scale_of(unit, [size, float("nan")]).text(size) == told
