"""The counterparts of the paper's Figures 3 to 27, drawn from runs of the simulated rig."""

from __future__ import annotations

from comparisons.paper.figures_common import PaperFigure
from comparisons.paper.figures_cycles import draw_cycle_figures
from comparisons.paper.figures_facility import draw_facility
from comparisons.paper.figures_filter import draw_filter_figures
from comparisons.paper.figures_identified import draw_identified_figures
from comparisons.paper.figures_inception import draw_inception_figures
from comparisons.paper.figures_response import draw_responses, draw_work_inputs
from comparisons.paper.instabilities import STEADY_STALL, Instabilities

__all__ = ["PaperFigure", "draw_figures"]


def draw_figures(runs: Instabilities) -> list[PaperFigure]:
    """Draw the counterparts of Figures 3 to 27 of the paper.

    Parameters
    ----------
    runs : Instabilities
        The runs; those at 90 % and 98.5 % are needed. Without the steady record at 75 % speed
        Fig 20 is a sketch and Fig 23 has no steady points.

    Returns
    -------
    list of PaperFigure
        In the order of the paper.
    """
    high, low = runs["985"], runs["90"]
    steady = runs.runs.get(STEADY_STALL)
    drawn = [
        *draw_filter_figures(low),
        *draw_inception_figures(high),
        draw_facility(high),
        *draw_cycle_figures(high),
        *draw_responses(high, steady),
        draw_work_inputs(low),
        *draw_identified_figures(high, low, steady),
    ]
    return sorted(drawn, key=lambda figure: figure.number)
