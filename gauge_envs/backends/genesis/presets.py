"""Presets of the Genesis backend, the choice of a preset for a scene, and unsupported scenes. Needs no engine.

The content of a scene determines its preset; scores have no influence.
"""

from collections.abc import Iterator, Mapping
from typing import Any

from gauge_envs.backends.genesis.document import is_frictionless, unsupported_contacts
from gauge_envs.backends.genesis.settings import (
    PRESETS,
    SOFT_PRESETS,
    SettingsGenesis,
    pbd_presets,
    soft_presets,
    touching_bodies,
)
from gauge_envs.backends.settings import STACK_BODY_COUNT, resolve_settings
from gauge_envs.backends.shared.attachments import attachment_problems
from gauge_envs.backends.shared.bundled import first_of, unsupported_joints
from gauge_envs.backends.shared.soft_rows import soft_row_problems
from gauge_envs.backends.shared.spring_damper import impact_speed_m_per_s
from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.scene import Cloth, ContactMode, Rod, Rope, Scene, SoftBody

FRICTIONLESS_IMPRATIO = 1e-9
"""Ratio of frictional to normal impedance in scenes without friction. Signorini contacts keep their normal force."""


def presets_for(scene: Scene) -> Mapping[str, SettingsGenesis]:
    """Return the presets of a scene by name. Scenes with deformable bodies have presets of their solvers."""
    if scene.has(Cloth):
        return pbd_presets(scene)
    if scene.has(SoftBody):
        return soft_presets(scene)
    return PRESETS


def settings_for(
    scene: Scene, changes: Mapping[str, Any] | None = None
) -> SettingsGenesis:
    """Return the settings of a scene: its preset with a user's changes."""
    presets = presets_for(scene)
    if isinstance(changes, Mapping):
        _check_kind(changes.get("preset"), presets)
    settings = resolve_settings(
        "Genesis", presets, preset=_preset_name(scene), changes=changes
    )
    if settings.impact_speed_m_per_s is None:
        settings = settings.model_copy(
            update={"impact_speed_m_per_s": float(f"{impact_speed_m_per_s(scene):.2g}")}
        )
    if (
        "impratio" not in (changes or {})
        and settings.friction_cone == "elliptic"
        and is_frictionless(scene)
    ):
        return settings.model_copy(update={"impratio": FRICTIONLESS_IMPRATIO})
    return settings


def _check_kind(name: object, presets: Mapping[str, SettingsGenesis]) -> None:
    """Raise an error if a preset exists, but only for scenes of another kind."""
    if not isinstance(name, str) or name in presets:
        return
    for kind, kind_presets in (
        ("rigid bodies alone", tuple(PRESETS)),
        ("soft bodies", SOFT_PRESETS),
    ):
        if name in kind_presets:
            raise UnsupportedSceneError(
                f"Genesis preset {name!r} is for scenes with {kind}; presets of this scene: {', '.join(presets)}"
            )


def _preset_name(scene: Scene) -> str:
    if scene.deformables:
        return "default"
    if not scene.contacts:
        return "contact_free"
    if len(scene.dynamic_bodies) >= STACK_BODY_COUNT:
        return "stack"
    if scene.has_impact_chain:
        return "impact_chain"
    return (
        "impact"
        if all(contact.mode is ContactMode.IMPACT for contact in scene.contacts)
        else "default"
    )


def unsupported_features(scene: Scene, settings: SettingsGenesis) -> Iterator[str]:
    """Yield one sentence for each kind of unsupported feature of a scene."""
    yield from unsupported_joints(scene)
    yield from unsupported_contacts(scene, settings)
    yield from unsupported_deformables(scene)


def unsupported_deformables(scene: Scene) -> Iterator[str]:
    """Yield one sentence for each kind of unsupported feature of the deformable bodies of a scene."""
    lines = [body.name for body in scene.deformables if isinstance(body, Rope | Rod)]
    if lines:
        yield f"{first_of(lines)} is a line: Genesis has no solver of ropes and rods"
    yield from attachment_problems(scene)
    yield from _unsupported_cloth(scene)
    yield from _unsupported_solids(scene)


def _unsupported_cloth(scene: Scene) -> Iterator[str]:
    cloths = {body.name for body in scene.deformables if isinstance(body, Cloth)}
    dynamic = {body.name for body in scene.dynamic_bodies}
    loads = sorted(
        name
        for name, partner, _ in touching_bodies(scene)
        if name in dynamic and partner in cloths
    )
    if loads:
        yield (
            f"{first_of(loads)} is dynamic and touches cloth: Genesis moves particles out of a body and gives it only "
            "their momentum, so that cloth does not carry it"
        )


def _unsupported_solids(scene: Scene) -> Iterator[str]:
    solids = {body.name for body in scene.deformables if isinstance(body, SoftBody)}
    cloths = [body.name for body in scene.deformables if isinstance(body, Cloth)]
    if solids and cloths:
        yield f"{min(solids)!r} shares a scene with cloth {cloths[0]!r}: this backend builds one of both kinds"
    yield from soft_row_problems(scene)
    for first, second, _ in touching_bodies(scene):
        if {first, second} <= solids:
            yield f"{first!r} may touch {second!r}: Genesis's finite elements do not collide with each other"
            return
