"""MuJoCo's contact constraint in closed form."""

import math
from dataclasses import dataclass

from scipy.optimize import brentq

from gauge_envs.scene import GRAVITY_M_PER_S2 as G

Solimp = tuple[float, float, float, float, float]
"""Impedance: d0, dwidth, width [m], midpoint, power."""

DEEPEST_M = 1e3
"""Depth at which a contact counts as none [m]."""

LONGEST_IMPACT_S = 2.0
"""Time after which an impact counts as a rest [s]."""


def mujoco_impedance(solimp: Solimp, depth_m: float) -> float:
    """Return MuJoCo's impedance d(r) at a depth [m]; `solimp` is d0, dwidth, width [m], midpoint, power."""
    d0, dwidth, width, midpoint, power = solimp
    x = min(abs(depth_m) / width, 1.0) if width > 0.0 else 1.0
    if x <= midpoint:
        y = x**power / midpoint ** (power - 1.0) if midpoint > 0.0 else 0.0
    else:
        y = 1.0 - (1.0 - x) ** power / (1.0 - midpoint) ** (power - 1.0)
    return d0 + y * (dwidth - d0)


@dataclass(frozen=True, kw_only=True)
class ContactForm:
    """What MuJoCo's documented contact equation gives for a body with one coordinate, without the engine.

    Attributes:
        restitution: Mean over the phases of the impact within a step.
        penetration_m: Depth at rest [m].
        creep_m_s: Speed on a slope below the friction angle [m/s].
        time_constant_s: Twice the inverse of the damping per mass [s], as MuJoCo defines it; None if one step stops the
            body or more, or without damping.
    """

    restitution: float
    penetration_m: float
    creep_m_s: float
    time_constant_s: float | None


@dataclass(frozen=True, kw_only=True)
class MuJoCoContact:
    """MuJoCo's contact equation: a = (1 - D) a0 - D (b v + k r), with D = n d / (n d + p (1 - d)) on n contacts.

    The softness p is 1 for the elliptic cone. The four edges of a pyramidal cone together have mu^2 (1 + mu^2) / 2 over
    the ratio of impedances.

    Attributes:
        solref: Time constant [s] and damping ratio, or the negative stiffness and damping.
        solimp: Impedance: d0, dwidth, width [m], midpoint, power.
        solreffriction: As `solref` for friction; zeros stand for `solref`.
        friction: Coefficient of friction.
        impratio: Ratio of frictional to normal impedance.
        is_elliptic: Whether the friction cone is elliptic, not pyramidal.
        timestep_s: Time step [s].

    Source: MuJoCo documentation, Computation, section Constraint model, and Modeling, section Solver parameters; the
    softness of the pyramid, function mj_makeImpedance in engine_core_constraint.c.
    """

    solref: tuple[float, float]
    solimp: Solimp
    solreffriction: tuple[float, float]
    friction: float
    impratio: float
    is_elliptic: bool
    timestep_s: float

    def form(
        self, *, contact_count: int, slope_rad: float, drop_m: float, phase_count: int
    ) -> ContactForm:
        """Return what the equation gives for a body on equal contacts, and for a drop on one contact.

        Args:
            contact_count: Number of contacts that carry the body at rest.
            slope_rad: Slope of the creep [rad].
            drop_m: Height of the drop [m].
            phase_count: Number of drops, each at another phase of the impact within a step.
        """
        depth_m = self._depth_m(contact_count, G)
        loss = (
            self.timestep_s
            * self._share(self._impedance(depth_m), contact_count)
            * self._damping(self.solref)
        )
        rebounds = self.rebounds(drop_m=drop_m, phase_count=phase_count)
        return ContactForm(
            penetration_m=depth_m,
            time_constant_s=-2.0 * self.timestep_s / math.log1p(-loss)
            if 0.0 < loss < 1.0
            else None,
            restitution=sum(rebounds) / phase_count,
            creep_m_s=self._creep_m_s(contact_count, slope_rad),
        )

    def rebounds(self, *, drop_m: float, phase_count: int) -> tuple[float, ...]:
        """Return the restitution of drops on one contact, each at another phase of the impact within a step.

        Args:
            drop_m: Height of the drop [m].
            phase_count: Number of drops.
        """
        return tuple(
            self._rebound(drop_m, index / phase_count) for index in range(phase_count)
        )

    def _impedance(self, depth_m: float) -> float:
        return mujoco_impedance(self.solimp, depth_m)

    def _stiffness(self, d: float) -> float:
        """Return k of the reference acceleration [1/s^2]; MuJoCo keeps the time constant at two steps or more."""
        first, second = self.solref
        dmax = self.solimp[1]
        return (
            -first * d / dmax**2
            if first <= 0.0
            else d / (dmax * max(first, 2.0 * self.timestep_s) * second) ** 2
        )

    def _damping(self, solref: tuple[float, float]) -> float:
        """Return b of the reference acceleration [1/s]."""
        first, second = solref
        dmax = self.solimp[1]
        return (
            -second / dmax
            if first <= 0.0
            else 2.0 / (dmax * max(first, 2.0 * self.timestep_s))
        )

    @property
    def _softness(self) -> float:
        square = self.friction**2
        return (
            1.0 if self.is_elliptic else 0.5 * square * (1.0 + square) / self.impratio
        )

    def _share(self, d: float, contact_count: int) -> float:
        return contact_count * d / (contact_count * d + self._softness * (1.0 - d))

    def _depth_m(self, contact_count: int, load_m_per_s2: float) -> float:
        def excess(depth_m: float) -> float:
            d = self._impedance(depth_m)
            share = self._share(d, contact_count)
            return share * self._stiffness(d) * depth_m - (1.0 - share) * load_m_per_s2

        deepest = 1e-9
        while excess(deepest) < 0.0:
            deepest *= 10.0
            if deepest > DEEPEST_M:
                return math.inf
        return float(brentq(excess, 0.0, deepest, xtol=1e-15))

    def _creep_m_s(self, contact_count: int, slope_rad: float) -> float:
        depth_m = self._depth_m(contact_count, G * math.cos(slope_rad))
        d = self._impedance(min(depth_m, DEEPEST_M))
        damping = self._damping(
            self.solreffriction if any(self.solreffriction) else self.solref
        )
        load = (
            (1.0 - d)
            * G
            * math.sin(slope_rad)
            * (1.0 if self.is_elliptic else 1.0 + self.friction**2)
        )
        return (
            load / (contact_count * d * self.impratio * damping)
            if damping > 0.0
            else math.inf
        )

    def _rebound(self, drop_m: float, phase: float) -> float:
        """Return the restitution of a drop, by height, with the engine's steps: velocity first, then position."""
        h, height_m = (
            self.timestep_s,
            drop_m + phase * math.sqrt(2.0 * G * drop_m) * self.timestep_s,
        )
        # After n steps of the fall the speed is n g h, and the way n (n + 1) g h^2 / 2.
        count = (
            math.floor(0.5 * (math.sqrt(1.0 + 8.0 * height_m / (G * h**2)) - 1.0)) + 1
        )
        speed, depth_m = count * G * h, 0.5 * count * (count + 1) * G * h**2 - height_m
        has_turned = False
        for _ in range(math.ceil(LONGEST_IMPACT_S / h)):
            d = self._impedance(depth_m)
            push = G + self._damping(self.solref) * speed + self._stiffness(d) * depth_m
            speed += h * (G - self._share(d, 1) * max(push, 0.0))
            depth_m += h * speed
            if depth_m <= 0.0 or depth_m > DEEPEST_M or (has_turned and speed >= 0.0):
                break
            has_turned = speed < 0.0
        if not depth_m <= 0.0:
            return 0.0
        # Positions without force lie on a parabola, whose slope is that between two steps.
        rise = -speed - 0.5 * h * G
        return (
            math.sqrt(max(0.5 * rise**2 / G - depth_m, 0.0) / height_m)
            if rise > 0.0
            else 0.0
        )
