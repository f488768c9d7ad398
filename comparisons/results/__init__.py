"""Frozen values of every result: what was fitted, scored, compared and reconstructed.

They compute nothing but views of themselves and know neither who made them nor who draws them, so
that the harness, the pages and the command line can all stand on them.
"""

from comparisons.results.answer import Answer, Curve
from comparisons.results.caution import Caution, texts_of
from comparisons.results.comparison import (
    COLUMNS,
    Comparison,
    EstimatorResult,
)
from comparisons.results.lag import FittedLag, LagModel
from comparisons.results.names import ESTIMATOR_LABELS, SYMBOLS, estimator_label
from comparisons.results.reconstruction import (
    RECONSTRUCTION_COLUMNS,
    Reconstruction,
    reconstruction_grids,
)
from comparisons.results.rows import FitRows, FitScore, Terms
from comparisons.results.tau import TauTrial, Truth
from comparisons.results.terms import evaluate_terms, is_known_term

__all__ = [
    "COLUMNS",
    "ESTIMATOR_LABELS",
    "RECONSTRUCTION_COLUMNS",
    "SYMBOLS",
    "Answer",
    "Caution",
    "Comparison",
    "Curve",
    "EstimatorResult",
    "FitRows",
    "FitScore",
    "FittedLag",
    "LagModel",
    "Reconstruction",
    "TauTrial",
    "Terms",
    "Truth",
    "estimator_label",
    "evaluate_terms",
    "is_known_term",
    "reconstruction_grids",
    "texts_of",
]
