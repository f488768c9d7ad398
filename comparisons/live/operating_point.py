"""Counts to operating point, causally: each row from itself and the rows before it.

This is the chain of `sindy-surge reduce --phase causal` up to Eq 5 and 7, over the last rows: the
same calibration, one pass of the same low-pass over every channel, the same averages. dW25/dt in
ψ' is a central difference, so that the operating point is known one row late.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from classic_ml.calibration import calibrate, near_stall_match
from classic_ml.coefficients import coefficients
from classic_ml.filters import filter_channels, phase_delay_s
from classic_ml.flow import local_flows, plane_averages
from classic_ml.io import TestDescription
from classic_ml.records import Record

# The low-pass of the reduction (ReductionSettings), run once.
ORDER, CUTOFF_HZ = 3, 48.0
# The slowest pole of that low-pass decays by exp(-150 t): after so long to one part in 1e16.
SETTLED_S = 0.25
# The surge frequencies at which the delay is stated.
SURGE_HZ = 10.0
NEEDED = ("P25_Pa", "P31_Pa", "T25_K", "W25_kg_s", "Wc25_kg_s")


def low_pass_delay_s(rate_hz: float) -> float:
    """Return by how much one pass of the low-pass is late at surge frequencies.

    Parameters
    ----------
    rate_hz : float
        Sample rate.

    Returns
    -------
    float
        Phase delay at 10 Hz, in seconds; 0 for records too slow to be filtered.
    """
    if not _is_filtered(rate_hz):
        return 0.0
    return phase_delay_s(SURGE_HZ, rate_hz, order=ORDER, cutoff_hz=CUTOFF_HZ)


def _is_filtered(rate_hz: float) -> bool:
    # A record too slow for the low-pass has nothing above it to be taken out.
    return rate_hz > 2.0 * CUTOFF_HZ


def points_of(record: Record, test: TestDescription, first: int) -> pd.DataFrame:
    """Return the operating points of rows, but for the last one.

    Parameters
    ----------
    record : Record
        Rows as read; those before the first one asked for are what the low-pass settles on.
    test : TestDescription
        The test; matched at near stall where it states the shifts.
    first : int
        First row that is asked for.

    Returns
    -------
    DataFrame
        Facility clock ``time_s``; corrected inlet flow ``Wc25_kg_s``, ``P31_Pa`` and
        ``pressure_ratio`` P31/P25; φ, ψ' and corrected speed: ``phi``, ``psi_p``, ``Nc_frac``.

    Raises
    ------
    InputError
        When a row has no operating point.
    """
    shifts = near_stall_match(record, test)[0] if test.near_stall_shifts else None
    matched = calibrate(record, test, shifts)
    if _is_filtered(test.sample_rate_hz):
        names = tuple(name for name in test.channel_names if name in matched)
        matched = filter_channels(matched, names, order=ORDER, cutoff_hz=CUTOFF_HZ, phase="causal")
    averages = plane_averages(local_flows(matched, test), test)
    needed = replace(averages, channels={name: averages.channel(name) for name in NEEDED})
    found = coefficients(needed, test)
    names = ("Wc25_kg_s", "P31_Pa", "phi", "psi_p", "Nc_frac")
    points = pd.DataFrame({name: found[name] for name in names})
    points["time_s"] = record.start_s + np.arange(record.n_samples) / record.sample_rate_hz
    points["pressure_ratio"] = found["P31_Pa"] / found["P25_Pa"]
    return points[first:-1]
