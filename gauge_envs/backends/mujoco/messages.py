"""Warnings of MuJoCo."""

from collections.abc import Iterator
from contextlib import contextmanager

import mujoco


@contextmanager
def mujoco_warnings() -> Iterator[list[str]]:
    """Yield a list that collects MuJoCo's warnings, instead of stderr and `MUJOCO_LOG.TXT`."""
    handler, warned = mujoco.get_mju_user_warning(), list[str]()
    mujoco.set_mju_user_warning(warned.append)
    try:
        yield warned
    finally:
        mujoco.set_mju_user_warning(handler)
