"""Inner loops from readings to Eq 3 and its inverse.

`calibration` and `airflow` have the equations to be read.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from classic_ml.columns.compiled_as_written import as_written
from classic_ml.columns.elementary import power_of
from surge_core.types import FloatArray

__all__ = ["change_scale", "invert_flow", "pair_flow", "pair_total"]

# Rows that go through Newton's steps together, until the slowest of them has arrived.
TOGETHER = 64
MOST_STEPS = 60
# Two counts in one number: the loop is a third slower with another one.
REFUSED = 1 << 32
ARRIVED = 1e-16
# More than half of the largest second derivative of Eq 3's right-hand side (1.37 for γ of 1.1 to
# 1.67): times the square of a step and over the slope it bounds what the step leaves.
CURVATURE = 1.0
# At the choke the slope of Eq 3 is zero; a step must stay finite there.
LEAST_SLOPE = 1e-6
# With γ of 1.4 the exponent of Eq 3 is 3, but for the rounding of γ.
DIATOMIC = 1e-12


@as_written
def change_scale(
    readings: NDArray[Any],
    start: float,
    step: float,
    zero: float,
    slope: float,
    reference: float,
    shift: float,
    out: FloatArray,
) -> None:
    """Compute ((start + readings · step) − zero)/slope + reference + shift.

    Parameters
    ----------
    readings : ndarray of shape (n,)
        Codes, or readings in a unit.
    start, step, zero, slope, reference, shift : float
        From codes to volts, from volts to pascal, and by how much these are moved.
    out : ndarray of shape (n,)
        Where the results go.
    """
    for k in range(readings.size):
        out[k] = ((start + readings[k] * step) - zero) / slope + reference + shift


@as_written
def pair_flow(
    forward_Pa: FloatArray,
    aft_Pa: FloatArray,
    gamma: float,
    slope: float,
    offset: float,
    constant_kg_s: float,
    reversed_above: float,
    flow_kg_s: FloatArray,
    total_Pa: FloatArray,
) -> tuple[int, int]:
    """Compute corrected flow and total pressure of one probe pair, Eq 1 to 3 in one go.

    Parameters
    ----------
    forward_Pa, aft_Pa : ndarray of shape (n,)
        Absolute pressures.
    gamma : float
        Ratio of the specific heats.
    slope, offset : float
        a and b of Eq 2.
    constant_kg_s : float
        A P_o √(γ/(R T_o)) of Eq 3.
    reversed_above : float
        As for :func:`pair_total`.
    flow_kg_s, total_Pa : ndarray of shape (n,)
        Where the results go.

    Returns
    -------
    tuple of int
        Rows with reversed flow; and rows with a pressure that is not above zero, whose results are
        none.
    """
    rise = (gamma - 1.0) / gamma
    fall = (gamma + 1.0) / (2.0 * (gamma - 1.0))
    half = 0.5 * (gamma - 1.0)
    counted = 0
    for k in range(forward_Pa.size):
        forward, aft = forward_Pa[k], aft_Pa[k]
        high = forward if forward > aft else aft
        low = aft if forward > aft else forward
        ratio = high / low
        square = 2.0 / (gamma - 1.0) * (power_of(ratio, rise) - 1.0)
        magnitude = slope * sqrt(square if square > 0.0 else 0.0) + offset
        # The sign is not known where the probes read alike, nor below a negative offset.
        magnitude = magnitude if magnitude > 0.0 and square > 0.0 else 0.0
        mach = magnitude if forward > aft else -magnitude
        # No comparison lets a NaN through: it comes back here.
        flow_kg_s[k] = mach + (ratio - ratio)
        total_Pa[k] = high
        counted += (1 if aft > reversed_above * forward else 0) + (REFUSED if low <= 0.0 else 0)
    # A loop for each way: with a choice in it none is done four rows at a time.
    if abs(fall - 3.0) < DIATOMIC:
        for k in range(flow_kg_s.size):
            mach = flow_kg_s[k]
            bracket = 1.0 + half * mach * mach
            flow_kg_s[k] = constant_kg_s * (mach / (bracket * bracket * bracket))
    else:
        for k in range(flow_kg_s.size):
            mach = flow_kg_s[k]
            flow_kg_s[k] = constant_kg_s * (mach / power_of(1.0 + half * mach * mach, fall))
    return counted % REFUSED, counted // REFUSED


@as_written
def pair_total(
    forward_Pa: FloatArray, aft_Pa: FloatArray, reversed_above: float, total_Pa: FloatArray
) -> tuple[int, int]:
    """Find the total pressure of one probe pair, for where nobody wants its flow.

    Parameters
    ----------
    forward_Pa, aft_Pa : ndarray of shape (n,)
        Absolute pressures.
    reversed_above : float
        Ratio of the aft to the forward pressure above which the flow is reversed.
    total_Pa : ndarray of shape (n,)
        Where the results go.

    Returns
    -------
    tuple of int
        As of :func:`pair_flow`.
    """
    counted = 0
    for k in range(forward_Pa.size):
        forward, aft = forward_Pa[k], aft_Pa[k]
        low = aft if forward > aft else forward
        total_Pa[k] = forward if forward > aft else aft
        counted += (1 if aft > reversed_above * forward else 0) + (REFUSED if low <= 0.0 else 0)
    return counted % REFUSED, counted // REFUSED


@as_written
def invert_flow(share: FloatArray, gamma: float, mach: FloatArray) -> None:
    """Find the subsonic Mach numbers m/(1 + (γ−1)/2 m²)^((γ+1)/(2(γ−1))) = share, by Newton.

    Each row takes its own steps, so that its result does not depend on the others.

    Parameters
    ----------
    share : ndarray of shape (n,)
        Corrected flows over the constant of Eq 3, no larger than at the choke; odd in the sign.
    gamma : float
        Ratio of the specific heats.
    mach : ndarray of shape (n,)
        Where the results go.
    """
    fall = (gamma + 1.0) / (2.0 * (gamma - 1.0))
    half = 0.5 * (gamma - 1.0)
    choked = (2.0 / (gamma + 1.0)) ** fall
    # First guess: exact at rest and at the choke, with the slopes there, as a function of
    # u = √(1 − share/choked), in which the choke is no singularity.
    linear = 1.0 - sqrt(0.5 * (gamma + 1.0))
    quadratic = 2.0 * choked - 1.0 - linear
    m, power = np.empty(TOGETHER), np.empty(TOGETHER)
    under_way = np.empty(TOGETHER, dtype=np.bool_)
    for start in range(0, share.size, TOGETHER):
        n = min(TOGETHER, share.size - start)
        for k in range(n):
            left = 1.0 - abs(share[start + k]) / choked
            u = sqrt(left if left > 0.0 else 0.0)
            m[k] = (1.0 - u) * (1.0 + u * (linear + u * quadratic))
            under_way[k] = True
        for _ in range(MOST_STEPS):
            if abs(fall - 3.0) < DIATOMIC:
                for k in range(n):
                    bracket = 1.0 + half * m[k] * m[k]
                    power[k] = bracket * bracket * bracket
            else:
                for k in range(n):
                    power[k] = power_of(1.0 + half * m[k] * m[k], fall)
            n_left = 0
            for k in range(n):
                bracket = 1.0 + half * m[k] * m[k]
                gradient = (1.0 - m[k] * m[k]) / (power[k] * bracket)
                gradient = gradient if gradient > LEAST_SLOPE else LEAST_SLOPE
                step = (m[k] / power[k] - abs(share[start + k])) / gradient
                after = m[k] - step
                after = after if after > 0.0 else 0.0
                after = after if after < 1.0 else 1.0
                m[k] = after if under_way[k] else m[k]
                arrived = CURVATURE * step * step < ARRIVED * gradient
                under_way[k] = under_way[k] and not arrived
                n_left += 1 if under_way[k] else 0
            if n_left == 0:
                break
        for k in range(n):
            signed = m[k] if share[start + k] >= 0.0 else -m[k]
            mach[start + k] = signed + (share[start + k] - share[start + k])
