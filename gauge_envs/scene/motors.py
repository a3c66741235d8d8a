"""Motors of joints: a torque over time, or a position servo that follows a command."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from gauge_envs.scene.geometry import NonNegative, Positive
from gauge_envs.scene.profiles import Profile


@dataclass(frozen=True, kw_only=True)
class TorqueMotor:
    """Motor that exerts a torque on a joint, whatever the joint does.

    Attributes:
        kind: Name of the motor in files.
        command: Torque over time [N m].
        delay_s: Time from a command to its torque [s].
    """

    kind: Literal["torque"] = field(default="torque", repr=False)
    command: Profile
    delay_s: NonNegative = 0.0


@dataclass(frozen=True, kw_only=True)
class Servo:
    """Position servo: its torque is kp (command - angle) - kv rate, and at most its limit.

    Attributes:
        kind: Name of the motor in files.
        command: Angle of the joint over time, from its angle at the start [rad].
        kp_n_m_per_rad: Torque per error of the angle [N m/rad].
        kv_n_m_s_per_rad: Torque per rate of the joint [N m s/rad].
        torque_limit_n_m: Largest torque [N m]; None is no limit.
        delay_s: Time from a command to the servo's response [s].
    """

    kind: Literal["servo"] = field(default="servo", repr=False)
    command: Profile
    kp_n_m_per_rad: Positive
    kv_n_m_s_per_rad: NonNegative = 0.0
    torque_limit_n_m: Positive | None = None
    delay_s: NonNegative = 0.0

    def torque_n_m(
        self, command_rad: float, angle_rad: float, rate_rad_per_s: float
    ) -> float:
        """Return the torque for a command and the state of the joint [N m], without delay."""
        torque = (
            self.kp_n_m_per_rad * (command_rad - angle_rad)
            - self.kv_n_m_s_per_rad * rate_rad_per_s
        )
        limit = self.torque_limit_n_m
        return torque if limit is None else min(max(torque, -limit), limit)


Motor = TorqueMotor | Servo
