"""Chains of a rope and the bodies on its ends, as one multibody in reduced coordinates."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.backends.pybullet.engine import pybullet
from gauge_envs.backends.pybullet.rope import RopePart, chain_of
from gauge_envs.backends.pybullet.world import BulletWorld
from gauge_envs.backends.shared.attachments import attached_ends, rigid_attachments
from gauge_envs.scene import Motion, RigidBody, Rope, Scene

NO_SHAPE = -1
"""Number of the shape of segments, which touch nothing."""

UNTURNED = [0.0, 0.0, 0.0, 1.0]


@dataclass(frozen=True)
class RopeEnds:
    """Bodies on the ends of a rope.

    Attributes:
        from_low: Whether the chain starts at the low end.
        root: Body with which the chain starts, or None if its first segment is free.
        tip: Dynamic body with which the chain ends, or None.
    """

    from_low: bool
    root: RigidBody | None
    tip: RigidBody | None


def rope_ends(scene: Scene, rope: Rope) -> RopeEnds:
    """Return the bodies on the ends of a rope; the chain starts at a fixed body if there is one."""
    held = {
        side: scene.body(attachment.body)
        for side, attachment in attached_ends(rope, rigid_attachments(scene, rope.name)).items()
    }
    low, high = held.get("low"), held.get("high")
    if low is None or (high is not None and high.motion is Motion.FIXED):
        return RopeEnds(from_low=high is None, root=high, tip=low)
    return RopeEnds(from_low=True, root=low, tip=high)


@dataclass
class _Links:
    """Arguments of `createMultiBody` for the links after the base."""

    masses: list[float] = field(default_factory=list)
    shapes: list[int] = field(default_factory=list)
    positions: list[list[float]] = field(default_factory=list)
    orientations: list[list[float]] = field(default_factory=list)
    centres: list[list[float]] = field(default_factory=list)
    moments: list[list[float]] = field(default_factory=list)

    def add(
        self,
        *,
        mass_kg: float,
        shape: int,
        place: tuple[NDArray[np.float64], Rotation],
        centre: NDArray[np.float64],
        moments: list[float],
    ) -> None:
        """Add a link on a spherical joint at a place in the frame of the link before; lengths are in units."""
        self.masses.append(mass_kg)
        self.shapes.append(shape)
        self.positions.append(place[0].tolist())
        self.orientations.append(place[1].as_quat().tolist())
        self.centres.append(centre.tolist())
        self.moments.append(moments)

    def arguments(self) -> dict[str, Any]:
        """Return the keyword arguments."""
        count = len(self.masses)
        return {
            "linkMasses": self.masses,
            "linkCollisionShapeIndices": self.shapes,
            "linkVisualShapeIndices": [-1] * count,
            "linkPositions": self.positions,
            "linkOrientations": self.orientations,
            "linkInertialFramePositions": self.centres,
            "linkInertialFrameOrientations": [UNTURNED] * count,
            "linkParentIndices": list(range(count)),
            "linkJointTypes": [pybullet.JOINT_SPHERICAL] * count,
            "linkJointAxis": [[0.0, 0.0, 1.0]] * count,
        }


def add_rope(world: BulletWorld, rope: Rope, *, cell_m: float | None) -> RopePart:
    """Add a rope and the dynamic bodies on its ends, and enter these bodies in `world.handles`.

    Args:
        world: The world.
        rope: The rope.
        cell_m: Desired length of a segment [m], or None for the default.
    """
    ends = rope_ends(world.scene, rope)
    chain = chain_of(rope, cell_m=cell_m, from_low=ends.from_low, scale=world.scale)
    links = _Links()
    root = ends.root if ends.root is not None and ends.root.motion is Motion.DYNAMIC else None
    if root is not None:
        frame = world.frame(root)
        base = world.base_arguments(root, frame)
        turn = root.pose.rotation * frame.axes
        arm = turn.inv().apply(chain.start_m - root.pose.to_world(frame.centre_m))
        place = (world.scale * arm, turn.inv() * chain.rotation)
        base_moments = frame.moments
    elif ends.root is not None:
        base = _base(world, chain.start_m, chain.rotation)
        place, base_moments = (np.zeros(3), Rotation.identity()), []
    else:
        base = _base(world, chain.start_m + 0.5 / chain.count * (chain.end_m - chain.start_m), chain.rotation)
        base["baseMass"] = chain.mass_kg
        place, base_moments = (np.array([0.0, 0.0, 0.5 * chain.length]), Rotation.identity()), chain.moments
    first = -1 if ends.root is None else 0
    centre = np.array([0.0, 0.0, 0.5 * chain.length])
    for _ in range(chain.count + min(first, 0)):
        links.add(mass_kg=chain.mass_kg, shape=NO_SHAPE, place=place, centre=centre, moments=chain.moments)
        place = (np.array([0.0, 0.0, chain.length]), Rotation.identity())
    if ends.tip is not None:
        frame = world.frame(ends.tip)
        turn = ends.tip.pose.rotation * frame.axes
        arm = turn.inv().apply(ends.tip.pose.to_world(frame.centre_m) - chain.end_m)
        shape = world.shape(ends.tip.shape, turn.inv().apply(np.subtract(ends.tip.pose.position_m, chain.end_m)), frame)
        links.add(
            mass_kg=ends.tip.mass_kg,
            shape=shape,
            place=(place[0], chain.rotation.inv() * turn),
            centre=world.scale * arm,
            moments=frame.moments,
        )
    body = int(world.call("createMultiBody", **base, **links.arguments()))
    if base_moments:
        world.call("changeDynamics", body, -1, mass=base["baseMass"], localInertiaDiagonal=base_moments)
    for link, (mass_kg, moments) in enumerate(zip(links.masses, links.moments, strict=True)):
        world.call("changeDynamics", body, link, mass=mass_kg, localInertiaDiagonal=moments)
    world.free_joints(body, len(links.masses), spherical=range(len(links.masses)))
    if root is not None:
        world.add_handle(root, body, -1)
    if ends.tip is not None:
        world.add_handle(ends.tip, body, len(links.masses) - 1)
    return chain.part(rope.name, body, first)


def _base(world: BulletWorld, place_m: NDArray[np.float64], rotation: Rotation) -> dict[str, Any]:
    """Return the arguments of a base without mass and shape."""
    position = (world.scale * place_m).tolist()
    return {"baseMass": 0.0, "basePosition": position, "baseOrientation": rotation.as_quat().tolist()}
