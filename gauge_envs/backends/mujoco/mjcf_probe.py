"""Compile a model of MuJoCo from standard input, in a child process whose memory and time are limited.

The script is started by `mjcf_reader` and imports nothing of this package.
"""

from __future__ import annotations

import sys

import mujoco

__all__: list[str] = []


def main(text: str) -> None:
    """Compile a model and allocate its state; a file that MuJoCo cannot load is no matter of limits."""
    try:
        mujoco.MjData(mujoco.MjSpec.from_string(text).compile())
    except ValueError:
        return


if __name__ == "__main__":
    main(sys.stdin.read())
