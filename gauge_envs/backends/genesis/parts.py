"""What the model and the simulation need of a deformable body. Each solver of Genesis implements it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.shared.driven_motion import DrivenMotion

Motions = Mapping[str, DrivenMotion]
"""Motion of each driven body in the current interval, by name. A body that was never driven rests at its start."""


class DeformablePart(ABC):
    """Deformable bodies of one solver of a Genesis scene, the bodies' nodes and how they are driven.

    The calls come in this order: `scene_options` and `touches` before the Genesis scene exists, `add` before it is
    built, `finish` after it, then `reset`, and `prescribe` before each step.

    Attributes:
        names: Names of the bodies.
    """

    names: tuple[str, ...]

    @abstractmethod
    def scene_options(self) -> dict[str, Any]:
        """Return keyword arguments of `gs.Scene`, such as `pbd_options` and `coupler_options`."""

    def touches(self) -> Mapping[str, float]:
        """Return the friction with which rigid bodies collide with the part, by their names.

        Each of these bodies gets one more geom, the first of its geoms, which collides with no rigid body. Only this
        geom takes part in the coupling.
        """
        return {}

    def touch_margin_m(self) -> float:
        """Return by how much the geoms of `touches` exceed their bodies [m], planes and unions apart."""
        return 0.0

    @abstractmethod
    def add(self, scene: Any) -> None:
        """Add the bodies to a `gs.Scene` that is not built."""

    @abstractmethod
    def finish(self, scene: Any) -> None:
        """Complete the bodies after the scene was built: fix particles, keep the start state."""

    @abstractmethod
    def reset(self) -> None:
        """Return the bodies to their start."""

    @abstractmethod
    def prescribe(self, motions: Motions, time_s: float, step_s: float) -> None:
        """Move the driven nodes before a step.

        Args:
            motions: Motions of driven bodies since the start of the interval.
            time_s: Time of the start of the step since the start of the interval [s].
            step_s: Length of the step [s].
        """

    @abstractmethod
    def nodes(self, name: str) -> NDArray[np.float64]:
        """Return the positions of a body's nodes [m], shape [node_count, 3]."""

    def track(self, name: str, points_m: NDArray[np.float64]) -> Callable[[], NDArray[np.float64]] | None:
        """Return a reader of material points; see `World.track`."""
        return None

    def fault(self) -> str | None:
        """Return why the solver gave up the state; see `World.fault`."""
        return None

    @abstractmethod
    def state(self) -> Any:
        """Return a snapshot that can be pickled."""

    @abstractmethod
    def restore(self, state: Any) -> None:
        """Restore a snapshot; the motion continues bit for bit."""
