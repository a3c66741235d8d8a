"""Drake: rigid bodies with point and hydroelastic contact. The first build imports the engine, which takes a second."""

from collections.abc import Callable, Iterator
from types import MappingProxyType

from gauge_envs.backends.drake.settings import settings_for
from gauge_envs.backends.features import Feature
from gauge_envs.backends.shared.bundled import (
    SingleWorldBackend,
    first_of,
    unsupported_compounds,
)
from gauge_envs.backends.simulation import Simulation
from gauge_envs.scene import Scene

__all__ = ["BackendDrake"]

REASONS = {
    "Cloth": "Drake has no cloth",
    "SoftBody": "Drake's linear tetrahedra lock: 3840 of them bend as a cantilever by 5.43 mm, in theory 5.89 mm",
    "Rope": "Drake has no ropes",
    "Rod": "Drake has no elastic rods",
}
"""Why each kind of deformable body is unsupported."""


class BackendDrake(SingleWorldBackend):
    """Drake's discrete multibody plant on the CPU: rigid bodies, hinges, tethers and driven bodies."""

    name = "drake"
    title = "Drake"
    color = "#e69f00"
    marker = "v"
    modules = ("pydrake",)
    packages = ("drake",)
    settings_for = staticmethod(settings_for)
    configurations = MappingProxyType(
        {
            name: {"preset": name}
            for name in ("tamsi", "sap", "similar", "point", "out_of_box")
        }
    )
    corrections = (
        "the dissipation of a contact is derived from the restitution, because Drake has no coefficient of restitution",
        "a string is a spring that this package computes",
    )
    features = frozenset({Feature.STATED_INERTIA})

    def unsupported(self, scene: Scene) -> Iterator[str]:
        """Yield one sentence for each kind of feature of a scene that this backend does not build."""
        yield from unsupported_compounds(scene)
        subjects: dict[str, list[str]] = {}
        for body in scene.deformables:
            subjects.setdefault(REASONS[type(body).__name__], []).append(body.name)
        for reason, names in subjects.items():
            yield f"{first_of(names)} is deformable: {reason}"

    def simulation(self) -> Callable[..., Simulation]:
        """Return the class of simulations; the first call imports the engine."""
        from gauge_envs.backends.drake.simulation import SimulationDrake

        return SimulationDrake
