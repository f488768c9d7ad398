"""Pictures of a diagnosis: drawn for every verdict, marked where they must be, and truthful."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from made_diagnosis import SIGMA, VERDICTS, made_diagnosis, made_fit, swept
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from comparisons.missing_effect.catalogue import find_effect
from comparisons.missing_effect.shown import contributions, where_of
from comparisons.show.plots_added_effect import AFTER, BEFORE
from comparisons.show.plots_missing_effect import (
    draw_characteristics,
    draw_contributions,
    draw_diagnosis,
    draw_spectra,
    title,
)

FOUND = ("named", "alias_set", "provisional", "unnamed_term")
HOSTILE = "p$25_{x}^2 \\frac 漢字 <b>.csv"


def share_of_ink(figure: Figure) -> float:
    figure.canvas.draw()
    pixels = np.asarray(figure.canvas.buffer_rgba())[:, :, :3]  # type: ignore[attr-defined]
    return float(np.mean(np.any(pixels < 250, axis=2)))


@cache
def whole(verdict: str) -> Figure:
    d = made_diagnosis(verdict)
    return draw_diagnosis(d, where_of(d, d.before), where_of(d, d.after))


def texts(figure: Figure) -> list[str]:
    return [text.get_text() for ax in figure.axes for text in ax.texts]


def panel(figure: Figure, words: str) -> Axes:
    (ax,) = [a for a in figure.axes if words in a.get_title("left") + a.get_ylabel()]
    return ax


@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_verdict_is_drawn(verdict: str) -> None:
    assert 0.05 < share_of_ink(whole(verdict)) < 0.6


@pytest.mark.parametrize("verdict", VERDICTS)
def test_the_heading_says_the_verdict(verdict: str) -> None:
    heading = texts(whole(verdict))[0]
    assert heading == title(made_diagnosis(verdict)).replace("$", r"\$")
    assert (
        heading
        == {
            "nothing_missing": "Nothing missing",
            "named": "Missing: hysteresis",
            "alias_set": "Missing: transport_delay or second_order_lag",
            "provisional": "Missing, provisional name: hysteresis",
            "unnamed_term": "Missing, without a name: c · φ·dφ/dt",
            "unexplained_structure": "Something is left that has no name",
            "noise_model_wrong": "Nothing missing; the noise is not white and normal",
        }[verdict]
    )


def test_tau_and_gap_stand_below_the_heading() -> None:
    told = texts(whole("named"))[1]
    assert "τ 110.0 ms → 100.0 ± 0.4 ms" in told
    assert "2.10 → 1.02 times the noise: 98.8 % of the gap closed" in told
    assert "τ = 110.0 ± 0.4 ms" in texts(whole("nothing_missing"))[1]


def test_a_long_heading_stays_within_the_picture() -> None:
    d = made_diagnosis("alias_set")
    (item,) = d.missing
    many = replace(item, alias_set=(*item.alias_set, "flow_inertia", "thermocouple_lag"))
    figure = draw_diagnosis(replace(d, missing=(many,)), None)
    figure.canvas.draw()
    heading = figure.axes[0].texts[0].get_window_extent()
    assert heading.x1 <= figure.bbox.x1
    assert heading.y1 <= figure.bbox.y1


def test_the_alias_set_is_marked_among_the_candidates() -> None:
    ax = panel(whole("alias_set"), "who:")
    bars = [patch for patch in ax.patches if patch.get_width() > 0.0]  # type: ignore[attr-defined]
    hatched = [bool(bar.get_hatch()) for bar in bars]
    assert hatched == [False, True, False]
    assert to_hex(bars[0].get_facecolor()) == AFTER.lower()
    words = [text.get_text() for text in ax.texts]
    assert "second_order_lag (alias)" in words
    assert "bias_drift (refused)" in words
    assert "944, τ 100 ms" in words


def test_the_residual_is_in_units_of_the_noise() -> None:
    d = made_diagnosis("named")
    ax = panel(draw_diagnosis(d, None), "residual [noise rms]")
    lines = {str(line.get_label()): line for line in ax.lines}
    after = np.asarray(lines["after"].get_ydata(), dtype=float)
    before = np.asarray(lines["before"].get_ydata(), dtype=float)
    assert to_hex(str(lines["before"].get_color())) == BEFORE.lower()
    # The made model before has the right curve and a τ off by a tenth.
    assert 1.5 < np.std(before) < 4.0
    # The made model after has a branch that these records have not.
    assert np.std(after) > 2.0


def test_records_too_short_to_look_at_are_drawn_without_where() -> None:
    figure = draw_diagnosis(made_diagnosis("named"), None)
    assert any("too short" in text for text in texts(figure))
    assert share_of_ink(figure) > 0.05


def test_views_are_bars_against_what_chance_reaches() -> None:
    d = made_diagnosis("named")
    where = where_of(d, d.before)
    ax = panel(draw_diagnosis(d, where, where), "where")
    assert [line.get_xdata()[0] for line in ax.lines] == [1.0]  # type: ignore[index]
    widths = [patch.get_width() for patch in ax.patches]  # type: ignore[attr-defined]
    assert max(widths) == pytest.approx(max(where.strongest_z.values()) / where.bound_z)


def test_both_branches_are_drawn() -> None:
    d = made_diagnosis("named")
    upper, lower = draw_characteristics(d).axes
    labels = {str(line.get_label()) for line in upper.lines}
    assert {"before", "after, φ falling", "after, φ rising"} <= labels
    before = next(line for line in upper.lines if line.get_label() == "before")
    phi = np.asarray(before.get_xdata(), dtype=float)
    np.testing.assert_allclose(np.asarray(before.get_ydata(), dtype=float), swept(phi))
    differences = [np.asarray(line.get_ydata(), dtype=float) for line in lower.lines[1:]]
    assert min(float(d.min()) for d in differences) == pytest.approx(-0.021)


@pytest.mark.parametrize("verdict", VERDICTS)
def test_characteristics_are_drawn_for_every_verdict(verdict: str) -> None:
    assert share_of_ink(draw_characteristics(made_diagnosis(verdict))) > 0.02


@pytest.mark.parametrize("verdict", FOUND)
def test_contributions_are_drawn_for_what_was_found(verdict: str) -> None:
    d = made_diagnosis(verdict)
    figure = draw_contributions(d)
    assert share_of_ink(figure) > 0.02
    (part,) = contributions(d)
    assert f"{part.rms / SIGMA:.1f} times the noise" in figure.axes[0].get_title("left")


def test_two_effects_have_a_row_each() -> None:
    d = made_diagnosis("named")
    fit = made_fit(find_effect("bias_drift"), (1e-3,))
    both = replace(
        d.after,
        structure=d.after.structure.with_effect(fit.structure.effects[0]),
        coefficients=np.append(d.after.coefficients, 1e-3),
    )
    figure = draw_contributions(replace(d, after=both))
    assert len(figure.axes) == 4


def test_spectra_before_and_after_lie_over_that_of_the_noise() -> None:
    d = made_diagnosis("named")
    before, after = where_of(d, d.before), where_of(d, d.after)
    (ax,) = draw_spectra(before, after).axes
    assert [str(line.get_label()) for line in ax.lines][:3] == ["before", "after", "noise"]
    assert set(np.asarray(ax.lines[2].get_ydata())) == {1.0}
    assert any(text.get_text() == "surge" for text in ax.texts)
    alone = draw_spectra(before)
    assert [str(line.get_label()) for line in alone.axes[0].lines][:2] == ["the model", "noise"]
    assert share_of_ink(alone) > 0.01


def test_a_hostile_name_is_drawn_as_it_is() -> None:
    d = made_diagnosis("named")
    named = replace(d, data=replace(d.data, sources=(HOSTILE, HOSTILE)))
    assert share_of_ink(draw_diagnosis(named, None)) > 0.05
