"""Pictures: values in, matplotlib Axes or Figures out."""

from __future__ import annotations

from comparisons.page.style import LineStyle, estimator_styles, figure_to_data_uri, new_figure
from comparisons.results import Truth
from comparisons.show.plots_fit import (
    plot_characteristics,
    plot_reconstruction,
    plot_residual_structure,
    plot_residuals,
    plot_validation,
)
from comparisons.show.plots_record import (
    plot_hub_and_tip,
    plot_inlet_spectra,
    plot_loops,
    plot_operating_points,
    plot_series,
    plot_surge_cycles,
)
from comparisons.show.plots_tau_trial import plot_tau_trial

__all__ = [
    "LineStyle",
    "Truth",
    "estimator_styles",
    "figure_to_data_uri",
    "new_figure",
    "plot_characteristics",
    "plot_hub_and_tip",
    "plot_inlet_spectra",
    "plot_loops",
    "plot_operating_points",
    "plot_reconstruction",
    "plot_residual_structure",
    "plot_residuals",
    "plot_series",
    "plot_surge_cycles",
    "plot_tau_trial",
    "plot_validation",
]
