"""Raw records as Parquet: one column a channel."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from classic_ml.description import FileLayout
from classic_ml.io.table import Columns, RawFile, check_unique
from surge_core.errors import InputError

__all__ = ["INDEX", "open_parquet"]

_PER_SECOND = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
# What pandas calls an index without a name.
INDEX = "__index_level_"


def open_parquet(file: Path, layout: FileLayout, lenient: bool = False) -> RawFile:
    """Open a Parquet file; its rows are read batch by batch.

    Parameters
    ----------
    file : path
        An existing file. The metadata ``units`` or ``unit`` of a column state its unit; a column
        of timestamps counts from the first sample; a missing value is NaN.
    layout : FileLayout
        Which column is the clock; an index without a name that pandas wrote is left aside unless
        it is that, or holds timestamps.
    lenient : bool
        Of no effect here.

    Raises
    ------
    InputError
        When the file holds no column of numbers.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    with pq.ParquetFile(file) as opened:
        schema, n_rows = opened.schema_arrow, opened.metadata.num_rows
    kept: dict[str, Any] = {}
    unusable: dict[str, str] = {}
    check_unique(str(file), tuple(schema.names))
    for field in schema:
        dated = pa.types.is_timestamp(field.type)
        index = field.name.startswith(INDEX) and field.name != layout.time and not dated
        if index or not (dated or _is_numeric(field.type)):
            unusable[field.name] = "an index of pandas" if index else f"a column of {field.type}"
        else:
            kept[field.name] = field
    if not kept or not n_rows:
        found = "no rows" if kept else "no column of numbers"
        raise InputError(str(file), expected="columns of numbers", found=found)
    origins = _first_stamps(file, [n for n, f in kept.items() if pa.types.is_timestamp(f.type)])

    def read(names: tuple[str, ...], rows: int) -> Iterator[Columns]:
        with pq.ParquetFile(file, pre_buffer=False) as table:
            for batch in table.iter_batches(rows, columns=list(names)):
                columns = dict(zip(batch.schema.names, batch.columns, strict=True))
                yield tuple(_numbers(columns[name], origins.get(name, 0)) for name in names)

    stamps = {
        name: f"seconds from the first sample at {np.datetime64(ticks, kept[name].type.unit)}"
        for name, ticks in origins.items()
    }
    units = {name: _unit(field) for name, field in kept.items()}
    return RawFile(
        str(file),
        tuple(kept),
        read,
        {name: unit for name, unit in units.items() if unit},
        n_rows,
        stamps.get(layout.time, ""),
        unusable,
        stamps,
    )


def _is_numeric(kind: Any) -> bool:
    import pyarrow as pa

    tests = (pa.types.is_integer, pa.types.is_floating, pa.types.is_boolean, pa.types.is_decimal)
    return any(test(kind) for test in (*tests, pa.types.is_duration))


def _unit(field: Any) -> str:
    import pyarrow as pa

    if pa.types.is_timestamp(field.type) or pa.types.is_duration(field.type):
        return "s"
    stated = {key.lower(): value for key, value in (field.metadata or {}).items()}
    return str(stated.get(b"units", stated.get(b"unit", b"")).decode("utf-8", "replace"))


def _numbers(column: Any, origin: int) -> NDArray[Any]:
    """Return a column as whole numbers or as float64; stamps and durations in seconds."""
    import pyarrow as pa

    kind = column.type
    if pa.types.is_timestamp(kind) or pa.types.is_duration(kind):
        ticks = column.cast(pa.int64())
        missing = column.is_null().to_numpy(zero_copy_only=False)
        # The difference first: a date in nanoseconds is no double.
        seconds = (ticks.fill_null(0).to_numpy() - origin) / _PER_SECOND[kind.unit]
        return np.where(missing, np.nan, seconds)
    if not (pa.types.is_integer(kind) and not column.null_count):
        column = column.cast(pa.float64(), safe=False)
    return np.asarray(column.to_numpy(zero_copy_only=False))


def _first_stamps(file: Path, names: list[str]) -> dict[str, int]:
    """Return the first value of each column of timestamps, in its own ticks."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    if not names:
        return {}
    with pq.ParquetFile(file) as table:
        batch = next(table.iter_batches(1, columns=names))
    return {name: batch.column(name).cast(pa.int64())[0].as_py() or 0 for name in names}
