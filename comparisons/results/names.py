"""What people call coefficients and estimators."""

from __future__ import annotations

SYMBOLS = {"psi_p": "ψ'", "psi": "ψ"}
NAMES = {"psi_p": "pressure coefficient ψ'", "psi": "work coefficient ψ"}
ESTIMATOR_LABELS = {
    "classic_ml": "whole-run output error",
    "paper": "the paper's way (armax)",
    "classic_ml_arx": "least squares (arx)",
    "classic_ml_output_error": "free run (output error)",
    "sindy": "sparse regression",
}


def named(label: str, name: str) -> str:
    """Return the cell of an estimator: its label, in small print what the command line calls it."""
    return label if label == name else f"{label}\n{name}"


def estimator_label(name: str) -> str:
    """Return what people call an estimator, or its key where it is none of the default ones.

    Parameters
    ----------
    name : str
        Key of the estimator, as in a saved model.
    """
    return ESTIMATOR_LABELS.get(name, name)
