"""MuJoCo's contact constraint in closed form, in the scenes of `probes`."""

import math
from dataclasses import dataclass

from scipy.optimize import brentq

from gauge_envs.scene import GRAVITY_M_PER_S2 as G
from gauge_envs.tools.recipes.probes import (
    BALL_COUNT,
    PLATE_CONTACTS,
    creep_slope_rad,
    drop_heights_m,
)

Solimp = tuple[float, float, float, float, float]
"""Impedance: d0, dwidth, width [m], midpoint, power."""

DEEPEST_M = 1e3
"""Depth at which a contact counts as none [m]."""

LONGEST_IMPACT_S = 2.0
"""Time after which an impact counts as a rest [s]."""


def mujoco_impedance(solimp: Solimp, depth_m: float) -> float:
    """Return MuJoCo's impedance d(r) at a depth [m]; `solimp` is d0, dwidth, width [m], midpoint, power."""
    d0, dwidth, width_m, midpoint, power = solimp
    x = min(abs(depth_m) / width_m, 1.0) if width_m > 0.0 else 1.0
    if x <= midpoint:
        y = midpoint * (x / midpoint) ** power
    else:
        y = 1.0 - (1.0 - midpoint) * ((1.0 - x) / (1.0 - midpoint)) ** power
    return d0 + y * (dwidth - d0)


@dataclass(frozen=True, kw_only=True)
class MuJoCoContact:
    """MuJoCo's contact equation: a = (1 - D) a0 - D (b v + k r), with D = n d / (n d + p (1 - d)) on n contacts.

    The softness p is 1 for the elliptic cone. The four edges of a pyramidal cone together have mu^2 (1 + mu^2) / 2 over
    the ratio of impedances.

    Attributes:
        solref: Time constant [s] and damping ratio, or the negative stiffness and damping.
        solimp: Impedance: d0, dwidth, width [m], midpoint, power.
        timestep_s: Time step [s].
        solreffriction: As `solref` for friction; zeros stand for `solref`.
        friction: Coefficient of friction.
        impratio: Ratio of frictional to normal impedance.
        is_elliptic: Whether the friction cone is elliptic, not pyramidal.

    Source: MuJoCo documentation, Computation, section Constraint model, and Modeling, section Solver parameters; the
    softness of the pyramid, function mj_makeImpedance in engine_core_constraint.c.
    """

    solref: tuple[float, float]
    solimp: Solimp
    timestep_s: float
    solreffriction: tuple[float, float] = (0.0, 0.0)
    friction: float = 1.0
    impratio: float = 1.0
    is_elliptic: bool = True

    def form(self) -> dict[str, float | None]:
        """Return what the equation gives for the plate and the mean of the drops, by the names of measured values.

        The time constant is twice the inverse of the damping per mass, as MuJoCo defines it. It is None without
        damping, and where one step stops the body or more.
        """
        depth_m = self._depth_m(G)
        impedance = mujoco_impedance(self.solimp, depth_m)
        share = self._share(impedance, PLATE_CONTACTS)
        _, damping_per_s = self._constants(self.solref)
        loss = self.timestep_s * share * damping_per_s
        time_constant_s = None
        if 0.0 < loss < 1.0:
            time_constant_s = -2.0 * self.timestep_s / math.log1p(-loss)
        return {
            "friction": self.friction,
            "restitution": sum(self.rebounds()) / BALL_COUNT,
            "penetration_m": depth_m,
            "creep_m_s": self._creep_m_s(),
            "time_constant_s": time_constant_s,
        }

    def rebounds(self) -> list[float]:
        """Return the restitution of each drop on one contact."""
        return [self._rebound(height_m) for height_m in drop_heights_m(self.timestep_s)]

    def _constants(self, solref: tuple[float, float]) -> tuple[float, float]:
        """Return stiffness over impedance [1/s^2] and damping [1/s] of the reference acceleration: k / d, and b.

        MuJoCo keeps the time constant at two steps or more.
        """
        first, second = solref
        dmax = self.solimp[1]
        if first <= 0.0:
            return -first / dmax**2, -second / dmax
        time_constant_s = max(first, 2.0 * self.timestep_s)
        time_s = dmax * time_constant_s
        return 1.0 / (time_s * second) ** 2, 2.0 / time_s

    def _share(self, d: float, contact_count: int) -> float:
        """Return D."""
        square = self.friction**2
        softness = 0.5 * square * (1.0 + square) / self.impratio
        if self.is_elliptic:
            softness = 1.0
        return contact_count * d / (contact_count * d + softness * (1.0 - d))

    def _depth_m(self, load_m_per_s2: float) -> float:
        """Return the depth of the plate at rest [m]: D k r = (1 - D) g."""
        stiffness_per_s2, _ = self._constants(self.solref)

        def excess(depth_m: float) -> float:
            d = mujoco_impedance(self.solimp, depth_m)
            share = self._share(d, PLATE_CONTACTS)
            spring_m_per_s2 = share * stiffness_per_s2 * d * depth_m
            return spring_m_per_s2 - (1.0 - share) * load_m_per_s2

        if excess(DEEPEST_M) < 0.0:
            return math.inf
        return float(brentq(excess, 0.0, DEEPEST_M, xtol=1e-15, maxiter=1000))

    def _creep_m_s(self) -> float:
        """Return the speed of the plate on the slope [m/s], at which damping balances the soft share of the load."""
        slope_rad = creep_slope_rad(self.friction)
        has_tangential = any(self.solreffriction)
        _, damping_per_s = self._constants(
            self.solreffriction if has_tangential else self.solref
        )
        if damping_per_s <= 0.0:
            return math.inf
        d = mujoco_impedance(self.solimp, self._depth_m(G * math.cos(slope_rad)))
        load_m_per_s2 = (1.0 - d) * G * math.sin(slope_rad)
        if not self.is_elliptic:
            load_m_per_s2 *= 1.0 + self.friction**2
        return load_m_per_s2 / (PLATE_CONTACTS * d * self.impratio * damping_per_s)

    def _rebound(self, height_m: float) -> float:
        """Return the restitution of a drop, by height, with the engine's steps: velocity first, then position."""
        step_s = self.timestep_s
        stiffness_per_s2, damping_per_s = self._constants(self.solref)
        # After n steps of the fall the speed is n g h, and the way n (n + 1) g h^2 / 2.
        way_steps = 2.0 * height_m / (G * step_s**2)
        count = math.floor(0.5 * (math.sqrt(1.0 + 4.0 * way_steps) - 1.0)) + 1
        speed_m_per_s = count * G * step_s
        depth_m = 0.5 * count * (count + 1) * G * step_s**2 - height_m
        has_turned = False
        for _ in range(math.ceil(LONGEST_IMPACT_S / step_s)):
            d = mujoco_impedance(self.solimp, depth_m)
            push_m_per_s2 = (
                G + damping_per_s * speed_m_per_s + stiffness_per_s2 * d * depth_m
            )
            speed_m_per_s += step_s * (G - self._share(d, 1) * max(push_m_per_s2, 0.0))
            depth_m += step_s * speed_m_per_s
            is_back = has_turned and speed_m_per_s >= 0.0
            if depth_m <= 0.0 or depth_m > DEEPEST_M or is_back:
                break
            has_turned = speed_m_per_s < 0.0
        # Positions without force lie on a parabola, whose slope is that between two steps.
        rise_m_per_s = -speed_m_per_s - 0.5 * step_s * G
        if not depth_m <= 0.0 or rise_m_per_s <= 0.0:
            return 0.0
        peak_m = 0.5 * rise_m_per_s**2 / G - depth_m
        return math.sqrt(max(peak_m, 0.0) / height_m)
