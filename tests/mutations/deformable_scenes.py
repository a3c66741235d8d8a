"""Faults of a backend that builds cloth, foam, ropes, rods or air other than those of the scene."""

from dataclasses import asdict, replace

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.scene import Air, Cloth, Pose, Rod, Rope
from gauge_envs.scene.geometry import vector
from mutations.mutant import fault
from mutations.scenes import change_deformables


def _random_fabric(scene):
    return change_deformables(
        Cloth,
        stretch_stiffness_n_per_m=1.0 + 1e-9 * float(np.random.default_rng().random()),
    )(scene)


def _edge_only(scene):
    attachments = [
        replace(one, region=replace(one.region, depth_m=0.0))
        for one in scene.attachments
    ]
    return replace(scene, attachments=tuple(attachments))


def _one_row_more(scene):
    held = (
        scene.attachments
        if any(isinstance(one, Cloth) for one in scene.deformables)
        else ()
    )
    deeper = [
        replace(one, region=replace(one.region, depth_m=one.region.depth_m + 0.03))
        for one in held
    ]
    return replace(scene, attachments=tuple(deeper or scene.attachments))


def _lines_turned(scene):
    turn = Rotation.from_euler("z", 3.0, degrees=True)
    changed = [
        replace(
            one, pose=Pose.from_rotation(one.pose.position_m, turn * one.pose.rotation)
        )
        if isinstance(one, Rope | Rod)
        else one
        for one in scene.deformables
    ]
    return replace(scene, deformables=tuple(changed))


class _PumpingAir(Air):
    """Air that drives the cloth along its motion."""

    def forces_n(self, areas_m2, velocities_m_per_s):
        return -super().forces_n(areas_m2, velocities_m_per_s)


def _pumping(scene):
    """Return air of the wrong sign in the scene that checks energy, so that no simpler check sees it first."""
    air = scene.air
    if air is None or not (air.lift_coefficient and air.normal_coefficient):
        return scene
    return replace(scene, air=_PumpingAir(**asdict(air)))


def _raised(scene):
    raised = [
        replace(
            one,
            pose=replace(
                one.pose,
                position_m=vector(np.add(one.pose.position_m, [0.0, 0.0, 3e-3])),
            ),
        )
        if isinstance(one, Cloth)
        else one
        for one in scene.deformables
    ]
    return replace(scene, deformables=tuple(raised))


def _cloth_through_itself(scene):
    cloths = {body.name for body in scene.deformables if isinstance(body, Cloth)}
    kept = tuple(
        one
        for one in scene.contacts
        if one.first != one.second or not cloths & {*one.first}
    )
    return replace(scene, contacts=kept)


FAULTS = dict(
    (
        fault(
            "cloth-stretch",
            "stretch stiffness of cloth times 1.3",
            "cloth-stretch",
            "stretches 0.7",
            scene=change_deformables(Cloth, stretch_stiffness_n_per_m=1.3),
        ),
        fault(
            "cloth-itself",
            "contact of cloth with itself left out",
            "cloth-touches-itself",
            "pass through each other",
            scene=_cloth_through_itself,
        ),
        fault(
            "cloth-height",
            "cloth 3 mm too high",
            "cloth-start",
            "centred on its pose",
            scene=_raised,
        ),
        fault(
            "cloth-random",
            "random fabric",
            "cloth-determinism",
            "random numbers",
            scene=_random_fabric,
        ),
        fault(
            "no-attachments",
            "attachments missing",
            "cloth-pinned-edge",
            "attachment is missing",
            scene=lambda scene: replace(scene, attachments=()),
        ),
        fault(
            "attachment-depth",
            "attachments at the edge only",
            "cloth-bending",
            "a clamp of 50 mm",
            scene=_edge_only,
        ),
        fault(
            "attachment-row",
            "attachments of cloth with one row of nodes too many",
            "cloth-clamp",
            "one line of nodes too many",
            scene=_one_row_more,
        ),
        fault(
            "air-pumps",
            "forces of the air along the motion, where there is lift as well as drag and no wind",
            "air-energy",
            "wrong sign",
            scene=_pumping,
        ),
        fault(
            "lines-turned",
            "ropes and rods turned by 3 degrees",
            "rope-start",
            "another position or orientation",
            scene=_lines_turned,
        ),
    )
)
"""Faults by id."""
