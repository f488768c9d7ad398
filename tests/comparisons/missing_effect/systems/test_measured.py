"""A measured system with a known omission, by its model of examples/measured.

On stretches of the record, so that the suite stays short; the figures on the official splits, and
the joint with its dry friction, are printed by the scripts themselves.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

from comparisons.missing_effect import diagnose_model
from comparisons.missing_effect.systems.benchmark_data import BENCHMARK_FOLDER

ROOT = Path(__file__).parents[4]
DATA = ROOT / "shared" / "data" if (ROOT / "shared").is_dir() else ROOT.parent / "shared" / "data"
needs_data = pytest.mark.skipif(
    not (DATA / "silverbox").is_dir(), reason="the measured records are not beside the checkout"
)


def script(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, ROOT / "examples/measured" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(autouse=True)
def _folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(BENCHMARK_FOLDER, str(DATA))


@needs_data
def test_the_spring_of_the_silverbox_is_cubic() -> None:
    """From the linear model alone: its name, its place, and the error on unseen rows."""
    made = script("silverbox")
    train = made.rows("training", 40650, 40650 + 3600)
    tests = [made.rows("multisine", 105712, 108712)]
    d = diagnose_model(made.model, train, tests, most_effects=1)
    found = d.missing[0]
    assert found.alias_set == ("cubic_stiffness",)
    assert (found.place["equation"], found.place["signal"]) == ("dv/dt", "x")
    check = d.checks[0]
    assert 6e-3 < check.before_rms[0] < 8e-3
    assert check.after_rms[0] < 0.15 * check.before_rms[0]
