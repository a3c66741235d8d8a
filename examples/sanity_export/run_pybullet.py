"""Run the scenes of `gauge sanity export DIR` in PyBullet from URDF: python run_pybullet.py DIR [SCENE ...].

It needs PyBullet and the folder alone. Bullet multiplies the friction and the restitution of two bodies.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pybullet

STEP_S = 1.0 / 240.0
"""Bullet's default step [s]."""

BASE = -1
"""Bullet's number of the root link."""

DRIVEN_MASS_KG = 1e6
"""Mass of a driven body, which contacts must not move."""


class World:
    """One scene in PyBullet.

    Args:
        folder: Folder of the scene.
        scene: Its entry in the manifest.
    """

    step_s = STEP_S

    def __init__(self, folder: Path, scene: dict[str, Any]) -> None:
        pybullet.resetSimulation()
        pybullet.setTimeStep(self.step_s)
        pybullet.setGravity(*scene["gravity_m_per_s2"])
        self.fall_m_per_s = self.step_s * np.array(scene["gravity_m_per_s2"])
        self.links: dict[str, tuple[int, int]] = {}
        self.origins_m: dict[str, list[float]] = {}
        self.driven: dict[str, list[float]] = {}
        for body in scene["bodies"]:
            self.add(folder, body)
        self.let_touch(scene["contacts"])

    def add(self, folder: Path, body: dict[str, Any]) -> None:
        """Load a body, and set the constants that URDF lacks."""
        number = pybullet.loadURDF(
            str(folder / body["urdf"]),
            body["urdf_root_position_m"],
            xyzw(body["urdf_root_quaternion_wxyz"]),
            useFixedBase=body["urdf_root_is_fixed"],
            flags=pybullet.URDF_USE_INERTIA_FROM_FILE,
        )
        link = pybullet.getNumJoints(number) - 1
        self.links[body["name"]] = number, link
        self.origins_m[body["name"]] = body["urdf_origin_in_link_m"]
        if body["motion"] == "driven":
            pybullet.changeDynamics(number, link, mass=DRIVEN_MASS_KG, localInertiaDiagonal=[DRIVEN_MASS_KG] * 3)
        pybullet.changeDynamics(
            number,
            link,
            lateralFriction=body["friction_by_rule"].get("product", 0.0),
            restitution=body["restitution_by_rule"].get("product", 0.0),
            linearDamping=0.0,
            angularDamping=0.0,
            jointDamping=0.0,
        )
        if link == BASE:
            pybullet.resetBaseVelocity(number, body["velocity_m_per_s"], body["angular_velocity_rad_per_s"])
        else:
            # PyBullet has a motor in each joint that acts as a brake.
            pybullet.setJointMotorControl2(number, link, pybullet.VELOCITY_CONTROL, force=0.0)

    def let_touch(self, contacts: list[dict[str, Any]]) -> None:
        """Let the pairs of bodies touch that the manifest lists, and no others."""
        touching = {frozenset((a, b)) for c in contacts for a in c["first"] for b in c["second"]}
        names = list(self.links)
        for index, one in enumerate(names):
            for other in names[index + 1 :]:
                if {one, other} not in touching:
                    (a, i), (b, j) = self.links[one], self.links[other]
                    pybullet.setCollisionFilterPair(a, b, i, j, enableCollision=0)

    def state(self, name: str) -> list[float]:
        """Return position [m], quaternion (w, x, y, z) and velocity [m/s] of a body's origin."""
        number, link = self.links[name]
        if link == BASE:
            place, turn = pybullet.getBasePositionAndOrientation(number)
            velocity, spin = pybullet.getBaseVelocity(number)
        else:
            found = pybullet.getLinkState(number, link, computeLinkVelocity=1, computeForwardKinematics=1)
            place, turn, velocity, spin = found[0], found[1], found[6], found[7]
        # Bullet has the frame of the centre of mass along the principal axes.
        local = pybullet.invertTransform(*pybullet.getDynamicsInfo(number, link)[3:5])
        frame, turn = pybullet.multiplyTransforms(place, turn, *local)
        origin, turn = pybullet.multiplyTransforms(frame, turn, self.origins_m[name], [0.0, 0.0, 0.0, 1.0])
        speed = np.add(velocity, np.cross(spin, np.subtract(origin, place)))
        return [*origin, turn[3], *turn[:3], *speed.tolist()]

    def drive(self, name: str, numbers: list[float]) -> None:
        """Set pose (7) and velocity (6) of a driven body; its acceleration is not used."""
        self.driven[name] = numbers

    def step(self, count: int) -> None:
        """Simulate steps."""
        for _ in range(count):
            for name, numbers in self.driven.items():
                body = self.links[name][0]
                pybullet.resetBasePositionAndOrientation(body, numbers[:3], xyzw(numbers[3:7]))
                # A driven body does not fall.
                pybullet.resetBaseVelocity(body, np.subtract(numbers[7:10], self.fall_m_per_s).tolist(), numbers[10:13])
            pybullet.stepSimulation()


def xyzw(quaternion: list[float]) -> list[float]:
    """Return a quaternion in Bullet's order."""
    return [*quaternion[1:], quaternion[0]]


if __name__ == "__main__":
    pybullet.connect(pybullet.DIRECT)
    sys.path.insert(0, sys.argv[1])
    from gauge_loop import run

    run(sys.argv[1], World, only=sys.argv[2:])
