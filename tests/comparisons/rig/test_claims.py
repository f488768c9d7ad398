"""The numbers that the paper states of its surges, asked of the rig."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.signal import detrend, find_peaks, periodogram

from comparisons.rig import CASES, RigRun
from comparisons.rig.gas import LBM_KG, PSI_PA
from comparisons.rig.instrument import PROBES

Runs = Callable[[str], RigRun]
WINDOW = slice(1_800, 3_600)


def _spectrum(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    # 1600 samples put 81.2 and 162 Hz of the paper onto bins of 0.625 Hz.
    piece = detrend(values[1_900:3_500])
    frequency, power = periodogram(piece, fs=1_000.0, window="hann")
    return frequency, power


def _peak(frequency: np.ndarray, power: np.ndarray, low: float, high: float) -> float:
    band = (frequency >= low) & (frequency <= high)
    return float(frequency[band][np.argmax(power[band])])


def test_twenty_channels(default_run: Runs) -> None:
    raw = default_run("985").raw
    assert sum(name.startswith("P") for name in raw.channels) == 16
    assert sum(name.startswith("T") for name in raw.channels) == 4


def test_aft_probes_read_above_static() -> None:
    assert all(1.05 <= slope <= 1.12 for slope, _ in PROBES.values())


def test_four_instabilities_at_three_speeds(default_run: Runs) -> None:
    cases = ("90", "95", "985", "985-second")
    assert {CASES[name].corrected_speed_frac for name in cases} == {0.90, 0.95, 0.985}
    for name in (*cases, "blowdown"):
        truth = default_run(name).truth
        recoveries = np.sum(np.diff(truth["in_stall"]) < 0.0)
        assert recoveries >= 12, name
        # Still cycling at the end, not recovered and not locked in stall.
        assert np.ptp(truth["in_stall"][-600:]) == 1.0, name


def test_cells_and_their_harmonic_in_p25(default_run: Runs) -> None:
    frequency, power = _spectrum(default_run("985").raw["P25_A_tip_forward"])
    assert _peak(frequency, power, 60.0, 120.0) == pytest.approx(81.2, abs=1.5)
    assert _peak(frequency, power, 140.0, 190.0) == pytest.approx(162.0, abs=4.0)


@pytest.mark.parametrize(
    ("name", "first_hz", "tolerance"),
    [("985", 6.9, 0.4), ("90", 7.5, 0.4), ("985-second", 6.9, 0.5)],
)
def test_surge_frequency_and_its_second_peak(
    default_run: Runs, name: str, first_hz: float, tolerance: float
) -> None:
    frequency, power = _spectrum(default_run(name).truth["P31_Pa"])
    assert _peak(frequency, power, 2.0, 11.0) == pytest.approx(first_hz, abs=tolerance)
    assert _peak(frequency, power, 11.5, 18.0) == pytest.approx(2.0 * first_hz, abs=2.0)
    # A second oscillation in stall between deep cycles, not just a sharp wave's harmonic.
    peaks, _ = find_peaks(default_run(name).truth["P31_Pa"][WINDOW], distance=25)
    assert len(peaks) / 1.8 == pytest.approx(2.0 * first_hz, rel=0.08)


def test_time_from_instability_to_quasi_steady_cycles(default_run: Runs) -> None:
    for name, own in (("985", 1.06), ("985-second", 1.27)):
        parameters = default_run(name).truth_parameters
        wait = parameters["recovery_times_s"][0] - parameters["stall_times_s"][0]
        assert wait == pytest.approx(1.4, abs=0.4)
        assert wait == pytest.approx(own, abs=0.06)
    assert default_run("985").truth_parameters["stall_times_s"][0] == pytest.approx(0.28, abs=0.01)


def test_cycles_repeat(default_run: Runs) -> None:
    times = np.array(default_run("985").truth_parameters["recovery_times_s"])
    periods = np.diff(times[(times > 1.8) & (times < 3.6)])
    assert np.std(periods) < 0.03 * np.mean(periods)


def test_inlet_heats_and_pressurises(default_run: Runs) -> None:
    truth = default_run("985").truth
    assert truth["P25_Pa"][0] / PSI_PA == pytest.approx(8.0, abs=0.05)
    assert 17.0 <= np.median(truth["P25_Pa"][WINDOW]) / PSI_PA <= 18.0
    assert truth["T25_K"][0] * 1.8 == pytest.approx(459.0, abs=0.5)
    assert np.median(truth["T25_K"][WINDOW]) * 1.8 == pytest.approx(800.0, rel=0.04)


def test_corrected_speed_droops_to_70_to_80_percent(default_run: Runs) -> None:
    for name in ("985", "985-second", "95"):
        speed = default_run(name).truth["Nc_frac"]
        assert np.all((speed[WINDOW] > 0.70) & (speed[WINDOW] < 0.80)), name
    truth = default_run("985").truth
    assert 0.73 <= np.median(truth["Nc_frac"][WINDOW]) <= 0.76
    # Physical speed is constant: Nc falls with the root of T25 and with nothing else.
    ratio = truth["T25_K"] / truth["T25_K"][0]
    assert (0.985 / truth["Nc_frac"]) ** 2 == pytest.approx(ratio, rel=1e-12)


def test_recoveries_do_not_return_to_the_first_pressure_ratio(default_run: Runs) -> None:
    truth = default_run("985").truth
    ratio = truth["P31_Pa"] / truth["P25_Pa"]
    assert ratio[0] > 23.0
    assert 3.8 < ratio[WINDOW].max() < 4.4
    assert 1.5 < ratio[WINDOW].min() < 1.8


def test_flow_range_and_in_stall_phi_range(default_run: Runs) -> None:
    truth = default_run("985").truth
    flow = truth["Wc25_kg_s"][WINDOW] / LBM_KG
    assert -7.0 < flow.min() < -4.0
    assert 60.0 < flow.max() < 70.0
    stalled = truth["in_stall"][WINDOW] > 0.0
    low, high = np.percentile(truth["phi"][WINDOW][stalled], [5.0, 95.0])
    assert low == pytest.approx(-0.022, abs=0.005)
    assert high == pytest.approx(0.187, abs=0.02)


@pytest.mark.parametrize("name", ["985", "90"])
def test_tip_reverses_more_than_hub_and_first(default_run: Runs, name: str) -> None:
    truth = default_run(name).truth
    assert truth["Wc25_tip_kg_s"][WINDOW].min() < truth["Wc25_hub_kg_s"][WINDOW].min()
    onset = np.flatnonzero(truth["in_stall"])[0]
    first = {
        side: np.flatnonzero(truth[f"Wc25_{side}_kg_s"][onset:] < 0.0)[0] for side in ("tip", "hub")
    }
    assert first["tip"] < first["hub"]


@pytest.mark.parametrize("name", ["985", "90", "95"])
def test_inlet_reverses_more_than_exit(default_run: Runs, name: str) -> None:
    truth = default_run(name).truth
    assert truth["W25_kg_s"][WINDOW].min() < truth["W31_kg_s"][WINDOW].min() - 0.5 * LBM_KG


def test_first_stall_in_the_order_of_the_paper(default_run: Runs) -> None:
    truth = default_run("985").truth
    onset = int(np.flatnonzero(truth["in_stall"])[0])
    near = slice(onset, onset + 30)
    flow, p31, p25 = (truth[name][near] for name in ("W25_kg_s", "P31_Pa", "P25_Pa"))
    assert flow[0] > 28.0
    assert flow.min() < 0.0
    assert p31[-1] < 0.8 * p31[0]
    # The spike in P25 comes with the fall of the flow and ends at the reversal.
    reversal = int(np.flatnonzero(flow < 0.0)[0])
    spike = int(np.argmax(p25[: reversal + 3]))
    assert p25[spike] > 1.2 * p25[0]
    assert spike <= reversal
    assert p25[spike : spike + 6].min() < 0.9 * p25[spike]


def test_t25_rises_in_stall_and_falls_in_recovery(default_run: Runs) -> None:
    truth = default_run("985").truth
    # Away from the reversals, where hot gas arrives at once, the slope tells the regime.
    slope = np.gradient(truth["T25_K"], 1e-3)[WINDOW]
    stalled = truth["in_stall"][WINDOW] > 0.0
    assert np.mean(slope[stalled]) > 0.0
    assert np.mean(slope[~stalled]) < 0.0
    assert np.corrcoef(truth["T25_K"][WINDOW], stalled)[0, 1] > 0.0


def test_cells_live_in_stall_only_and_at_90_percent_throughout(default_run: Runs) -> None:
    for name, always in (("985", False), ("90", True)):
        run = default_run(name)
        stalled = run.truth["in_stall"][WINDOW] > 0.0
        cells = run.truth["cell_amplitude"][WINDOW]
        assert np.mean(cells[stalled]) > 0.9
        free = cells[~stalled].min()
        assert free > 0.84 if always else free < 0.15
    assert default_run("90").test["segmentation"] == {"threshold_lbm_s": "none"}
    assert default_run("985").test["segmentation"] == {"threshold_lbm_s": 50.0}
    # Before the first stall there are none, at any speed.
    assert np.all(default_run("90").truth["cell_amplitude"][:150] == 0.0)


def test_t31_exceeds_the_acquisition_above_90_percent_only(default_run: Runs) -> None:
    for name in ("985", "985-second", "95"):
        run = default_run(name)
        high = run.test["limits"]["T31_A"][1]
        assert np.all(run.raw["T31_A"][:140] == high), name
    run = default_run("90")
    low, high = run.test["limits"]["T31_A"]
    assert np.all((run.raw["T31_A"] > low) & (run.raw["T31_A"] < high))
    assert 577.0 < CASES["985"].t31_limit_k[1] < 645.0  # type: ignore[index]


def test_nearly_all_codes_lie_within_the_converter(default_run: Runs) -> None:
    for name in CASES:
        raw = default_run(name).raw
        for channel in raw.channels:
            if channel.startswith("P"):
                codes = raw[channel][1_200:]
                assert np.mean((codes <= 0.0) | (codes >= 4095.0)) < 0.01, (name, channel)
