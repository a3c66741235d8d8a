"""Genesis: rigid bodies with its Newton solver, and the deformable bodies of its other solvers.

The first build imports the engine and compiles its kernels, which takes up to two minutes.
"""

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from gauge_envs.backends.features import Feature
from gauge_envs.backends.genesis.fabrics import pbd_constants
from gauge_envs.backends.genesis.presets import settings_for, unsupported_features
from gauge_envs.backends.genesis.settings import SettingsGenesis
from gauge_envs.backends.shared.bundled import BundledBackend, check_settings
from gauge_envs.backends.world import Simulation
from gauge_envs.backends.worlds import Worlds
from gauge_envs.scene import Scene

__all__ = ["BackendGenesis"]


class BackendGenesis(BundledBackend):
    """Genesis on the CPU.

    Rigid bodies move by its constraint solver, a descendant of MuJoCo's with a friction cone of its own.
    """

    name = "genesis"
    title = "Genesis"
    color = "#56b4e9"
    marker = "P"
    modules = ("genesis", "torch")
    # MuJoCo reads the description of the bodies.
    packages = ("genesis-world", "quadrants", "torch", "mujoco")
    corrections = (
        "an impact is a damped spring that is fitted to the restitution, of which Genesis has no coefficient",
        "kernels of this package bend cloth and rub it against bodies",
        "a string is a spring that this package computes",
        "its cache of geoms, whose key lacks torsional and rolling friction, is emptied",
    )
    features = frozenset(Feature) - {Feature.AIR}
    own_defaults = frozenset({"out_of_box", "paper"})
    settings_for = staticmethod(settings_for)
    fabric_constants = staticmethod(pbd_constants)
    configurations = MappingProxyType(
        {"CG": {"constraint_solver": "CG", "contact_resolution": "convex"}}
        | {name: {"preset": name} for name in ("out_of_box", "paper")}
    )

    def unsupported(self, scene: Scene) -> Iterator[str]:
        """Yield one sentence for each feature of a scene that Genesis does not support."""
        return unsupported_features(scene, settings_for(scene))

    def build(
        self, scene: Scene, settings: Mapping[str, Any] | None = None
    ) -> Simulation:
        """Build a scene; settings are the fields of `SettingsGenesis`, or of the class of the preset's solver."""
        chosen = _checked(scene, settings)
        from gauge_envs.backends.genesis.simulation import SimulationGenesis

        return SimulationGenesis(scene, chosen)

    def build_worlds(
        self, scenes: Sequence[Scene], settings: Mapping[str, Any] | None = None
    ) -> Worlds:
        """Build scenes as environments of one Genesis scene, which advance in the same step.

        Scenes with deformable bodies, and scenes that differ in more than start poses, advance one after another.
        """
        chosen = _checked(scenes[0], settings)
        from gauge_envs.backends.genesis.model import model_key
        from gauge_envs.backends.genesis.simulation import WorldsGenesis

        is_rigid = not any(scene.deformables for scene in scenes)
        if is_rigid and len({model_key(scene, chosen) for scene in scenes}) == 1:
            return WorldsGenesis(scenes, chosen)
        return super().build_worlds(scenes, settings)


def _checked(scene: Scene, changes: Mapping[str, Any] | None) -> SettingsGenesis:
    settings = settings_for(scene, changes)
    check_settings("Genesis", settings, unsupported_features(scene, settings))
    return settings
