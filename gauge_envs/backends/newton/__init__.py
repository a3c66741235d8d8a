"""NVIDIA Newton: its MuJoCo solver for rigid bodies, VBD for deformable bodies, implicit MPM as a choice for foam.

The first build imports the engine, which takes seconds.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import product
from types import MappingProxyType
from typing import Any

from gauge_envs.backends.base import Repeatability
from gauge_envs.backends.features import Feature
from gauge_envs.backends.newton.contacts import unsupported_surface_contacts
from gauge_envs.backends.newton.fabrics import vbd_constants
from gauge_envs.backends.newton.settings import (
    SettingsImplicitMPM,
    SettingsLines,
    SettingsMuJoCoWarp,
    SettingsNewton,
    SettingsVBD,
    settings_for,
)
from gauge_envs.backends.shared.attachments import attachment_problems
from gauge_envs.backends.shared.bundled import BundledBackend, check_settings
from gauge_envs.backends.shared.soft_rows import soft_row_problems
from gauge_envs.backends.simulation import Simulation
from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.scene import Cloth, ContactMode, Rod, Rope, Scene, SoftBody

__all__ = ["BackendNewton"]


class BackendNewton(BundledBackend):
    """NVIDIA Newton on the CPU or a GPU.

    Its MuJoCo solver simulates rigid scenes and VBD all others; presets `mpm...` select implicit MPM for foam.
    """

    name = "newton"
    title = "Newton"
    color = "#cc79a7"
    marker = "D"
    restarts_worlds = True
    modules = ("newton", "warp", "mujoco_warp")
    packages = ("newton", "warp-lang", "mujoco-warp", "mujoco")
    settings_for = staticmethod(settings_for)
    fabric_constants = staticmethod(vbd_constants)
    contact_softness = MappingProxyType(
        dict.fromkeys(("contact_per_stretch", "soft_contact_stiffness_n_per_m"), 2.0)
        | dict.fromkeys(("sustained_solref", "contact_solref"), 0.5)
    )
    configurations = MappingProxyType(
        {"out_of_box": {"preset": "out_of_box"}, "paper": {"preset": "paper"}}
    )
    corrections = (
        "the damping of a contact is derived from the restitution, because the MuJoCo solver ignores its coefficient",
        "a step of cloth starts from the last acceleration, by a subclass of SolverVBD",
    )
    features = frozenset(Feature) - {Feature.AIR}
    own_defaults = frozenset({"out_of_box", "paper"})

    def unsupported(self, scene: Scene) -> Iterator[str]:
        """Yield one sentence for each feature of a scene that Newton's solvers do not support."""
        return _unsupported_features(scene, settings_for(scene))

    def repeatability(self, settings: Mapping[str, Any] | None = None) -> Repeatability:
        """Return that runs on a GPU diverge from single-precision noise: its kernels add in any order."""
        if (settings or {}).get("device", "cpu") == "cpu":
            return Repeatability()
        return Repeatability(kind="statistical", start_error=1e-6)

    def build_worlds(
        self,
        scene: Scene,
        world_count: int,
        settings: Mapping[str, Any] | None = None,
    ) -> Simulation:
        """Build a scene as worlds of one model, which advance in the same step; material points need a model each."""
        chosen = _checked(scene, settings)
        if world_count > 1 and isinstance(chosen, SettingsImplicitMPM):
            return super().build_worlds(scene, world_count, settings)
        from gauge_envs.backends.newton.simulation import SimulationNewton

        return SimulationNewton(scene, world_count, chosen)


SIMULATED: Mapping[type[SettingsNewton], set[type]] = {
    SettingsMuJoCoWarp: set(),
    SettingsVBD: {Cloth, SoftBody},
    SettingsLines: {Rope, Rod},
    SettingsImplicitMPM: {SoftBody},
}
"""Kinds of deformable bodies that each solver simulates here; its scenes have at least one of them."""


def _checked(scene: Scene, changes: Mapping[str, Any] | None) -> SettingsNewton:
    """Return the settings for a scene if their solver supports it, and keep Warp from logging each kernel."""
    settings = settings_for(scene, changes)
    kinds = {type(body) for body in scene.deformables}
    simulated = SIMULATED[type(settings)]
    if not kinds <= simulated or (simulated and not kinds):
        names = sorted(kind.__name__ for kind in kinds) or ["rigid bodies alone"]
        raise UnsupportedSceneError(
            f"Newton preset {settings.preset!r} is for {settings.solver}, which does not simulate {', '.join(names)} "
            "here: choose another preset"
        )
    check_settings("Newton", settings, _unsupported_features(scene, settings))
    import warp

    warp.config.log_level = warp.LOG_WARNING
    return settings


def _unsupported_features(scene: Scene, settings: SettingsNewton) -> Iterator[str]:
    """Yield one sentence for each feature of a scene that Newton does not support with given settings."""
    if not scene.deformables:
        return
    for joint in scene.joints:
        yield f"{joint.body!r} has a joint in a scene with deformable bodies, which this backend does not support"
    per_body = isinstance(settings, SettingsVBD) and not settings.full_surface
    yield from unsupported_surface_contacts(scene, per_body=per_body)
    yield from _rebounds(scene)
    yield from _unsupported_lines(scene)
    yield from attachment_problems(scene)
    yield from soft_row_problems(scene)
    if isinstance(settings, SettingsImplicitMPM) and scene.dynamic_bodies:
        yield (
            f"{scene.dynamic_bodies[0].name!r} moves freely: the material point method of this backend collides with "
            "fixed and driven bodies only"
        )


def _rebounds(scene: Scene) -> Iterator[str]:
    """Yield one sentence for each rebound between two bodies that are not made of particles."""
    lines = {body.name for body in scene.deformables if isinstance(body, Rope | Rod)}
    moving = lines | {body.name for body in scene.dynamic_bodies}
    rigid = lines | {body.name for body in scene.bodies}
    for contact in scene.contacts:
        if contact.restitution == 0.0 or contact.mode is not ContactMode.IMPACT:
            continue
        for first, second in product(contact.first, contact.second):
            is_apart = first != second or first in lines
            if is_apart and {first, second} <= rigid and {first, second} & moving:
                yield f"{first!r} rebounds from {second!r}: Newton's vertex block descent has no restitution"
                break


def _unsupported_lines(scene: Scene) -> Iterator[str]:
    lines = [body.name for body in scene.deformables if isinstance(body, Rope | Rod)]
    others = [body.name for body in scene.deformables if body.name not in lines]
    if lines and others:
        yield f"{lines[0]!r} shares a scene with {others[0]!r}: ropes and rods need a scene of rigid bodies"
