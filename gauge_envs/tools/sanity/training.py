"""Define what is checked: the numerical settings that a policy is trained with, and its model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, TypeAlias

from gauge_envs.scene import Vector
from gauge_envs.tools.sanity.robot.robot import Robot

Settings: TypeAlias = Mapping[str, Any]
"""Settings by name. A value is a number, a truth value, a text, a list, or None for what is not set."""


class Need(StrEnum):
    """What a target must have for a check of measured objects to apply to it."""

    GRAVITY = "gravity"
    CONTACT = "contact"
    SPACE = "space"
    """Motion in space, not in a plane along an axis of the world."""


@dataclass(frozen=True, kw_only=True)
class ContactGroup:
    """Pairs of geoms of a model that collide with the same constants.

    Attributes:
        geoms: Description of the geoms, such as `floor with torso, bthigh and 6 more`.
        pair_count: Number of pairs of geoms.
        is_used: Whether the experiments run with these constants.
        settings: Settings of the backend that give all contacts these constants.
    """

    geoms: str
    pair_count: int
    is_used: bool = False
    settings: Settings = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class TrainingConfiguration:
    """Numerical settings that a policy is trained with.

    Attributes:
        name: Name that the user gave, such as `HalfCheetah-v5`.
        source: Description of what it was read from.
        backend: Name of the physics engine.
        settings: Settings of that backend for every scene; other settings are the backend's default.
        contact_groups: Contact constants of a model: those on ground first, then by the number of pairs.
        notes: Properties that are not carried over, or that need attention.
        warnings: MuJoCo's warnings on the user's file, which are shown even where all checks pass.
        inapplicable: Needs of checks that the target does not meet, with the reason.
        up: Unit vector away from the ground, shape [3].
        robot: The target's own model, which JSON leaves out; None when it is unknown.
    """

    name: str
    source: str
    backend: str
    settings: Settings
    contact_groups: tuple[ContactGroup, ...] = ()
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    inapplicable: Mapping[Need, str] = field(default_factory=dict)
    up: Vector = (0.0, 0.0, 1.0)
    robot: Robot | None = field(default=None, compare=False)

    @property
    def contact_sets(self) -> dict[str, dict[str, Any]]:
        """Settings of each set of contact constants that is checked, by its geoms, which may be unknown."""
        sets: dict[str, dict[str, Any]] = {}
        contact = {name for group in self.contact_groups for name in group.settings}
        options = {
            name: value for name, value in self.settings.items() if name not in contact
        }
        for group in self.contact_groups:
            settings = {**options, **group.settings}
            if group.is_used and settings not in sets.values():
                sets[group.geoms] = settings
        return sets or {"": dict(self.settings)}
