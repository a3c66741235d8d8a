"""Optional features of engines, and which of them a scene needs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

from gauge_envs.scene import Scene


@dataclass(frozen=True)
class Support:
    """Whether a backend can build a scene, and the unsupported features if it cannot.

    Attributes:
        missing: One sentence for each unsupported feature; empty if the backend can build the scene.
    """

    missing: tuple[str, ...] = ()

    def __bool__(self) -> bool:
        return not self.missing


class Feature(StrEnum):
    """Part of a scene that an engine builds only if it declares the feature."""

    AIR = "air"
    """`Scene.air` around cloth."""
    STATED_INERTIA = "stated inertia"
    """`RigidBody.inertia_kg_m2`."""
    TORSION = "torsional friction"
    """`Contact.torsion_m`."""
    ROLLING = "rolling friction"
    """`Contact.rolling_m`."""


def needed_features(scene: Scene) -> Iterator[tuple[Feature, str]]:
    """Yield the optional features that a scene needs, each with the sentence of a backend that lacks it."""
    if scene.air:
        yield (
            Feature.AIR,
            "the scene has air around its cloth, which this backend does not apply",
        )
    for contact in scene.contacts:
        bodies = f"{contact.first[0]!r} and {contact.second[0]!r}"
        for feature, length_m in (
            (Feature.TORSION, contact.torsion_m),
            (Feature.ROLLING, contact.rolling_m),
        ):
            if length_m:
                yield (
                    feature,
                    f"{bodies} touch with {feature.value}, which this backend does not build",
                )
    for body in scene.dynamic_bodies:
        if body.inertia_kg_m2 is not None:
            yield (
                Feature.STATED_INERTIA,
                f"{body.name!r} has a given inertia, which this backend does not read",
            )
