"""Pictures of a diagnosis: made for every verdict, marked where they must be, and truthful."""

from __future__ import annotations

import re
from functools import cache

import numpy as np
import pytest
from made_diagnosis import VERDICTS, made_diagnosis, swept
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from comparisons.missing_effect.shown import (
    contributions,
    residual_runs,
    steady_curves,
    where_of,
)
from comparisons.page.blocks import Picture
from comparisons.page.style import MARK
from comparisons.show.plots_added_effect import (
    AFTER,
    BEFORE,
    characteristics_before_and_after,
    contributions_in_time,
    residual_spectra,
)
from comparisons.show.plots_missing_effect import diagnosis_picture
from comparisons.show.plots_where import where_picture

HEADINGS = {
    "nothing_missing": "Nothing missing",
    "named": "Missing: hysteresis",
    "alias_set": "Missing: transport_delay or second_order_lag",
    "provisional": "Missing, provisional name: hysteresis",
    "unnamed_term": "Missing, without a name: c · φ·dφ/dt",
    "unexplained_structure": "Something is left that has no name",
    "noise_model_wrong": "Nothing missing; the noise is not white and normal",
}


@cache
def whole(verdict: str) -> Picture:
    d = made_diagnosis(verdict)
    return diagnosis_picture(d, where_of(d, d.before), where_of(d, d.after))


def texts(figure: Figure) -> list[str]:
    return [text.get_text() for ax in figure.axes for text in ax.texts]


def panel(figure: Figure, words: str) -> Axes:
    (ax,) = [a for a in figure.axes if words in a.get_title("left") + a.get_ylabel()]
    return ax


@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_verdict_is_drawn_with_its_heading(verdict: str) -> None:
    picture = whole(verdict)
    assert texts(picture.figure)[0] == HEADINGS[verdict]
    assert picture.alt.startswith(HEADINGS[verdict])
    d = made_diagnosis(verdict)
    said = picture.alt.split("rms of ψ'", 1)[1]
    number = re.search(r"\d+\.\d+", said)
    assert number is not None
    assert float(number.group()) == pytest.approx(d.gap.before_rms, rel=0.01)


def test_tau_and_gap_stand_below_the_heading() -> None:
    below = texts(whole("named").figure)[1]
    assert "τ 110.0 ms → 100.0 ± 0.4 ms" in below
    assert "2.10 → 1.02 times the noise: 98.8 % of the gap closed" in below
    assert "τ = 110.0 ± 0.4 ms" in texts(whole("nothing_missing").figure)[1]


def test_the_alias_set_is_marked_among_the_candidates() -> None:
    ax = panel(whole("alias_set").figure, "who:")
    bars = [patch for patch in ax.patches if patch.get_width() > 0.0]  # type: ignore[attr-defined]
    assert [bool(bar.get_hatch()) for bar in bars] == [False, True, False]
    assert to_hex(bars[0].get_facecolor()) == AFTER.lower()
    words = [text.get_text() for text in ax.texts]
    assert "second_order_lag (alias)" in words
    assert "bias_drift (refused)" in words


def test_the_residual_is_in_units_of_the_noise() -> None:
    ax = panel(diagnosis_picture(made_diagnosis("named"), None).figure, "residual [noise rms]")
    lines = {str(line.get_label()): line for line in ax.lines}
    before = np.asarray(lines["before"].get_ydata(), dtype=float)
    assert to_hex(str(lines["before"].get_color())) == BEFORE.lower()
    # The made model before has the right curve and a τ off by a tenth.
    assert 1.5 < np.std(before) < 4.0


def test_records_too_short_to_look_at_are_drawn_without_where() -> None:
    figure = diagnosis_picture(made_diagnosis("named"), None).figure
    assert any("too short" in text for text in texts(figure))


def test_views_are_bars_against_what_chance_reaches() -> None:
    d = made_diagnosis("named")
    where = where_of(d, d.before)
    ax = panel(diagnosis_picture(d, where, where).figure, "where")
    widths = [patch.get_width() for patch in ax.patches]  # type: ignore[attr-defined]
    assert max(widths) == pytest.approx(max(where.strongest_z.values()) / where.bound_z)


def test_both_branches_of_a_hysteresis_are_drawn() -> None:
    d = made_diagnosis("named")
    picture = characteristics_before_and_after(d)
    upper, lower = picture.figure.axes
    assert {"before", "after, φ falling", "after, φ rising"} <= {
        str(line.get_label()) for line in upper.lines
    }
    before = next(line for line in upper.lines if line.get_label() == "before")
    phi = np.asarray(before.get_xdata(), dtype=float)
    np.testing.assert_allclose(np.asarray(before.get_ydata(), dtype=float), swept(phi))
    differences = [np.asarray(line.get_ydata(), dtype=float) for line in lower.lines[1:]]
    assert min(float(each.min()) for each in differences) == pytest.approx(-0.021)
    old = steady_curves(d.before, d.data)[0]
    assert f"{old.value[0]:.3g} to {old.value[-1]:.3g}" in picture.alt


@pytest.mark.parametrize("verdict", ["named", "alias_set", "provisional", "unnamed_term"])
def test_contributions_are_drawn_for_what_was_found(verdict: str) -> None:
    d = made_diagnosis(verdict)
    picture = contributions_in_time(d)
    (part,) = contributions(d)
    assert f"{part.effect} rms {part.rms:.3g}" in picture.alt
    over_time = picture.figure.axes[0].lines[1]
    drawn = np.asarray(over_time.get_ydata(), dtype=float)
    np.testing.assert_allclose(np.nanmax(np.abs(drawn)), np.nanmax(np.abs(part.value)))


@pytest.mark.parametrize("verdict", ["nothing_missing", "named"])
def test_spectra_are_ratios_to_the_noise(verdict: str) -> None:
    d = made_diagnosis(verdict)
    before = where_of(d, d.before)
    picture = residual_spectra(before, where_of(d, d.after) if d.missing else None)
    (ax,) = picture.figure.axes
    labels = [str(line.get_label()) for line in ax.lines]
    assert ("before" in labels) == bool(d.missing)
    assert f"{max(row.ratio for row in before.frequency):.3g} times" in picture.alt


def test_where_marks_what_lies_beyond_chance() -> None:
    d = made_diagnosis("named")
    where = where_of(d, d.before)
    picture = where_picture(residual_runs(d, d.before), where)
    assert picture.said_above
    assert picture.alt == " ".join(where.words)
    frequency = panel(picture.figure, "power over the floor's")
    marked = [to_hex(str(line.get_color())) == MARK.lower() for line in frequency.lines]
    beyond = any(row.z > where.bound_z for row in where.frequency)
    assert any(marked) == beyond
    assert beyond
