"""Deformable bodies of a scene -> parts of a MuJoCo model: what is glued to what, and what touches what."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product

import mujoco
import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.mujoco.cloth import ClothPartMuJoCo, add_cloth
from gauge_envs.backends.mujoco.contacts import IMPEDANCE_SHAPE, contact_constants, given_constants
from gauge_envs.backends.mujoco.flex import FlexPart
from gauge_envs.backends.mujoco.line import LinePartMuJoCo, add_rod, add_rope
from gauge_envs.backends.mujoco.settings import SettingsMuJoCo
from gauge_envs.backends.mujoco.soft import SoftPartMuJoCo, add_soft
from gauge_envs.backends.shared.attachments import bonded_rows, rigid_attachments
from gauge_envs.scene import Cloth, Contact, Motion, Rope, Scene, SoftBody
from gauge_envs.scene.fabrics import plate_bending_stiffness

__all__ = [
    "add_deformables",
    "add_flex_contact",
    "nodes_of",
    "unsupported_features",
]


def add_deformables(spec: mujoco.MjSpec, scene: Scene, settings: SettingsMuJoCo) -> dict[str, FlexPart]:
    """Add all deformable bodies to an editable model that has the rigid ones.

    Returns:
        The part of each deformable body, by its name; soft bodies that are bonded share one.
    """
    glued = {body.name: rigid_attachments(scene, body.name) for body in scene.deformables}
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


def unsupported_features(scene: Scene) -> Iterator[str]:
    """What of a scene's deformable bodies cannot be built, a sentence each."""
    rigid = {body.name: body for body in scene.bodies}
    soft = {body.name: body for body in scene.deformables}
    for attachment in scene.attachments:
        glued, to = soft.get(attachment.deformable), rigid.get(attachment.to)
        if glued is None or (to is None and attachment.to not in soft):
            yield f"{attachment.deformable!r} is glued to {attachment.to!r}, and one of them is not in the scene"
        elif to is not None and to.motion is Motion.DYNAMIC and isinstance(glued, Cloth | SoftBody):
            yield f"{glued.name!r} is glued to {to.name!r}, which moves under forces"
    yield from _frictions_in_conflict(scene)


def _touches_itself(scene: Scene, name: str) -> bool:
    return any(name in contact.first and name in contact.second for contact in scene.contacts)


def nodes_of(part: FlexPart, name: str) -> NDArray[np.float64]:
    """Nodes of one deformable body now [m], shape [node_count, 3]."""
    nodes = part.nodes()
    return nodes[part.block_nodes(name)] if isinstance(part, SoftPartMuJoCo) else nodes


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
    accept the bit; so rigid bodies that touch the same cloth do not meet each other by it. A flex has one friction:
    where a contact has another one, its rigid geoms carry the constants, with priority over the flex. Each kind has
    solref and solimp of its own, unless the settings give those of all contacts.
    """
    constants = contact_constants(contact, settings)
    _, sliding, torsional, rolling, _ = constants.friction
    rigid = [geom for name in _rigid_names(scene, contact) for geom in geoms[name]]
    for name in _deformable_names(scene, contact):
        part = parts[name]
        colliders = part.geoms if isinstance(part, LinePartMuJoCo) and part.geoms else [part.flex]
        for collider in colliders:
            collider.contype |= bit
        if isinstance(part, ClothPartMuJoCo):
            part.flex.solref = list(settings.cloth_solref)
            part.flex.solimp = _cloth_solimp(part, settings)
        for collider, (key, value) in product(colliders, given_constants(settings).items()):
            setattr(collider, key, value)
        is_own = contact.friction == _own_friction(scene, name)
        for carrier in colliders if is_own else rigid:
            carrier.condim = constants.condim
            carrier.friction = [sliding, torsional, rolling]
            carrier.priority = 1 if is_own else 2
            carrier.solref, carrier.solimp = list(colliders[0].solref), list(colliders[0].solimp)
        if name in contact.first and name in contact.second:
            part.flex.selfcollide = mujoco.mjtFlexSelf.mjFLEXSELF_AUTO
            # Without a bit that the flex both offers and accepts, MuJoCo silently skips its self-contact.
            part.flex.conaffinity |= bit
    for geom in rigid:
        geom.conaffinity |= bit


def _cloth_solimp(part: ClothPartMuJoCo, settings: SettingsMuJoCo) -> list[float]:
    if settings.cloth_solimp is not None:
        return [*settings.cloth_solimp, *IMPEDANCE_SHAPE]
    assert settings.cloth_softness_m2_per_kg is not None, "the settings check it"
    impedance = 1.0 / (1.0 + settings.cloth_softness_m2_per_kg * part.cloth.areal_density_kg_per_m2)
    # The width is without effect where the impedance is constant in depth.
    return [impedance, impedance, 0.001, *IMPEDANCE_SHAPE]


def _deformable_names(scene: Scene, contact: Contact) -> set[str]:
    return {*contact.first, *contact.second} & {body.name for body in scene.deformables}


def _rigid_names(scene: Scene, contact: Contact) -> set[str]:
    """Rigid bodies that meet deformable ones by a contact."""
    # What a body is glued to is part of it, and would be in contact all along the seam.
    seams = {a.to for a in scene.attachments if a.deformable in (*contact.first, *contact.second)}
    return {*contact.first, *contact.second} - _deformable_names(scene, contact) - seams


def _own_friction(scene: Scene, name: str) -> float:
    """Friction that the flex of a deformable body carries: that of its self-contact, or of its first contact."""
    rows = [{body.name for body in row} for row in bonded_rows(scene)]
    members = next((row for row in rows if name in row), {name})
    touching = [c for c in scene.contacts if members & {*c.first, *c.second}]
    return next((c for c in touching if members & {*c.first} & {*c.second}), touching[0]).friction


def _frictions_in_conflict(scene: Scene) -> Iterator[str]:
    """Contacts of deformable bodies whose friction neither a flex nor a rigid geom can carry."""
    for contact in scene.contacts:
        soft = _deformable_names(scene, contact)
        if all(contact.friction == _own_friction(scene, name) for name in soft):
            continue
        if len(soft) > 1:
            yield f"{sorted(soft)} touch with another friction than they touch other bodies"
        for name in sorted(_rigid_names(scene, contact)):
            touching = [c for c in scene.contacts if name in _rigid_names(scene, c) and _deformable_names(scene, c)]
            if len({c.friction for c in touching}) > 1:
                yield f"{name!r} touches deformable bodies with several frictions, and so do they"
