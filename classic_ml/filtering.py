"""Butterworth low-pass of the measured channels, alike on every one of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from classic_ml.columns.workspace import IN_MEMORY, Workspace, blocks, evaluated
from classic_ml.errors import InputError
from classic_ml.filter_kernels import CHANNELS, run_sections
from classic_ml.records import Channel, FloatArray, LedgerEntry, Record

__all__ = ["butterworth_gain", "filter_channels", "low_pass", "period_average", "phase_delay_s"]


def _sections(order: int, cutoff_hz: float, sample_rate_hz: float) -> FloatArray:
    from scipy.signal import butter

    if not 0.0 < cutoff_hz < 0.5 * sample_rate_hz:
        raise InputError(
            "cutoff_hz",
            expected=f"above 0 and below half the sample rate ({0.5 * sample_rate_hz:g} Hz)",
            found=f"{cutoff_hz:g}",
        )
    return np.asarray(butter(order, cutoff_hz, fs=sample_rate_hz, output="sos"), dtype=np.float64)


def low_pass(
    values: FloatArray,
    sample_rate_hz: float,
    *,
    order: int,
    cutoff_hz: float,
    phase: str,
    workspace: Workspace = IN_MEMORY,
) -> FloatArray:
    """Filter one signal with a Butterworth low-pass.

    Parameters
    ----------
    values : ndarray of shape (n,)
        Uniformly sampled signal.
    sample_rate_hz : float
        Samples a second.
    order : int
        Order of the filter; the paper used 3 and 5.
    cutoff_hz : float
        Frequency of the −3 dB point of one pass; the paper used 48 Hz.
    phase : {"zero", "causal", "none"}
        ``"zero"`` runs forth and back: no delay, and twice the attenuation in dB (−6 dB at the
        cut-off). ``"causal"`` runs once, as the paper's, and delays. ``"none"`` does nothing.
    workspace : Workspace
        Where the result lies.

    Returns
    -------
    ndarray of shape (n,)
        The filtered signal, read-only. The causal filter starts from the steady state of the first
        sample; the one that runs forth and back is scipy's ``sosfiltfilt``.

    Raises
    ------
    ValueError
        When a signal that is to be filtered forth and back is no longer than a few samples.
    """
    signal = np.asarray(values, dtype=np.float64)
    if phase == "none":
        return signal
    sections = _sections(order, cutoff_hz, sample_rate_hz)
    return _filtered([signal], sections, phase, workspace)[0]


def _filtered(
    columns: Sequence[FloatArray], sections: FloatArray, phase: str, workspace: Workspace
) -> list[FloatArray]:
    """Filter columns of one length, so many at a time as the inner loop takes."""
    from scipy.signal import sosfilt_zi

    outputs = [workspace.column(column.size) for column in columns]
    rest = np.asarray(sosfilt_zi(sections), dtype=np.float64)
    for first in range(0, len(columns), CHANNELS):
        chosen = slice(first, first + CHANNELS)
        _filter_together(columns[chosen], outputs[chosen], (sections, rest), phase, workspace)
    for output in outputs:
        output.setflags(write=False)
    return outputs


def _filter_together(
    columns: Sequence[FloatArray],
    outputs: Sequence[FloatArray],
    design: tuple[FloatArray, FloatArray],
    phase: str,
    workspace: Workspace,
) -> None:
    """Filter up to five columns block by block, forth and then back over what came out.

    ``design`` holds the sections and their state behind a long constant of 1.
    """
    sections, rest = design
    # Where there are fewer, the last one is done over and over, with the same result.
    inputs = [*columns, *[columns[-1]] * (CHANNELS - len(columns))]
    results = [*outputs, *[outputs[-1]] * (CHANNELS - len(outputs))]
    n = inputs[0].size

    def run(values: Sequence[FloatArray], to: Sequence[FloatArray], backward: bool = False) -> None:
        run_sections(sections, state, tuple(values), tuple(to), backward)

    def put(rows: slice, parts: Sequence[FloatArray]) -> None:
        # The parts that are done over and over come last.
        for output, part in zip(outputs, parts, strict=False):
            workspace.put(output, rows, part)
        workspace.release()

    if phase == "zero":
        before, behind = _mirrored(inputs, sections)
        state = _steady_state(rest, [b[0] for b in before])
        run(before, [np.empty(b.size) for b in before])
    else:
        state = _steady_state(rest, [c[0] for c in inputs])
    for rows in blocks(n):
        parts = [np.empty(rows.stop - rows.start) for _ in inputs]
        run([_read_only(c[rows]) for c in inputs], parts)
        put(rows, parts)
    if phase != "zero":
        return
    ends = [np.empty(b.size) for b in behind]
    run(behind, ends)
    state = _steady_state(rest, [e[-1] for e in ends])
    run([_read_only(e) for e in ends], [np.empty(e.size) for e in ends], backward=True)
    for rows in reversed(list(blocks(n))):
        parts = [np.empty(rows.stop - rows.start) for _ in inputs]
        run([_read_only(o[rows]) for o in results], parts, backward=True)
        put(rows, parts)


def _steady_state(rest: FloatArray, levels: Sequence[float]) -> FloatArray:
    """Return the state of the filter behind a long constant, for each of the channels."""
    return np.asarray(rest[:, :, np.newaxis] * np.asarray(levels))


def _mirrored(
    columns: Sequence[FloatArray], sections: FloatArray
) -> tuple[list[FloatArray], list[FloatArray]]:
    """Continue signals beyond both ends by their point reflection there, as ``sosfiltfilt`` does.

    Three times as many rows as the filter, written as one quotient, has coefficients.
    """
    without = min(np.count_nonzero(sections[:, 2] == 0), np.count_nonzero(sections[:, 5] == 0))
    edge = 3 * (2 * len(sections) + 1 - int(without))
    if columns[0].size <= edge:
        raise ValueError(
            f"a signal that is filtered forth and back must have more than {edge} samples, found "
            f"{columns[0].size}"
        )
    before = [_read_only(2.0 * c[0] - c[edge:0:-1]) for c in columns]
    behind = [_read_only(2.0 * c[-1] - c[-2 : -(edge + 2) : -1]) for c in columns]
    return before, behind


def _read_only(values: FloatArray) -> FloatArray:
    """Return the values as a contiguous array of the one type that the inner loop is made for."""
    part = np.ascontiguousarray(values).view()
    part.setflags(write=False)
    return part


def period_average(
    values: FloatArray,
    period_s: float,
    sample_rate_hz: float,
    *,
    workspace: Workspace = IN_MEMORY,
) -> FloatArray:
    """Return the centred moving average over exactly one period.

    It has a null at 1/period and at all its harmonics, and no delay.

    Parameters
    ----------
    values : ndarray of shape (n,)
        Uniformly sampled signal.
    period_s : float
        Width of the average; the ends of the window get fractional weights.
    sample_rate_hz : float
        Samples a second.
    workspace : Workspace
        Where the result lies.

    Returns
    -------
    ndarray of shape (n,)
        The averaged signal, read-only; near the ends of the record over what there is.
    """
    width = period_s * sample_rate_hz
    side = max(0, int(np.ceil(0.5 * (width - 1.0))))
    signal = np.asarray(values, dtype=np.float64)

    def average(rows: slice) -> FloatArray:
        return _averaged(signal, rows, width, side) if side else signal[rows]

    return evaluated(workspace, signal.size, average)


def _averaged(values: FloatArray, rows: slice, width: float, side: int) -> FloatArray:
    """Return some rows of the moving average over ``width`` samples, ``side`` to each side."""
    n = rows.stop - rows.start
    first, stop = max(0, rows.start - side), min(values.size, rows.stop + side)
    around = values[first:stop]
    whole = around.size == n + 2 * side
    if not whole:
        around = np.zeros(n + 2 * side)
        around[first - rows.start + side : stop - rows.start + side] = values[first:stop]
    end_weight = 0.5 * (width - (2 * side - 1))
    added = around[:n] + around[2 * side :]
    added *= end_weight
    added += _window_sums(around[1:-1], 2 * side - 1)
    # How many samples are inside of the record, without the ends of the window, and of those.
    inner: int | NDArray[np.int64] = 2 * side - 1
    ends: int | NDArray[np.int64] = 2
    if not whole:
        row = np.arange(rows.start, rows.stop)
        behind = values.size - 1 - row
        inner = np.minimum(row, side - 1) + np.minimum(behind, side - 1) + 1
        ends = (row >= side).astype(np.int64) + (behind >= side)
    added /= inner + end_weight * ends
    return added


def _window_sums(values: FloatArray, length: int) -> FloatArray:
    """Return the sum over each window of ``length`` samples.

    From the sums over 1, 2, 4, … samples, as many as the binary digits of the length: whatever
    lies around a window, its samples are added in one order.
    """
    n = values.size - length + 1
    total: FloatArray | None = None
    doubled, size, at = values, 1, 0
    while True:
        if length & size:
            part = doubled[at : at + n]
            total = part if total is None else total + part
            at += size
        if 2 * size > length:
            assert total is not None
            return total
        doubled = doubled[:-size] + doubled[size:]
        size *= 2


def butterworth_gain(
    frequency_hz: FloatArray, sample_rate_hz: float, *, order: int, cutoff_hz: float
) -> FloatArray:
    """Return the gain of one pass of the filter at the given frequencies (1 at rest)."""
    from scipy.signal import sosfreqz

    sections = _sections(order, cutoff_hz, sample_rate_hz)
    _, response = sosfreqz(sections, worN=np.atleast_1d(frequency_hz), fs=sample_rate_hz)
    return np.abs(response)


def phase_delay_s(
    frequency_hz: float, sample_rate_hz: float, *, order: int, cutoff_hz: float
) -> float:
    """Return the phase delay of one causal pass at a frequency, in seconds."""
    from scipy.signal import sosfreqz

    sections = _sections(order, cutoff_hz, sample_rate_hz)
    grid = np.linspace(0.0, frequency_hz, 512)
    _, response = sosfreqz(sections, worN=grid, fs=sample_rate_hz)
    return float(-np.unwrap(np.angle(response))[-1] / (2.0 * np.pi * frequency_hz))


def filter_channels(
    record: Record, names: tuple[str, ...], *, order: int, cutoff_hz: float, phase: str
) -> Record:
    """Filter channels of a record, all with the same filter.

    Pressures and temperatures alike: a delay that differs between φ and ψ' reads as dynamics.

    Parameters
    ----------
    record : Record
        The record.
    names : tuple of str
        Channels to filter.
    order, cutoff_hz, phase
        See :func:`low_pass`.

    Returns
    -------
    Record
        The record with those channels filtered.
    """
    rate = record.sample_rate_hz
    parameters: dict[str, str | int | float | bool] = {"phase": phase}
    if phase == "none":
        return record.after(LedgerEntry("filter", "no low-pass filter", parameters))
    sections = _sections(order, cutoff_hz, rate)
    columns = _filtered([record[name] for name in names], sections, phase, record.workspace)
    filtered = [
        Channel(name, column, record.channel(name).unit)
        for name, column in zip(names, columns, strict=True)
    ]
    parameters |= {"order": order, "cutoff_hz": cutoff_hz}
    delay_ms = 1e3 * phase_delay_s(0.2 * cutoff_hz, rate, order=order, cutoff_hz=cutoff_hz)
    word = (
        "forth and back, without delay"
        if phase == "zero"
        else f"causal, which delays surge frequencies by {delay_ms:.1f} ms"
    )
    entry = LedgerEntry(
        "filter",
        f"Butterworth of order {order} at {cutoff_hz:g} Hz on {len(names)} channels, {word}",
        parameters,
    )
    return record.after(entry, add=filtered)
