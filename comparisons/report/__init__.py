"""The HTML report."""

from comparisons.report.blocks import Bullets, Head, Part, Picture, Table, Words
from comparisons.report.report import ReportSection, Truth, render_report, write_report

__all__ = [
    "Bullets",
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
