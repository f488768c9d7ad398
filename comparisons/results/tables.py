"""One list of fields for a table: text, notebook, HTML and JSON read it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

__all__ = ["ESTIMATOR_LABELS", "SYMBOLS", "TableField", "estimator_label"]

SYMBOLS = {"psi_p": "ψ'", "psi": "ψ"}
ESTIMATOR_LABELS = {
    "classic_ml": "maximum likelihood",
    "paper": "the paper's way (armax)",
    "classic_ml_arx": "least squares (arx)",
    "classic_ml_output_error": "free run (output error)",
    "sindy": "sparse regression (SINDy)",
}


@dataclass(frozen=True)
class TableField:
    """One column of a table.

    Parameters
    ----------
    heading : str
        Head of the column.
    meaning : str
        What it says, for a tooltip or a legend.
    text : callable
        Gives the cell: ``text(row, result)`` of a comparison, ``text(run)`` of a reconstruction.
    numeric : bool
        Whether the column holds numbers.
    """

    heading: str
    meaning: str
    text: Callable[..., str]
    numeric: bool = True


def estimator_label(name: str) -> str:
    """Return what people call an estimator, or its key where it is none of the default ones.

    Parameters
    ----------
    name : str
        Key of the estimator, as in a saved model.
    """
    return ESTIMATOR_LABELS.get(name, name)
