"""Reads a Parquet file in a child process, and prints its columns as an NPZ: pyarrow aborts on some damaged ones.

Arguments: the largest count of values, and the columns. The file is the standard input. `files.child_output` runs it.
"""

import io
import sys
from typing import Any

import numpy as np

REFUSED = 3
"""Exit code of a refusal; `files.CHILD_REFUSED`."""


def columns(content: bytes, names: list[str], largest_count: int) -> dict[str, Any]:
    """Return columns of numbers of a table; an error if it states more values than the limit."""
    from pyarrow import parquet

    table = parquet.ParquetFile(io.BytesIO(content))
    stated = table.metadata
    count = stated.num_rows
    for group in range(stated.num_row_groups):
        for place in range(stated.num_columns):
            count += stated.row_group(group).column(place).num_values
    # A few bytes of an encoding may stand for any number of values.
    if count > largest_count:
        raise ValueError(f"it states {count} values, the limit is {largest_count}")
    found = table.read(columns=names).to_pydict()
    return {name: np.asarray(found[name], np.float64) for name in names}


if __name__ == "__main__":
    try:
        arrays = columns(sys.stdin.buffer.read(), sys.argv[2:], int(sys.argv[1]))
        np.savez(sys.stdout.buffer, **arrays)
    except Exception as error:  # pyarrow raises many types for a damaged file.
        print(ascii(str(error))[1:-1] or type(error).__name__)
        sys.exit(REFUSED)
