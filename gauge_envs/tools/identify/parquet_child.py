"""Reads a Parquet file of a stranger in a child process: pyarrow aborts on some damaged ones, and has no limits.

Arguments: the largest count of values, and the columns. The file is the standard input. `files.child_refusal` runs it.
"""

import contextlib
import io
import sys

REFUSED = 3
"""Exit code of a refusal; `files.CHILD_REFUSED`."""


def main() -> None:
    """Read the columns; exit with `REFUSED` where there are too many values."""
    from pyarrow import parquet

    most, names = int(sys.argv[1]), sys.argv[2:]
    # A file that is wrong is named by the process that reads it next.
    with contextlib.suppress(Exception):
        table = parquet.ParquetFile(io.BytesIO(sys.stdin.buffer.read()))
        stated = table.metadata
        count = stated.num_rows
        for group in range(stated.num_row_groups):
            for place in range(stated.num_columns):
                count += stated.row_group(group).column(place).num_values
        # A few bytes of an encoding may stand for any number of values.
        if count > most:
            print(f"it states {count} values, the limit is {most}")
            sys.exit(REFUSED)
        table.read(columns=names).to_pydict()


if __name__ == "__main__":
    main()
