"""PyBullet: sequential impulses for rigid bodies, Featherstone's algorithm for joints, tetrahedra for foam.

The first build imports the engine.
"""

import sys
from collections.abc import Callable, Iterator
from types import MappingProxyType

from gauge_envs.backends.features import Feature
from gauge_envs.backends.pybullet.contacts import colliding_pairs, turning_shares
from gauge_envs.backends.pybullet.settings import settings_for
from gauge_envs.backends.shared.attachments import (
    attachment_problems,
    rigid_attachments,
)
from gauge_envs.backends.shared.bundled import (
    SingleWorldBackend,
    unsupported_compounds,
    unsupported_joints,
)
from gauge_envs.backends.simulation import Simulation
from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.scene import (
    Cloth,
    ContactMode,
    Motion,
    Rod,
    Rope,
    Scene,
    SoftBody,
    Tether,
)

__all__ = ["BackendPyBullet"]

LAST_PYTHON_WITH_WHEELS = (3, 11)

UNSUPPORTED = {
    Cloth: "is cloth, and Bullet's bending springs have no stiffness while it is flat",
    Rod: "is a rod, and Bullet's chains have no bending stiffness",
}


class BackendPyBullet(SingleWorldBackend):
    """PyBullet on the CPU, in double precision: rigid bodies, joints, and ropes and soft bodies without contacts.

    A hanging bar of foam is 3 % too soft, and a swinging rope gains 2.5 % of its energy.
    """

    name = "pybullet"
    title = "PyBullet"
    color = "#000000"
    marker = "X"
    modules = ("pybullet",)
    packages = ("pybullet",)
    settings_for = staticmethod(settings_for)
    configurations = MappingProxyType({"out_of_box": {"preset": "out_of_box"}})
    corrections = (
        "a metre has 100 units, because margins and thresholds of Bullet are absolute",
        "a string is a chain of three joints",
    )
    features = frozenset(Feature) - {Feature.AIR}

    def failed_import(self, module: str) -> ImportError:
        """Return the failed import, with the way to install PyBullet on this version of Python."""
        if sys.version_info[:2] <= LAST_PYTHON_WITH_WHEELS:
            return super().failed_import(module)
        return ModuleNotFoundError(
            "PyBullet on Python 3.11 (for later versions it has no wheels; 'pip install pybullet' then compiles it)"
        )

    def unsupported(self, scene: Scene) -> Iterator[str]:
        """Yield one sentence for each feature of a scene that this backend does not support."""
        yield from unsupported_compounds(scene)
        for kind, reason in UNSUPPORTED.items():
            names = [body.name for body in scene.deformables if isinstance(body, kind)]
            if names:
                yield f"{names[0]!r} {reason}"
        yield from attachment_problems(scene)
        yield from unsupported_joints(scene)
        yield from _unsupported_joints(scene)
        yield from _unsupported_soft_bodies(scene)
        for rope in scene.deformables:
            if isinstance(rope, Rope):
                yield from _unsupported_rope(scene, rope)
        try:
            turning_shares(scene)
        except UnsupportedSceneError as error:
            yield str(error)

    def simulation(self) -> Callable[..., Simulation]:
        """Return the class of simulations; the first call imports the engine."""
        from gauge_envs.backends.pybullet.simulation import SimulationPyBullet

        return SimulationPyBullet


def _unsupported_joints(scene: Scene) -> Iterator[str]:
    jointed: set[str] = set()
    for joint in scene.joints:
        name = joint.body
        body = scene.body(name)
        if name in jointed:
            yield f"{name!r} has two joints: this backend builds one joint for each body"
        jointed.add(name)
        if isinstance(joint, Tether) and body.pose.position_m == joint.anchor_m:
            yield f"{name!r} starts at the anchor of its string, which then has no direction"
        if isinstance(joint, Tether) and not body.starts_at_rest:
            yield f"{name!r} is on a string and has an initial velocity: this backend starts strings at rest"


def _unsupported_rope(scene: Scene, rope: Rope) -> Iterator[str]:
    """Yield the unsupported features of a rope: contacts, and ends outside one tree of joints."""
    name = rope.name
    if any(name in pair for _, pair in colliding_pairs(scene)):
        yield f"{name!r} touches other bodies or itself: chains of light segments in contact diverge in Bullet"
    ends = rigid_attachments(scene, name)
    jointed = {joint.body for joint in scene.joints}
    jointed |= {
        attachment.to
        for attachment in scene.attachments
        if attachment.deformable != name
    }
    for end in ends:
        if end.motion is Motion.KINEMATIC:
            yield f"{name!r} is attached to {end.body!r}, which is driven: chains start at fixed or dynamic bodies"
        if end.motion is Motion.DYNAMIC and end.body in jointed:
            yield f"{end.body!r} is attached to {name!r} and has another joint or rope"
    bodies = {end.body for end in ends}
    motions = {end.motion for end in ends}
    if len(ends) == 2 and (len(bodies) == 1 or motions == {Motion.FIXED}):
        yield f"{name!r} is attached at both ends, so that its chain is a loop, which this backend does not build"


def _unsupported_soft_bodies(scene: Scene) -> Iterator[str]:
    """Yield the unsupported features of soft bodies: contacts between them, bonds, and moving rigid bodies."""
    soft = {body.name: body for body in scene.deformables if isinstance(body, SoftBody)}
    if not soft:
        return
    deformable = {body.name for body in scene.deformables}
    for contact, (first, second) in colliding_pairs(scene):
        rebounds = contact.mode is ContactMode.IMPACT and contact.restitution > 0.0
        if deformable >= {first, second}:
            yield f"{first!r} and {second!r} are deformable and touch: this backend builds no such contacts"
        elif rebounds and soft.keys() & {first, second}:
            yield f"{first!r} rebounds from {second!r}: contacts of Bullet's soft bodies have no restitution"
    for bond in scene.attachments:
        if soft.keys() >= {bond.deformable, bond.to}:
            yield f"{bond.deformable!r} is attached to {bond.to!r}: this backend builds no bonds of soft bodies"
    for body in soft.values():
        yield from _unsupported_solid(scene, body)
    for neighbour in (*scene.dynamic_bodies, *scene.deformables):
        if neighbour.name not in soft:
            yield f"{neighbour.name!r} moves in a scene with {min(soft)!r}: this backend builds soft bodies alone"


def _unsupported_solid(scene: Scene, body: SoftBody) -> Iterator[str]:
    """Yield the attachments that the mesh of a soft body cannot represent."""
    regions = [attachment.region for attachment in rigid_attachments(scene, body.name)]
    for axis, edge_m in zip("xyz", body.shape.size_m, strict=True):
        if sum(region.depth_m for region in regions if region.axis == axis) >= edge_m:
            yield f"{body.name!r} is attached over all of its length: reduce the regions' depth_m"
