"""Butterworth low-pass of the measured channels, alike on every one of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from classic_ml.columns.computed import as_column
from classic_ml.columns.workspace import IN_MEMORY, Workspace, blocks, evaluated
from classic_ml.filter_kernels import CHANNELS, run_sections
from classic_ml.records import Channel, LedgerEntry, Record
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = [
    "LocalFilter",
    "butterworth_gain",
    "channel_filter",
    "filter_channels",
    "filter_entry",
    "low_pass",
    "period_average",
    "phase_delay_s",
]


def _sections(order: int, cutoff_hz: float, sample_rate_hz: float) -> FloatArray:
    if not 0.0 < cutoff_hz < 0.5 * sample_rate_hz:
        raise InputError(
            "cutoff_hz",
            expected=f"above 0 and below half the sample rate ({0.5 * sample_rate_hz:g} Hz)",
            found=f"{cutoff_hz:g}",
        )
    # The bilinear transform of 1/∏(s − e^{iπ(2k + n + 1)/2n}), k = 0 … n−1, with its cut-off at
    # tan(π f_c/f_s). A dozen lines, since to load scipy's takes as long as to reduce ten minutes.
    warped = np.tan(np.pi * cutoff_hz / sample_rate_hz)
    sections = []
    for k in range((order - 1) // 2, -1, -1):
        angle = np.pi * (2 * k + order + 1) / (2 * order)
        if 2 * k + 1 == order:
            pole = (1.0 - warped) / (1.0 + warped)
            sections.append([0.5 * (1.0 - pole), 0.5 * (1.0 - pole), 0.0, 1.0, -pole, 0.0])
            continue
        damping = -2.0 * warped * np.cos(angle)
        whole = 1.0 + damping + warped**2
        gain = warped**2 / whole
        linear, square = 2.0 * (warped**2 - 1.0) / whole, (1.0 - damping + warped**2) / whole
        sections.append([gain, 2.0 * gain, gain, 1.0, linear, square])
    return np.array(sections)


def _rest(sections: FloatArray) -> FloatArray:
    """Return the state of each section, of unit gain at rest, behind a long constant of 1.

    Of the transposed direct form, shape (m, 2): what comes out is 1 as well.
    """
    second = sections[:, 2] - sections[:, 5]
    return np.stack((sections[:, 1] - sections[:, 4] + second, second), axis=1)


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
    signal = as_column(values)
    if phase == "none":
        return signal
    sections = _sections(order, cutoff_hz, sample_rate_hz)
    run = LocalFilter(lambda rows: [signal[rows]], signal.size, sections, phase)
    return _evaluated(run, signal.size, 1, workspace)[0]


Readings = Callable[[slice], Sequence[FloatArray]]

# What was so many times smaller than the signal no longer shows in its last bit.
FORGOTTEN = 2.0**-80
# Rows that are filtered at once. A constant of its own: the numbers depend on it in the last bit.
PIECE_ROWS = 65_536


class LocalFilter:
    """A low-pass that gives some rows of signals without having filtered all the others.

    A filter forgets: what it was fed longer ago than its slowest pole remembers is below the
    rounding. So each piece of :data:`PIECE_ROWS` rows is filtered by itself, with as many rows more
    before it, and behind it for the way back. A signal of one piece is filtered as by scipy's
    ``sosfiltfilt``, or by ``sosfilt`` from the steady state of its first sample.

    Parameters
    ----------
    readings : callable
        ``readings(rows)`` returns those rows of each signal.
    n_rows : int
        Length of the signals.
    sections : ndarray of shape (m, 6)
        Second-order sections.
    phase : {"zero", "causal"}
        Forth and back, or forth.

    Raises
    ------
    ValueError
        When signals that are to be filtered forth and back are no longer than a few samples.
    """

    def __init__(self, readings: Readings, n_rows: int, sections: FloatArray, phase: str) -> None:
        self._readings, self._n_rows = readings, n_rows
        self._sections, self._back = sections, phase == "zero"
        self._rest = _rest(sections)
        self._edge = _edge(sections) if self._back else 0
        if n_rows <= self._edge:
            raise ValueError(
                "a signal that is filtered forth and back must have more than "
                f"{self._edge} samples, found {n_rows}"
            )
        self._reach = _memory_rows(sections)
        # A narrow filter remembers long; its pieces are no shorter than that.
        self._piece_rows = max(PIECE_ROWS, self._reach)
        self._piece = slice(0, 0)
        self._values: list[FloatArray] = []
        # Pieces that nobody has asked for yet, by their first rows.
        self._ahead: dict[int, list[FloatArray]] = {}

    def __call__(self, rows: slice) -> list[FloatArray]:
        """Return some rows of each signal, filtered and read-only."""
        parts: list[list[FloatArray]] = []
        start = rows.start
        while start < rows.stop:
            self._fill(start)
            stop = min(rows.stop, self._piece.stop)
            part = slice(start - self._piece.start, stop - self._piece.start)
            parts.append([values[part] for values in self._values])
            start = stop
        if len(parts) == 1:
            return parts[0]
        return [_read_only(np.concatenate(some)) for some in zip(*parts, strict=True)]

    def needed(self, rows: slice) -> slice:
        """Return all the rows of the signals that some filtered rows depend on."""
        size = self._piece_rows
        first, stop = rows.start // size * size, -(-rows.stop // size) * size
        return slice(max(0, first - self._reach), min(self._n_rows, stop + self._reach))

    def _fill(self, row: int) -> None:
        """Filter the piece that a row is in, unless it was the last one asked for."""
        if self._piece.start <= row < self._piece.stop:
            return
        first = row - row % self._piece_rows
        self._piece = self._piece_from(first)
        if first not in self._ahead:
            # Let go of the last one first.
            self._values = []
            self._ahead = self._filled_from(first)
        self._values = self._ahead.pop(first)

    def _piece_from(self, first: int) -> slice:
        return slice(first, min(first + self._piece_rows, self._n_rows))

    def _around(self, piece: slice) -> slice:
        """Return the rows that a piece is filtered with."""
        return slice(max(0, piece.start - self._reach), min(self._n_rows, piece.stop + self._reach))

    def _is_inner(self, first: int) -> bool:
        """Tell whether a piece is whole, with as much before and behind it as the others have."""
        return first >= self._reach and first + self._piece_rows + self._reach <= self._n_rows

    def _filled_from(self, first: int) -> dict[int, list[FloatArray]]:
        """Filter a piece, and with a few signals those behind it that go in the same run."""
        piece = self._piece_from(first)
        around = self._around(piece)
        inputs = [*self._readings(around)]
        firsts, n = [first], len(inputs)
        following = first + self._piece_rows
        while self._is_inner(first) and len(inputs) + n <= CHANNELS and self._is_inner(following):
            inputs += self._readings(self._around(self._piece_from(following)))
            firsts.append(following)
            following += self._piece_rows
        values: list[FloatArray] = []
        for some in range(0, len(inputs), CHANNELS):
            values += self._filtered(inputs[some : some + CHANNELS], piece, around)
        return {begun: values[k * n : (k + 1) * n] for k, begun in enumerate(firsts)}

    def _filtered(self, inputs: list[FloatArray], piece: slice, around: slice) -> list[FloatArray]:
        """Return a piece of up to five signals, of which ``inputs`` holds the rows ``around``."""
        # Where there are fewer, the last one is done over and over, with the same result.
        signals = tuple(
            _read_only(values) for values in [*inputs, *[inputs[-1]] * (CHANNELS - len(inputs))]
        )
        state = self._steady([values[0] for values in signals])
        if self._back and around.start == 0:
            before = tuple(_read_only(2.0 * v[0] - v[self._edge : 0 : -1]) for v in signals)
            state = self._steady([values[0] for values in before])
            self._run(state, before)
        results = self._run(state, signals)
        if self._back:
            if around.stop == self._n_rows:
                behind = tuple(
                    _read_only(2.0 * v[-1] - v[-2 : -(self._edge + 2) : -1]) for v in signals
                )
                ends = self._run(state, behind)
                state = self._steady([values[-1] for values in ends])
                self._run(state, ends, backward=True)
            else:
                state = self._steady([values[-1] for values in results])
            results = self._run(state, results, backward=True)
        part = slice(piece.start - around.start, piece.stop - around.start)
        return [values[part] for values in results[: len(inputs)]]

    def _steady(self, levels: Sequence[float]) -> FloatArray:
        """Return the state of the filter behind a long constant, for each of the signals."""
        return np.asarray(self._rest[:, :, np.newaxis] * np.asarray(levels))

    def _run(
        self, state: FloatArray, signals: tuple[FloatArray, ...], backward: bool = False
    ) -> tuple[FloatArray, ...]:
        results = tuple(np.empty(values.size) for values in signals)
        run_sections(self._sections, state, signals, results, backward)
        return tuple(_read_only(values) for values in results)


def _edge(sections: FloatArray) -> int:
    """Return by how many rows ``sosfiltfilt`` continues a signal beyond each end.

    Three times as many as the filter, written as one quotient, has coefficients; the rows are the
    point reflection of those inside.
    """
    without = min(np.count_nonzero(sections[:, 2] == 0), np.count_nonzero(sections[:, 5] == 0))
    return int(3 * (2 * len(sections) + 1 - without))


def _memory_rows(sections: FloatArray) -> int:
    """Return after how many rows a filter has forgotten what it was fed."""
    slowest = max(float(np.max(np.abs(np.roots(section[3:])))) for section in sections)
    return int(np.ceil(np.log(FORGOTTEN) / np.log(slowest)))


def _evaluated(
    run: LocalFilter, n_rows: int, n_signals: int, workspace: Workspace
) -> list[FloatArray]:
    """Return whole signals, filtered."""
    writers = [workspace.writer(n_rows) for _ in range(n_signals)]
    for rows in blocks(n_rows):
        for writer, values in zip(writers, run(rows), strict=True):
            writer.append(values)
        workspace.release()
    return [writer.finished() for writer in writers]


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
    stored: bool = True,
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
    stored : bool
        Whether it will be read more than once; else it is computed on disk when it is read.

    Returns
    -------
    ndarray of shape (n,)
        The averaged signal, read-only; near the ends of the record over what there is.
    """
    width = period_s * sample_rate_hz
    side = max(0, int(np.ceil(0.5 * (width - 1.0))))
    signal = as_column(values)

    def average(rows: slice) -> FloatArray:
        return _averaged(signal, rows, width, side) if side else signal[rows]

    if not stored:
        return workspace.derived(signal.size, average)
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
    if phase == "none":
        entry = filter_entry(0, rate, order=order, cutoff_hz=cutoff_hz, phase=phase)
        return record.after(entry)
    run = channel_filter(record, names, order=order, cutoff_hz=cutoff_hz, phase=phase)
    columns = _evaluated(run, record.n_samples, len(names), record.workspace)
    filtered = [
        Channel(name, column, record.channel(name).unit)
        for name, column in zip(names, columns, strict=True)
    ]
    entry = filter_entry(len(names), rate, order=order, cutoff_hz=cutoff_hz, phase=phase)
    return record.after(entry, add=filtered)


def channel_filter(
    record: Record, names: Sequence[str], *, order: int, cutoff_hz: float, phase: str
) -> LocalFilter:
    """Return the filter of channels of a record, which gives any of their rows.

    Parameters
    ----------
    record, names, order, cutoff_hz, phase
        As for :func:`filter_channels`; the phase is not ``"none"``.
    """
    columns = [record[name] for name in names]
    sections = _sections(order, cutoff_hz, record.sample_rate_hz)
    return LocalFilter(
        lambda rows: [column[rows] for column in columns], record.n_samples, sections, phase
    )


def filter_entry(
    n_channels: int, sample_rate_hz: float, *, order: int, cutoff_hz: float, phase: str
) -> LedgerEntry:
    """Return what the ledger says of a filter.

    Parameters
    ----------
    n_channels : int
        How many channels were filtered.
    sample_rate_hz : float
        Samples a second.
    order, cutoff_hz, phase
        See :func:`low_pass`.
    """
    parameters: dict[str, str | int | float | bool] = {"phase": phase}
    if phase == "none":
        return LedgerEntry("filter", "no low-pass filter", parameters)
    parameters |= {"order": order, "cutoff_hz": cutoff_hz}
    word = "forth and back, without delay"
    if phase == "causal":
        at_hz = 0.2 * cutoff_hz
        delay_ms = 1e3 * phase_delay_s(at_hz, sample_rate_hz, order=order, cutoff_hz=cutoff_hz)
        word = f"causal, which delays surge frequencies by {delay_ms:.1f} ms"
    return LedgerEntry(
        "filter",
        f"Butterworth of order {order} at {cutoff_hz:g} Hz on {n_channels} channels, {word}",
        parameters,
    )
