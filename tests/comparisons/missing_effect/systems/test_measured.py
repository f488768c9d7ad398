"""Measured systems with a known omission, by the models of examples/measured.

On stretches of the records and one round each, so that the suite stays short; the figures on the
official splits are printed by the scripts themselves.
"""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest

from comparisons.missing_effect import diagnose_model
from comparisons.missing_effect.systems.benchmark_data import BENCHMARK_FOLDER
from comparisons.missing_effect.systems.results import SystemDiagnosis

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


def silverbox(most_effects: int, **changes: object) -> SystemDiagnosis:
    made = script("silverbox")
    train = made.rows("training", 40650, 40650 + 3600)
    tests = [made.rows("multisine", 105712, 108712)]
    model = replace(made.model, **changes)
    return diagnose_model(model, train, tests, most_effects=most_effects)


@needs_data
def test_the_spring_of_the_silverbox_is_cubic() -> None:
    """From the linear model alone: its name, its place, and the error on unseen rows."""
    d = silverbox(1)
    found = d.missing[0]
    assert found.alias_set == ("cubic_stiffness",)
    assert (found.place["equation"], found.place["signal"]) == ("dv/dt", "x")
    check = d.checks[0]
    assert 6e-3 < check.before_rms[0] < 8e-3
    assert check.after_rms[0] < 0.15 * check.before_rms[0]


@needs_data
def test_the_joint_has_dry_friction() -> None:
    """In closed loop: mass, viscous and dry friction as the inverse dynamics of the data say."""
    made = script("emps")
    train = made.experiment("training", "DATA_EMPS.mat").rows(0, 6000)
    d = diagnose_model(made.closed_loop, train, most_effects=1)
    found = d.missing[0]
    assert found.effect == "coulomb_friction"
    assert (found.place["equation"], found.place["signal"]) == ("dv/dt", "v")
    # SOURCE.txt of the record: least squares on the inverse dynamics.
    assert d.parameter("mass").after == pytest.approx(95.0, rel=0.05)
    assert d.parameter("viscous").after == pytest.approx(204.5, rel=0.05)
    assert found.numbers[0].value == pytest.approx(20.3, rel=0.05)
    assert found.numbers[0].unit == "N"
    before, after = d.training[0].before_rms[1], d.training[0].after_rms[1]
    assert after < 0.4 * before
