"""The HTML report."""

from comparisons.page.blocks import Bullets, Cell, Head, Part, Picture, Table, Words
from comparisons.show.report.report import ReportSection, Truth, render_report, write_report

__all__ = [
    "Bullets",
    "Cell",
    "Head",
    "Part",
    "Picture",
    "ReportSection",
    "Table",
    "Truth",
    "Words",
    "render_report",
    "write_report",
]
