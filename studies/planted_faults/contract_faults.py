"""Misreadings of each part of the contract, planted in the backend of MuJoCo."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import mujoco
import numpy as np

from gauge_envs.scene import Contact, Hinge, Motion, Scene
from studies.planted_faults.third_set import (
    Stepped,
    _without_pairs,
    dofs,
    edited,
    free,
    matrix,
)
from tests.faults import FAULTS as MISTAKES, Fault, Planted, change_contacts

# --- the scene -------------------------------------------------------------------------------------------------------


def scaled_contacts(**factors: float) -> Fault:
    """Return a fault that scales constants of all contacts."""

    def change(contact: Contact) -> Contact:
        scaled = {name: by * getattr(contact, name) for name, by in factors.items()}
        if "restitution" in scaled:
            scaled["restitution"] = min(scaled["restitution"], 1.0)
        return replace(contact, **scaled)

    return Fault(scene=change_contacts(change))


def scaled_gravity(factor: float) -> Fault:
    """Return a fault that scales gravity."""
    return Fault(
        scene=lambda scene: replace(
            scene, gravity_m_per_s2=factor * scene.gravity_m_per_s2
        )
    )


def all_pairs(scene: Scene, is_free: bool = False) -> Scene:
    """Return a scene in which all pairs with a free body collide, or only pairs of free bodies."""
    known = {
        frozenset(pair)
        for contact in scene.contacts
        for pair in scene.colliding_pairs(contact)
    }
    moving = {body.name for body in scene.dynamic_bodies}
    bodies = scene.dynamic_bodies if is_free else scene.bodies
    extra = [
        Contact(first=(one.name,), second=(other.name,), friction=0.5, restitution=0.0)
        for at, one in enumerate(bodies)
        for other in bodies[at + 1 :]
        if {one.name, other.name} & moving
        and frozenset((one.name, other.name)) not in known
    ]
    return replace(scene, contacts=(*scene.contacts, *extra))


def _no_free_pairs(scene: Scene) -> Scene:
    still = {body.name for body in scene.bodies if body.motion is not Motion.DYNAMIC}
    return _without_pairs(scene, lambda one, other: not {one, other} & still)


def _long_tether(scene: Scene) -> Scene:
    joints = tuple(
        joint
        if isinstance(joint, Hinge)
        else replace(joint, length_m=1.02 * joint.length_m)
        for joint in scene.joints
    )
    return replace(scene, joints=joints)


# --- the model -------------------------------------------------------------------------------------------------------


def changed_model(change: Callable[[Any, Any], None]) -> Fault:
    """Return a fault of the compiled model."""

    def edit(simulation: Any) -> None:
        change(simulation.model, simulation)
        mujoco.mj_setConst(simulation.model, simulation.data)
        simulation.reset()

    return Fault(engine=edited(edit))


def scaled_bodies(field: str, factor: float) -> Fault:
    """Return a fault that scales a field of free bodies."""

    def change(model: Any, simulation: Any) -> None:
        for body in free(simulation.given):
            getattr(model, field)[model.body(body.name).id] *= factor

    return changed_model(change)


def _mixed_axes(model: Any, simulation: Any) -> None:
    for body in free(simulation.given):
        row = model.body(body.name).id
        model.body_inertia[row] = np.roll(model.body_inertia[row], 1)


def margin(value_m: float) -> Fault:
    """Return a fault that adds a margin to all contacts."""

    def change(model: Any, _: Any) -> None:
        model.pair_margin[:] += value_m

    return changed_model(change)


def _soft(model: Any, _: Any) -> None:
    for row in model.pair_solref:
        if row[0] > 0.0:
            row[0] *= 4.0
        elif row[1] < 0.0 and row[0] < -1.0:
            row[0] *= 0.05


def _few_iterations(model: Any, _: Any) -> None:
    model.opt.iterations, model.opt.ls_iterations = 2, 4


def _soft_friction(model: Any, _: Any) -> None:
    model.opt.impratio = 0.05


# --- motion ----------------------------------------------------------------------------------------------------------


def after_each_call(change: Callable[[Any, slice, float], None]) -> Fault:
    """Return a fault that changes velocities of free bodies after each call of `advance`."""

    class After(Planted):
        def advance(self, seconds):
            super().advance(seconds)
            for data in self.datas:
                for body in free(self.given):
                    change(data, dofs(self.model, body.name), seconds)

    return Fault(simulation=After)


def _damped(first: int, share: float, data: Any, rows: slice, seconds: float) -> None:
    data.qvel[rows.start + first : rows.start + first + 3] *= share**seconds


def _limited(limit: float, data: Any, rows: slice, _: float) -> None:
    speed = np.linalg.norm(data.qvel[rows][:3])
    if speed > limit:
        data.qvel[rows.start : rows.start + 3] *= limit / speed


class _NoGyroscopicTerm(Stepped):
    def before(self, data):
        for body in free(self.given):
            row = self.model.body(body.name).id
            if np.abs(self.model.body_ipos[row]).max() < 1e-9:
                axes = np.empty(9)
                mujoco.mju_quat2Mat(axes, self.model.body_iquat[row])
                axes = axes.reshape(3, 3)
                inertia = axes @ np.diag(self.model.body_inertia[row]) @ axes.T
                rows = dofs(self.model, body.name)
                spin = data.qvel[rows][3:]
                torque = np.cross(spin, inertia @ spin)
                data.qfrc_applied[rows.start + 3 : rows.stop] = torque


# --- calls -----------------------------------------------------------------------------------------------------------


def changed_wrench(change: Callable[[Any, str, Any], Any]) -> Fault:
    """Return a fault that changes the wrenches of a call."""

    class Changed(Planted):
        def apply_wrench(self, body, wrenches):
            super().apply_wrench(body, change(self, body, np.array(wrenches)))

    return Fault(simulation=Changed)


def _force_of_body(simulation: Any, body: str, wrenches: Any) -> Any:
    if body not in simulation.given.hinges:
        for row, data in enumerate(simulation.datas):
            wrenches[row, :3] = matrix(data, simulation.model, body) @ wrenches[row, :3]
    return wrenches


FAULTS = {
    "gravity x 1.02": scaled_gravity(1.02),
    "gravity upward": scaled_gravity(-1.0),
    "speed damped": after_each_call(partial(_damped, 0, 0.8)),
    "spin damped": after_each_call(partial(_damped, 3, 0.8)),
    "speed limit": after_each_call(partial(_limited, 3.0)),
    "no gyro": Fault(simulation=_NoGyroscopicTerm),
    "inertia x 1.25": scaled_bodies("body_inertia", 1.25),
    "inertia axes": changed_model(_mixed_axes),
    "mass x 1.2": scaled_bodies("body_mass", 1.2),
    "centre at origin": scaled_bodies("body_ipos", 0.0),
    "friction x 1.2": scaled_contacts(friction=1.2),
    "friction x 0.9": scaled_contacts(friction=0.9),
    "restitution x 0.8": scaled_contacts(restitution=0.8),
    "restitution 0": scaled_contacts(restitution=0.0),
    "torsion x 2": scaled_contacts(torsion_m=2.0),
    "rolling x 2": scaled_contacts(rolling_m=2.0),
    "force in body frame": changed_wrench(_force_of_body),
    "no torque": changed_wrench(
        lambda _, body, wrenches: wrenches * [1, 1, 1, 0, 0, 0]
    ),
    "double wrench": changed_wrench(lambda _, body, wrenches: 2.0 * wrenches),
    "hover": margin(4e-4),
    "sink": margin(-4e-4),
    "soft contacts": changed_model(_soft),
    "few iterations": changed_model(_few_iterations),
    "regularized": changed_model(_soft_friction),
    "all pairs collide": Fault(scene=all_pairs),
    "dynamic pairs pass": Fault(scene=_no_free_pairs),
    "tether long": Fault(scene=_long_tether),
} | {
    name: MISTAKES[name]
    for name in (
        "edges read as half edges",
        "the inertia of a sphere",
        "the first part of a compound",
        "a leaning plane built level",
        "hinge axis in the body frame",
        "frictions of two bodies multiplied",
        "friction 20 % low",
        "a driven body without velocity",
        "a driven body without acceleration",
        "a driven body an interval late",
    )
}
"""Faults by name."""
