"""Collect settings of the backend `physx` with their origins, and make a configuration of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gauge_envs.errors import ParameterError, TargetError
from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.sanity.foot_contact import FootContact
from gauge_envs.tools.sanity.model import Need, TrainingConfiguration
from gauge_envs.tools.sanity.readers.reader import check_settings
from gauge_envs.tools.sanity.readers.table import Table

OFFSET_PER_LENGTH, DISTANCE_PER_LENGTH = 0.04, 0.025
"""PhysX's friction offset threshold and friction correlation distance, over its length scale."""

LEAST_NOTED_M_PER_S = 0.1
"""Smallest bounce threshold that gets a note [m/s]: a fall of half a millimetre."""

SAME_LENGTH = 1e-6
"""Relative difference of two length scales that counts as none."""

LARGEST = {
    "max_linear_velocity_m_per_s": 1e16,
    "max_angular_velocity_rad_per_s": 1e16,
    "max_depenetration_velocity_m_per_s": 1e32,
}
"""Values that stand for no limit."""


class PhysxValues:
    """Settings of the backend `physx`, with their origins, and notes on what has no setting.

    Args:
        preset: Preset that supplies what the target does not state.
    """

    def __init__(self, preset: str) -> None:
        self.settings: dict[str, Any] = {"preset": preset}
        self.origins = {"preset": "not stated: this package's preset"}
        self.notes: list[str] = []

    def take(self, name: str, value: Any, origin: str) -> None:
        """Set a setting; None leaves it to the preset."""
        if value is None:
            return
        self.settings[name] = min(value, LARGEST[name]) if name in LARGEST else value
        self.origins[name] = origin

    def take_friction_scale(self, offset_m: float | None, distance_m: float | None, origin: str) -> None:
        """Set the length scale that gives a friction offset threshold and a friction correlation distance [m].

        A note states what the engine does with two values that no scale gives.
        """
        if offset_m is None or distance_m is None:
            return
        length = offset_m / OFFSET_PER_LENGTH
        if length > 0.0 and abs(distance_m / DISTANCE_PER_LENGTH - length) <= SAME_LENGTH * length:
            self.take("tolerance_length_m", round(length, 12), origin)
            return
        self.notes.append(
            f"friction_offset_threshold {offset_m:g} m and friction_correlation_distance {distance_m:g} m are not "
            "carried over: SAPIEN leaves them at 0.04 and 0.025 of one length scale, here 1 m"
        )

    def configuration(
        self,
        table: Table,
        *,
        name: str,
        source: str,
        language: str,
        gravity_m_per_s2: tuple[float, ...] | None,
        frame_skip: int | None,
        foot_contact: FootContact,
        inapplicable: Mapping[Need, str] | None = None,
    ) -> TrainingConfiguration:
        """Return the configuration, after a trial of its settings."""
        try:
            check_settings("physx", self.settings)
        except ParameterError as error:
            raise TargetError(f"{table.source}: {error}") from error
        reasons = dict(inapplicable or {})
        x, y, z = gravity_m_per_s2 or (0.0, 0.0, -GRAVITY_M_PER_S2)
        if not any((x, y, z)):
            reasons[Need.GRAVITY] = "the target has no gravity"
        threshold = self.settings.get("bounce_threshold_m_per_s")
        if threshold is not None and threshold >= LEAST_NOTED_M_PER_S:
            fall_mm = 1e3 * threshold**2 / (2.0 * GRAVITY_M_PER_S2)
            self.notes.append(
                f"what meets the ground more slowly than {threshold:g} m/s, as after a fall of {fall_mm:.3g} mm, does "
                "not bounce, whatever its restitution"
            )
        return TrainingConfiguration(
            name=name,
            source=source,
            backend="physx",
            settings=self.settings,
            origins=self.origins,
            frame_skip=frame_skip,
            notes=tuple(self.notes),
            inapplicable=reasons,
            gravity_m_per_s2=None if gravity_m_per_s2 is None else (x, y, z),
            language=language,
            foot_contact=foot_contact,
        )


def solver_name(table: Table, key: str) -> str | None:
    """Return the name of the solver for PhysX's number of it."""
    number = table.whole(key)
    if number is None:
        return None
    if number not in (0, 1):
        raise TargetError(f"{table.source}: {table.name(key)} is {number}: give 0 (PGS) or 1 (TGS)")
    return "TGS" if number else "PGS"
