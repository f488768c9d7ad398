"""What is said of a diagnosis: every verdict with every number, and the table of candidates.

`SINDY_SURGE_WRITE_GOLDEN=1 pytest tests/comparisons/missing_effect/test_words.py` writes the golden
file anew; read the difference before it is committed.
"""

from __future__ import annotations

import os
import re
from dataclasses import replace
from pathlib import Path

import pytest
from made_diagnosis import VERDICTS, Told, made_diagnosis

from comparisons.missing_effect.catalogue import CATALOGUE, find_effect
from comparisons.missing_effect.diagnosis import FittedParameter, Gap
from comparisons.missing_effect.noise import NoiseModel
from comparisons.missing_effect.quantities import (
    chance,
    equation_of,
    model_equation,
    numbers_of,
    quantity,
)
from comparisons.missing_effect.terminal import candidate_table, diagnosis_text
from comparisons.missing_effect.words import noise_words, untried_words, verdict_words

GOLDEN = Path(__file__).parents[2] / "golden" / "diagnosis_text.txt"
FOUND = ("named", "alias_set", "provisional", "unnamed_term")


def text_of(verdict: str) -> str:
    return diagnosis_text(made_diagnosis(verdict), Told("Time: strongest at 4 to 6 s."))  # type: ignore[arg-type]


def test_the_text_of_each_verdict_is_the_golden_one() -> None:
    rule = "\n" + 100 * "=" + "\n"
    text = rule.join(text_of(verdict) for verdict in VERDICTS) + "\n"
    if os.environ.get("SINDY_SURGE_WRITE_GOLDEN"):
        GOLDEN.write_text(text, "utf-8")
    assert text == GOLDEN.read_text("utf-8")


@pytest.mark.parametrize("verdict", VERDICTS)
def test_no_line_of_prose_is_wider_than_100_columns_and_no_row_than_110(verdict: str) -> None:
    lines = text_of(verdict).splitlines()
    rows = [line for line in lines if re.match(r"(round| +\d) ", line)]
    assert max(len(line) for line in lines if line not in rows) <= 100
    assert max(map(len, rows)) <= 110


@pytest.mark.parametrize("verdict", ["named", "provisional"])
def test_an_effect_is_told_with_port_equation_number_tau_and_gap(verdict: str) -> None:
    words = verdict_words(made_diagnosis(verdict))
    for fact in (
        "hysteresis, at the port “characteristic”",
        find_effect("hysteresis").equation,
        "Δ = 0.02100 ± 0.00021",
        "φ_lo = 0.1100 ± 0.0011",
        "to 100.0 ± 0.4 ms (−9.1 %)",
        find_effect("hysteresis").on_tau,
        "from 2.10 to 1.02 times the noise",
        "98.8 % of the gap is closed",
        find_effect("hysteresis").confirm,
    ):
        assert fact in words
    assert ("may be another effect" in words) == (verdict == "provisional")


def test_an_alias_set_says_why_and_gives_tau_under_every_name() -> None:
    words = verdict_words(made_diagnosis("alias_set"))
    assert "cannot tell transport_delay and second_order_lag apart" in words
    assert "both move the phase alike" in words
    assert "their scores lie 5.5 log-units apart" in words
    assert "transport_delay 100.0 ms, second_order_lag 104.3 ms" in words
    for name in ("transport_delay", "second_order_lag"):
        assert f"{name}: {find_effect(name).confirm}" in words
    assert "--separate" in words
    assert "--separate" not in verdict_words(made_diagnosis("alias_set"), separated=True)


def test_a_term_without_a_name_is_told_as_such() -> None:
    words = verdict_words(made_diagnosis("unnamed_term"))
    assert "no effect of the catalogue" in words
    assert "c · φ·dφ/dt" in words
    assert "c = 0.01300 ± 0.00013" in words
    assert "unknown" not in words


def test_nothing_missing_has_a_limit_and_says_how_to_get_it() -> None:
    words = verdict_words(made_diagnosis("nothing_missing"))
    assert words.startswith("Nothing is missing that these records show.")
    assert "an effect that is small enough goes unseen, and --limits" in words
    limited = verdict_words(made_diagnosis("nothing_missing"), limited=True)
    assert "--limits" not in limited
    assert "the limits below" in limited


def test_structure_without_a_name_is_not_nothing_missing() -> None:
    words = verdict_words(made_diagnosis("unexplained_structure"))
    assert "not “nothing missing”" in words
    assert "Nothing is missing" not in words
    assert "171 log-units (p 3e-51)" in words


def test_noise_is_told_by_its_colour_and_its_tails() -> None:
    words = verdict_words(made_diagnosis("noise_model_wrong"))
    assert "autoregression 0.55, -0.10" in words
    assert "2.1 % of the errors lie beyond three standard deviations" in words
    d = made_diagnosis("nothing_missing")
    assert noise_words(d).startswith("The noise is white and about normal")
    tails = replace(d, noise=NoiseModel(0.002, 0.002, (), 0.05))
    assert "autoregression" not in noise_words(tails)


def test_a_gap_that_is_closed_beyond_the_noise_is_closed_and_no_more() -> None:
    d = made_diagnosis("named")
    below = replace(d, gap=Gap(d.gap.before_rms, 0.9 * d.gap.floor_rms, d.gap.floor_rms))
    assert "noise 0.00200): all of the gap is closed" in verdict_words(below)
    worse = replace(d, gap=Gap(0.004, 0.005, d.gap.floor_rms))
    assert "the rms error stays at 0.00500" in verdict_words(worse)


def test_a_tau_that_does_not_move_is_said_to_stay() -> None:
    d = made_diagnosis("named")
    still = replace(d, tau_before_s=d.tau_after_s * 1.0001)
    assert "With it τ stays at 100.0 ± 0.4 ms." in verdict_words(still)


def test_a_base_that_is_too_stiff_is_told_how_to_bend() -> None:
    d = made_diagnosis("named")
    (item,) = d.missing
    shape = replace(
        item,
        effect="characteristic_shape",
        alias_set=("characteristic_shape",),
        parameters=(
            FittedParameter("f", -0.0766, 0.0011, "1"),
            FittedParameter("intervals", 4.0, 0.0, "1"),
        ),
    )
    words = verdict_words(replace(d, missing=(shape,)))
    assert "--degree" in words
    assert "--base sindy" in words
    assert "largest f = -0.0766 ± 0.0011, 4 intervals" in words


def test_remarks_are_part_of_what_is_said() -> None:
    d = replace(made_diagnosis("named"), remarks=("the run is not scored there",))
    assert "The run is not scored there." in verdict_words(d)


def test_every_effect_is_in_the_table_or_told_below_it() -> None:
    d = made_diagnosis("named")
    told = candidate_table(d) + "".join(untried_words(d))
    assert [e.name for e in CATALOGUE if not re.search(rf"\b{e.name}\b", told)] == []
    assert "speed_droop needs the column Nc_frac" in untried_words(d)[-1]


def test_the_table_says_what_became_of_each_candidate() -> None:
    rows = candidate_table(made_diagnosis("alias_set")).splitlines()[1:4]
    fates = [row.split("  ")[-1].strip() for row in rows]
    assert fates == ["added", "alias", "refused: fitted, later, other"]


def test_a_table_without_a_candidate_says_so() -> None:
    d = made_diagnosis("nothing_missing")
    step = replace(d.rounds[0], candidates=())
    assert "No effect promised enough" in candidate_table(replace(d, rounds=(step,)))


def test_limits_and_separation_stand_in_the_text() -> None:
    text = diagnosis_text(
        made_diagnosis("alias_set"),
        None,
        limits=Told("bias_drift  c = 7e-06 1/s"),
        separation=Told("  records twice as long: enough"),
    )
    assert "Limits\nbias_drift  c = 7e-06 1/s" in text
    assert "What would tell them apart\n  records twice as long: enough" in text
    assert "too short" in text


@pytest.mark.parametrize(
    ("value", "stderr", "unit", "shown"),
    [
        (0.005744, 0.000052, "s", "5.74 ± 0.05 ms"),
        (43.81, 1.64, "s", "43.8 ± 1.6 s"),
        (3.3e-4, 1e-5, "s^2", "330 ± 10 ms²"),
        (0.0221, 0.0002, "1", "0.02210 ± 0.00020"),
        (27.231, 0.008, "Hz", "27.231 ± 0.008 Hz"),
        (9.27e-5, 9e-7, "1/s", "(9.27 ± 0.09)e-05 1/s"),
    ],
)
def test_numbers_are_rounded_to_their_error_in_a_unit_to_read(
    value: float, stderr: float, unit: str, shown: str
) -> None:
    assert quantity(value, stderr, unit) == shown


def test_numbers_that_were_held_are_words() -> None:
    loss = (FittedParameter("c", 2.0, 0.1, "1"), FittedParameter("lagged", 0.0, 0.0, "1"))
    assert numbers_of("reverse_flow_branch", loss) == "c = 2.00 ± 0.10, not lagged"
    gate = FittedParameter("phi_gate", 0.16, 0.0, "1")
    flagged = replace(gate, value=0.0)
    ripple = FittedParameter("f", 27.0, 0.1, "Hz")
    assert numbers_of("rotating_stall_ripple", (ripple, gate)).endswith("Hz, where φ < 0.16")
    assert numbers_of("rotating_stall_ripple", (ripple, flagged)).endswith("Hz")


def test_equations_name_their_effects() -> None:
    d = made_diagnosis("alias_set")
    assert model_equation(d.before) == "τ dψ'/dt + ψ' = 0.2000 + 1.500 φ − 1.800 φ², τ = 110.0 ms"
    assert model_equation(d.after).endswith("τ = 100.0 ms; transport_delay: φ(t − d)")
    (term,) = made_diagnosis("unnamed_term").after.structure.effects
    assert equation_of(term) == "+ c · φ·dφ/dt"


def test_chances_are_short() -> None:
    assert [chance(p) for p in (0.0, 3e-51, 0.0004, 0.87)] == ["<1e-300", "3e-51", "4e-04", "0.87"]


@pytest.mark.parametrize("verdict", FOUND)
def test_what_is_found_is_never_called_nothing(verdict: str) -> None:
    words = verdict_words(made_diagnosis(verdict))
    assert "Nothing is missing" not in words
    assert "--limits" not in words
