"""Load an ONNX network and run it once in a child process whose memory and time are limited.

The script imports nothing of this package. The network comes from standard input; the argument is the size of the
observation. The runtime has no limits of its own: a small file may hold a loop without end, or arrays of terabytes.
"""

from __future__ import annotations

import sys

import numpy as np

REFUSED = 3
"""Exit code after a printed reason, as in `files.child_refusal`."""

NUMBERS = {"tensor(float)": np.float32, "tensor(double)": np.float64}


def main(content: bytes, observation_size: int) -> None:
    """Load and run a network; an input that fits no observation is left to the caller."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    try:
        session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # The runtime has a class of its own for each kind of damage.
        _refuse(f"it is no network that onnxruntime can load: {error}")
    inputs = session.get_inputs()
    if len(inputs) != 1 or inputs[0].type not in NUMBERS:
        return
    # A dimension that is free has a name or None.
    stated = [size if isinstance(size, int) else None for size in inputs[0].shape]
    shape = (1, observation_size)[-len(stated) :] if stated else ()
    if len(shape) != len(stated) or any(size not in (None, one) for size, one in zip(stated, shape, strict=True)):
        return
    try:
        session.run([session.get_outputs()[0].name], {inputs[0].name: np.zeros(shape, dtype=NUMBERS[inputs[0].type])})
    except Exception as error:
        _refuse(f"onnxruntime cannot run the network: {error}")


def _refuse(reason: str) -> None:
    print(reason[:300])
    sys.exit(REFUSED)


if __name__ == "__main__":
    main(sys.stdin.buffer.read(), int(sys.argv[1]))
