"""The wrenches by which rigid bodies hold the deformable bodies attached to them.

MuJoCo computes the elastic forces of a flex at its free points. Attached points are points of rigid bodies, and those
of a fixed body have no degree of freedom that would show their forces. A copy of the model frees the fixed bodies; it
is never stepped, and its elastic forces at the places of the simulation are read where the bodies hold it.
"""

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.mujoco.flex import FlexPart
from gauge_envs.backends.mujoco.line import LinePartMuJoCo
from gauge_envs.backends.mujoco.soft import Grip
from gauge_envs.scene import Motion, Scene
from gauge_envs.scene.geometry import FloatArray, IntArray
from gauge_envs.scene.scene import GRAVITY_M_PER_S2

UPWARD = np.array([0.0, 0.0, GRAVITY_M_PER_S2])
"""Acceleration that a held mass seems to have at rest [m/s^2], shape [3]."""


class GripReader:
    """Reader of the wrenches of a scene's fixed and driven bodies.

    Args:
        scene: The scene.
        spec: The editable model.
        model: The compiled model, with its tables completed.
        data: Its state.
        parts: Parts of the deformable bodies, by name.
        grips: Nodes of soft bodies that move with driven bodies.
    """

    def __init__(
        self,
        scene: Scene,
        spec: mujoco.MjSpec,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        parts: Mapping[str, FlexPart],
        grips: Sequence[Grip],
    ) -> None:
        is_read = not any(isinstance(part, LinePartMuJoCo) for part in parts.values())
        self.names = scene.holders if is_read else ()
        if not self.names:
            return
        freed = spec.copy()
        for key in list(freed.keys):
            freed.delete(key)
        fixed = [name for name in self.names if scene.body(name).motion is Motion.FIXED]
        for name in fixed:
            body = freed.body(name)
            body.add_freejoint()
            # A body that could move needs a mass, which no force depends on.
            body.explicitinertial, body.mass, body.inertia = True, 1.0, [1.0] * 3
        self._twin = freed.compile()
        self._twin.flex_stiffness[:] = model.flex_stiffness
        self._twin.flex_bending[:] = model.flex_bending
        self._twin.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        self._copy = mujoco.MjData(self._twin)
        mujoco.mj_setConst(self._twin, self._copy)
        mujoco.mj_resetData(self._twin, self._copy)
        self._model, self._data = model, data

        # Joints keep their order; those of the freed bodies are further ones.
        free_ids = {int(self._twin.body(name).jntadr[0]) for name in fixed}
        kept = [one for one in range(self._twin.njnt) if one not in free_ids]
        self._places = _entries(self._twin, kept, self._twin.jnt_qposadr, (7, 4, 1, 1))
        self._speeds = _entries(self._twin, kept, self._twin.jnt_dofadr, (6, 3, 1, 1))
        self._holders = {
            name: _Holder(self._twin, scene, name, parts, grips) for name in self.names
        }

    def wrenches(self) -> dict[str, FloatArray]:
        """Return force [N] and torque about the body origin [N m] in the world frame, shape [6], by body."""
        twin, copy, data = self._twin, self._copy, self._data
        copy.qpos[self._places] = data.qpos
        copy.qvel[self._speeds] = data.qvel
        mujoco.mj_fwdPosition(twin, copy)
        mujoco.mj_fwdVelocity(twin, copy)
        elastic = copy.qfrc_spring + copy.qfrc_damper
        driven_n = (
            data.xfrc_applied / np.maximum(self._model.body_mass, 1e-300)[:, None]
        )
        found = {}
        for name, holder in self._holders.items():
            # The mass and all moments of inertia of a driven body are the same number; a fixed one is not accelerated.
            rates = driven_n[self._model.body(name).id]
            found[name] = holder.wrench(copy, elastic, rates)
        return found


class _Holder:
    """A rigid body that holds deformable bodies.

    Args:
        twin: The model in which it is free.
        scene: The scene.
        name: Its name.
        parts: Parts of the deformable bodies, by name.
        grips: Nodes of soft bodies that move with driven bodies.
    """

    def __init__(
        self,
        twin: mujoco.MjModel,
        scene: Scene,
        name: str,
        parts: Mapping[str, FlexPart],
        grips: Sequence[Grip],
    ) -> None:
        self._body = twin.body(name).id
        first = int(twin.body(name).dofadr[0])
        self._linear, self._angular = first + np.arange(3), first + 3 + np.arange(3)
        nodes = [node for grip in grips if grip.body == name for node in grip.names]
        self._nodes = np.array([twin.body(node).id for node in nodes], dtype=np.intp)
        self._pulls = twin.body_dofadr[self._nodes][:, None] + np.arange(3)
        carried = [part.carried(name) for part in dict.fromkeys(parts.values())]
        self._masses_kg = np.concatenate([masses for masses, _ in carried])
        places_m = np.concatenate([places for _, places in carried])
        self._local_m = scene.body(name).pose.to_body(places_m)

    def wrench(
        self,
        data: mujoco.MjData,
        elastic: FloatArray,
        rates: FloatArray,
    ) -> FloatArray:
        """Return force [N] and torque about the body origin [N m], shape [6].

        Args:
            data: State of the twin.
            elastic: Its elastic forces, shape [nv].
            rates: Linear [m/s^2] and angular [rad/s^2] acceleration of the body, shape [6].
        """
        rotation = data.xmat[self._body].reshape(3, 3)
        origin = data.xpos[self._body]
        # A free joint's torque and spin are in the body frame.
        torque = -rotation @ elastic[self._angular]
        spin = rotation @ data.qvel[self._angular]
        arms_m = self._local_m @ rotation.T
        accelerations = (
            UPWARD
            + rates[:3]
            + np.cross(rates[3:], arms_m)
            + np.cross(spin, np.cross(spin, arms_m))
        )
        carrying = self._masses_kg[:, None] * accelerations
        pulls = np.vstack([-elastic[self._pulls], carrying])
        all_arms_m = np.vstack([data.xpos[self._nodes] - origin, arms_m])
        return np.concatenate(
            [
                pulls.sum(axis=0) - elastic[self._linear],
                np.cross(all_arms_m, pulls).sum(axis=0) + torque,
            ]
        )


def _entries(
    model: mujoco.MjModel,
    joints: Sequence[int],
    starts: NDArray[np.int32],
    widths: tuple[int, ...],
) -> IntArray:
    """Return the entries of joints in `qpos` or `qvel`, whose widths are by type of joint."""
    return np.concatenate(
        [starts[one] + np.arange(widths[model.jnt_type[one]]) for one in joints]
    ).astype(np.intp)
