"""Units: factors against hand-made ones, there and back, absolute and gauge told apart."""

from __future__ import annotations

import re
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from classic_ml import units
from classic_ml.units import (
    Conversion,
    is_count,
    is_unit_label,
    kind_of_unit,
    pressure_conversion,
    pressure_reference,
    quantity_in,
    same_unit,
    temperature_conversion,
    time_conversion,
    unit_in_brackets,
)
from surge_core.errors import InputError

INCH, FOOT, POUND, GRAVITY = (
    Fraction(254, 10_000),
    Fraction(3048, 10_000),
    Fraction(45_359_237, 10**8),
    Fraction(980_665, 10**5),
)
# By definition, in exact fractions: pint's own numbers have no part in them.
PASCALS = {
    "Pa": Fraction(1),
    "hPa": Fraction(100),
    "kPa": Fraction(1000),
    "MPa": Fraction(10**6),
    "mbar": Fraction(100),
    "bar": Fraction(10**5),
    "psi": POUND * GRAVITY / INCH**2,
    "psf": POUND * GRAVITY / FOOT**2,
    "atm": Fraction(101_325),
    "torr": Fraction(101_325, 760),
    # Mercury of 13 595.1 kg/m³ and water of 1000 kg/m³ under standard gravity.
    "inHg": Fraction(135_951, 10) * GRAVITY * INCH,
    "mmHg": Fraction(135_951, 10) * GRAVITY / 1000,
    "mmH2O": GRAVITY,
    "lbf/in^2": POUND * GRAVITY / INCH**2,
}
KELVINS = {
    "K": (Fraction(1), Fraction(0)),
    "degC": (Fraction(1), Fraction(27_315, 100)),
    "degF": (Fraction(5, 9), Fraction(45_967, 100) * Fraction(5, 9)),
    "degR": (Fraction(5, 9), Fraction(0)),
}
SECONDS = {
    "s": Fraction(1),
    "ms": Fraction(1, 1000),
    "us": Fraction(1, 10**6),
    "µs": Fraction(1, 10**6),
    "ns": Fraction(1, 10**9),
    "min": Fraction(60),
    "hour": Fraction(3600),
}


@pytest.mark.parametrize("unit", PASCALS)
def test_a_pressure_unit_is_its_definition_to_rounding(unit: str) -> None:
    found = pressure_conversion(unit, "test", 0.0)
    assert found.offset == 0.0
    assert found.factor == float(PASCALS[unit])


@pytest.mark.parametrize("unit", KELVINS)
def test_a_temperature_unit_is_its_definition_to_rounding(unit: str) -> None:
    factor, offset = KELVINS[unit]
    found = temperature_conversion(unit, "test")
    assert found == Conversion(float(factor), float(offset))
    # Freezing and boiling water, and where the scales of °C and °F cross.
    points = {"degC": (0.0, 100.0, -40.0), "degF": (32.0, 212.0, -40.0)}
    if unit in points:
        kelvins = found.to_si(np.array(points[unit]))
        np.testing.assert_allclose(kelvins, [273.15, 373.15, 233.15], rtol=1e-15, atol=0.0)


@pytest.mark.parametrize("unit", SECONDS)
def test_a_time_unit_is_its_definition_to_rounding(unit: str) -> None:
    assert time_conversion(unit, "test") == Conversion(float(SECONDS[unit]), 0.0)


READINGS = st.floats(min_value=-1e7, max_value=1e7, allow_subnormal=False)


@settings(max_examples=60, deadline=None)
@given(READINGS, st.sampled_from(list(PASCALS)), st.floats(min_value=0.0, max_value=2e5))
def test_a_pressure_goes_to_si_exactly_and_back(value: float, unit: str, reference: float) -> None:
    found = pressure_conversion(unit, "test", reference)
    si = found.to_si(np.array([value]))
    exact = Fraction(value) * Fraction(found.factor) + Fraction(reference)
    scale = abs(Fraction(value) * Fraction(found.factor)) + Fraction(reference)
    assert abs(Fraction(float(si[0])) - exact) <= scale * Fraction(1, 2**52)
    back = (si - found.offset) / found.factor
    assert abs(back[0] - value) <= 4e-16 * (abs(value) + reference / found.factor)


@settings(max_examples=60, deadline=None)
@given(READINGS, st.sampled_from(list(KELVINS)))
def test_a_temperature_goes_to_si_exactly_and_back(value: float, unit: str) -> None:
    found = temperature_conversion(unit, "test")
    factor, offset = KELVINS[unit]
    si = found.to_si(np.array([value]))
    exact = Fraction(value) * factor + offset
    scale = abs(Fraction(value)) * factor + offset
    assert abs(Fraction(float(si[0])) - exact) <= scale * Fraction(3, 2**53)
    back = (si - found.offset) / found.factor
    assert abs(back[0] - value) <= 1e-15 * (abs(value) + found.offset / found.factor)


def test_readings_in_si_keep_every_bit() -> None:
    values = np.random.default_rng(0).normal(1e5, 1e4, 1000)
    for found in (pressure_conversion("Pa", "", 0.0), temperature_conversion("K", "")):
        assert found.to_si(values) is values


@pytest.mark.parametrize(
    ("unit", "reference"),
    [
        ("psia", "absolute"),
        ("PSIA", "absolute"),
        ("kPa abs", "absolute"),
        ("kPa_abs", "absolute"),
        ("bar(a)", "absolute"),
        ("inHg (abs)", "absolute"),
        ("mbara", "absolute"),
        ("psig", "gauge"),
        ("psi gauge", "gauge"),
        ("bar (g)", "gauge"),
        ("barg", "gauge"),
        ("kPag", "gauge"),
        ("inHg gage", "gauge"),
        ("psid", "differential"),
        ("kPa diff", "differential"),
        ("psi", ""),
        ("Pa", ""),
        ("in Hg", ""),
        ("torr", ""),
    ],
)
def test_what_a_pressure_is_taken_against_is_read_from_its_name(unit: str, reference: str) -> None:
    assert pressure_reference(unit) == reference
    given = None if reference == "absolute" else 1e5
    found = pressure_conversion(unit, "test", given)
    assert found.offset == (0.0 if given is None else given)
    assert found.factor > 0.0


@pytest.mark.parametrize(
    ("unit", "reference_Pa", "words"),
    [
        ("psi", None, 'reading of 0 "psi" stands for, found nothing; .* or the unit "psia", for'),
        ("inHg", None, 'or the unit "inHg abs"'),
        ("Pa", None, "reference_Pa: expected the absolute pressure"),
        ("psig", None, "found nothing; the barometer for a gauge reading$"),
        ("psig", 0.0, 'taken against, found 0; write "psia" if they are absolute'),
        ("psia", 101325.0, 'none beside the unit "psia", which is absolute, found 101325'),
        ("furlong", 0.0, 'a unit of pressure, such as Pa, .* found "furlong"$'),
        ("kPaq", 0.0, "found \"kPaq\"; is 'kPa' meant"),
        ("degC", 0.0, 'a unit of pressure, .* found "degC"'),
        ("", 0.0, 'found ""'),
        ("psi**2", 0.0, 'found "psi'),
        ("__import__('os')", 0.0, "a unit of pressure"),
        ("p" * 500, 0.0, "a unit of pressure"),
        ("3 psi", 0.0, "a unit of pressure"),
    ],
)
def test_a_pressure_unit_that_leaves_doubt_is_refused(
    unit: str, reference_Pa: float | None, words: str
) -> None:
    with pytest.raises(InputError, match=words):
        pressure_conversion(unit, "test.toml: [channels.P]", reference_Pa)


@pytest.mark.parametrize("unit", ["delta_degC", "delta_degF", "ΔdegC", "psi", "J", "", "K/s"])
def test_a_difference_of_temperatures_or_another_quantity_is_no_temperature(unit: str) -> None:
    with pytest.raises(InputError, match="a unit of temperature, such as K, degC, degF, degR"):
        temperature_conversion(unit, "test.toml: [channels.T]")


@pytest.mark.parametrize(
    ("spelling", "unit"),
    [
        *((s, "degC") for s in ("C", "°C", "deg C", "Celsius", "DegC", "degree_Celsius")),
        *((s, "degF") for s in ("F", "°F", "deg F", "fahrenheit", "DEGF")),
        *((s, "degR") for s in ("R", "°R", "deg R", "rankine", "degree_Rankine")),
        *((s, "K") for s in ("k", "kelvin", "degK")),
    ],
)
def test_the_trade_spells_temperatures_in_its_own_ways(spelling: str, unit: str) -> None:
    assert temperature_conversion(spelling, "") == temperature_conversion(unit, "")


def test_capitals_do_not_matter_but_between_milli_and_mega() -> None:
    for spelling, unit in (("PSI", "psi"), ("KPA", "kPa"), ("inhg", "inHg"), ("MBar", "mbar")):
        assert pressure_conversion(spelling, "", 0.0) == pressure_conversion(unit, "", 0.0)
    assert pressure_conversion("MPa", "", 0.0).factor == 1e6
    assert pressure_conversion("mPa", "", 0.0).factor == 1e-3
    with pytest.raises(InputError, match="is 'MPa' meant"):
        pressure_conversion("MPA", "", 0.0)


@pytest.mark.parametrize(
    ("stated", "unit", "kind", "reference_Pa", "same"),
    [
        ("psi", "psia", "pressure", None, True),
        ("psi", "psi", "pressure", 101325.0, True),
        ("PSIA", "psi", "pressure", 0.0, True),
        ("lbf/in^2", "psia", "pressure", None, True),
        ("psig", "psia", "pressure", None, False),
        ("psig", "psi", "pressure", 0.0, False),
        ("psig", "psi", "pressure", 101325.0, True),
        ("psia", "psi", "pressure", 101325.0, False),
        ("psia", "psig", "pressure", 101325.0, False),
        ("kPa", "psia", "pressure", None, False),
        ("hPa", "mbar", "pressure", 0.0, True),
        ("V", "psia", "pressure", None, False),
        ("counts", "count", "pressure", None, True),
        ("1", "count", "pressure", None, True),
        ("psi", "count", "pressure", None, False),
        ("V", "count", "pressure", None, False),
        ("counts", "psia", "pressure", None, False),
        ("K", "psia", "pressure", None, False),
        ("°C", "degC", "temperature", None, True),
        ("degF", "degC", "temperature", None, False),
        ("C", "K", "temperature", None, False),
        ("ms", "s", "time", None, False),
        ("sec", "s", "time", None, True),
    ],
)
def test_what_a_file_states_is_held_against_what_test_toml_says(
    stated: str, unit: str, kind: str, reference_Pa: float | None, same: bool
) -> None:
    assert same_unit(stated, unit, kind, reference_Pa) is same


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("PT25 fwd [psia]", "psia"),
        ("Time (ms)", "ms"),
        ("P31 {kPa(g)}", "kPa(g)"),
        ("T25_A (°C)", "°C"),
        ("P25 raw (counts)", "counts"),
        ("P25 (A)", ""),
        ("P25 (C)", ""),
        ("T25 (C)", "C"),
        ("P25 (s)", "s"),
        ("P25 (fwd)", ""),
        ("P25", ""),
        ("P25 []", ""),
        ("speed (rpm)", ""),
    ],
)
def test_a_unit_in_the_brackets_of_a_name_is_read(name: str, unit: str) -> None:
    assert unit_in_brackets(name) == unit


def test_labels_are_told_from_numbers_and_words() -> None:
    assert all(is_unit_label(text) for text in ("psi", "s", "", "-", "rpm", "V", "degC", "counts"))
    assert not any(is_unit_label(text) for text in ("1.5", "0", "nan", "1e5", "hello world", "?"))
    assert is_count("ADC counts")
    kinds = [kind_of_unit(text) for text in ("psig", "degF", "ms", "counts", "rpm", "")]
    assert kinds == ["pressure", "temperature", "time", "count", "", ""]


@pytest.mark.parametrize(
    "label",
    [
        "10**999999999",
        "9**9**9**9",
        "(km/m)**99999999",
        "2**9999999*Pa",
        "Pa**2**9",
        "1e99999999 s",
    ],
)
def test_a_label_that_would_be_worked_out_for_hours_is_no_unit(label: str) -> None:
    assert kind_of_unit(label) == ""
    assert not is_unit_label(label)


def test_units_that_are_put_together_are_units() -> None:
    assert kind_of_unit("N/m**2") == "pressure"
    assert kind_of_unit("kg*m**-1*s**-2") == "pressure"
    assert pressure_conversion("kgf/cm**2", "", 0.0).factor == 98066.5
    assert kind_of_unit("inH2O_60F") == "pressure"


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [
        ("7.98 psia", "pressure", 7.98 * float(PASCALS["psi"])),
        ("101.325 kPa abs", "pressure", 101325.0),
        ("-0.67 degF", "temperature", 255.0),
        ("-18.15 °C", "temperature", 255.0),
    ],
)
def test_a_setting_may_be_a_text_with_a_unit(text: str, kind: str, value: float) -> None:
    assert quantity_in(text, kind, "") == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize(
    ("text", "kind", "words"),
    [
        ("7.98 psi", "pressure", 'an absolute pressure, .* write "7.98 psia" if it is one'),
        ("7.98 psig", "pressure", "an absolute pressure"),
        ("7.98", "pressure", "a number with a unit of pressure"),
        ("seven psia", "pressure", "found 'seven psia'"),
        ("20 delta_degC", "temperature", 'a unit of temperature as in "-0.67 degF"'),
    ],
)
def test_a_text_that_is_no_quantity_is_refused(text: str, kind: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        quantity_in(text, kind, "test.toml: [near_stall] P25_Pa")


def test_nothing_is_written_where_units_are_read(tmp_path: Any, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    assert pressure_conversion("ftH2O", "", 0.0).factor == pytest.approx(2989.07, rel=1e-4)
    assert list(tmp_path.iterdir()) == []


def test_a_label_of_any_length_is_looked_at_in_a_bounded_way(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Watched:
        """A pattern whose time grows with the square of what it is tried on."""

        def __init__(self, pattern: re.Pattern[str]) -> None:
            self.pattern = pattern

        def match(self, text: str) -> re.Match[str] | None:
            assert len(text) < 100
            return self.pattern.match(text)

    for name in ("_WORDED", "_LETTERED"):
        monkeypatch.setattr(units, name, Watched(getattr(units, name)))
    label = "P " * 10_000
    assert kind_of_unit(label) == pressure_reference(label) == unit_in_brackets(f"[{label}]") == ""
    assert not same_unit(label, "psia", "pressure")
    with pytest.raises(InputError, match="a unit of pressure"):
        pressure_conversion(label, "test")
    assert pressure_reference("kPa (absolute)") == "absolute"


def test_labels_without_end_are_not_all_remembered() -> None:
    for number in range(3000):
        kind_of_unit(f"rubbish{number}")
    assert units._factor_and_offset.cache_info().currsize < 3000


def test_what_is_too_large_in_si_is_infinite_and_nothing_is_said(recwarn: Any) -> None:
    found = temperature_conversion("kK", "test").to_si(np.array([1e306, 0.3]))
    assert found.tolist() == [np.inf, 300.0]
    assert not recwarn.list
