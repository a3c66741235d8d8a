"""Physical bounds of a scene; a simulation that leaves them has diverged, even where its numbers are finite."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from gauge_envs.backends.device import HOST, DeviceWorlds, HostArrays
from gauge_envs.scene import Scene
from gauge_envs.scene.geometry import BoolArray, FloatArray, length_of


def speed_fault(
    names: Sequence[str], velocities: FloatArray, limit_m_per_s: float
) -> str | None:
    """Return why speeds are out of bounds, or None.

    Args:
        names: Names of the bodies.
        velocities: Their velocities [m/s], shape [body_count, 3].
        limit_m_per_s: Largest component of a velocity [m/s].
    """
    sizes = np.abs(velocities)
    # A comparison with NaN is false. Counting is five times faster than `all` on so few.
    if np.count_nonzero(sizes <= limit_m_per_s) == sizes.size:
        return None
    speeds = sizes.max(axis=1)
    if not np.isfinite(speeds).all():
        return "the state is not finite"
    fastest = int(speeds.argmax())
    return f"{names[fastest]} moves at {speeds[fastest]:.3g} m/s, above the limit of the scene, {limit_m_per_s:.3g} m/s"


class RigidBounds:
    """Bounds of distance, speed and kinetic energy of the dynamic bodies."""

    def __init__(self, scene: Scene) -> None:
        self._names = tuple(body.name for body in scene.dynamic_bodies)
        self._masses = np.array(
            [body.mass_kg for body in scene.dynamic_bodies]
        ).reshape(-1, 1)
        self._energy_j = scene.kinetic_energy_limit_j
        limits = [scene.distance_limit_m] * 3 + [2.0] * 4
        limits += [scene.speed_limit_m_per_s] * 3 + [np.inf] * 3
        self._limits = np.array(limits)

    def fault(self, states: FloatArray) -> str | None:
        """Return why the bodies are out of bounds, or None.

        Args:
            states: States of the dynamic bodies, shape [body_count, 13].
        """
        velocity = states[:, 7:10]
        energy_j = 0.5 * float(np.vdot(velocity, self._masses * velocity))
        # A comparison with NaN is false, so that each bound also catches what is not a number.
        within = np.count_nonzero(np.abs(states) <= self._limits) == states.size
        if within and energy_j <= self._energy_j:
            return None
        if not np.isfinite(states).all():
            return "the state is not finite"
        fault = speed_fault(self._names, velocity, self._limits[7])
        if fault:
            return fault
        far = (np.abs(states[:, :3]) > self._limits[:3]).any(axis=1)
        if far.any():
            return f"{self._names[int(far.argmax())]} is more than {self._limits[0]:.3g} m from the origin"
        return f"kinetic energy is {energy_j:.3g} J, above the limit of the scene, {self._energy_j:.3g} J"


class RigidBoundsOfWorlds:
    """Bounds of the dynamic bodies of many worlds, tested at once.

    Args:
        scenes: The scene of each world, which differ in their starts and constants.
        device: Where states are tested.

    Attributes:
        masses_kg: Masses of the dynamic bodies [kg], shape [world_count, body_count].
        distances_m: Largest coordinate in each world [m], shape [world_count].
        speeds_m_per_s: Largest component of a velocity [m/s], shape [world_count].
        energies_j: Largest kinetic energy [J], shape [world_count].
    """

    def __init__(
        self, scenes: Sequence[Scene], device: DeviceWorlds | HostArrays = HOST
    ) -> None:
        self._arrays = device.arrays
        put = device.asarray
        self.masses_kg = put(
            np.array(
                [[body.mass_kg for body in scene.dynamic_bodies] for scene in scenes]
            )
        )
        limits = [
            (one.distance_limit_m, one.speed_limit_m_per_s, one.kinetic_energy_limit_j)
            for one in scenes
        ]
        columns = np.array(limits).T.copy()
        self.distances_m, self.speeds_m_per_s, self.energies_j = map(put, columns)

    def suspects(self, states: Any) -> Any:
        """Return which worlds may be out of bounds; `RigidBounds.fault` decides, and gives the reason.

        Args:
            states: States of the dynamic bodies, shape [world_count, body_count, 13].

        Returns:
            Shape [world_count]; true for every world that is out of bounds, and for those within rounding of a bound.
        """
        arrays = self._arrays
        every = (1, 2)
        sizes, velocities = arrays.abs(states), states[:, :, 7:10]
        with np.errstate(invalid="ignore", over="ignore"):
            squares = arrays.square(velocities).sum(axis=2)
            energies_j = 0.5 * (self.masses_kg * squares).sum(axis=1)
            # A comparison with NaN is false, so that each bound also catches what is not a number.
            within = (sizes[:, :, :3] <= self.distances_m[:, None, None]).all(
                axis=every
            )
            within &= (sizes[:, :, 3:7] <= 2.0).all(axis=every)
            speeds = sizes[:, :, 7:10]
            within &= (speeds <= self.speeds_m_per_s[:, None, None]).all(axis=every)
            within &= arrays.isfinite(states[:, :, 10:]).all(axis=every)
            within &= energies_j <= self.energies_j * (1.0 - 1e-9)
        return ~within


class DeformableBounds:
    """Bounds of extent and distance of a deformable body.

    Args:
        name: Name of the body.
        scene: The scene.
        rest_m: Its nodes at the start [m], shape [node_count, 3].

    Attributes:
        distance_m: Largest coordinate of a node [m].
        largest_extent_m: Largest diagonal of the box around the nodes [m].
    """

    STRETCH = 3.0
    """Largest extent over that at rest; the largest strains of the paper are 0.3."""

    def __init__(self, name: str, scene: Scene, rest_m: FloatArray) -> None:
        self.name = name
        self.distance_m = scene.distance_limit_m
        self._extent_m = _extent_m(rest_m)
        self.largest_extent_m = self.STRETCH * self._extent_m

    def fault(self, nodes: FloatArray) -> str | None:
        """Return why the body is out of bounds, or None.

        Args:
            nodes: Its nodes now [m], shape [node_count, 3].
        """
        extent_m = _extent_m(nodes)
        if extent_m <= self.largest_extent_m and np.abs(nodes).max() <= self.distance_m:
            return None
        if not np.isfinite(nodes).all():
            return f"a node of {self.name} is not finite"
        return (
            f"{self.name} spans {extent_m:.3g} m ({self._extent_m:.3g} m at rest), or a node is more than "
            f"{self.distance_m:.3g} m from the origin"
        )


class DeformableBoundsOfWorlds:
    """Bounds of a deformable body in many worlds, tested at once.

    Args:
        bounds: The bounds in each world.

    Attributes:
        name: Name of the body.
    """

    def __init__(self, bounds: Sequence[DeformableBounds]) -> None:
        self.name = bounds[0].name
        self._extents_m = np.array([one.largest_extent_m for one in bounds])
        self._distances_m = np.array([one.distance_m for one in bounds])

    def suspects(self, nodes: FloatArray) -> BoolArray:
        """Return which worlds may be out of bounds; `DeformableBounds.fault` decides, and gives the reason.

        Args:
            nodes: Nodes of the body [m], shape [world_count, node_count, 3].

        Returns:
            Shape [world_count]; true for every world that is out of bounds, and for those within rounding of a bound.
        """
        with np.errstate(invalid="ignore", over="ignore"):
            # Reductions over the last axis are several times as fast.
            axes = np.ascontiguousarray(nodes.transpose(0, 2, 1))
            upper_m, lower_m = axes.max(axis=2), axes.min(axis=2)
            extents_m = np.linalg.norm(upper_m - lower_m, axis=1)
            # A comparison with NaN is false, so that each bound also catches what is not a number.
            within = extents_m <= self._extents_m * (1.0 - 1e-9)
            return ~(
                within
                & (np.maximum(upper_m, -lower_m).max(axis=1) <= self._distances_m)
            )


def _extent_m(nodes: FloatArray) -> float:
    return length_of(np.ptp(nodes, axis=0))
