"""Raw records as Parquet: one column a channel."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from classic_ml.description import FileLayout
from classic_ml.io.table import BLOCK_ROWS, Columns, StoredTable, stated_unit
from surge_core.errors import InputError


@contextmanager
def open_parquet(file: Path, layout: FileLayout) -> Iterator[StoredTable]:
    """Open a Parquet file; its rows are read batch by batch.

    The metadata ``units`` or ``unit`` of a column state its unit; a missing value is NaN; an index
    without a name that pandas wrote is left aside. Arguments as
    :func:`classic_ml.io.formats.open_stored` has them.
    """
    import pyarrow.parquet as pq

    with pq.ParquetFile(file, pre_buffer=False) as opened:
        fields = {field.name: field for field in opened.schema_arrow}
        kept = [
            name
            for name, field in fields.items()
            if _is_number(field.type) and not name.startswith("__index_level_")
        ]
        if not kept or not opened.metadata.num_rows:
            found = "no rows" if kept else "no column of numbers"
            raise InputError(str(file), expected="columns of numbers", found=found)

        def read(names: tuple[str, ...]) -> Iterator[Columns]:
            for batch in opened.iter_batches(BLOCK_ROWS, columns=list(names)):
                yield tuple(_array(batch.column(name)) for name in names)

        yield StoredTable(
            str(file),
            tuple(kept),
            read,
            {name: unit for name in kept if (unit := stated_unit(fields[name].metadata or {}))},
            {n: f"a column of {f.type}" for n, f in fields.items() if n not in kept},
        )


def _is_number(kind: Any) -> bool:
    import pyarrow as pa

    tests = (pa.types.is_integer, pa.types.is_floating, pa.types.is_boolean, pa.types.is_decimal)
    return any(test(kind) for test in tests)


def _array(column: Any) -> NDArray[Any]:
    """Return a column as whole numbers or float64."""
    import pyarrow as pa

    if not pa.types.is_integer(column.type) or column.null_count:
        column = column.cast(pa.float64(), safe=False)
    return np.asarray(column.to_numpy(zero_copy_only=False))
