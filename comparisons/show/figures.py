"""What a page shows as files to take away: pictures, tables, and the curve as a lookup table."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

from comparisons.page.blocks import Part
from comparisons.results import Curve
from surge_core.display import Grid
from surge_core.files import replace_whole, to_strict_json, write_whole

# Widths of one and of two columns of a paper in inches; a picture up to the limit takes one.
COLUMN_IN, PAGE_IN, NARROW_IN = 3.5, 7.16, 5.0
KINDS = (".svg", ".pdf")
# What LaTeX sets in its own letters, so that any engine can set the table.
LETTERS = {
    "φ": r"$\varphi$",
    "ψ": r"$\psi$",
    "τ": r"$\tau$",
    "Δ": r"$\Delta$",
    "±": r"$\pm$",
    "²": r"$^2$",
    "³": r"$^3$",
    "…": r"\dots{}",
    "≤": r"$\le$",
    "≥": r"$\ge$",
    "−": "$-$",
}


def write_figures(
    pages: Sequence[tuple[str, Sequence[Part]]], folder: Path, curve: Curve | None = None
) -> int:
    """Write every picture as SVG and PDF, and every table as CSV and LaTeX (booktabs).

    The folder is made where there is none; a curve becomes a lookup table for a simulation, CSV and
    JSON. Returns how many files were written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    parts = [part for _, own in pages for part in own]
    pictures = [picture for part in parts for picture in part.pictures]
    tables = [b for part in parts for b in part.blocks if isinstance(b, Grid) and b.rows]
    for number, picture in enumerate(pictures, start=1):
        figure: Any = picture.figure
        wide, high = figure.get_size_inches()
        scale = (COLUMN_IN if wide < NARROW_IN else PAGE_IN) / wide
        figure.set_size_inches(scale * wide, scale * high)
        for kind in KINDS:
            path = folder / f"figure_{number:02d}_{_slug(picture.title)}{kind}"
            replace_whole(path, partial(_save, figure, kind))
        figure.set_size_inches(wide, high)
    for number, table in enumerate(tables, start=1):
        rows = [[_text(cell) for cell in row] for row in table.rows]
        frame = pd.DataFrame(rows, columns=[head or "#" for head in table.header])
        stem = folder / f"table_{number:02d}_{_slug(table.title)}"
        write_whole(stem.with_suffix(".csv"), frame.to_csv(index=False, lineterminator="\n"))
        write_whole(stem.with_suffix(".tex"), _latex(frame))
    if curve is not None:
        columns = {"phi": curve.phi, curve.target: curve.value, "stderr": curve.stderr}
        lookup = pd.DataFrame(columns).to_csv(index=False, lineterminator="\n")
        write_whole(folder / "characteristic.csv", lookup)
        write_whole(folder / "characteristic.json", to_strict_json(curve.to_json()))
    return len(KINDS) * len(pictures) + 2 * (len(tables) + (curve is not None))


def _save(figure: Any, kind: str, path: Path) -> None:
    # Without the time of day, the same picture is the same file.
    dated = {"Date": None} if kind == ".svg" else {"CreationDate": None}
    figure.savefig(path, format=kind[1:], metadata=dated)


def _text(cell: str) -> str:
    text, _, small = cell.partition("\n")
    return f"{text} ({small})" if small else text


def _latex(frame: pd.DataFrame) -> str:
    """Return a table between the rules of booktabs."""
    text = frame.to_latex(index=False, escape=True)
    for letter, command in LETTERS.items():
        text = text.replace(letter, command)
    return f"% needs \\usepackage{{booktabs}}\n{text}"


def _slug(title: str) -> str:
    plain = title.replace("ψ'", "psi_p").replace("ψ", "psi").replace("φ", "phi").replace("τ", "tau")
    return re.sub(r"[^a-z0-9]+", "_", plain.lower()).strip("_")[:40].rstrip("_") or "untitled"
