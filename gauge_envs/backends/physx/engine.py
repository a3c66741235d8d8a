"""SAPIEN's PhysX: a quiet import, and the one engine of a process."""

from __future__ import annotations

import gc
import warnings
from weakref import WeakSet

from gauge_envs.backends.physx.settings import SettingsPhysX
from gauge_envs.errors import BackendError

with warnings.catch_warnings():
    # SAPIEN warns that no Vulkan driver is installed. Only its renderer needs one, which this package never starts.
    warnings.simplefilter("ignore")
    import sapien
    from sapien import physx, pysapien

__all__ = ["EngineLease", "new_system", "physx", "pysapien", "sapien"]


class EngineLease:
    """A claim on the engine of the process, whose tolerances are fixed while a simulation exists.

    Args:
        settings: Settings with the tolerances.

    Raises:
        BackendError: Another simulation exists that needs other tolerances.
    """

    def __init__(self, settings: SettingsPhysX) -> None:
        self.tolerances = (settings.tolerance_length_m, settings.tolerance_speed_m_per_s)
        if any(lease.tolerances != self.tolerances for lease in _LEASES):
            # A cycle of references may still hold a simulation that nothing uses.
            gc.collect()
        for lease in _LEASES:
            if lease.tolerances != self.tolerances:
                raise BackendError(
                    "PhysX has one engine per process, and a simulation with tolerances of "
                    f"{lease.tolerances} (m, m/s) exists. A simulation with {self.tolerances} cannot start beside it. "
                    "Close the other one first, set tolerance_length_m and tolerance_speed_m_per_s to the same values, "
                    "or use another process."
                )
        self._engine = physx.PhysxEngine(*self.tolerances)
        _LEASES.add(self)


_LEASES: WeakSet[EngineLease] = WeakSet()


def new_system(settings: SettingsPhysX, gravity_m_per_s2: float) -> physx.PhysxCpuSystem:
    """Return an empty PhysX scene. The defaults of other users of SAPIEN in this process do not change."""
    before = physx.get_scene_config()
    physx.set_scene_config(
        gravity=[0.0, 0.0, -gravity_m_per_s2],
        bounce_threshold=settings.bounce_threshold_m_per_s,
        enable_pcm=settings.persistent_manifolds,
        enable_tgs=settings.solver == "TGS",
        enable_ccd=settings.continuous_detection,
        enable_enhanced_determinism=settings.enhanced_determinism,
        enable_friction_every_iteration=settings.friction_every_iteration,
        cpu_workers=0,
    )
    try:
        system = physx.PhysxCpuSystem()
    finally:
        physx.set_scene_config(before)
    system.timestep = settings.timestep_s
    return system
