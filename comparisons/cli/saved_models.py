"""Saved models of either kind: a plain lag, or a lag with effects."""

from __future__ import annotations

from pathlib import Path

from comparisons.harness.saved_models import load_models
from comparisons.missing_effect.extended_file import is_extended_file, load_extended
from comparisons.results import LagModel


def load_any_models(path: str | Path) -> dict[str, LagModel]:
    """Read lag models, or lag models with effects: whichever the file says that it holds.

    Parameters
    ----------
    path : str or path
        Written by ``compare --save`` or ``diagnose --save``.

    Raises
    ------
    InputError
        When it is missing or is neither.
    """
    if not is_extended_file(path):
        return dict(load_models(path))
    # The name in the file is the one that tables show and that --estimator takes.
    return {name: m.called(name) for name, m in load_extended(path).items()}
