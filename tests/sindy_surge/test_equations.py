from __future__ import annotations

import math
import pickle
from dataclasses import replace

import numpy as np
import pytest

from sindy_surge import InputError
from sindy_surge.equations import (
    EquationParts,
    format_uncertain,
    pretty_term,
    pysindy_equations,
    read_term,
    round_to_error,
    write_equation,
)

PARTS = EquationParts(
    ("1", "phi", "phi^2[phi<0]", "relu(phi-0.05)"),
    (0.35, -1.2, 20.0, -0.5),
    (0.004, 0.05, 0.7, 0.04),
    0.018,
    0.00012,
)


@pytest.mark.parametrize(
    ("value", "stderr", "text"),
    [
        (1.2134, 0.03, "1.213(30)"),
        (1.2134, 0.04, "1.21(4)"),
        (0.018012, 0.00012, "0.01801(12)"),
        (47.38, 1.2, "47.4(1.2)"),
        (47.38, 5.2, "47(5)"),
        (1234.0, 56.0, "1230(60)"),
        (2.0, 0.0, "2"),
        (2.5, math.nan, "2.5"),
        (0.35, 1e-20, "0.35"),
        (1.0, 0.0999, "1.00(10)"),
        (1.2e-8, 3.1e-10, "1.200(31)e-08"),
        (-4.1e8, 3e6, "-4.100(30)e+08"),
        (0.0, 2e-7, "0.0(2.0)e-07"),
    ],
)
def test_values_are_rounded_to_their_error(value: float, stderr: float, text: str) -> None:
    assert format_uncertain(value, stderr) == text


def test_rounding_keeps_the_value_within_a_fifth_of_its_error() -> None:
    rng = np.random.default_rng(0)
    for _ in range(300):
        value = float(rng.normal() * 10.0 ** rng.uniform(-9, 9))
        stderr = abs(value) * 10.0 ** float(rng.uniform(-6, 1))
        text, error = round_to_error(value, stderr)
        assert abs(float(text) - value) <= 0.2 * stderr
        assert abs(float(error) - stderr) <= 0.2 * stderr


def test_an_unknown_error_is_left_empty() -> None:
    assert round_to_error(2.5, math.nan) == ("2.5", "")
    assert round_to_error(2.5, 0.0) == ("2.5", "0")


def test_text_carries_units_signs_and_terms() -> None:
    assert write_equation(PARTS) == (
        "0.01800(12) s · dψ'/dt + ψ' = 0.350(4) − 1.20(5) φ + 20.0(7) φ²[φ<0] "
        "− 0.50(4) relu(φ-0.05)   [φ, ψ' dimensionless, t in s]"
    )


def test_text_writes_the_dead_time_where_there_is_one() -> None:
    late = replace(PARTS, dead_time_s=0.002, dead_time_stderr_s=0.0003)
    assert ", with φ at t − 0.00200(30) s   [" in write_equation(late)
    early = replace(PARTS, dead_time_s=-0.002, dead_time_stderr_s=0.0003)
    assert ", with φ at t + 0.00200(30) s   [" in write_equation(early)
    found_none = replace(PARTS, dead_time_stderr_s=0.0003)
    assert "at t − 0.00000(30) s" in write_equation(found_none)
    assert " at t " not in write_equation(PARTS)


def test_terms_in_psi_p_are_written_in_the_fields_letters() -> None:
    assert pretty_term("psi_p^2") == "ψ'²"
    assert pretty_term("psi_p phi^12") == "ψ' φ¹²"
    assert pretty_term("|phi| phi") == "|φ| φ"
    assert pretty_term("phi_sp_0 x1^2.5") == "phi_sp_0 x1^2.5"


def test_static_fit_has_no_derivative() -> None:
    parts = EquationParts(("1",), (-0.35,), (math.nan,), math.nan, math.nan)
    assert write_equation(parts) == "ψ' = −0.35   [ψ' dimensionless]"


@pytest.mark.parametrize(
    "term",
    ["phi^2", "psi_p^3", "exp(-phi/0.05)", "|phi| phi", "phi^2[phi<=0]", "f0(phi)", "a{b_}$%~^\\"],
)
def test_latex_balances_its_braces_and_escapes(term: str) -> None:
    parts = EquationParts(("1", term), (0.3, -2e-9), (0.01, 1e-10), 0.018, 1e-4, 0.002, 1e-4)
    text = write_equation(parts, "latex")
    bare = text.replace(r"\{", "").replace(r"\}", "")
    assert bare.count("{") == bare.count("}")
    assert "$" not in text.replace(r"\$", "")
    assert r"\times 10^{-9}" in text
    assert r"\varphi=\varphi(t-d)" in text
    assert r"d=0.00200(10)\,\mathrm{s}" in text


def test_latex_knows_the_terms() -> None:
    parts = EquationParts(("psi_p^2", "relu(phi-0.05)"), (1, 2), (0.1, 0.1), 0.018, 1e-4)
    text = write_equation(parts, "latex")
    assert r"1.00(10)\,{\psi'}^{2}" in text
    assert r"2.00(10)\,\operatorname{relu}(\varphi-0.05)" in text


def test_names_of_inputs_are_read_whole() -> None:
    assert read_term("x10 x1^2", ("x1", "x10")) == [
        ("name", "x10"),
        ("space", " "),
        ("name", "x1"),
        ("operator", "^"),
        ("number", "2"),
    ]
    assert read_term("phi_sp_0", ("phi",)) is None
    assert read_term("f0(phi)", ("phi",)) is None
    assert read_term("flow - 2", ("flow - 2", "flow")) == [("name", "flow - 2")]


def _parse(equation: str) -> dict[str, float]:
    pairs = (piece.split(" ", 1) for piece in equation.split(" + "))
    return {name: float(number) for number, name in pairs}


def test_pysindy_strings_are_those_of_the_rate() -> None:
    parts = EquationParts(("1", "phi", "phi^2"), (0.35, 1.2, -1.9), (0.1,) * 3, 0.018, 1e-4)
    right = "-55.556 psi_p + 19.444 1 + 66.667 phi + -105.556 phi^2"
    assert pysindy_equations(parts) == [right]
    assert pysindy_equations(parts, lhs=True) == [f"(psi_p)' = {right}"]
    late = replace(parts, dead_time_s=0.002)
    assert _parse(pysindy_equations(late)[0])["phi(t-0.002)^2"] == -105.556


@pytest.mark.parametrize("precision", [1, 3, 8])
def test_pysindy_strings_parse_back(precision: int) -> None:
    rng = np.random.default_rng(precision)
    names = (
        "1",
        "phi",
        "phi^2[phi<0]",
        "relu(phi-0.05)",
        "exp(-phi/0.05)",
        "psi_p phi",
        "|phi| phi",
    )
    for _ in range(40):
        coef = rng.normal(size=len(names)) * 10.0 ** rng.uniform(-10, 10, len(names))
        parts = EquationParts(names, tuple(coef), (0.1,) * len(names), 0.018, 1e-4)
        parsed = _parse(pysindy_equations(parts, precision)[0])
        assert list(parsed) == ["psi_p", *names]
        for name, value in zip(names, coef / 0.018, strict=True):
            assert parsed[name] == pytest.approx(value, rel=0.5000001 * 10.0 ** (1 - precision))


def test_pysindy_writes_the_same_numbers() -> None:
    """Against pysindy itself, where its decimals suffice."""
    import pysindy

    rng = np.random.default_rng(0)
    psi_p, phi = rng.uniform(0.1, 0.6, (2, 60))
    rate = (0.35 + 1.2 * phi - 1.9 * phi**2 - psi_p) / 0.018
    model = pysindy.SINDy(
        optimizer=pysindy.STLSQ(threshold=0.1, alpha=0.0),
        feature_library=pysindy.PolynomialLibrary(degree=2),
    )
    model.fit(
        psi_p[:, None], t=1.0, x_dot=rate[:, None], u=phi[:, None], feature_names=["psi_p", "phi"]
    )
    theirs = _parse(" + ".join(p.strip() for p in model.equations(3)[0].split(" + ")))
    parts = EquationParts(("1", "phi", "phi^2"), (0.35, 1.2, -1.9), (0.1,) * 3, 0.018, 1e-4)
    assert theirs == _parse(pysindy_equations(parts)[0])


def test_what_cannot_be_written_is_refused() -> None:
    static = replace(PARTS, time_constant_s=math.nan)
    with pytest.raises(InputError, match="static"):
        pysindy_equations(static)
    with pytest.raises(InputError, match="precision"):
        pysindy_equations(PARTS, precision=0)
    with pytest.raises(InputError, match="style"):
        write_equation(PARTS, "html")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="as many terms"):
        EquationParts(("1", "phi"), (1.0,), (1.0,), 0.018, 1e-4)


def test_parts_are_plain_values() -> None:
    parts = EquationParts(
        ["1", "phi"],  # type: ignore[arg-type]
        np.array([0.35, 1.2]),  # type: ignore[arg-type]
        np.array([0.01, 0.1]),  # type: ignore[arg-type]
        0.018,
        1e-4,
        dead_time_stderr_s=0.0,
    )
    assert hash(parts) == hash(pickle.loads(pickle.dumps(parts)))
    assert parts.coef == (0.35, 1.2)
