"""What people call an estimator whose key is all that is known, as in a saved model."""

from __future__ import annotations

from comparisons.harness.estimators import default_estimators

__all__ = ["estimator_label"]


def estimator_label(name: str) -> str:
    """Return the label of an estimator, or its key where it is none of the default ones.

    Parameters
    ----------
    name : str
        Key of the estimator.
    """
    return {spec.name: spec.label for spec in default_estimators()}.get(name, name)
