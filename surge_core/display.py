"""A value at a glance: one list of fields and tables, as text and as HTML for a notebook."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import field as of_field
from html import escape
from typing import Any

_LINE_WIDTH = 100

# Colours are the notebook's own, so that a dark theme stays dark; the tints are see-through.
_STYLE = """
.sindy-surge { color: inherit; font-size: 0.95em; line-height: 1.4; max-width: 70em; }
.sindy-surge table { border-collapse: collapse; margin: 0.6em 0; }
.sindy-surge table caption { text-align: left; font-weight: 600; color: inherit; }
.sindy-surge table th, .sindy-surge table td {
  text-align: left; vertical-align: top; padding: 0.15em 0.8em 0.15em 0; white-space: normal;
  border-bottom: 1px solid rgba(128, 128, 128, 0.35);
}
.sindy-surge table th { font-weight: 600; }
.sindy-surge table td { overflow-wrap: anywhere; }
.sindy-surge table .n {
  text-align: right; white-space: nowrap; font-variant-numeric: tabular-nums;
}
.sindy-surge table tr.chosen { background: rgba(70, 140, 210, 0.2); }
.sindy-surge .state { border-left: 4px solid #2f9e63; padding-left: 0.5em; }
.sindy-surge .state.advice { border-left-color: #d98200; }
.sindy-surge summary { cursor: pointer; font-weight: 600; }
"""


@dataclass(frozen=True)
class Field:
    """One quantity of a value: its name, and what it is, with its unit, in one line or several.

    The tone is "plain", or that of a state: "good", or "advice" where it asks for something.
    """

    label: str
    value: str | tuple[str, ...]
    tone: str = "plain"

    @property
    def lines(self) -> tuple[str, ...]:
        """The value, line by line."""
        return (self.value,) if isinstance(self.value, str) else self.value


@dataclass(frozen=True)
class Grid:
    """A table of a value, in a terminal, a notebook or a page."""

    title: str  # What the rows are
    header: tuple[str, ...]
    # The cells; the first of each row names it. Small print, behind a line break, is of a page.
    rows: tuple[tuple[str, ...], ...]
    words: frozenset[int] = frozenset({0})  # Columns of words; all others are numbers
    marks: tuple[str, ...] = ()  # Of each row: "best" (to look at first), "failed" or empty
    meanings: Mapping[str, str] = of_field(default_factory=dict)  # What a column says, by its head
    # Whether a notebook shows only the title until it is opened, and a terminal nothing more
    folded: bool = False

    def mark(self, row: int) -> str:
        """Return the mark of a row."""
        return self.marks[row] if row < len(self.marks) else ""

    def lines(self) -> list[str]:
        """Return head and rows as aligned text."""
        rows = [[cell.partition("\n")[0] for cell in row] for row in (self.header, *self.rows)]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        return [
            "  ".join(
                cell.ljust(width) if column in self.words else cell.rjust(width)
                for column, (cell, width) in enumerate(zip(row, widths, strict=True))
            ).rstrip()
            for row in rows
        ]


@dataclass(frozen=True)
class Sheet:
    """What is shown of a value: what it is, its quantities, its tables."""

    title: str
    fields: tuple[Field, ...]
    grids: tuple[Grid, ...] = ()

    def text(self) -> str:
        """Return the sheet as plain text; of a folded table the title alone."""
        lines = [self.title]
        width = max((len(field.label) for field in self.fields), default=0) + 4
        for field in self.fields:
            labels = [field.label] + [""] * (len(field.lines) - 1)
            for label, value in zip(labels, field.lines, strict=True):
                lines += textwrap.wrap(
                    value,
                    max(_LINE_WIDTH, 2 * width),
                    initial_indent=f"  {label:<{width - 2}}",
                    subsequent_indent=" " * width,
                    break_long_words=False,
                    break_on_hyphens=False,
                )
        for grid in self.grids:
            folded = [f"{grid.title} (not shown)"]
            shown = [grid.title, *(f"  {line}" for line in grid.lines())]
            lines += ["", *(folded if grid.folded else shown)]
        return "\n".join(lines)

    def html(self) -> str:
        """Return the sheet as a self-contained piece of HTML without scripts, all of it escaped."""
        rows = []
        for field in self.fields:
            value = "<br>".join(map(escape, field.lines))
            if field.tone != "plain":
                kind = "state" if field.tone == "good" else "state advice"
                value = f'<div class="{kind}">{value}</div>'
            rows.append(f'<tr><th scope="row">{escape(field.label)}</th><td>{value}</td></tr>')
        grids = "".join(map(_html_grid, self.grids))
        return (
            f'<div class="sindy-surge"><style>{_STYLE}</style>'
            f"<table><caption>{escape(self.title)}</caption><tbody>{''.join(rows)}</tbody></table>"
            f"{grids}</div>"
        )


class Displayed:
    """Show a value as its sheet: a base for values that are no estimators."""

    def _sheet(self) -> Sheet:
        """Return what to show."""
        raise NotImplementedError

    def __str__(self) -> str:
        return self._sheet().text()

    def _repr_html_(self) -> str:
        return self._sheet().html()

    def _repr_mimebundle_(self, **kwargs: Any) -> dict[str, str]:
        # A terminal of IPython would print every sample of a value that has only a repr.
        sheet = self._sheet()
        return {"text/plain": sheet.text(), "text/html": sheet.html()}


class FittedDisplay:
    """Show a fitted estimator as its sheet, an unfitted one as scikit-learn does.

    To stand before scikit-learn's ``BaseEstimator`` among the bases. ``repr`` is left alone: it
    is what rebuilds an estimator, and what pipelines and searches print of their parts.
    """

    def _sheet(self) -> Sheet | None:
        """Return what to show, or None before a fit."""
        raise NotImplementedError

    def __str__(self) -> str:
        sheet = self._sheet()
        return super().__str__() if sheet is None else sheet.text()

    def _repr_html_inner(self) -> str:
        # scikit-learn's `_repr_html_` is a property that hands this method out, or raises
        # AttributeError under set_config(display="text").
        sheet = self._sheet()
        if sheet is None:
            inner: str = super()._repr_html_inner()  # type: ignore[misc]
            return inner
        return sheet.html()

    def _repr_mimebundle_(self, **kwargs: Any) -> dict[str, str]:
        sheet = self._sheet()
        if sheet is None:
            bundle: dict[str, str] = super()._repr_mimebundle_(**kwargs)  # type: ignore[misc]
            return bundle
        shown = {"text/plain": sheet.text()}
        if hasattr(self, "_repr_html_"):
            shown["text/html"] = sheet.html()
        return shown


def _html_grid(grid: Grid) -> str:
    kinds = ["" if column in grid.words else ' class="n"' for column in range(len(grid.header))]

    def cells(row: tuple[str, ...], tags: list[str]) -> str:
        each = zip(tags, kinds, [cell.partition("\n")[0] for cell in row], strict=True)
        return "".join(f"<{tag}{kind}>{escape(cell)}</{tag[:2]}>" for tag, kind, cell in each)

    head = cells(grid.header, ['th scope="col"'] * len(kinds))
    body, tags = [], ['th scope="row"', *["td"] * (len(kinds) - 1)]
    for number, row in enumerate(grid.rows):
        chosen = ' class="chosen"' if grid.mark(number) == "best" else ""
        body.append(f"<tr{chosen}>{cells(row, tags)}</tr>")
    caption = "" if grid.folded else f"<caption>{escape(grid.title)}</caption>"
    text = f"<table>{caption}<thead><tr>{head}</tr></thead><tbody>{''.join(body)}</tbody></table>"
    if not grid.folded:
        return text
    return f"<details><summary>{escape(grid.title)}</summary>{text}</details>"
