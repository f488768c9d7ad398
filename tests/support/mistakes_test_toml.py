"""Mistakes in test.toml: what was tested, in which units, and how it was calibrated."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mistake import FLAGGED, REFUSED, UNNOTICED, Mistake, Spoil
from spoiling import toml

__all__ = ["CALIBRATIONS", "MACHINES"]

PROBE = "P31_B_hub_aft"
CHANNEL = f"channels/{PROBE}"
HERE = ("test.toml", f"channels.{PROBE}")
SAME = (1e-9, 1e-9)
SOURCE = "test.toml"


def _exchanged(tables: dict[str, object], first: str, second: str) -> dict[str, object]:
    return tables | {first: tables[second], second: tables[first]}


def _zero_calibrate(channel: dict[str, object]) -> dict[str, object]:
    return _exchanged(channel, "zero_count", "calibrate_count")


def _facing(channels: dict[str, dict[str, object]]) -> dict[str, dict[str, object]]:
    other = {"forward": "aft", "aft": "forward"}
    return {
        name: channel | ({"facing": other[str(channel["facing"])]} if "facing" in channel else {})
        for name, channel in channels.items()
    }


def _all_pressures(key: str, change: Callable[[float], float]) -> Spoil:
    def edit(channels: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
        return {
            name: channel | ({key: change(channel[key])} if key in channel else {})
            for name, channel in channels.items()
        }

    return toml(("channels", edit))


CALIBRATIONS = (
    Mistake(
        "zero-is-calibrate",
        "the zero and the calibrate reading of a channel are the same",
        REFUSED,
        (*HERE, "calibrate_count", "zero_count"),
        spoil=toml((f"{CHANNEL}/calibrate_count", 2050.0), (f"{CHANNEL}/zero_count", 2050.0)),
    ),
    Mistake(
        "zero-calibrate-exchanged",
        "zero and calibrate reading of a channel are exchanged",
        REFUSED,
        (PROBE, "zero and calibrate"),
        spoil=toml((CHANNEL, _zero_calibrate)),
    ),
    Mistake(
        "zero-calibrate-exchanged-all",
        "zero and calibrate readings of all channels are exchanged",
        REFUSED,
        ("P25_A_tip_forward", "zero and calibrate"),
        spoil=toml(
            (
                "channels",
                lambda t: {n: _zero_calibrate(c) if "zero_count" in c else c for n, c in t.items()},
            )
        ),
    ),
    Mistake(
        "sensitivity-negative",
        "the calibrate pressure of a channel has the wrong sign",
        REFUSED,
        (PROBE, "near stall"),
        spoil=toml((f"{CHANNEL}/calibrate_pressure_Pa", lambda p: -p)),
    ),
    Mistake(
        "calibrate-psi",
        "the calibrate pressure of a channel is in psi",
        REFUSED,
        (*HERE, "calibrate_pressure_Pa", "Pa", "66"),
        spoil=toml((f"{CHANNEL}/calibrate_pressure_Pa", 66.0)),
    ),
    Mistake(
        "calibrate-kpa-all",
        "the calibrate pressures of all channels are in kPa",
        REFUSED,
        ("test.toml", "calibrate_pressure_Pa", "kPa"),
        spoil=_all_pressures("calibrate_pressure_Pa", lambda p: p / 1e3),
    ),
    Mistake(
        "calibrate-zero",
        "the calibrate pressure of a channel is zero",
        REFUSED,
        (*HERE, "calibrate_pressure_Pa"),
        spoil=toml((f"{CHANNEL}/calibrate_pressure_Pa", 0.0)),
    ),
    Mistake(
        "calibrate-missing",
        "the calibrate reading of a channel is missing",
        REFUSED,
        (*HERE, "calibrate_count", "nothing"),
        spoil=toml((f"{CHANNEL}/calibrate_count", ...)),
    ),
    Mistake(
        "calibrate-off-scale",
        "the calibrate reading is beyond the converter's range",
        REFUSED,
        (*HERE, "calibrate_count", "4095"),
        spoil=toml((f"{CHANNEL}/calibrate_count", 5000.0)),
    ),
    Mistake(
        "calibrate-ten-per-cent",
        "the calibrate readings of a pair were taken with the wrong weight: 10 % off",
        FLAGGED,
        ("31_B_hub",),
        spoil=toml(
            (f"{CHANNEL}/calibrate_count", lambda c: c + 123.0),
            ("channels/P31_B_hub_forward/calibrate_count", lambda c: c + 123.0),
        ),
    ),
    Mistake(
        "calibrate-plane",
        "the calibrate pressure of all probes of plane 31 is a fifth too low",
        FLAGGED,
        ("all probes of plane 31 read", "calibrate_pressure_Pa"),
        why="they are off by one share near stall, which the match hides; the slopes stay wrong",
        spoil=toml(
            *(
                (f"channels/P31_{place}_{facing}/calibrate_pressure_Pa", lambda p: 0.8 * p)
                for place in ("A_tip", "A_hub", "B_tip", "B_hub")
                for facing in ("forward", "aft")
            )
        ),
    ),
    Mistake(
        "reference-missing",
        "the reference pressure of a channel is missing",
        REFUSED,
        (*HERE, "zoc_reference_Pa", "nothing"),
        spoil=toml((f"{CHANNEL}/zoc_reference_Pa", ...)),
    ),
    Mistake(
        "reference-zero",
        "the reference pressures are zero: the transducers were taken for absolute ones",
        REFUSED,
        ("near stall", "P25_A_tip_forward"),
        spoil=_all_pressures("zoc_reference_Pa", lambda p: 0.0),
    ),
    Mistake(
        "reference-psi",
        "the reference pressure of a channel is in psi",
        REFUSED,
        (PROBE, "zoc_reference_Pa"),
        spoil=toml((f"{CHANNEL}/zoc_reference_Pa", 110.0)),
    ),
    Mistake(
        "slope-per-cent",
        "the probe slope of a pair is in per cent",
        REFUSED,
        ("test.toml", "probe_slope", "110"),
        spoil=toml(
            ("channels/P25_A_tip_forward/probe_slope", 110.0),
            ("channels/P25_A_tip_aft/probe_slope", 110.0),
        ),
    ),
    Mistake(
        "slope-of-one-probe",
        "the two probes of a pair have different probe slopes",
        REFUSED,
        ("test.toml", "probe_slope", "1.5"),
        spoil=toml((f"{CHANNEL}/probe_slope", 1.5)),
    ),
    Mistake(
        "slope-offset-exchanged",
        "probe slope and probe offset of a pair are exchanged",
        REFUSED,
        ("test.toml", "channels.P25_A_tip"),
        spoil=toml(
            *(
                (
                    f"channels/P25_A_tip_{facing}",
                    lambda t: _exchanged(t, "probe_slope", "probe_offset"),
                )
                for facing in ("forward", "aft")
            )
        ),
    ),
    Mistake(
        "facing-exchanged",
        "test.toml calls all forward probes aft and the reverse",
        REFUSED,
        ("forward and aft exchanged",),
        spoil=toml(("channels", _facing)),
    ),
    Mistake(
        "facing-twice",
        "test.toml calls both probes of a pair forward",
        REFUSED,
        ("test.toml", "one forward and one aft", "rake B hub of plane 31"),
        spoil=toml((f"{CHANNEL}/facing", "forward")),
    ),
    Mistake(
        "recovery-per-cent",
        "the recovery factor of a thermocouple is in per cent",
        REFUSED,
        ("test.toml", "channels.T25_A", "recovery_factor"),
        spoil=toml(("channels/T25_A/recovery_factor", 99.4)),
    ),
    Mistake(
        "couple-time-ms",
        "the time constant of a thermocouple is in milliseconds",
        REFUSED,
        ("test.toml", "channels.T25_A", "time_constant_s", "ms"),
        spoil=toml(("channels/T25_A/time_constant_s", 10.0)),
    ),
)

MACHINES = (
    Mistake(
        "near-stall-outside",
        "[near_stall] lies outside the record",
        REFUSED,
        ("test.toml", "[near_stall]", "5 to 5.2 s"),
        spoil=toml(("near_stall/from_s", 5.0), ("near_stall/to_s", 5.2)),
    ),
    Mistake(
        "near-stall-reversed",
        "[near_stall] ends before it begins",
        REFUSED,
        ("test.toml", "[near_stall]", "to_s"),
        spoil=toml(("near_stall/from_s", 0.2), ("near_stall/to_s", 0.0)),
    ),
    Mistake(
        "near-stall-in-surge",
        "[near_stall] lies on the surge cycles",
        REFUSED,
        ("raw.csv", "near stall"),
        spoil=toml(("near_stall/from_s", 1.0), ("near_stall/to_s", 1.2)),
    ),
    Mistake(
        "near-stall-into-surge",
        "[near_stall] reaches into the surge",
        REFUSED,
        ("test.toml", "[near_stall]", "steady"),
        spoil=toml(("near_stall/to_s", 0.33)),
    ),
    Mistake(
        "near-stall-early",
        "[near_stall] begins five seconds before the record",
        FLAGGED,
        ("of which 0.2 s are in the record", "clock"),
        within=SAME,
        spoil=toml(("near_stall/from_s", -5.0)),
    ),
    Mistake(
        "facility-high",
        "the facility's reading of P31 is 15 % too high",
        FLAGGED,
        ("all probes of plane 31 read 13", "P31_Pa of [near_stall]"),
        spoil=toml(("near_stall/P31_Pa", lambda p: 1.15 * p)),
    ),
    Mistake(
        "facility-kpa",
        "the facility's reading of P25 is in kPa",
        REFUSED,
        ("test.toml", "[near_stall]", "P25_Pa", "kPa"),
        spoil=toml(("near_stall/P25_Pa", 55.0)),
    ),
    Mistake(
        "facility-celsius",
        "the facility's reading of T25 is in °C",
        REFUSED,
        ("test.toml", "[near_stall]", "T25_K", "°C"),
        spoil=toml(("near_stall/T25_K", -18.0)),
    ),
    Mistake(
        "facility-planes",
        "the facility's pressures of the two planes are exchanged",
        REFUSED,
        ("test.toml", "[near_stall]", "P31_Pa", "P25_Pa"),
        spoil=toml(("near_stall", lambda t: _exchanged(t, "P25_Pa", "P31_Pa"))),
    ),
    Mistake(
        "facility-temperatures",
        "the facility's temperatures of the two planes are exchanged",
        REFUSED,
        ("test.toml", "[near_stall]", "T31_K", "T25_K"),
        spoil=toml(("near_stall", lambda t: _exchanged(t, "T25_K", "T31_K"))),
    ),
    Mistake(
        "areas-exchanged",
        "the areas of the planes are exchanged",
        REFUSED,
        ("flow near stall", "area_m2"),
        spoil=toml(("planes", lambda t: _exchanged(t, "25", "31"))),
    ),
    Mistake(
        "area-cm2",
        "an area is in cm²",
        REFUSED,
        ("test.toml", "planes.25", "area_m2", "cm²"),
        spoil=toml(("planes/25/area_m2", 2938.0)),
    ),
    Mistake(
        "area-square-feet",
        "both areas are in square feet",
        REFUSED,
        ("P31", "dW25/dt", "inertia_per_m"),
        spoil=toml(("planes/25/area_m2", 3.1624), ("planes/31/area_m2", 0.69966)),
    ),
    Mistake(
        "speed-hz",
        "the rotor speed is in Hz",
        REFUSED,
        ("test.toml", "rotor_speed_rpm", "Hz"),
        spoil=toml(("test/rotor_speed_rpm", 190.0 / 2.0)),
    ),
    Mistake(
        "speed-rad-s",
        "the rotor speed is in rad/s",
        REFUSED,
        ("φ near stall", "rotor_speed_rpm"),
        spoil=toml(("test/rotor_speed_rpm", 1193.8)),
    ),
    Mistake(
        "speed-half",
        "half the rotor speed is given",
        FLAGGED,
        ("φ is 0.89", "rotor_speed_rpm"),
        spoil=toml(("test/rotor_speed_rpm", lambda n: 0.5 * n)),
    ),
    Mistake(
        "design-speed-rad-s",
        "the design speed is in rad/s",
        REFUSED,
        ("test.toml", "design_corrected_speed_rpm"),
        spoil=toml(("test/design_corrected_speed_rpm", 1288.4)),
    ),
    Mistake(
        "radius-mm",
        "the mean radius is in mm",
        REFUSED,
        ("test.toml", "mean_radius_m", "mm"),
        spoil=toml(("compressor/mean_radius_m", 280.0)),
    ),
    Mistake(
        "radius-inches",
        "the mean radius is in inches",
        REFUSED,
        ("test.toml", "mean_radius_m", "inches"),
        spoil=toml(("compressor/mean_radius_m", 11.02)),
    ),
    Mistake(
        "diameter",
        "the mean diameter is given for the radius",
        UNNOTICED,
        why="φ near stall of 0.22 and a quarter of ψ' are those of other machines; nothing in the "
        "record knows the wheel; the ledger prints φ near stall for those who know their machine",
        spoil=toml(("compressor/mean_radius_m", 0.56)),
    ),
    Mistake(
        "gamma-of-one-less",
        "γ is given as γ − 1",
        REFUSED,
        ("test.toml", "gamma", "0.4"),
        spoil=toml(("compressor/gamma", 0.4)),
    ),
    Mistake(
        "gas-constant-us",
        "the gas constant is in ft·lbf/(lbm·°R)",
        REFUSED,
        ("test.toml", "gas_constant_J_kg_K", "287.05"),
        spoil=toml(("compressor/gas_constant_J_kg_K", 53.35)),
    ),
    Mistake(
        "volume-litres",
        "the volume is in litres",
        REFUSED,
        ("test.toml", "internal_volume_m3", "litres"),
        spoil=toml(("compressor/internal_volume_m3", 80.0)),
    ),
    Mistake(
        "inertia-zero",
        "∫dx/A is zero: it was not known",
        REFUSED,
        ("test.toml", "inertia_per_m", "above 0", "inertia_factor"),
        spoil=toml(("compressor/inertia_per_m", 0.0)),
    ),
    Mistake(
        "inertia-per-foot",
        "∫dx/A is in 1/ft",
        UNNOTICED,
        why="no steady reading depends on it; `diagnose` finds it as flow_inertia where the record "
        "is good enough",
        spoil=toml(("compressor/inertia_per_m", 3.26)),
    ),
    Mistake(
        "window-outside",
        "[window] ends after the record",
        REFUSED,
        ("test.toml", "[window]", "0.000 to 2.000 s"),
        spoil=toml(("window/from_s", 0.8), ("window/to_s", 12.0)),
    ),
    Mistake(
        "window-reversed",
        "[window] ends before it begins",
        REFUSED,
        ("test.toml", "[window]", "to_s"),
        spoil=toml(("window/from_s", 1.9), ("window/to_s", 0.8)),
    ),
    Mistake(
        "window-before-surge",
        "[window] lies before the surge",
        REFUSED,
        ("test.toml", "[window]"),
        spoil=toml(("window/from_s", 0.02), ("window/to_s", 0.25)),
    ),
    Mistake(
        "window-short",
        "[window] is shorter than one surge cycle",
        FLAGGED,
        ("0.9 cycles of 140 ms", "too few"),
        spoil=toml(("window/from_s", 1.0), ("window/to_s", 1.12)),
    ),
    Mistake(
        "window-ms",
        "[window] is in milliseconds",
        REFUSED,
        ("test.toml", "[window]", "800 to 1900"),
        spoil=toml(("window/from_s", 800.0), ("window/to_s", 1900.0)),
    ),
    Mistake(
        "threshold-kg-s",
        "the threshold is in kg/s",
        FLAGGED,
        ("threshold",),
        spoil=toml(("segmentation/threshold_lbm_s", 22.68)),
    ),
    Mistake(
        "threshold-high",
        "the threshold is above every flow: all is in stall",
        FLAGGED,
        ("500 lbm/s",),
        spoil=toml(("segmentation/threshold_lbm_s", 500.0)),
    ),
    Mistake(
        "limits-reversed",
        "the limits of a channel are reversed",
        REFUSED,
        ("test.toml", "[limits]", "T31_A", "[low, high]"),
        spoil=toml(("limits/T31_A", [900.0, 200.0])),
    ),
    Mistake(
        "limits-unknown",
        "there are limits of a channel that is not there",
        REFUSED,
        ("test.toml", "[limits]", "T31_C"),
        spoil=toml(("limits/T31_C", [200.0, 900.0])),
    ),
    Mistake(
        "limits-celsius",
        "the limits of a thermocouple are in °C",
        FLAGGED,
        ("T31_A", "beyond its limits"),
        within=(0.01, 0.05),
        spoil=toml(("limits/T31_A", [0.0, 500.0])),
    ),
    Mistake(
        "limits-psi",
        "the limits of a pressure are in psi",
        FLAGGED,
        ("pair 31_B_hub", "beyond its limits"),
        within=(0.01, 0.05),
        spoil=toml((f"limits/{PROBE}", [0.0, 300.0])),
    ),
    Mistake(
        "limits-psi-all",
        "the limits of all tip probes of plane 25 are in psi",
        REFUSED,
        ("P25_A_tip", "beyond its limits", "last tip pair of plane 25", "psi", "[limits]"),
        spoil=toml(
            *(
                (f"limits/P25_{rake}_tip_{facing}", [5.0, 25.0])
                for rake in "AB"
                for facing in ("forward", "aft")
            )
        ),
    ),
)
