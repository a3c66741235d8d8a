"""Reads a demonstration in HDF5 in a child process, and prints it as an NPZ: h5py has no limits, and may never end.

Arguments: the demonstration, and the largest size of its states. The file is the standard input.
`files.child_output` runs it.
"""

import io
import sys

import numpy as np

REFUSED = 3
"""Exit code of a refusal; `files.CHILD_REFUSED`."""


def demonstration(
    content: bytes, chosen: str, most_bytes: int
) -> tuple[np.ndarray, str]:
    """Return the states of a demonstration, shape [step_count, 1 + nq + nv], and its model; empty if it has none.

    Args:
        content: The content of the file.
        chosen: Name of the demonstration; the first one if it is empty.
        most_bytes: Largest size of the states.

    Raises:
        ValueError: There is no such demonstration, or it holds no table of numbers.
    """
    import h5py

    with h5py.File(io.BytesIO(content), "r") as file:
        demonstrations: list[str] = sorted(file.get("data", {}))
        chosen = chosen or next(iter(demonstrations), "")
        if chosen not in demonstrations or "states" not in file["data"][chosen]:
            known = ", ".join(demonstrations[:8]) or "none"
            raise ValueError(
                f"it has no data/{chosen or 'demo_0'}/states; its demonstrations: {known}"
            )
        group = file["data"][chosen]
        states = group["states"]
        if states.ndim != 2 or states.dtype.kind not in "biuf":
            raise ValueError("states are a table of numbers")
        if 8 * states.size > most_bytes:
            raise ValueError(f"it states {states.size} numbers")
        model = group.attrs.get("model_file", "")
        text = model.decode() if isinstance(model, bytes) else str(model)
        return states[:].astype(np.float64), text


if __name__ == "__main__":
    try:
        content = sys.stdin.buffer.read()
        states, model = demonstration(content, sys.argv[1], int(sys.argv[2]))
        np.savez(sys.stdout.buffer, states=states, model=model)
    except Exception as error:  # h5py raises many types for a damaged file.
        print(ascii(str(error))[1:-1] or type(error).__name__)
        sys.exit(REFUSED)
