"""What the rig hides: nothing at the neutral size, no name in what is written, the right form."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from rig_records import rig_run

from comparisons.cli import main
from comparisons.rig import CASES, HIDEABLE, RigRun, SensorSettings, simulate, write_run
from comparisons.rig.hidden import (
    BRANCH_PHIS,
    BUMP_PHI,
    BUMP_WIDTH_PHI,
    HEAT_SOAK_S,
    LOW_FLOW_PHI,
    SECOND_CELL_ROTOR_FRAC,
    SETTLED_SPEED_FRAC,
    UNTOUCHED,
)
from surge_core.errors import InputError

Array = np.ndarray

IN_THE_PLANT = (
    "facility_heating",
    "speed_droop",
    "hysteresis",
    "reverse_flow_branch",
    "characteristic_shape",
    "asymmetric_lag",
    "flow_dependent_lag",
)
IN_THE_SENSORS = tuple(name for name in HIDEABLE if name not in IN_THE_PLANT)


def ideal_hidden(name: str, size: float | None = None) -> RigRun:
    return rig_run("985", sensors=SensorSettings.ideal(), hide=name, hide_size=size)


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def nominal_psi_p_qs(run: RigRun, case: str = "985") -> tuple[Array, Array]:
    """Return ψ'_QS as the case states it, in stall and blended, at the flows of a run."""
    plant, truth = CASES[case], run.truth
    share = (truth["Nc_frac"] - plant.stall_speeds[0]) / np.ptp(plant.stall_speeds)
    phi_s = plant.stall_phis[0] + share * np.ptp(plant.stall_phis)
    psi_s = plant.stall_psi_ps[0] + share * np.ptp(plant.stall_psi_ps)
    free = psi_s - plant.unstalled_droop * np.maximum(truth["phi"] - phi_s, 0.0) ** 2
    stalled = np.minimum(np.polynomial.polynomial.polyval(truth["phi"], plant.pressure_terms), free)
    blend = truth["stall_blend"]
    return stalled, blend * stalled + (1.0 - blend) * free


def in_stall(run: RigRun) -> Array:
    """Rows well in stall, where the blend of the branches is over."""
    return np.asarray((run.truth["stall_blend"] > 0.999_9) & (run.truth.time_s > 0.5))


@pytest.mark.parametrize("name", ["flow_inertia", "facility_heating", "bias_drift", "hysteresis"])
def test_what_is_written_holds_neither_name_nor_size(name: str, tmp_path: Path) -> None:
    size = UNTOUCHED[name] + 0.437_291 * (HIDEABLE[name].default - UNTOUCHED[name])
    run = simulate("985", duration_s=0.6, hide=name, hide_size=size)
    write_run(run, tmp_path / "run")
    files = [path for path in (tmp_path / "run").iterdir() if path.is_file()]
    assert sorted(path.name for path in files) == ["raw.csv", "test.toml"]
    written = b"\n".join(path.read_bytes() for path in files).decode("utf-8").lower()
    said = f"{run.raw.source} {run.raw.history} {dict(run.test)}".lower()
    words = [name, name.replace("_", " "), "hid", "effect", "alter", repr(size), f"{size:.5g}"]
    for word in words:
        assert word not in written + said, word
    with (tmp_path / "run" / "truth" / "truth.toml").open("rb") as file:
        hidden = tomllib.load(file)["hidden"]
    assert (hidden["effect"], hidden["size"]) == (name, size)


@pytest.mark.parametrize("name", IN_THE_SENSORS)
def test_a_sensor_leaves_the_plant_alone(name: str) -> None:
    for channel in ("phi", "psi_p", "P31_Pa", "T25_K"):
        assert np.array_equal(
            rig_run("985", hide=name).truth[channel], rig_run("985").truth[channel]
        )
    moved = {
        channel
        for channel in rig_run("985").raw.channels
        if not np.array_equal(rig_run("985", hide=name).raw[channel], rig_run("985").raw[channel])
    }
    expected = {
        "flow_inertia": (),
        "thermocouple_lag": ("T25",),
        "rotating_stall_ripple": ("P25", "P31"),
        "flow_noise": ("P25",),
    }.get(name, ("P31",))
    assert {channel[:3] for channel in moved} == set(expected)


@pytest.mark.parametrize(
    ("name", "lag_s", "channel"),
    [("thermocouple_lag", 0.2, "T25_A"), ("second_order_lag", 0.004, "P31_A_hub_forward")],
)
def test_a_slow_sensor_obeys_the_lag_that_nothing_states(
    name: str, lag_s: float, channel: str
) -> None:
    run, plain = ideal_hidden(name, lag_s), ideal_hidden("flow_inertia")
    felt, gas = run.raw[channel], plain.raw[channel]
    rate = (felt[2:] - felt[:-2]) / 2e-3
    assert rms(felt[1:-1] + lag_s * rate - gas[1:-1]) < 0.05 * rms(felt - gas)
    assert run.test == plain.test | {"compressor": run.test["compressor"]}


def test_a_drifting_transducer_scales_or_shifts_what_it_feels() -> None:
    plain = ideal_hidden("flow_inertia")
    gain, shift = ideal_hidden("sensitivity_drift", -0.02), ideal_hidden("bias_drift", 0.02)
    time_s, counts_per_volt = plain.raw.time_s, 4096.0 / 10.0
    for name in ("P31_A_tip_forward", "P31_B_hub_aft"):
        zero = plain.test["channels"][name]["zero_count"]
        ratio = (gain.raw[name] - zero) / (plain.raw[name] - zero)
        assert ratio == pytest.approx(1.0 - 0.02 * time_s, rel=1e-9)
        moved = shift.raw[name] - plain.raw[name]
        assert moved == pytest.approx(0.02 * counts_per_volt * time_s, abs=1e-9)


def test_late_channels_are_those_of_so_many_samples_before() -> None:
    samples = 12
    run, plain = ideal_hidden("transport_delay", 0.012), ideal_hidden("flow_inertia")
    for name in ("P31_A_tip_forward", "P31_B_hub_aft"):
        assert run.raw[name][samples:] == pytest.approx(plain.raw[name][:-samples], abs=1e-6)
        assert run.raw[name][:samples] == pytest.approx(plain.raw[name][0])


def test_second_cells_have_the_amplitude_stated() -> None:
    plain = ideal_hidden("flow_inertia")
    swings = []
    for size in (0.3, 0.6):
        run = ideal_hidden("rotating_stall_ripple", size)
        swings.append(run.raw["P25_A_tip_forward"] - plain.raw["P25_A_tip_forward"])
    rows = in_stall(plain) & (plain.truth["W25_kg_s"] > 5.0)
    assert rms(swings[1][rows]) == pytest.approx(2.0 * rms(swings[0][rows]), rel=0.02)
    spectrum = np.abs(np.fft.rfft(np.hanning(2_000) * swings[1][1_000:3_000]))
    expected_hz = SECOND_CELL_ROTOR_FRAC * CASES["985"].rotor_speed_rpm / 60.0
    # The line has sidebands at the surge frequency, which switches the cells.
    assert 0.5 * np.argmax(spectrum) == pytest.approx(expected_hz, abs=1.0)


def test_wake_noise_is_on_the_flow_and_not_on_the_total_pressure() -> None:
    run, plain = ideal_hidden("flow_noise", 0.4), ideal_hidden("flow_inertia")
    forward_flow = plain.truth["W25_kg_s"] > 0.5
    pairs = [f"P25_{rake}_{place}" for rake in "AB" for place in ("tip", "hub")]
    noise = []
    for pair in pairs:
        total, wake = f"{pair}_forward", f"{pair}_aft"
        assert np.array_equal(run.raw[total][forward_flow], plain.raw[total][forward_flow])
        moved = (run.raw[wake] - plain.raw[wake])[forward_flow]
        drop = (plain.raw[total] - plain.raw[wake])[forward_flow]
        clear = drop > 5.0
        noise.append(moved[clear] / drop[clear] if pair == pairs[0] else moved / drop.mean())
    n = noise[0].size
    # Correlated over some two samples of 1 ms.
    assert np.std(noise[0]) == pytest.approx(0.4, rel=4.0 / np.sqrt(n))
    assert abs(np.mean(noise[0])) < 4.0 * 0.4 * np.sqrt(2.0 / n)
    between = [abs(np.corrcoef(noise[1], noise[i])[0, 1]) for i in (2, 3)]
    assert max(between) < 6.0 * np.sqrt(2.0 / n)


def test_heat_soak_lowers_the_whole_characteristic() -> None:
    run = rig_run("985", hide="facility_heating")
    kept = 1.0 - 0.12 * (1.0 - np.exp(-run.truth.time_s / HEAT_SOAK_S))
    assert run.truth["psi_p_qs"] == pytest.approx(kept * nominal_psi_p_qs(run)[1], rel=1e-9)


def test_speed_scales_the_stalled_characteristic() -> None:
    run = rig_run("985", hide="speed_droop")
    rows = in_stall(run)
    speed = run.truth["Nc_frac"] / (SETTLED_SPEED_FRAC * CASES["985"].corrected_speed_frac)
    ratio = (run.truth["psi_p_qs"] / nominal_psi_p_qs(run)[0])[rows]
    # The polynomial is not cut off by the unstalled branch at these flows.
    low = run.truth["phi"][rows] < 0.15
    assert ratio[low] == pytest.approx((speed**-2.0)[rows][low], rel=2e-3)
    assert np.ptp(ratio[low]) > 0.05


def test_deep_stall_holds_until_the_flow_is_back() -> None:
    run = rig_run("985", hide="hysteresis")
    phi, deep, state = run.truth["phi"], [], 0.0
    for value in phi:
        state = 1.0 if value < BRANCH_PHIS[0] else 0.0 if value > BRANCH_PHIS[1] else state
        deep.append(state)
    rows = in_stall(run)
    lost = (nominal_psi_p_qs(run)[0] - run.truth["psi_p_qs"])[rows]
    # The rows of 1 ms at which the state changes may differ by one.
    assert np.mean(np.abs(lost - 0.15 * np.array(deep)[rows]) < 1e-3) > 0.99
    # One flow, two branches: both are met.
    middle = (phi[rows] > 0.03) & (phi[rows] < 0.09)
    assert 0.1 < np.mean(lost[middle] > 0.1) < 0.9


@pytest.mark.parametrize("case", ["985", "90"])
def test_the_loss_in_reverse_has_the_changed_size(case: str) -> None:
    run = rig_run(case, hide="reverse_flow_branch")
    loss = run.truth["psi_p"] - run.truth["psi_p_lagged"]
    calm = (run.truth["W25_kg_s"] < 0.0) & (np.abs(run.truth["dW25_kg_s2"]) < 30.0)
    expected = 2.5 * CASES[case].reverse_loss * run.truth["phi"] ** 2
    assert np.count_nonzero(calm) > 100
    assert loss[calm] == pytest.approx(expected[calm], rel=0.02)
    assert run.truth_parameters["reverse_loss"] == CASES[case].reverse_loss
    # Reversed flow meets more, and goes less deep.
    plain = rig_run(case).truth["phi"]
    assert run.truth["phi"][1_500:].min() > 0.85 * plain[1_500:].min()


def test_the_characteristic_has_a_bell() -> None:
    run = rig_run("985", hide="characteristic_shape")
    rows = in_stall(run) & (run.truth["phi"] < 0.15)
    bell = (run.truth["psi_p_qs"] - nominal_psi_p_qs(run)[0])[rows]
    phi = run.truth["phi"][rows]
    assert bell == pytest.approx(
        0.2 * np.exp(-(((phi - BUMP_PHI) / BUMP_WIDTH_PHI) ** 2)), abs=2e-3
    )


def test_two_time_constants_by_the_way_of_the_flow_and_by_its_size() -> None:
    for name, split in (("asymmetric_lag", "way"), ("flow_dependent_lag", "size")):
        run = rig_run("985", hide=name)
        truth = run.truth
        state, tau_s = truth["psi_p_lagged"], CASES["985"].tau_s
        rate = np.gradient(state, 1e-3)
        rows = in_stall(run) & (np.abs(rate) > 2.0)
        local = ((truth["psi_p_qs"] - state) / np.where(rate == 0.0, 1.0, rate))[rows]
        slope, phi = np.gradient(truth["phi"], 1e-3)[rows], truth["phi"][rows]
        if split == "way":
            parts = {1.0 + 0.3: slope > 0.3, 1.0 - 0.3: slope < -0.3}
        else:
            low, high = LOW_FLOW_PHI - 0.01, LOW_FLOW_PHI + 0.01
            parts = {1.0 + 0.5: phi < low, 1.0: phi > high}
        for factor, part in parts.items():
            assert np.count_nonzero(part) > 50
            assert np.median(local[part]) == pytest.approx(factor * tau_s, rel=0.02)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"hide": "inertia"}, "hide: expected one of transport_delay, facility_heating"),
        (
            {"hide": "flow_inertia", "hide_size": 30.0},
            "0.2 to 3 (stated over true ∫dx/A), found 30",
        ),
        ({"hide_size": 1.5}, "hide_size: expected a size only with the name"),
    ],
)
def test_what_cannot_be_hidden_is_said_in_one_sentence(
    arguments: dict[str, object], words: str
) -> None:
    with pytest.raises(InputError) as caught:
        simulate(**{"case": "985", **arguments})  # type: ignore[arg-type]
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_command_line_hides_and_keeps_quiet(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "record"
    arguments = ["simulate", "--duration", "0.5", "--hide", "flow_inertia", "--hide-size", "1.2"]
    assert main([*arguments, "-o", str(out)]) == 0
    assert "inertia" not in capsys.readouterr().out
    with (out / "test.toml").open("rb") as file:
        assert tomllib.load(file)["compressor"]["inertia_per_m"] == pytest.approx(12.848)
    with (out / "truth" / "truth.toml").open("rb") as file:
        assert tomllib.load(file)["hidden"]["size"] == 1.2
