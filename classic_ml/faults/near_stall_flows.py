"""Are the flows of both planes, in the steady flow near stall, those of one machine?"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from classic_ml.calibration import near_stall_rows
from classic_ml.coefficients import flow_coefficient
from classic_ml.columns.workspace import IN_MEMORY
from classic_ml.faults.choice import choose_channels
from classic_ml.faults.near_stall_checks import check_pairs, check_steady
from classic_ml.faults.near_stall_levels import beside_the_record, unusual_machine
from classic_ml.flow import physical_flow
from classic_ml.planes import plane_flows
from classic_ml.readers.test_description import TestDescription
from classic_ml.records import Channel, LedgerEntry, Record
from surge_core.errors import InputError

__all__ = ["check_flows"]

# In the steady flow near stall the planes pass the same but for bleeds of a few per cent (0.3 % on
# the independent record); exchanged areas are a factor of twenty.
FLOWS_DIFFER = 0.05
FLOWS_REFUSED = 0.2
# An axial compressor near stall is at φ of 0.3 to 0.6, a centrifugal one above 0.1.
NEAR_STALL_PHI = (0.1, 1.5)


def check_flows(record: Record, test: TestDescription) -> LedgerEntry:
    """Check φ, and the flow of one plane against the other's, in the steady flow near stall.

    Parameters
    ----------
    record : Record
        Calibrated and matched.
    test : TestDescription
        Its test.

    Returns
    -------
    LedgerEntry
        What was found.

    Raises
    ------
    InputError
        When the flow is not steady, pairs of one plane contradict each other, W25 and W31 differ
        by more than a fifth, or no compressor has such a φ near stall.
    """
    if test.near_stall_shifts:
        return LedgerEntry("near-stall flow", "not known: the reading is not in this record")
    steady = _steady(record, test)
    check_steady(steady, test)
    # No row is in a window yet: only what cannot be matched is left out here.
    steady = choose_channels(steady, test, slice(0, 0))
    flags = check_pairs(steady, test)
    steady = plane_flows(steady, test)
    inlet, leaving = _steady_flows(steady, test)
    how = "" if "W31_kg_s" in steady else " (with the facility's T31)"
    differ = abs(leaving / inlet - 1.0)
    areas = f"area_m2 of [planes.25] and [planes.31] in {test.source}"
    if differ > FLOWS_REFUSED and not how:
        raise InputError(
            f"{record.source}: flow near stall",
            expected=f"W25 and W31 within {FLOWS_REFUSED:.0%} of each other",
            found=f"{inlet:.4g} and {leaving:.4g} kg/s",
            remedy=f"check {areas} ({test.areas_m2[25]:g} and {test.areas_m2[31]:g} m²)",
        )
    phi = _steady_phi(steady, test)
    flags += (*unusual_machine(test, phi), *beside_the_record(record, test))
    if differ > FLOWS_DIFFER:
        flags += (
            f"near stall W25 is {inlet:.4g} kg/s and W31 {leaving:.4g} kg/s{how}: check {areas}",
        )
    return LedgerEntry(
        "near-stall flow",
        f"φ {phi:.3f}, W25 {inlet:.2f} kg/s, W31 {leaving:.2f} kg/s{how}",
        {"phi": round(phi, 4), "W25_kg_s": round(inlet, 4), "W31_kg_s": round(leaving, 4)},
        flags=flags,
    )


def _steady(record: Record, test: TestDescription) -> Record:
    """Return the tenth of a second near stall, which needs no files."""
    rows = near_stall_rows(record, test)
    return replace(
        record,
        channels={n: Channel(n, c.values[rows], c.unit) for n, c in record.channels.items()},
        start_s=record.time_at_s(rows.start),
        workspace=IN_MEMORY,
    )


def _steady_phi(steady: Record, test: TestDescription) -> float:
    """Return the mean φ, or refuse one that no compressor has."""
    columns = steady["Wc25_kg_s"], steady["T25_K"]
    area_m2, speed_m_s = test.areas_m2[25], test.rotor_velocity_m_s
    phi = float(np.mean(flow_coefficient(*columns, area_m2, speed_m_s, test.compressor)))
    if NEAR_STALL_PHI[0] <= phi <= NEAR_STALL_PHI[1]:
        return phi
    raise InputError(
        f"{steady.source}: φ near stall",
        expected=f"{NEAR_STALL_PHI[0]:g} to {NEAR_STALL_PHI[1]:g}",
        found=f"{phi:.3g}",
        # The area is not among them: it cancels between Eq 3 and its inverse.
        remedy=f"check rotor_speed_rpm and mean_radius_m in {test.source}, and the zero and "
        "calibrate readings",
    )


def _steady_flows(steady: Record, test: TestDescription) -> tuple[float, float]:
    """Return W25 and W31, the latter with the facility's T31 where no thermocouple counts."""
    inlet = float(np.mean(steady["W25_kg_s"]))
    if "W31_kg_s" in steady:
        return inlet, float(np.mean(steady["W31_kg_s"]))
    exit_K = np.full(steady.n_samples, test.near_stall.temperature_K(31))
    return inlet, float(np.mean(physical_flow(steady["Wc31_kg_s"], steady["P31_Pa"], exit_K)))
