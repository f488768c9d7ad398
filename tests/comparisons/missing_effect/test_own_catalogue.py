"""A catalogue of one's own: effects that nothing but this test knows, through every step."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from effect_data import series_of

from classic_ml.series import CoefficientSeries
from comparisons.missing_effect import CATALOGUE, Diagnosis, Effect, Parameter, diagnose
from comparisons.missing_effect.document import diagnosis_document
from comparisons.missing_effect.extended_file import load_extended, save_extended
from comparisons.missing_effect.extended_refit import refitted, value_of
from comparisons.missing_effect.lag_data import LagData
from comparisons.missing_effect.limits import planted_limits
from comparisons.missing_effect.ports import Ports
from comparisons.missing_effect.report import diagnosis_text
from comparisons.missing_effect.separate import separating_measurements
from comparisons.rig.coefficient_tests import simulate_test
from surge_core.errors import InputError
from surge_core.types import FloatArray

SIZE = 0.02


def swirl(name: str, at_rest: float) -> Effect:
    """A probe that reads too much where the flow changes fast, whichever way it does."""

    def acts(ports: Ports, data: LagData, values: FloatArray) -> Ports:
        rate = data.sampled(data["dphi_s"])
        reads = np.sqrt(rate**2 + at_rest**2) - at_rest
        return ports.with_added(reads[:, None], (name,))

    return Effect(
        name,
        "output",
        "+ k |dφ/dt|",
        "the probe reads swirl where the flow changes fast",
        (Parameter("k", "s", -1.0, 1.0, "linear", 1e-4),),
        acts,
        lambda data: np.zeros((1, 0)),
        1.0,
        "little",
        "a probe turned by 90°",
    )


SWIRL, NEAR = swirl("probe_swirl", 0.0), swirl("probe_swirl_near_rest", 0.02)
DELAY = next(effect for effect in CATALOGUE if effect.name == "transport_delay")
OWN = (SWIRL, NEAR, DELAY)


@pytest.fixture(scope="module")
def found() -> Diagnosis:
    return diagnose(hidden_in(700), degree=3, catalogue=OWN)


def hidden_in(rows: int) -> list[CoefficientSeries]:
    records = series_of(simulate_test(None, seed=2, n_samples=rows))
    return [
        replace(r, psi_p=r.psi_p + SIZE * np.abs(np.gradient(r.phi, r.time_s))) for r in records
    ]


def test_it_is_named_and_shown(found: Diagnosis) -> None:
    assert found.names in (("probe_swirl",), ("probe_swirl_near_rest",))
    assert set(found.missing[0].alias_set) == {"probe_swirl", "probe_swirl_near_rest"}
    (number,) = found.missing[0].parameters
    assert abs(number.value - SIZE) < 4.0 * number.stderr
    assert set(found.not_fitted) <= set(OWN)
    (item,) = diagnosis_document(found)["missing"]
    assert item["label"] == f"{item['effect']} at the output ψ'"
    assert item["place"] == {"port": "output"}
    assert len(item["alias_labels"]) == 2
    assert item["confirm"][item["effect"]] == "a probe turned by 90°"
    assert "probe swirl" in diagnosis_text(found)


def test_it_is_simulated_saved_and_fitted_again(found: Diagnosis, tmp_path: Path) -> None:
    model, path = value_of(found), tmp_path / "model.json"
    moved = hidden_in(400)[2]
    plain = replace(model, effects=())
    left = [np.sqrt(np.mean((m.simulate(moved) - moved.psi_p)[50:] ** 2)) for m in (model, plain)]
    assert left[0] < 0.5 * left[1]
    save_extended({"own": model}, path)
    with pytest.raises(InputError, match=r"catalogue=") as refused:
        load_extended(path)
    assert "probe_swirl" in str(refused.value)
    again = load_extended(path, catalogue=OWN)["own"]
    assert repr(again) == repr(model)  # Some numbers are NaN, which equals nothing
    assert refitted(again, [moved]).effects[0].values[0] == pytest.approx(SIZE, rel=0.1)


def test_its_limit_and_what_would_separate_it_are_found(found: Diagnosis) -> None:
    clean = diagnose(series_of(simulate_test(None, seed=2, n_samples=400)), 3, catalogue=OWN)
    limits = planted_limits(clean, effects=["probe_swirl"], trials=3)
    assert 0.0 < limits["probe_swirl"].size < SIZE
    assert [row.effect for row in limits.rows] == ["probe_swirl"]
    with pytest.raises(InputError, match="probe_swirl"):
        planted_limits(clean, effects=["hysteresis"])
    (one,) = separating_measurements(found).sets
    assert set(one.alias_set) == {"probe_swirl", "probe_swirl_near_rest"}
    assert all(np.isfinite(m.sigma) for m in one.measurements)
