"""Both formats of a feed: exact, indifferent to how the bytes are cut, and hard to upset."""

from __future__ import annotations

import struct
import zlib
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from comparisons.live import frames as frames_module
from comparisons.live.frames import COLUMNS as COLUMNS_KIND
from comparisons.live.frames import (
    LONGEST_PAYLOAD,
    FrameDecoder,
    _frame,
    columns_frame,
    end_frame,
    rows_frame,
)
from comparisons.live.rows import End, Header, Item, Rows, Tally
from comparisons.live.text_lines import LONGEST_LINE, TextDecoder

COLUMNS = {"time_s": "f8", "P": "i2", "Q": "u2", "T": "f8"}
FINITE = st.floats(allow_nan=False, allow_infinity=False)


def decoded(decoder: TextDecoder | FrameDecoder, pieces: list[bytes]) -> list[Item]:
    items = [item for piece in pieces for item in decoder.feed(piece)]
    decoder.close()
    return items


def values_of(items: list[Item]) -> np.ndarray:
    rows = [item for item in items if isinstance(item, Rows)]
    return np.concatenate([row.values for row in rows]) if rows else np.empty((0, 0))


def lines_of(items: list[Item]) -> list[bytes]:
    return [line for item in items if isinstance(item, Rows) for line in item.lines]


def pieces_of(content: bytes, places: list[int]) -> list[bytes]:
    cuts = sorted({p % (len(content) + 1) for p in places})
    return [content[a:b] for a, b in zip([0, *cuts], [*cuts, len(content)], strict=True)]


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(FINITE, FINITE, FINITE), min_size=1, max_size=20),
    st.lists(st.integers(0, 10_000), max_size=12),
)
def test_text_is_read_to_the_last_bit_however_it_is_cut(
    rows: list[tuple[float, float, float]], places: list[int]
) -> None:
    text = "time_s,P,Q\n" + "".join(f"{a!r}, {b!r} ,{c!r}\r\n" for a, b, c in rows)
    tally = Tally()
    items = decoded(TextDecoder(tally), pieces_of(text.encode(), places))
    assert items[0] == Header(("time_s", "P", "Q"))
    assert np.array_equal(values_of(items), np.array(rows))
    assert tally.total == 0
    # The lines that are kept stand for the same numbers.
    kept = [tuple(map(float, line.split(b","))) for line in lines_of(items)]
    assert kept == rows


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.tuples(FINITE, st.integers(-(2**15), 2**15 - 1), st.integers(0, 2**16 - 1), FINITE),
        min_size=1,
        max_size=30,
    ),
    st.lists(st.integers(0, 10_000), max_size=12),
)
def test_frames_are_read_to_the_last_bit_however_they_are_cut(
    rows: list[tuple[float, int, int, float]], places: list[int]
) -> None:
    table = np.array(rows, dtype=np.float64)
    content = columns_frame(COLUMNS) + rows_frame(COLUMNS, table, 1) + end_frame(2)
    tally = Tally()
    items = decoded(FrameDecoder(tally), pieces_of(content, places))
    assert items[0] == Header(tuple(COLUMNS))
    assert isinstance(items[-1], End)
    assert np.array_equal(values_of(items), table)
    assert [tuple(map(float, line.split(b","))) for line in lines_of(items)] == rows
    assert tally.total == 0


@pytest.mark.parametrize(
    "line",
    [
        b"1,2",
        b"1,2,3,4",
        b"1,,3",
        b"1,nan,3",
        b"1,inf,3",
        b"1,1e999,3",
        b"1,1_0,3",
        b"1,0x10,3",
        b"1,two,3",
        b"1,2 2,3",
        "1,٣,3".encode(),
        b"\xff\x00\x80",
        b"__import__('os').abort(),2,3",
        b"GET / HTTP/1.1",
    ],
)
def test_a_line_that_is_no_row_is_counted_and_the_others_stay(line: bytes) -> None:
    tally = Tally()
    content = b"time_s,P,Q\n1,2,3\n" + line + b"\n4,5,6\n"
    items = decoded(TextDecoder(tally), [content])
    assert np.array_equal(values_of(items), [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    assert tally.total == 1


def test_comments_empty_lines_and_a_header_sent_again_count_for_nothing() -> None:
    tally = Tally()
    content = b"\xef\xbb\xbftime_s,P\n# unit: s\n\n1,2\n\xef\xbb\xbftime_s,P\n3,4\n#end\n5,6\n"
    items = decoded(TextDecoder(tally), [content])
    assert items[0] == Header(("time_s", "P"))
    assert np.array_equal(values_of(items), [[1.0, 2.0], [3.0, 4.0]])
    assert isinstance(items[-1], End)
    assert tally.total == 0


def test_an_endless_line_is_not_kept_in_memory() -> None:
    tally = Tally()
    decoder = TextDecoder(tally)
    decoder.feed(b"time_s,P\n")
    for _ in range(100):
        assert decoder.feed(b"1" * 40_000) == []
        assert len(decoder._rest) <= LONGEST_LINE
    items = decoder.feed(b"\n1,2\n")
    assert np.array_equal(values_of(items), [[1.0, 2.0]])
    assert dict(tally.refused) == {"a line longer than the limit": 1}


def test_a_line_cut_off_by_the_end_of_the_connection_is_not_taken_for_a_row() -> None:
    # "1,25" may have been "1,257".
    tally = Tally()
    items = decoded(TextDecoder(tally), [b"time_s,P\n0,1\n1,25"])
    assert np.array_equal(values_of(items), [[0.0, 1.0]])
    assert tally.total == 1


def frames(n: int = 4) -> tuple[list[bytes], np.ndarray]:
    number = np.arange(3.0 * n)
    table = np.column_stack([number, number, number, np.ones(3 * n)])
    parts = [rows_frame(COLUMNS, table[3 * i : 3 * i + 3], i + 1) for i in range(n)]
    return [columns_frame(COLUMNS), *parts], table


@pytest.mark.parametrize("place", [1, 4, 6, 8, 12, 16, 20, 25, -2])
def test_a_damaged_frame_is_left_out_and_the_next_one_is_found(place: int) -> None:
    parts, table = frames()
    spoiled = bytearray(parts[2])
    spoiled[place] ^= 0x41
    tally = Tally()
    items = decoded(FrameDecoder(tally), [*parts[:2], bytes(spoiled), *parts[3:], end_frame(5)])
    assert np.array_equal(values_of(items), np.concatenate([table[:3], table[6:]]))
    assert isinstance(items[-1], End)
    assert tally.refused["damaged bytes between two frames"] == 1
    assert tally.refused["a frame missing by its number"] == 1


def test_noise_between_frames_is_passed_over() -> None:
    parts, table = frames()
    rng = np.random.default_rng(3)
    noise = [rng.bytes(50) + b"SSLV" + rng.bytes(30) + b"SSL" for _ in parts]
    tally = Tally()
    content = b"".join(n + p for n, p in zip(noise, parts, strict=True))
    items = decoded(FrameDecoder(tally), pieces_of(content, rng.integers(0, 2000, 40).tolist()))
    assert np.array_equal(values_of(items), table)


def test_a_frame_that_claims_too_much_is_not_waited_for() -> None:
    parts, table = frames()
    greedy = bytearray(parts[1])
    greedy[16:20] = (LONGEST_PAYLOAD + 1).to_bytes(4, "little")
    items = decoded(FrameDecoder(Tally()), [parts[0], bytes(greedy), *parts[1:]])
    assert np.array_equal(values_of(items), table)


def test_rows_before_their_columns_and_rows_that_do_not_fit_them_are_left_out() -> None:
    parts, table = frames()
    other = rows_frame({"time_s": "f8"}, np.zeros((2, 1)), 1)
    tally = Tally()
    items = decoded(FrameDecoder(tally), [parts[1], parts[0], other, parts[2]])
    assert np.array_equal(values_of(items), table[3:6])
    assert tally.refused["a frame that does not fit its columns"] == 1
    assert tally.refused["a frame of rows before one of columns"] == 1


def test_a_row_with_a_value_that_is_no_number_is_left_out() -> None:
    table = np.array([[0.0, 1, 1, 280.0], [1.0, 1, 1, np.nan], [2.0, 1, 1, 281.0]])
    tally = Tally()
    items = decoded(FrameDecoder(tally), [columns_frame(COLUMNS), rows_frame(COLUMNS, table, 1)])
    assert values_of(items)[:, 0].tolist() == [0.0, 2.0]
    assert tally.total == 1


def test_a_cut_frame_counts_once() -> None:
    parts, _ = frames()
    tally = Tally()
    decoded(FrameDecoder(tally), [parts[0], parts[1][:-3]])
    assert dict(tally.refused) == {"a frame cut off by the end of the connection": 1}


@pytest.mark.parametrize(
    ("text", "remedy"),
    [
        (":f8,f0:f8", "each column is NAME:TYPE, such as time_s:f8"),
        ("f8", "each column is NAME:TYPE, such as time_s:f8"),
        ("time_s:f8, :f8", "each column is NAME:TYPE, such as time_s:f8"),
        ("a\x07:f8", "each column is NAME:TYPE, such as time_s:f8"),
        ("a\nb:f8", "each column is NAME:TYPE, such as time_s:f8"),
        ("time_s:f8,P:q9", "the type of column P is 'q9': write one of f8, f4, i2, u2, i4"),
        ("time_s:f8,P:f8,P:i2", "column P is there twice: name each once"),
    ],
)
def test_columns_that_cannot_be_read_are_left_out_and_it_is_said_why(
    text: str, remedy: str
) -> None:
    tally = Tally()
    items = decoded(FrameDecoder(tally), [_frame(COLUMNS_KIND, 0, 0, text.encode()), end_frame(1)])
    assert items == [End()]
    assert dict(tally.refused) == {"a frame of columns that cannot be read": 1}
    assert tally.remedies == {"a frame of columns that cannot be read": remedy}


def of_version(frame: bytes, version: int, *, checksum: bool) -> bytes:
    body = frame[:4] + bytes([version]) + frame[5:-4]
    return body + (struct.pack("<I", zlib.crc32(body)) if checksum else frame[-4:])


@pytest.mark.parametrize("checksum", [True, False])
def test_frames_of_another_version_are_told(checksum: bool) -> None:
    parts, _ = frames()
    tally = Tally()
    sent = [of_version(part, 9, checksum=checksum) for part in parts]
    assert decoded(FrameDecoder(tally), sent) == []
    assert tally.remedies == {
        "a frame of another version": "its version is 9: send frames of version 1"
    }


@pytest.mark.parametrize(
    ("content", "remedy"),
    [
        (b"time_s,P\n1,2\n", "they are text: if that is CSV, leave out --format binary"),
        (b"\xef\xbb\xbftime_s", "they are text: if that is CSV, leave out --format binary"),
        (b"\0\1\2" * 500, "a frame begins with SSLV: see sindy-surge live --help"),
    ],
)
def test_what_is_no_frame_from_the_beginning_is_told(content: bytes, remedy: str) -> None:
    tally = Tally()
    assert decoded(FrameDecoder(tally), [content]) == []
    assert tally.remedies == {"bytes that are no frame": remedy}


def test_rows_before_their_columns_are_told() -> None:
    tally = Tally()
    decoded(FrameDecoder(tally), frames()[0][1:])
    assert tally.refused["a frame of rows before one of columns"] == 4
    assert list(tally.remedies) == ["a frame of rows before one of columns"]


@given(st.integers(0, LONGEST_PAYLOAD), st.integers(1, 3000))
@settings(max_examples=60, deadline=None)
def test_a_damaged_length_costs_no_other_frame(length: int, chunk: int) -> None:
    parts, table = frames(6)
    spoiled = parts[2][:16] + struct.pack("<I", length) + parts[2][20:]
    tally = Tally()
    content = b"".join([*parts[:2], spoiled, *parts[3:], end_frame(7)])
    decoder = FrameDecoder(tally)
    items = [
        item
        for start in range(0, len(content), chunk)
        for item in decoder.feed(content[start : start + chunk])
    ]
    # All that can be had is there as soon as it has come: no end of the connection is needed.
    whole = struct.unpack_from("<I", parts[2], 16)[0] == length
    expected = table if whole else np.concatenate([table[:3], table[6:]])
    assert np.array_equal(values_of(items), expected)
    assert isinstance(items[-1], End)
    assert tally.refused["damaged bytes between two frames"] == (not whole)


def test_heads_inside_an_incomplete_frame_are_checked_once(monkeypatch: pytest.MonkeyPatch) -> None:
    covered: list[int] = []

    def crc32(data: bytes) -> int:
        covered.append(len(data))
        return zlib.crc32(data)

    monkeypatch.setattr(frames_module, "zlib", SimpleNamespace(crc32=crc32))
    head = struct.Struct("<4sBBHIII")
    # Each head claims the 1000 bytes behind it, and the first one all that will come.
    noise = head.pack(b"SSLV", 1, 1, 0, 0, 1, LONGEST_PAYLOAD)
    noise += head.pack(b"SSLV", 1, 1, 0, 0, 1, 1000) * 2000
    decoder = FrameDecoder(Tally())
    for start in range(0, len(noise), 100):
        decoder.feed(noise[start : start + 100])
    assert len(covered) <= 2001


def test_columns_may_be_called_as_numpy_calls_its_own() -> None:
    columns = {"f1": "f8", "f0": "i2", "0": "f4"}
    table = np.array([[0.5, 7.0, 1.5], [1.5, 8.0, 2.5]])
    items = decoded(FrameDecoder(Tally()), [columns_frame(columns), rows_frame(columns, table, 1)])
    assert items[0] == Header(("f1", "f0", "0"))
    assert np.array_equal(values_of(items), table)


def test_noise_that_claims_long_frames_costs_no_checksums(monkeypatch: pytest.MonkeyPatch) -> None:
    covered: list[int] = []
    parts, table = frames()

    def crc32(data: bytes) -> int:
        covered.append(len(data))
        return zlib.crc32(data)

    monkeypatch.setattr(frames_module, "zlib", SimpleNamespace(crc32=crc32))
    head = struct.Struct("<4sBBHIII")
    noise = head.pack(b"SSLV", 1, 1, 0, 0, 1, 1 << 20) * 53_000
    items = decoded(FrameDecoder(Tally()), [noise, *parts])
    assert np.array_equal(values_of(items), table)
    assert sum(covered) == sum(len(part) - 4 for part in parts)


def test_a_frame_holds_64_KiB_and_no_more() -> None:
    most = 65_536 // 20
    table = np.zeros((most + 1, len(COLUMNS)))
    items = decoded(
        FrameDecoder(Tally()), [columns_frame(COLUMNS), rows_frame(COLUMNS, table[:most], 1)]
    )
    assert len(values_of(items)) == most
    with pytest.raises(ValueError, match=f"a frame holds {most} rows .* not {most + 1}"):
        rows_frame(COLUMNS, table, 1)
