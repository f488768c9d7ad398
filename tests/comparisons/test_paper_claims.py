"""The paper's claims: each is computed from the runs, and fails when what it rests on changes."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from paper_runs import paper_runs, remembered_case

from classic_ml.flow import LBM_KG
from classic_ml.reduction_settings import ReductionSettings
from comparisons.cli import main
from comparisons.paper.claims import check_claim, check_claims
from comparisons.paper.figures import phi_of_flow, pressure_ratio
from comparisons.paper.instabilities import (
    PAPER_SETTINGS,
    Instabilities,
    InstabilityRun,
    reduce_run,
    run_case,
)
from comparisons.rig import CASES, SensorSettings, gas, simulate
from comparisons.rig.cases import RigCase

# What the rig, reduced and fitted the paper's way, does not show.
# On the one machine that the test takes for the command's four, 45 does not hold, while 31, 46 and
# 48 do, which fail on most of the four.
DO_NOT_HOLD = {35, 36, 37, 38, 39, 42, 43, 45}


@pytest.fixture(scope="module")
def runs() -> Instabilities:
    """All runs with the rig as it is."""
    return paper_runs()


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> dict[int, dict[str, object]]:
    """What the command writes, by the numbers of the claims."""
    folder = tmp_path_factory.mktemp("reproduce")
    arguments = ["--json", str(folder / "claims.json"), "--report", str(folder / "claims.html")]
    # The five runs are those of the other tests; all that follows is done here.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("comparisons.paper.instabilities.run_case", remembered_case)
        # One machine in place of four, for the time it takes.
        patch.setattr("comparisons.cli.reproduce.MACHINES", 1)
        assert main(["reproduce", *arguments]) == 0
    page = (folder / "claims.html").read_text("utf-8")
    assert page.count('class="failed"') == len(DO_NOT_HOLD)
    assert page.count("data:image/png;base64,") == 6
    return {row["id"]: row for row in json.loads((folder / "claims.json").read_text("utf-8"))}


def altered(runs: Instabilities, **changed: InstabilityRun) -> Instabilities:
    """Return the runs with others in place of ``r985``, ``r90`` and so on."""
    return {**runs, **{name[1:].replace("_", "-"): run for name, run in changed.items()}}


def remade(
    run: InstabilityRun,
    case: str | RigCase,
    sensors: SensorSettings | None = None,
    reduced: bool = True,
) -> InstabilityRun:
    """Simulate another rig for a run and reduce it in the paper's way; its fits stay."""
    rig = simulate(case, seed=0, sensors=sensors)
    paper = reduce_run(rig) if reduced else run.paper
    return replace(run, rig=rig, paper=paper)


def test_every_claim_has_a_row_of_its_kind(rows: dict[int, dict[str, object]]) -> None:
    assert list(rows) == list(range(1, 49))
    for row in rows.values():
        assert list(row) == ["id", "claim", "kind", "stated", "found", "holds"]
        assert row["kind"] in {"conformance", "built in", "tested"}
        # Numbers stand beside numbers.
        assert not isinstance(row["stated"], float) or isinstance(row["found"], float)
    assert {number for number, row in rows.items() if not row["holds"]} == DO_NOT_HOLD
    # What the code does as the paper did; the rest is the rig's making or an outcome.
    assert {n for n, row in rows.items() if row["kind"] == "conformance"} == {11, 14, 20, 21, 22}


def test_numbers_of_the_long_claims(rows: dict[int, dict[str, object]]) -> None:
    assert 0.5 < rows[34]["found"] < 5.0  # type: ignore[operator]
    # Split at 50 lbm/s the 98.5 % surge is read too long for 18 ms, and far from the paper's 243.
    assert 20.0 < rows[38]["found"] < 54.0  # type: ignore[operator]
    # 14 % for 2 ms in the study behind the list of claims.
    assert rows[47]["found"] == pytest.approx(14.0, abs=2.0)


@pytest.mark.parametrize(
    ("sensors", "failing"),
    [
        (SensorSettings(tube_frequency_hz=100.0), 4),
        (SensorSettings(leak_lag_s=0.01), 5),
        (SensorSettings(rake_coupling=0.3), 8),
        (SensorSettings(reading_samples=2), 10),
        (SensorSettings(noise_percent=0.0), 12),
        (SensorSettings(hub_tip=0.0), 29),
        (SensorSettings(cells=0.0), 32),
    ],
)
def test_a_claim_on_the_sensors_fails_with_other_sensors(
    runs: Instabilities, sensors: SensorSettings, failing: int
) -> None:
    # The readings of all four tests count for some; the others look at the raw record alone, or at
    # its reduction in the paper's way.
    run = remade(runs["985"], "985", sensors, reduced=failing >= 13)
    other = altered(runs, r985=run, r985_second=run, r90=run, r95=run)
    assert not check_claim(other, failing).holds


def test_a_claim_of_all_machines_must_hold_on_most_of_them(runs: Instabilities) -> None:
    poor = remade(runs["985"], "985", SensorSettings(reading_samples=2))
    bad = altered(runs, r985=poor, r985_second=poor, r90=poor, r95=poor)
    good, alone = (
        next(c for c in check_claims(runs, others, lambda _: ("calibration",)) if c.id == 10)
        for others in ((runs, runs, bad), (runs, bad))
    )
    assert good.holds
    assert good.machines == (True, True, False)
    assert not alone.holds


def test_the_spectrum_follows_the_cells(runs: Instabilities) -> None:
    other_cells = replace(CASES["90"], cell_frequency_hz=77.0)
    other = altered(runs, r90=remade(runs["90"], other_cells))
    for number, expected in ((17, 77.0), (18, 154.0)):
        claim = check_claim(other, number)
        assert claim.found == pytest.approx(expected, abs=0.5)
        assert not claim.holds


@pytest.mark.parametrize(
    "settings", [replace(PAPER_SETTINGS, cutoff_hz=40.0), replace(PAPER_SETTINGS, phase="zero")]
)
def test_another_filter_is_not_the_papers(runs: Instabilities, settings: ReductionSettings) -> None:
    paper = reduce_run(runs["90"].rig, settings)
    assert not check_claim(altered(runs, r90=replace(runs["90"], paper=paper)), 21).holds


def test_other_machines_do_not_show_it(runs: Instabilities) -> None:
    # A second record at 98.5 % in place of that at 95 %: three speeds no more.
    assert not check_claim(altered(runs, r95=runs["985-second"]), 16).holds
    # The steady record is neither heated nor does it fall short of its first stall.
    steady = altered(runs, r985=runs["75-stall"])
    assert not check_claim(steady, 24).holds
    assert not check_claim(steady, 27).holds
    wide = run_case(replace(CASES["95"], t31_limit_k=(200.0, 900.0)))
    assert check_claim(altered(runs, r95=wide), 41).found == "ψ at 90 %, 95 %"
    level = replace(CASES["75-stall"], pressure_terms=CASES["985"].pressure_terms)
    assert "lower by -" in str(check_claim(altered(runs, r75_stall=run_case(level)), 39).found)
    alone = remade(runs["90"], replace(CASES["90"], always_cells=0.0))
    assert not check_claim(altered(runs, r90=alone), 40).holds


def test_a_wrong_curve_does_not_reconstruct_and_a_true_one_is_valid(runs: Instabilities) -> None:
    low = runs["90"]
    known = low.rig.truth_parameters
    flat = replace(low.fits["psi_p"], coefficients=(2.0, 0.0, 0.0))
    wrong = altered(runs, r90=replace(low, fits={**low.fits, "psi_p": flat}))
    assert not any(check_claim(wrong, number).holds for number in (43, 44, 45))
    true = replace(low.fits["psi_p"], coefficients=tuple(known["beta"]))
    work = replace(
        low.fits["psi"],
        terms=("1", "min(phi,0.05)", "clip(phi-0.05,0,0.075)", "relu(phi-0.125)"),
        coefficients=(known["psi_intercept"], *known["psi_slopes"]),
    )
    fits = {"psi_p": true, "psi": work, "psi_p_linked": true}
    right = altered(runs, r90=replace(low, fits=fits), r985=replace(low, fits=fits))
    assert check_claim(right, 43).holds
    assert check_claim(right, 35).holds


def test_curves_of_the_case_are_those_of_the_run(runs: Instabilities) -> None:
    high, steady = runs["985"], runs["75-stall"]
    truth, case = steady.rig.truth, steady.machine
    rows = (truth.time_s > 1.0) & (truth["stall_blend"] > 1.0 - 1e-9)
    assert np.count_nonzero(rows) > 1000
    assert_allclose(truth["psi_p_qs"][rows], case.in_stall_psi_p(truth["phi"][rows]), rtol=1e-6)
    assert_allclose(truth["psi_qs"][rows], case.in_stall_psi(truth["phi"][rows]), rtol=1e-6)
    for run in (high, steady):
        begin = run.rig.truth
        found = run.machine.unstalled_psi_p(begin["phi"][0], float(begin["Nc_frac"][0]))
        assert found == pytest.approx(begin["psi_p_qs"][0], rel=1e-6)


def test_flow_and_pressure_ratio_follow_the_rigs_gas(runs: Instabilities) -> None:
    high = runs["985"]
    truth, velocity = high.rig.truth, high.rig.truth_parameters["rotor_velocity_m_s"]
    for row in (0, 2000, 2600):
        flow = truth["Wc25_kg_s"][row : row + 1] / LBM_KG
        phi = phi_of_flow(high, flow, float(truth["T25_K"][row]))
        assert phi == pytest.approx(truth["phi"][row], rel=1e-6, abs=1e-9)
    assert high.machine.stall_point(0.75) == pytest.approx((0.272, 4.2))
    inlet_K = 255.0 * (0.985 / 0.75) ** 2
    expected = (1.0 + 4.2 * velocity**2 / (2.0 * gas.CP_J_KG_K * inlet_K)) ** 3.5
    assert float(pressure_ratio(high, 4.2, inlet_K)) == pytest.approx(expected, rel=1e-4)
