"""What every effect owes: its name, its port, its sentences, bounds, and silence at amplitude 0."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from effect_data import CUBIC, hidden, series_of, without_channels

from comparisons.missing_effect import CATALOGUE, Effect, find_effect
from comparisons.missing_effect.fit import Structure
from comparisons.missing_effect.lag_data import LagData
from comparisons.missing_effect.loading import load_data
from comparisons.missing_effect.ports import respond
from comparisons.rig.coefficient_effects import EFFECTS
from surge_core.errors import InputError

# Visible amplitudes; the sizes that records of surge show.
SIZES = {
    "transport_delay": 0.01,
    "facility_heating": 0.05,
    "speed_droop": 2.0,
    "second_order_lag": 1e-3,
    "amplitude_dependent_lag": 0.3,
    "asymmetric_lag": 0.1,
    "flow_dependent_lag": 0.3,
    "thermocouple_lag": 0.3,
    "sensitivity_drift": 1e-3,
}
TAU_S = 0.1
BETA = np.array([0.3, 1.4, -0.6, -0.8])
every_effect = pytest.mark.parametrize("effect", CATALOGUE, ids=lambda e: e.name)


@pytest.fixture(scope="module")
def data() -> LagData:
    return load_data(series_of(hidden(None, seed=5, n_samples=400)))


def starts_of(effect: Effect, data: LagData) -> np.ndarray:
    """The starts of an effect; a ripple takes its frequency from a spectrum, here from us."""
    starts = effect.starts(data)
    if not effect.linear:
        starts[:, 0] = SIZES[effect.name]
    if effect.episodes:
        starts[:, 0] = 13.0
    return starts


def answer(effect: Effect, values: np.ndarray, data: LagData, amplitudes: float) -> np.ndarray:
    structure = Structure(CUBIC, (effect,))
    nonlinear = np.concatenate([[np.log(TAU_S)], values])
    ports = structure.ports(data, nonlinear)
    n_columns = respond(ports, data, TAU_S).shape[1]
    own = np.full(n_columns - BETA.size, amplitudes)
    n_driven = ports.driven.shape[1] - BETA.size
    coefficients = np.concatenate([BETA, own[:n_driven], own[n_driven:]])
    return structure.output(data, nonlinear, coefficients)


def test_identifiers_are_those_of_the_study() -> None:
    assert {effect.name for effect in CATALOGUE} == set(EFFECTS)
    with pytest.raises(InputError, match=r"transport_delay.*rotating_stall_ripple.*'heat'"):
        find_effect("heat")


@every_effect
def test_amplitude_zero_is_the_model_without_it_and_a_visible_one_is_not(
    effect: Effect, data: LagData
) -> None:
    plain = Structure(CUBIC).output(data, np.array([np.log(TAU_S)]), BETA)
    for values in effect.starts(data) if not effect.linear else starts_of(effect, data):
        assert np.allclose(answer(effect, values, data, 0.0), plain, rtol=0.0, atol=1e-12)
    for values in starts_of(effect, data):
        bounds = [(p.low, p.high) for p in effect.nonlinear]
        assert all(low <= v <= high for v, (low, high) in zip(values, bounds, strict=True))
        changed = answer(effect, values, data, 0.02)
        assert np.all(np.isfinite(changed))
        assert np.max(np.abs(changed - plain)) > 1e-5


def test_channels_that_are_not_there_or_stand_still() -> None:
    records = series_of(hidden(None, seed=5, n_samples=400))
    complete = load_data(records)
    bare = load_data([without_channels(record) for record in records])
    n = records[0].n_samples
    still = load_data(
        [replace(r, T25_K=np.full(n, 288.15), Nc_frac=np.full(n, 0.98)) for r in records]
    )
    in_one = load_data([records[0], *[without_channels(record) for record in records[1:]]])
    assert find_effect("thermocouple_lag").missing_channel(in_one) == "needs the column T25_K"
    for effect in CATALOGUE:
        column = {"thermocouple_lag": "T25_K", "speed_droop": "Nc_frac"}.get(effect.name)
        assert effect.missing_channel(complete) is None
        assert effect.missing_channel(bare) == (column and f"needs the column {column}")
        assert effect.missing_channel(still) == (column and f"needs a {column} that changes")
