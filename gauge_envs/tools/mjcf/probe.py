"""Compile a model of MuJoCo in a child process whose memory and time are limited.

The script imports nothing of this package. Argument: the file; without one, the model comes from standard input.
"""

import sys

import mujoco


def main(file: str | None) -> None:
    """Compile a model and allocate its state; a file that MuJoCo cannot load is no matter of limits."""
    try:
        spec = (
            mujoco.MjSpec.from_file(file)
            if file
            else mujoco.MjSpec.from_string(sys.stdin.read())
        )
        mujoco.MjData(spec.compile())
    except ValueError:
        return


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else None)
