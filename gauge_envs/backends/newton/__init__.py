"""NVIDIA Newton: its MuJoCo solver for rigid bodies, VBD for deformable bodies, implicit MPM as a choice for foam.

The first build imports the engine, which takes seconds.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from types import MappingProxyType
from typing import Any

from gauge_envs.backends.base import Repeatability
from gauge_envs.backends.features import Feature
from gauge_envs.backends.newton.contacts import unsupported_surface_contacts
from gauge_envs.backends.newton.fabrics import vbd_constants
from gauge_envs.backends.newton.settings import (
    SettingsLines,
    SettingsMPM,
    SettingsMuJoCoWarp,
    SettingsNewton,
    SettingsVBD,
    settings_for,
)
from gauge_envs.backends.shared.attachments import (
    attached_ends,
    attachment_problems,
    rigid_attachments,
)
from gauge_envs.backends.shared.bundled import BundledBackend, check_settings
from gauge_envs.backends.shared.soft_rows import soft_row_problems
from gauge_envs.backends.simulation import Simulation
from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.scene import Cloth, ContactMode, Rod, Rope, Scene, Tether

__all__ = ["BackendNewton"]


class BackendNewton(BundledBackend):
    """NVIDIA Newton on the CPU or a GPU.

    Its MuJoCo solver simulates rigid scenes and VBD all others; presets `mpm...` select implicit MPM for foam.
    """

    name = "newton"
    title = "Newton"
    color = "#cc79a7"
    marker = "D"
    modules = ("newton", "warp", "mujoco_warp")
    packages = ("newton", "warp-lang", "mujoco-warp", "mujoco")
    settings_for = staticmethod(settings_for)
    fabric_constants = staticmethod(vbd_constants)
    configurations = MappingProxyType(
        {"out_of_box": {"preset": "out_of_box"}, "paper": {"preset": "paper"}}
    )
    corrections = (
        "the damping of a contact is derived from the restitution, whose coefficient the MuJoCo solver ignores",
        "a step of cloth starts from the last acceleration, by a subclass of SolverVBD",
    )
    features = frozenset(Feature) - {Feature.AIR}
    own_defaults = frozenset({"out_of_box", "paper"})

    def unsupported(self, scene: Scene) -> Iterator[str]:
        """Yield one sentence for each feature of a scene that Newton's solvers do not support."""
        return _unsupported_features(scene, settings_for(scene))

    def repeatability(self, settings: Mapping[str, Any] | None = None) -> Repeatability:
        """Return that runs on a GPU part by single precision: its kernels add in any order."""
        if (settings or {}).get("device", "cpu") == "cpu":
            return Repeatability()
        return Repeatability(kind="statistical", start_error=1e-6)

    def build(
        self, scene: Scene, settings: Mapping[str, Any] | None = None
    ) -> Simulation:
        """Build a scene; settings are the fields of the settings class of the preset's solver."""
        return self.build_worlds(scene, 1, settings)

    def build_worlds(
        self,
        scene: Scene,
        world_count: int,
        settings: Mapping[str, Any] | None = None,
    ) -> Simulation:
        """Build a scene as worlds of one model, which advance in the same step; material points need a model each."""
        chosen = _checked(scene, settings)
        if world_count > 1 and isinstance(chosen, SettingsMPM):
            return super().build_worlds(scene, world_count, settings)
        from gauge_envs.backends.newton.simulation import SimulationNewton

        return SimulationNewton(scene, world_count, chosen)


def _checked(scene: Scene, changes: Mapping[str, Any] | None) -> SettingsNewton:
    """Return the settings for a scene if their solver supports it, and start Warp."""
    settings = settings_for(scene, changes)
    _check_preset(scene, settings)
    check_settings("Newton", settings, _unsupported_features(scene, settings))
    _start_quietly()
    return settings


@cache
def _start_quietly() -> None:
    """Keep Warp from logging every kernel that it loads."""
    import warp

    warp.config.log_level = warp.LOG_WARNING


def _check_preset(scene: Scene, settings: SettingsNewton) -> None:
    """Raise an error if the solver of settings does not simulate the kinds of body in a scene."""
    has_cloth = any(isinstance(body, Cloth) for body in scene.deformables)
    has_lines = any(isinstance(body, Rope | Rod) for body in scene.deformables)
    fits = {
        SettingsMuJoCoWarp: not scene.deformables,
        SettingsVBD: bool(scene.deformables) and not has_lines,
        SettingsLines: has_lines
        and all(isinstance(body, Rope | Rod) for body in scene.deformables),
        SettingsMPM: bool(scene.deformables) and not has_cloth and not has_lines,
    }
    if not fits[type(settings)]:
        kinds = sorted({type(body).__name__ for body in scene.deformables}) or [
            "rigid bodies alone"
        ]
        raise UnsupportedSceneError(
            f"Newton preset {settings.preset!r} is for {settings.solver}, which does not simulate {', '.join(kinds)} "
            "here: choose another preset"
        )


def _unsupported_features(scene: Scene, settings: SettingsNewton) -> Iterator[str]:
    """Yield one sentence for each feature of a scene that Newton does not support with given settings."""
    if not scene.deformables:
        return
    for joint in scene.joints:
        if isinstance(joint, Tether):
            yield f"{joint.body!r} hangs on a string beside deformable bodies, which this backend does not support"
    per_body = isinstance(settings, SettingsVBD) and not settings.full_surface
    yield from unsupported_surface_contacts(scene, per_body=per_body)
    yield from _unsupported_lines(scene)
    yield from _unsupported_solids(scene)
    if isinstance(settings, SettingsMPM) and scene.dynamic_bodies:
        yield (
            f"{scene.dynamic_bodies[0].name!r} moves freely: the material point method of this backend collides with "
            "fixed and driven bodies only"
        )


def _unsupported_lines(scene: Scene) -> Iterator[str]:
    lines = [body for body in scene.deformables if isinstance(body, Rope | Rod)]
    others = [
        body.name for body in scene.deformables if not isinstance(body, Rope | Rod)
    ]
    names = {line.name for line in lines}
    if lines and others:
        yield f"{lines[0].name!r} is beside {others[0]!r}: this backend builds ropes and rods with rigid bodies only"
    for attachment in scene.attachments:
        if {attachment.deformable, attachment.to} & names and attachment.to not in {
            body.name for body in scene.bodies
        }:
            yield f"{attachment.deformable!r} is attached to {attachment.to!r}, which is not a rigid body"
    for contact in scene.contacts:
        touching = names & {*contact.first, *contact.second}
        if (
            touching
            and contact.restitution > 0.0
            and contact.mode is ContactMode.IMPACT
        ):
            yield f"{min(touching)!r} rebounds: Newton's vertex block descent has no restitution"
    for line in lines:
        try:
            attached_ends(line, rigid_attachments(scene, line.name))
        except UnsupportedSceneError as error:
            yield str(error)


def _unsupported_solids(scene: Scene) -> Iterator[str]:
    """Yield what VBD does not support of rigid bodies, attachments and soft rows in scenes with deformable bodies."""
    soft = {body.name for body in scene.deformables}
    for name in scene.hinges:
        yield f"{name!r} is on a joint beside deformable bodies, which this backend does not support"
    for contact in scene.contacts:
        for first, second in scene.colliding_pairs(contact):
            if (
                contact.restitution > 0.0
                and contact.mode is ContactMode.IMPACT
                and not {first, second} & soft
            ):
                yield f"{first!r} rebounds from {second!r}: Newton's vertex block descent has no restitution"
    yield from attachment_problems(scene, not_to_dynamic=Cloth)
    cloths = {body.name for body in scene.deformables if isinstance(body, Cloth)}
    for attachment in scene.attachments:
        if attachment.region.axis == "z" and attachment.deformable in cloths:
            yield f"cloth {attachment.deformable!r} is attached to {attachment.to!r} by its face, not by an edge"
    yield from soft_row_problems(scene)
