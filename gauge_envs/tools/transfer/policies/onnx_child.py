"""Run an ONNX network in a child process whose memory and time are limited, for as long as its policy is used.

The script imports nothing of this package. The runtime has no limits of its own: a small file may hold a loop without
end, or arrays of terabytes, and may do so for some observations alone. Standard input has a message with the network,
and then one with each observation, of 64-bit floats. Each is answered with a message: `+` and an action of 64-bit
floats, or `-` and why there is none. A message is its length, 8 bytes, and its content.
"""

import sys
from typing import Any

import numpy as np

NUMBERS = {"tensor(float)": np.float32, "tensor(double)": np.float64}
"""Types of the input that an ONNX policy may have."""

ACTION_CPU_S = 5
"""Limit of the processor time of an action, and of loading the network [s]."""


def read_message(stream: Any) -> bytes | None:
    """Return the content of a message; None at the end of the stream."""
    head = stream.read(8)
    size = int.from_bytes(head, "little")
    content = stream.read(size) if len(head) == 8 else b""
    return content if len(head) == 8 and len(content) == size else None


def write_message(stream: Any, content: bytes) -> None:
    """Write a message."""
    stream.write(len(content).to_bytes(8, "little") + content)
    stream.flush()


def main(observation_size: int) -> None:
    """Answer observations until the input ends."""
    source, target = sys.stdin.buffer, sys.stdout.buffer
    run = None
    while (content := read_message(source)) is not None:
        _allow_more_time()
        try:
            if run is None:
                run = _network(content, observation_size)
                content = np.zeros(observation_size).tobytes()
            answer = b"+" + run(np.frombuffer(content)).tobytes()
        except (
            Exception
        ) as error:  # The runtime has a class of its own for each kind of damage.
            answer = f"-{error}"[:300].encode(errors="replace")
        write_message(target, answer)


def _allow_more_time() -> None:
    if sys.platform != "win32":
        import resource

        usage = resource.getrusage(resource.RUSAGE_SELF)
        total = resource.getrlimit(resource.RLIMIT_CPU)[1]
        limit = int(usage.ru_utime + usage.ru_stime) + 1 + ACTION_CPU_S
        resource.setrlimit(resource.RLIMIT_CPU, (min(limit, total), total))


def _network(content: bytes, observation_size: int) -> Any:
    """Return the function of a network: from an observation to the first output."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    try:
        session = onnxruntime.InferenceSession(
            content, options, providers=["CPUExecutionProvider"]
        )
    except Exception as error:
        raise ValueError(
            f"it is no network that onnxruntime can load: {error}"
        ) from error
    inputs = session.get_inputs()
    if len(inputs) != 1:
        raise ValueError(
            f"it has the inputs {', '.join(one.name for one in inputs)}, expected one, the observation"
        )
    entry = inputs[0]
    if entry.type not in NUMBERS:
        raise ValueError(
            f"input {entry.name!r} has the type {entry.type}, expected {' or '.join(NUMBERS)}"
        )
    # A dimension that is free has a name or None.
    stated = [size if isinstance(size, int) else None for size in entry.shape]
    shape = (1, observation_size)[-len(stated) :] if stated else ()
    if len(shape) != len(stated) or any(
        size not in (None, one) for size, one in zip(stated, shape, strict=True)
    ):
        raise ValueError(
            f"input {entry.name!r} has shape {entry.shape}, the task's observation has {observation_size} entries"
        )
    output = session.get_outputs()[0].name

    def run(observation: np.ndarray) -> np.ndarray:
        fed = observation.astype(NUMBERS[entry.type]).reshape(shape)
        try:
            return np.asarray(
                session.run([output], {entry.name: fed})[0], dtype=np.float64
            )
        except Exception as error:
            raise ValueError(f"onnxruntime cannot run the network: {error}") from error

    return run


if __name__ == "__main__":
    main(int(sys.argv[1]))
