"""What the deformable solvers of Genesis share: nodes, held nodes, states, and the rigid bodies that touch them."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.backends.genesis.document import COUPLED_BIT, body_label
from gauge_envs.backends.genesis.engine import engine
from gauge_envs.backends.genesis.settings import SettingsGenesis
from gauge_envs.backends.shared.attachments import RigidAttachment
from gauge_envs.backends.shared.rigid import DrivenMotion
from gauge_envs.errors import BackendError
from gauge_envs.scene import Motion, Scene
from gauge_envs.scene.geometry import FloatArray

Motions = Mapping[str, DrivenMotion]
"""Motion of each driven body in the current interval, by name. A body that was never driven rests at its start."""

State = tuple[NDArray[Any], ...]


class DeformablePart(ABC):
    """Deformable bodies of one solver of a Genesis scene, the bodies' nodes and how they are driven.

    The calls come in this order: `scene_options` and `touches` before the Genesis scene exists, `add` before it is
    built, `finish` after it, then `reset`, and `prescribe` before each step.

    Attributes:
        names: Names of the bodies.
    """

    def __init__(
        self, scene: Scene, settings: SettingsGenesis, names: Sequence[str]
    ) -> None:
        self.names = tuple(names)
        self._scene = scene
        # `finish` sets the kernels, which read and write the arrays of a state and hold nodes, and the start.
        self._kernels: Any = None
        self._start: State = ()
        self._interval_s = settings.drive_interval_s
        self._pins: list[tuple[RigidAttachment, NDArray[np.int32], FloatArray]] = []
        self._planned: list[tuple[NDArray[np.int32], list[NDArray[Any]]]] = []

    @abstractmethod
    def scene_options(self) -> dict[str, Any]:
        """Return keyword arguments of `gs.Scene`, such as `pbd_options` and `coupler_options`."""

    def touches(self) -> Mapping[str, float]:
        """Return the friction of the rigid bodies that collide with the part, by their names.

        Each of these bodies gets one more geom, the first of its geoms, which collides with no rigid body. Only this
        geom takes part in the coupling.
        """
        rigid, soft = {body.name for body in self._scene.bodies}, set(self.names)
        return {
            name: contact.friction
            for contact in self._scene.contacts
            for pair in self._scene.colliding_pairs(contact)
            for name, other in (pair, pair[::-1])
            if name in rigid and other in soft
        }

    def touch_margin_m(self) -> float:
        """Return by how much the geoms of `touches` exceed their bodies [m], planes and unions apart."""
        return 0.0

    def add(self, scene: Any) -> None:
        """Add the bodies to a `gs.Scene` that is not built, and let only the geoms for them touch them."""
        for geom in scene.sim.rigid_solver.geoms:
            geom._needs_coup = geom.conaffinity == COUPLED_BIT

    @abstractmethod
    def finish(self, scene: Any) -> None:
        """Complete the bodies after the scene was built: fix particles, keep the start state."""

    def pin(self, attachment: RigidAttachment, rows: Any, points_m: FloatArray) -> None:
        """Let nodes of the solver, given by their rows and start positions [m], move with a rigid body."""
        if len(rows):
            self._pins.append(
                (
                    attachment,
                    np.asarray(rows, dtype=np.int32),
                    attachment.pose.to_body(points_m),
                )
            )

    def prescribe(self, motions: Motions, time_s: float, step_s: float) -> None:
        """Move the held nodes before a step.

        Args:
            motions: Motions of driven bodies since the start of the interval.
            time_s: Time of the start of the step since the start of the interval [s].
            step_s: Length of the step [s].
        """
        if time_s == 0.0:
            times = step_s * np.arange(round(self._interval_s / step_s) + 1)
            self._planned = []
            for attachment, rows, places in self._pins:
                is_driven = attachment.motion is Motion.KINEMATIC
                motion = (
                    motions[attachment.body]
                    if is_driven
                    else DrivenMotion(attachment.pose)
                )
                arrays = self.plan(
                    rows, motion, driven_places(motion, places, times), times
                )
                self._planned.append((rows, [contiguous(array) for array in arrays]))
        step = round(time_s / step_s)
        for rows, planned in self._planned:
            self._kernels.hold(rows, *(array[step] for array in planned))

    @abstractmethod
    def plan(
        self,
        rows: NDArray[np.int32],
        motion: DrivenMotion,
        path_m: NDArray[Any],
        times_s: NDArray[Any],
    ) -> tuple[NDArray[Any], ...]:
        """Return what the kernel `hold` takes of held nodes in each step of an interval.

        Args:
            rows: The nodes.
            motion: Motion of their body.
            path_m: Positions of the nodes at the ends of the steps [m], shape [step_count + 1, node_count, 3].
            times_s: Times since the start of the interval [s], shape [step_count + 1].
        """

    @abstractmethod
    def nodes(self, name: str) -> FloatArray:
        """Return the positions of a body's nodes [m], shape [node_count, 3]."""

    def track(self, name: str, points_m: FloatArray) -> Callable[[], FloatArray] | None:
        """Return a reader of material points; see `World.track`."""
        return None

    def fault(self) -> str | None:
        """Return why the solver gave up the state; see `World.fault`."""
        return None

    def state(self) -> State:
        """Return a snapshot that can be pickled: positions [m], velocities [m/s] and what else the solver has."""
        state = tuple(
            np.empty(shape, dtype=engine().np_float) for shape in self._kernels.shapes
        )
        self._kernels.read(*state)
        return state

    def restore(self, state: State) -> None:
        """Restore a snapshot; the motion continues bit for bit. The next interval prescribes held nodes anew."""
        self._kernels.write(*state)
        self._planned = []

    def reset(self) -> None:
        """Return the bodies to their start."""
        self.restore(self._start)

    def _positions(self, rows: slice) -> FloatArray:
        """Return the current positions of nodes of the solver [m], shape [node_count, 3]."""
        return self.state()[0][rows].astype(np.float64)


def contiguous(array: NDArray[Any]) -> NDArray[Any]:
    """Return an array as the kernels take it, in Genesis's precision."""
    return np.ascontiguousarray(array, dtype=engine().np_float)


def coupled_geoms(
    built: Any, scene: Scene, touches: Mapping[str, float]
) -> Iterator[tuple[Any, float]]:
    """Yield the geoms that collide with deformable bodies, with their friction.

    Args:
        built: The `gs.Scene`.
        scene: The scene.
        touches: Friction of the bodies that touch deformable bodies, by name.
    """
    found: list[tuple[Any, float]] = []
    geoms = [
        geom for geom in built.sim.rigid_solver.geoms if geom.conaffinity == COUPLED_BIT
    ]
    # All fixed bodies are geoms of one link, in the order of the document.
    fixed = iter([geom for geom in geoms if not geom.link.name.startswith("body")])
    for index, body in enumerate(scene.bodies):
        if body.name not in touches:
            continue
        count = len(getattr(body.shape, "pieces_m", (None,)))
        if body.motion is Motion.FIXED:
            of_body = [geom for _, geom in zip(range(count), fixed, strict=False)]
        else:
            of_body = [geom for geom in geoms if geom.link.name == body_label(index)]
        found += [(geom, touches[body.name]) for geom in of_body]
    if len(found) != len(geoms):
        raise BackendError(
            f"Genesis made {len(geoms)} coupled geoms of {list(touches)}: check the bodies' shapes"
        )
    yield from found


def driven_places(
    motion: DrivenMotion, places_m: FloatArray, times_s: NDArray[Any]
) -> NDArray[Any]:
    """Return the world positions of places on a driven body at several times [m], shape [time_count, place_count, 3].

    Args:
        motion: The body's motion.
        places_m: Places in the body frame [m], shape [place_count, 3].
        times_s: Times since the start of the interval [s], shape [time_count].
    """
    travel = motion.travel(times_s[:, None])
    turned = (Rotation.from_rotvec(travel[:, 3:]) * motion.start.rotation).as_matrix()
    origins = np.asarray(motion.start.position_m) + travel[:, :3]
    return np.asarray(np.einsum("tij,pj->tpi", turned, places_m) + origins[:, None])
