"""States that an engine records in arrays of its own device, to be read once at the end of an episode."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, kw_only=True)
class Recording:
    """States of all worlds on the engine's device, as `Worlds.record` returns them.

    The arrays follow the DLPack protocol (`__dlpack__`), are contiguous and hold 64-bit floats. They stay valid until
    the next recording of the same worlds, which may reuse their memory.

    Attributes:
        device: Name of the device, as `cuda:0` or `cpu`.
        positions_m: Positions of the body origins at the start and after each sample [m], shape
            [sample_count, world_count, body_count, 3].
        states: Poses and velocities at the start and after each frame, shape
            [frame_count, world_count, body_count, 13]; see `World.body_states`.
    """

    device: str
    positions_m: Any
    states: Any
