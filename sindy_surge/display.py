"""A fitted model at a glance, as text and in a notebook."""

from __future__ import annotations

import html
import textwrap
from typing import Any

from sindy_surge.summary import ModelSummary, Table, summary_fields, summary_tables
from surge_core.fit_state import FitState

__all__ = ["FittedDisplay", "html_summary", "text_summary"]

_LINE_WIDTH = 100


def text_summary(summary: ModelSummary) -> str:
    """Write a fitted model as plain text.

    Parameters
    ----------
    summary : ModelSummary
        The fitted model.

    Returns
    -------
    str
        Fields, then tables.
    """
    fields = summary_fields(summary)
    lines = [summary.name]
    width = max(len(field.label) for field in fields) + 4
    for field in fields:
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
    for table in summary_tables(summary):
        lines += ["", *_text_table(table)]
    return "\n".join(lines)


def _text_table(table: Table) -> list[str]:
    grid = (table.header, *table.rows)
    widths = [max(len(row[column]) for row in grid) for column in range(len(table.header))]
    lines = [table.title]
    for row in grid:
        cells = (
            cell.ljust(width) if column in table.words else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        lines.append(f"  {'  '.join(cells)}".rstrip())
    return lines


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
.sindy-surge table .n {
  text-align: right; white-space: nowrap; font-variant-numeric: tabular-nums;
}
.sindy-surge table tr.chosen { background: rgba(70, 140, 210, 0.2); }
.sindy-surge .state { border-left: 4px solid #2f9e63; padding-left: 0.5em; }
.sindy-surge .state.advice { border-left-color: #d98200; }
.sindy-surge summary { cursor: pointer; font-weight: 600; }
"""


def html_summary(summary: ModelSummary) -> str:
    """Write a fitted model as a self-contained piece of HTML, without scripts.

    Parameters
    ----------
    summary : ModelSummary
        The fitted model.

    Returns
    -------
    str
        One ``div`` with the same fields and tables as `text_summary`; every string is escaped.
    """
    ok = summary.state is FitState.OK
    rows = []
    for field in summary_fields(summary):
        value = "<br>".join(map(_escape, field.lines))
        if field.label == "state":
            value = f'<div class="state{"" if ok else " advice"}">{value}</div>'
        rows.append(f'<tr><th scope="row">{_escape(field.label)}</th><td>{value}</td></tr>')
    tables = "".join(map(_html_table, summary_tables(summary)))
    return (
        f'<div class="sindy-surge"><style>{_STYLE}</style>'
        f"<table><caption>{_escape(summary.name)}</caption><tbody>{''.join(rows)}</tbody></table>"
        f"{tables}</div>"
    )


def _html_table(table: Table) -> str:
    kinds = ["" if column in table.words else ' class="n"' for column in range(len(table.header))]
    head = "".join(
        f'<th scope="col"{kind}>{_escape(cell)}</th>'
        for kind, cell in zip(kinds, table.header, strict=True)
    )
    body = []
    for number, row in enumerate(table.rows):
        cells = "".join(
            f'<th scope="row"{kind}>{_escape(cell)}</th>'
            if column == 0
            else f"<td{kind}>{_escape(cell)}</td>"
            for column, (kind, cell) in enumerate(zip(kinds, row, strict=True))
        )
        chosen = ' class="chosen"' if number == table.marked else ""
        body.append(f"<tr{chosen}>{cells}</tr>")
    caption = "" if table.folded else f"<caption>{_escape(table.title)}</caption>"
    text = f"<table>{caption}<thead><tr>{head}</tr></thead><tbody>{''.join(body)}</tbody></table>"
    if not table.folded:
        return text
    return f"<details><summary>{_escape(table.title)}</summary>{text}</details>"


def _escape(text: str) -> str:
    return html.escape(text, quote=True)


class FittedDisplay:
    """Show a fitted estimator as its summary, an unfitted one as scikit-learn does.

    To stand before scikit-learn's ``BaseEstimator`` among the bases. ``repr`` is left alone: it
    is what rebuilds an estimator, and what pipelines and searches print of their parts.
    """

    def _summary(self) -> ModelSummary | None:
        """Return what to show, or None before a fit."""
        raise NotImplementedError

    def __str__(self) -> str:
        summary = self._summary()
        return super().__str__() if summary is None else text_summary(summary)

    def _repr_html_inner(self) -> str:
        # scikit-learn's `_repr_html_` is a property that hands this method out, or raises
        # AttributeError under set_config(display="text").
        summary = self._summary()
        if summary is None:
            html: str = super()._repr_html_inner()  # type: ignore[misc]
            return html
        return html_summary(summary)

    def _repr_mimebundle_(self, **kwargs: Any) -> dict[str, str]:
        summary = self._summary()
        if summary is None:
            bundle: dict[str, str] = super()._repr_mimebundle_(**kwargs)  # type: ignore[misc]
            return bundle
        shown = {"text/plain": text_summary(summary)}
        if hasattr(self, "_repr_html_"):
            shown["text/html"] = html_summary(summary)
        return shown
