"""Rapier: rigid bodies in single precision, with a native restitution and snapshots. The first build imports it."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType

from gauge_envs.backends.features import Feature
from gauge_envs.backends.rapier.contacts import (
    LARGEST_CONTACT_COUNT,
    colliding_contacts,
)
from gauge_envs.backends.rapier.settings import settings_for
from gauge_envs.backends.shared.bundled import (
    SingleWorldBackend,
    first_of,
    unsupported_compounds,
)
from gauge_envs.backends.simulation import Simulation
from gauge_envs.scene import Cloth, Deformable, Hinge, Rod, Rope, Scene, SoftBody

__all__ = ["BackendRapier"]


KINDS: Mapping[type[Deformable], str] = {
    Cloth: "cloth",
    Rope: "a line",
    Rod: "a line",
    SoftBody: "soft",
}
"""Kinds of deformable bodies in words."""


class BackendRapier(SingleWorldBackend):
    """Rapier on the CPU, in single precision: rigid bodies, hinges and strings.

    Trajectories are the same bit for bit in every run on one machine.
    """

    name = "rapier"
    title = "Rapier"
    color = "#d55e00"
    marker = "s"
    modules = ("rapier3d",)
    packages = ("rapier3d",)
    settings_for = staticmethod(settings_for)
    contact_softness = MappingProxyType(
        {"contact_frequency_hz": 2.0, "static_contact_frequency_hz": 2.0}
    )
    configurations = MappingProxyType(
        {
            "coulomb": {"friction_model": "coulomb"},
            "out_of_box": {"preset": "out_of_box"},
        }
    )
    features = frozenset({Feature.STATED_INERTIA})

    def unsupported(self, scene: Scene) -> Iterator[str]:
        """Yield one sentence for each feature of a scene that this backend does not support."""
        yield from unsupported_compounds(scene)
        kinds: dict[str, list[str]] = {}
        for body in scene.deformables:
            kinds.setdefault(KINDS[type(body)], []).append(body.name)
        for kind, names in kinds.items():
            yield f"{first_of(names)} is {kind}, and this backend builds rigid bodies only"
        counts = Counter(joint.body for joint in scene.joints)
        hinged = [
            joint.body
            for joint in scene.joints
            if isinstance(joint, Hinge) and counts[joint.body] > 1
        ]
        if hinged:
            count = counts[hinged[0]]
            yield f"{hinged[0]!r} has {count} joints, and this backend builds a hinge as the only joint"
        count = len(colliding_contacts(scene))
        if count > LARGEST_CONTACT_COUNT:
            yield (
                f"the scene has {count} kinds of contact, and the 32 collision groups of Rapier separate "
                f"{LARGEST_CONTACT_COUNT}"
            )

    def simulation(self) -> Callable[..., Simulation]:
        """Return the class of simulations; the first call imports the engine."""
        from gauge_envs.backends.rapier.simulation import SimulationRapier

        return SimulationRapier
