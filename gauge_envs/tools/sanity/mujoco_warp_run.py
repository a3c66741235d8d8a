"""Run scenes on mujoco_warp, with the model that the MuJoCo backend compiles: the same options, in single precision.

The rows of a sanity check run MuJoCo's C engine. Policies are trained on its version for GPUs. What is said to mend a
flag of such a target is run here, on the CPU. The first run of a kernel compiles it, up to a minute in all.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib.metadata import version
from typing import Any

import mujoco

from gauge_envs.backends.features import Feature, Support
from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.backends.mujoco.model import build_model
from gauge_envs.backends.mujoco.settings import settings_for
from gauge_envs.backends.mujoco.simulation import SimulationMuJoCo
from gauge_envs.errors import BackendError, needs_extra
from gauge_envs.scene import Scene
from gauge_envs.tools.sanity.model import Settings

FEWEST_CONTACTS, CONTACTS_OF_BODY = 64, 16
"""Memory of a scene for contacts: a number, and more for each body. A brick of a wall has 7."""

ROWS_OF_CONTACT = 6
"""Memory of a scene for constraint rows, for each contact; a contact with the pyramidal cone has 4."""

TOO_LARGE = "the scene needs more memory for contacts than is reserved"
"""Start of the reason why a scene is not run to its end."""


class BackendMuJoCoWarp(BackendMuJoCo):
    """mujoco_warp on the CPU, for rigid scenes; settings are those of the MuJoCo backend."""

    name = "mujoco_warp"
    features = frozenset({Feature.STATED_INERTIA})

    def __init__(self) -> None:
        _started()

    def versions(self) -> dict[str, str]:
        """Return the versions of the engine and of Warp."""
        return {
            package: version(package)
            for package in ("mujoco-warp", "warp-lang", "mujoco")
        }

    def supports(self, scene: Scene) -> Support:
        """Return the unsupported features: deformable bodies, and what MuJoCo does not support."""
        missing = super().supports(scene).missing
        if scene.deformables:
            missing = ("deformable bodies run on MuJoCo's C engine alone", *missing)
        return Support(missing)

    def build(
        self, scene: Scene, settings: Settings | None = None
    ) -> SimulationMuJoCoWarp:
        """Build a scene; settings are the fields of `SettingsMuJoCo`."""
        chosen = settings_for(scene, settings)
        return SimulationMuJoCoWarp(
            scene, chosen.model_dump(mode="json"), *build_model(scene, chosen)
        )


class SimulationMuJoCoWarp(SimulationMuJoCo):
    """A scene on mujoco_warp. MuJoCo's data hold the state between the steps, so that it is driven and read there."""

    def __init__(self, scene: Scene, settings: Settings, *built: Any) -> None:
        super().__init__(scene, settings, *built)
        self._most_contacts = FEWEST_CONTACTS + CONTACTS_OF_BODY * len(scene.bodies)
        self._captured: tuple[Callable[[], None], Any] | None = None

    def reset(self, seed: int) -> None:
        """Return to the scene's start; the seed has no effect."""
        super().reset(seed)
        self._captured = None

    def _step(self, count: int) -> None:
        if self._captured is None:
            naconmax = self._most_contacts
            njmax = ROWS_OF_CONTACT * naconmax
            self._captured = _capture_step(
                self.model, self.data, njmax=njmax, naconmax=naconmax
            )
        step, state = self._captured
        for name in ("qpos", "qvel", "xfrc_applied"):
            values = getattr(self.data, name)
            getattr(state, name).assign(values.reshape(1, *values.shape))
        for _ in range(count):
            step()
        self.data.qpos[:], self.data.qvel[:] = (
            state.qpos.numpy()[0],
            state.qvel.numpy()[0],
        )
        self.data.time += count * self.timestep_s
        # mujoco_warp does not count contacts beyond its memory, so full memory is too small.
        if (
            state.nefc.numpy()[0] > state.njmax
            or state.nacon.numpy()[0] >= self._most_contacts
        ):
            raise BackendError(f"{TOO_LARGE}: {self._most_contacts} contacts")


def _capture_step(
    model: mujoco.MjModel, data: mujoco.MjData, *, njmax: int, naconmax: int
) -> tuple[Callable[[], None], Any]:
    """Return a function that steps a model on mujoco_warp, and its data, with memory for so many rows and contacts.

    The kernels of a step are captured once: their launch from Python takes ten times as long as they run.
    """
    import warp

    mujoco_warp, device = _started()
    with device:
        on_warp = mujoco_warp.put_model(model)
        # It runs into its limit of iterations on purpose, with settings that allow one.
        on_warp.opt.warn_overflow = 0
        state = mujoco_warp.put_data(model, data, naconmax=naconmax, njmax=njmax)
        with warp.ScopedCapture() as capture:
            mujoco_warp.step(on_warp, state)
    return partial(warp.capture_launch, capture.graph), state


def _started() -> tuple[Any, Any]:
    """Return mujoco_warp and its device, without its messages."""
    with needs_extra("running on mujoco_warp", "newton"):
        import mujoco_warp
        import warp
    warp.config.log_level = warp.LOG_WARNING
    return mujoco_warp, warp.ScopedDevice("cpu")
