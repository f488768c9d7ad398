"""Units: factors against hand-made ones, absolute and gauge kept apart."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from classic_ml.units import Conversion, conversion_to_si, kind_of_unit, same_unit, split_reference
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
    "lbf/in2": POUND * GRAVITY / INCH**2,
    "in. Hg": Fraction(135_951, 10) * GRAVITY * INCH,
    "PSI": POUND * GRAVITY / INCH**2,
    "mPa": Fraction(1, 1000),
}
KELVINS = {
    "K": (Fraction(1), Fraction(0)),
    "degC": (Fraction(1), Fraction(27_315, 100)),
    "degF": (Fraction(5, 9), Fraction(45_967, 100) * Fraction(5, 9)),
    "degR": (Fraction(5, 9), Fraction(0)),
}
SPELLINGS = {
    "degC": ("C", "°C", "deg C", "Celsius", "degree_Celsius"),
    "degF": ("F", "°F", "fahrenheit", "DEGF"),
    "degR": ("R", "deg R", "rankine"),
    "K": ("k", "kelvin", "degK"),
}
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "min": 60.0, "sec": 1.0}


@pytest.mark.parametrize("unit", PASCALS)
def test_a_pressure_unit_is_its_definition_to_rounding(unit: str) -> None:
    expected = Conversion(float(PASCALS[unit]), 0.0)
    assert conversion_to_si(unit, "pressure", "", 0.0) == expected


@pytest.mark.parametrize("unit", KELVINS)
def test_a_temperature_unit_is_its_definition_to_rounding(unit: str) -> None:
    factor, offset = KELVINS[unit]
    for spelling in (unit, *SPELLINGS[unit]):
        found = conversion_to_si(spelling, "temperature", "")
        assert found == Conversion(float(factor), float(offset))
    # Freezing and boiling water, and where the scales of °C and °F cross.
    points = {"degC": (0.0, 100.0, -40.0), "degF": (32.0, 212.0, -40.0)}
    if unit in points:
        kelvins = found.to_si(np.array(points[unit]))
        np.testing.assert_allclose(kelvins, [273.15, 373.15, 233.15], rtol=1e-15, atol=0.0)


@pytest.mark.parametrize("unit", SECONDS)
def test_a_time_unit_is_its_definition_to_rounding(unit: str) -> None:
    assert conversion_to_si(unit, "time", "") == Conversion(SECONDS[unit], 0.0)


@pytest.mark.parametrize(
    ("unit", "reference"),
    [
        *((u, "absolute") for u in ("psia", "PSIA", "kPa abs", "bar(a)", "inHg (abs)", "mbara")),
        *((u, "gauge") for u in ("psig", "psi gauge", "bar (g)", "kPag", "inHg gage", "psid")),
        *((u, "") for u in ("psi", "Pa", "in Hg", "torr")),
    ],
)
def test_what_a_pressure_is_taken_against_is_read_from_its_name(unit: str, reference: str) -> None:
    assert split_reference(unit)[1] == reference
    given = None if reference == "absolute" else 1e5
    found = conversion_to_si(unit, "pressure", "", given)
    assert found.offset == (0.0 if given is None else given)
    assert found.factor > 0.0


@pytest.mark.parametrize(
    ("unit", "reference_Pa", "words"),
    [
        ("psi", None, 'stands for, beside the unit "psi", found nothing; write "psi abs"'),
        ("psig", None, "found nothing; .* the barometer"),
        ("psig", 0.0, "reading of 0 stands for, .* found 0"),
        ("psia", 101325.0, 'none, beside the unit "psia", found 101325'),
        ("furlong", 0.0, 'a unit of pressure, such as Pa, .* found "furlong"$'),
        ("degC", 0.0, 'a unit of pressure, .* found "degC"'),
        ("MPA", 0.0, "a unit of pressure"),
        ("", 0.0, 'found ""'),
        ("psi**2", 0.0, 'found "psi'),
        ("p" * 500, 0.0, "a unit of pressure"),
        ("3 psi", 0.0, "a unit of pressure"),
    ],
)
def test_a_pressure_unit_that_leaves_doubt_is_refused(
    unit: str, reference_Pa: float | None, words: str
) -> None:
    with pytest.raises(InputError, match=words):
        conversion_to_si(unit, "pressure", "test.toml: [channels.P]", reference_Pa)


@pytest.mark.parametrize("unit", ["delta_degC", "ΔdegC", "psi", "J", "", "K/s"])
def test_a_difference_of_temperatures_or_another_quantity_is_no_temperature(unit: str) -> None:
    with pytest.raises(InputError, match="a unit of temperature, such as K, degC, degF, degR"):
        conversion_to_si(unit, "temperature", "test.toml: [channels.T]")


@pytest.mark.parametrize(
    ("stated", "unit", "reference_Pa", "same"),
    [("psi", "psia", None, True), ("PSIA", "psi", 0.0, True), ("lbf/in^2", "psia", None, True),
     ("psig", "psia", None, False), ("psig", "psi", 0.0, False), ("psig", "psi", 101325.0, True),
     ("psia", "psi", 101325.0, False), ("psia", "psig", 101325.0, False),
     ("kPa", "psia", None, False), ("hPa", "mbar", 0.0, True), ("V", "psia", None, False),
     ("counts", "count", None, True), ("1", "count", None, True), ("psi", "count", None, False),
     ("n/a", "count", None, True), ("counts", "psia", None, False), ("°C", "degC", None, True),
     ("degF", "degC", None, False), ("ms", "s", None, False), ("sec", "s", None, True)],
)  # fmt: skip
def test_what_a_file_states_is_held_against_what_test_toml_says(
    stated: str, unit: str, reference_Pa: float | None, same: bool
) -> None:
    assert same_unit(stated, unit, reference_Pa) is same


def test_each_label_is_of_one_kind() -> None:
    labels = ("psig", "degF", "ms", "ADC counts", "N/m**2", "rpm", "", "hello world", "1.5")
    kinds = ["pressure", "temperature", "time", "count", "pressure", "", "", "", ""]
    assert [kind_of_unit(label) for label in labels] == kinds


@pytest.mark.parametrize("label", ["10**999999999", "9**9**9**9", "(km/m)**99999999", "P " * 9999])
def test_a_label_that_would_be_worked_out_for_hours_is_no_unit(label: str) -> None:
    assert kind_of_unit(label) == ""
