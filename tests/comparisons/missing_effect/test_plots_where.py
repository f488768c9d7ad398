"""The picture of where a residual stands out: drawn for every kind of data, marked where it is."""

from __future__ import annotations

import math

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from comparisons.missing_effect.where import ResidualRuns, localise
from comparisons.page.style import MARK
from comparisons.show.plots_where import MOST_RECORDS, draw_where

HOSTILE = "p$25_{x}^2 \\frac 漢字 <b>"


def made(
    n_records: int, run_rows: int, rng: np.random.Generator, names: tuple[str, ...] | None = None
) -> ResidualRuns:
    n = 1200
    local_s = np.arange(n) / 100.0
    phi = 0.3 + 0.2 * np.cos(2 * np.pi * 1.1 * local_s)
    starts = range(0, n - run_rows + 1, max(run_rows, 100))
    kept = np.concatenate([np.arange(start, start + run_rows) for start in starts])
    pieces = kept.size // run_rows
    total = n_records * kept.size
    return ResidualRuns(
        rng.standard_normal(total),
        np.tile(phi[kept], n_records),
        np.concatenate([30.0 * k + local_s[kept] for k in range(n_records)]),
        tuple(slice(run_rows * k, run_rows * (k + 1)) for k in range(n_records * pieces)),
        np.repeat(np.arange(n_records), kept.size),
        np.ones(total, dtype=bool),
        100.0,
        names or tuple(f"record {k}" for k in range(n_records)),
    )


def share_of_ink(figure: Figure) -> float:
    figure.canvas.draw()
    pixels = np.asarray(figure.canvas.buffer_rgba())[:, :, :3]  # type: ignore[attr-defined]
    return float(np.mean(np.any(pixels < 250, axis=2)))


def texts(figure: Figure) -> list[str]:
    return [text.get_text() for ax in figure.axes for text in ax.texts]


def panel(figure: Figure, label: str) -> Axes:
    (ax,) = [ax for ax in figure.axes if label in ax.get_xlabel() + ax.get_ylabel()]
    return ax


@pytest.mark.parametrize(("n_records", "run_rows"), [(1, 1200), (3, 1200), (2, 60), (6, 1200)])
def test_every_kind_of_data_is_drawn(n_records: int, run_rows: int) -> None:
    data = made(n_records, run_rows, np.random.default_rng(1))
    where = localise(data, 1.0)
    figure = draw_where(data, where)
    assert 0.05 < share_of_ink(figure) < 0.6
    over_time = [ax for ax in figure.axes if ax.get_xlabel() == "facility clock [s]"]
    assert len(over_time) == min(n_records, MOST_RECORDS)
    assert bool([ax for ax in figure.axes if ax.get_xlabel() == "rms [floors]"]) == (n_records > 1)
    cyclic = any(math.isfinite(row.z) for row in where.phase)
    assert bool([ax for ax in figure.axes if "cycles since" in ax.get_xlabel()]) == cyclic
    assert cyclic == (run_rows == 1200)


def test_the_map_shows_the_numbers_of_its_cells() -> None:
    data = made(1, 1200, np.random.default_rng(2))
    where = localise(data, 1.0)
    shown = texts(draw_where(data, where))
    for row in where.flow:
        assert any(text.endswith(f"z {row.z:.1f}") for text in shown)


def test_what_stands_out_is_marked_and_noise_is_not() -> None:
    rng = np.random.default_rng(3)
    data = made(1, 1200, rng)
    quiet = localise(data, 1.0)
    data_with = ResidualRuns(
        data.residual + np.sin(2 * np.pi * 27.3 * data.time_s), *list(vars(data).values())[1:]
    )
    loud = localise(data_with, 1.0)
    marked = []
    for one, where in ((data, quiet), (data_with, loud)):
        ax = panel(draw_where(one, where), "frequency [Hz]")
        marked.append({to_hex(str(line.get_color())) for line in ax.lines} & {to_hex(MARK)})
    assert marked == [set(), {to_hex(MARK)}]
    (line,) = [line for line in loud.lines if line.source == "residual"]
    assert line.frequency_hz == pytest.approx(27.3, abs=0.05)
    assert f"{line.frequency_hz:.3g} Hz" in texts(draw_where(data_with, loud))


def test_names_that_look_like_formulae_are_drawn_as_they_are() -> None:
    data = made(2, 1200, np.random.default_rng(4), (HOSTILE, "B"))
    assert share_of_ink(draw_where(data, localise(data, 1.0))) > 0.05
