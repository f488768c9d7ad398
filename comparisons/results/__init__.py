"""Frozen values of every result: what was fitted, scored, compared and reconstructed.

They compute nothing but views of themselves and know neither who made them nor who draws them, so
that the harness, the pages and the command line can all stand on them.
"""

from comparisons.results.caution import Caution, texts_of
from comparisons.results.comparison import (
    FIELDS,
    Comparison,
    ComparisonRow,
    EstimatorResult,
    StructureChoice,
    comparison_cells,
)
from comparisons.results.lag import FittedLag, LagModel
from comparisons.results.reconstruction import (
    RECONSTRUCTION_FIELDS,
    Reconstruction,
    reconstruction_cells,
)
from comparisons.results.rows import FitRows, FitScore
from comparisons.results.tables import ESTIMATOR_LABELS, SYMBOLS, TableField, estimator_label
from comparisons.results.tau import TauEstimate, TauTrial, Truth
from comparisons.results.terms import evaluate_terms, is_known_term

__all__ = [
    "ESTIMATOR_LABELS",
    "FIELDS",
    "RECONSTRUCTION_FIELDS",
    "SYMBOLS",
    "Caution",
    "Comparison",
    "ComparisonRow",
    "EstimatorResult",
    "FitRows",
    "FitScore",
    "FittedLag",
    "LagModel",
    "Reconstruction",
    "StructureChoice",
    "TableField",
    "TauEstimate",
    "TauTrial",
    "Truth",
    "comparison_cells",
    "estimator_label",
    "evaluate_terms",
    "is_known_term",
    "reconstruction_cells",
    "texts_of",
]
