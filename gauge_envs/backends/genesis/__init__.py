"""Genesis: rigid bodies with its Newton solver, and the deformable bodies of its other solvers.

The first build imports the engine and compiles its kernels, which takes up to two minutes.
"""

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any

from gauge_envs.backends.features import Feature
from gauge_envs.backends.genesis.fabrics import pbd_constants
from gauge_envs.backends.genesis.presets import settings_for, unsupported_features
from gauge_envs.backends.shared.bundled import BundledBackend, check_settings
from gauge_envs.backends.simulation import Simulation
from gauge_envs.scene import Scene

__all__ = ["BackendGenesis"]


class BackendGenesis(BundledBackend):
    """Genesis on the CPU.

    Rigid bodies move by its constraint solver, a descendant of MuJoCo's solver with another friction cone.
    """

    name = "genesis"
    title = "Genesis"
    color = "#56b4e9"
    marker = "P"
    modules = ("genesis", "torch")
    # MuJoCo reads the description of the bodies.
    packages = ("genesis-world", "quadrants", "torch", "mujoco")
    corrections = (
        "an impact is a damped spring that is fitted to the restitution, because Genesis has no such coefficient",
        "kernels of this package bend cloth and rub it against bodies",
        "a string is a spring that this package computes",
        "its cache of geoms, whose key lacks torsional and rolling friction, is emptied",
    )
    features = frozenset(Feature) - {Feature.AIR}
    own_defaults = frozenset({"out_of_box", "paper"})
    settings_for = staticmethod(settings_for)
    fabric_constants = staticmethod(pbd_constants)
    contact_softness = MappingProxyType(
        {"sustained_timeconst_s": 0.5, "contact_softness_m": 0.5}
    )
    configurations = MappingProxyType(
        {"CG": {"constraint_solver": "CG", "contact_resolution": "convex"}}
        | {name: {"preset": name} for name in ("out_of_box", "paper")}
    )

    def unsupported(self, scene: Scene) -> Iterator[str]:
        """Yield one sentence for each feature of a scene that Genesis does not support."""
        return unsupported_features(scene, settings_for(scene))

    def build_worlds(
        self,
        scene: Scene,
        world_count: int,
        settings: Mapping[str, Any] | None = None,
    ) -> Simulation:
        """Build a scene in N worlds, which are environments of one Genesis scene.

        Each world with deformable bodies is a separate Genesis scene.
        """
        if scene.deformables and world_count > 1:
            return super().build_worlds(scene, world_count, settings)
        chosen = settings_for(scene, settings)
        check_settings("Genesis", chosen, unsupported_features(scene, chosen))
        from gauge_envs.backends.genesis.simulation import SimulationGenesis

        return SimulationGenesis(scene, chosen, world_count)
