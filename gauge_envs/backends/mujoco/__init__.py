"""MuJoCo backend, the default engine. The first build imports the engine."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from gauge_envs.backends.features import Feature
from gauge_envs.backends.mujoco.fabrics import flex_constants
from gauge_envs.backends.mujoco.settings import settings_for
from gauge_envs.backends.mujoco.versions import without_absent, without_deformables
from gauge_envs.backends.shared.bundled import BundledBackend
from gauge_envs.backends.simulation import Simulation
from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.scene import Scene

if TYPE_CHECKING:
    from gauge_envs.backends.mujoco.simulation import SimulationMuJoCo

__all__ = ["BackendMuJoCo"]


class BackendMuJoCo(BundledBackend):
    """MuJoCo on the CPU: rigid bodies, hinges, tethers, driven bodies; with MuJoCo 4, deformable bodies too."""

    name = "mujoco"
    title = "MuJoCo"
    color = "#0072b2"
    marker = "o"
    packages = ("mujoco",)
    settings_for = staticmethod(settings_for)
    fabric_constants = staticmethod(flex_constants)
    corrections = (
        "the damping of a contact is derived from the restitution, because MuJoCo has no coefficient of restitution",
    )
    features = frozenset(Feature)
    contact_softness = MappingProxyType(
        dict.fromkeys(("sustained_solref", "cloth_solref", "contact_solref"), 0.5)
    )
    configurations = MappingProxyType(
        {
            "PGS": {"solver": "PGS"},
            "CG": {"solver": "CG"},
            "out_of_box": {"preset": "out_of_box"},
        }
    )
    worlds_share_simulation = False
    restarts_worlds = True

    def unsupported(self, scene: Scene) -> Iterator[str]:
        """Yield the unsupported features, such as cloth on a dynamic body or, below MuJoCo 4, deformable bodies."""
        from gauge_envs.backends.mujoco.deformables import unsupported_features

        yield from without_deformables(scene)
        yield from unsupported_features(scene)

    def build(
        self, scene: Scene, settings: Mapping[str, Any] | None = None
    ) -> SimulationMuJoCo:
        """Build a scene; settings are the fields of `SettingsMuJoCo`."""
        return self.compiled(scene, 1, settings)

    def build_worlds(
        self,
        scene: Scene,
        world_count: int,
        settings: Mapping[str, Any] | None = None,
    ) -> Simulation:
        """Build rigid worlds of one model, which threads step; those with deformable bodies have a model each."""
        if scene.deformables:
            return super().build_worlds(scene, world_count, settings)
        return self.compiled(scene, world_count, settings)

    def compiled(
        self,
        scene: Scene,
        world_count: int,
        settings: Mapping[str, Any] | None,
    ) -> SimulationMuJoCo:
        """Build worlds of one model."""
        from gauge_envs.backends.mujoco.model import build_model
        from gauge_envs.backends.mujoco.simulation import SimulationMuJoCo

        for reason in without_deformables(scene):
            raise UnsupportedSceneError(reason)
        chosen = settings_for(scene, settings)
        effective = without_absent(chosen.model_dump(mode="json"))
        spec, model, parts = build_model(scene, chosen)
        return SimulationMuJoCo(
            scene, effective, spec, model, parts, world_count=world_count
        )
