"""Deformable bodies of a scene -> parts of a MuJoCo model: what is glued to what, and what touches what."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product

import mujoco
import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.glue import bonded_rows, glue_of
from gauge_envs.backends.mujoco.cloth import ClothPart, add_cloth
from gauge_envs.backends.mujoco.contacts import contact_constants, given_constants
from gauge_envs.backends.mujoco.flex import FlexPart
from gauge_envs.backends.mujoco.line import LinePart, add_rod, add_rope
from gauge_envs.backends.mujoco.settings import SettingsMuJoCo
from gauge_envs.backends.mujoco.soft import SoftPart, add_soft
from gauge_envs.materials import plate_bending_stiffness
from gauge_envs.scene import Cloth, Contact, Motion, Rope, Scene, SoftBody

__all__ = ["add_deformables", "add_flex_contact", "nodes_of", "undoable"]


def add_deformables(spec: mujoco.MjSpec, scene: Scene, settings: SettingsMuJoCo) -> dict[str, FlexPart]:
    """Add all deformable bodies to an editable model that has the rigid ones.

    Returns:
        The part of each deformable body, by its name; soft bodies that are bonded share one.
    """
    glued = {body.name: glue_of(scene, body.name) for body in scene.deformables}
    parts: dict[str, FlexPart] = {}
    for body in scene.deformables:
        if isinstance(body, Cloth):
            bending = plate_bending_stiffness(hinge_stiffness_n_m_per_rad=body.bend_stiffness_n_m_per_rad)
            parts[body.name] = add_cloth(
                spec,
                body,
                glued=glued[body.name],
                cell_m=settings.cloth_cell_m,
                bending_stiffness_n_m=bending,
                contact_radius_m=settings.cloth_fold_radius_m if _touches_itself(scene, body.name) else None,
            )
        elif isinstance(body, Rope):
            parts[body.name] = add_rope(spec, body, glued=glued[body.name])
        elif not isinstance(body, SoftBody):
            parts[body.name] = add_rod(spec, body, glued=glued[body.name])
    for row in bonded_rows(scene):
        part = add_soft(spec, row, glued={body.name: glued[body.name] for body in row})
        parts |= {body.name: part for body in row}
    return parts


def undoable(scene: Scene) -> Iterator[str]:
    """What of a scene's deformable bodies cannot be built, a sentence each."""
    rigid = {body.name: body for body in scene.bodies}
    soft = {body.name: body for body in scene.deformables}
    for attachment in scene.attachments:
        glued, to = soft.get(attachment.deformable), rigid.get(attachment.to)
        if glued is None or (to is None and attachment.to not in soft):
            yield f"{attachment.deformable!r} is glued to {attachment.to!r}, and one of them is not in the scene"
        elif to is not None and to.motion is Motion.DYNAMIC and isinstance(glued, Cloth | SoftBody):
            yield f"{glued.name!r} is glued to {to.name!r}, which moves under forces"


def _touches_itself(scene: Scene, name: str) -> bool:
    return any(name in contact.first and name in contact.second for contact in scene.contacts)


def nodes_of(part: FlexPart, name: str) -> NDArray[np.float64]:
    """Nodes of one deformable body now [m], shape [node_count, 3]."""
    nodes = part.nodes()
    return nodes[part.block_nodes(name)] if isinstance(part, SoftPart) else nodes


def add_flex_contact(
    scene: Scene,
    contact: Contact,
    parts: Mapping[str, FlexPart],
    geoms: Mapping[str, Sequence[mujoco.MjsGeom]],
    settings: SettingsMuJoCo,
    *,
    bit: int,
) -> None:
    """Let deformable bodies of a contact collide, through MuJoCo's broad phase.

    A flex or a rod's spheres carry the contact's bit and constants, with priority over the rigid geoms, which only
    accept the bit; so rigid bodies that touch the same cloth do not meet each other by it. Each kind has solref and
    solimp of its own, unless the settings give those of all contacts.
    """
    constants = contact_constants(contact, settings)
    _, sliding, torsional, rolling, _ = constants.friction
    for name in {*contact.first, *contact.second} & set(parts):
        part = parts[name]
        colliders = part.geoms if isinstance(part, LinePart) and part.geoms else [part.flex]
        for collider in colliders:
            collider.contype |= bit
            collider.condim = constants.condim
            collider.friction = [sliding, torsional, rolling]
            collider.priority = 1
        if isinstance(part, ClothPart):
            part.flex.solref = list(settings.cloth_solref)
            part.flex.solimp = [*settings.cloth_solimp, 0.5, 2.0]
        for collider, (key, value) in product(colliders, given_constants(settings).items()):
            setattr(collider, key, value)
        if name in contact.first and name in contact.second:
            part.flex.selfcollide = mujoco.mjtFlexSelf.mjFLEXSELF_AUTO
            # Without a bit that the flex both offers and accepts, MuJoCo silently skips its self-contact.
            part.flex.conaffinity |= bit
    # What a body is glued to is part of it, and would be in contact all along the seam.
    seams = {a.to for a in scene.attachments if a.deformable in (*contact.first, *contact.second)}
    for name in {*contact.first, *contact.second} - set(parts) - seams:
        for geom in geoms[name]:
            geom.conaffinity |= bit
