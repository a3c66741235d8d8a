"""What the deformable solvers of Genesis share: rigid bodies that touch particles, and held material."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.backends.genesis.document import COUPLED_BIT, body_label
from gauge_envs.backends.shared.driven_motion import DrivenMotion
from gauge_envs.errors import BackendError
from gauge_envs.scene import Motion, Scene


def touching_bodies(scene: Scene, names: Iterable[str]) -> dict[str, float]:
    """Return the friction of the rigid bodies that may touch some deformable bodies, by name.

    Args:
        scene: The scene.
        names: Names of the deformable bodies.
    """
    rigid, soft = {body.name for body in scene.bodies}, set(names)
    return {
        name: contact.friction
        for contact in scene.contacts
        for pair in scene.colliding_pairs(contact)
        for name, other in (pair, pair[::-1])
        if name in rigid and other in soft
    }


def couple_only_marked_geoms(scene: Any) -> None:
    """Let particles collide with the geoms that the document has for them, and with no others."""
    for geom in scene.sim.rigid_solver.geoms:
        geom._needs_coup = geom.conaffinity == COUPLED_BIT


def coupled_geoms(built: Any, scene: Scene, touches: Mapping[str, float]) -> dict[str, list[int]]:
    """Return the geoms that collide with particles, by name of their body.

    Args:
        built: The `gs.Scene`.
        scene: The scene.
        touches: Friction of the bodies that touch particles, by name.
    """
    found: dict[str, list[int]] = {}
    geoms = [geom for geom in built.sim.rigid_solver.geoms if geom.conaffinity == COUPLED_BIT]
    # All fixed bodies are geoms of one link, in the order of the document.
    fixed = iter([geom for geom in geoms if not geom.link.name.startswith("body")])
    for index, body in enumerate(scene.bodies):
        if body.name not in touches:
            continue
        count = len(getattr(body.shape, "pieces_m", (None,)))
        if body.motion is Motion.FIXED:
            own = [geom for _, geom in zip(range(count), fixed, strict=False)]
        else:
            own = [geom for geom in geoms if geom.link.name == body_label(index)]
        found[body.name] = [geom.idx for geom in own]
    if sum(map(len, found.values())) != len(geoms):
        raise BackendError(f"Genesis made {len(geoms)} coupled geoms of {list(touches)}: check the bodies' shapes")
    return found


def set_coupling(built: Any, scene: Scene, touches: Mapping[str, float], softness_m: float) -> None:
    """Set how rigid bodies act on the velocities of nodes and of a grid; they have no restitution.

    Args:
        built: The `gs.Scene`, not built yet.
        scene: The scene.
        touches: Friction of the bodies that touch soft bodies, by name.
        softness_m: Distance over which a body's velocity decays in front of it [m].
    """
    for name, indices in coupled_geoms(built, scene, touches).items():
        for index in indices:
            geom = built.sim.rigid_solver.geoms[index]
            geom._coup_friction, geom._coup_restitution, geom._coup_softness = touches[name], 0.0, softness_m


def driven_places(motion: DrivenMotion, places_m: NDArray[np.float64], times_s: NDArray[Any]) -> NDArray[Any]:
    """Return the world positions of places on a driven body at several times [m], shape [time_count, place_count, 3].

    Args:
        motion: The body's motion.
        places_m: Places in the body frame [m], shape [place_count, 3].
        times_s: Times since the start of the interval [s], shape [time_count].
    """
    times = times_s[:, None]
    travel = (motion.velocity + 0.5 * motion.acceleration * times) * times
    turned = (Rotation.from_rotvec(travel[:, 3:]) * motion.start.rotation).as_matrix()
    origins = np.asarray(motion.start.position_m) + travel[:, :3]
    return np.asarray(np.einsum("tij,pj->tpi", turned, places_m) + origins[:, None])
