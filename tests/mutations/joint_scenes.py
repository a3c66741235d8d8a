"""Faults of friction, armature and motors of joints, of chains on the world, and of grasps by motors."""

from dataclasses import replace

from gauge_envs.scene import Box, JointDynamics, Sphere
from mutations.mutant import Passed, fault


def _hinges(change):
    """Return a fault that changes each hinge, which is all joints of scenes with friction or motors."""

    def changed(scene):
        if all(
            hinge.motor is None and hinge.dynamics == JointDynamics()
            for hinge in scene.hinges
        ):
            return scene
        joints, inner = (
            tuple(map(change, hinges)) for hinges in (scene.joints, scene.body_hinges)
        )
        return replace(scene, joints=joints, body_hinges=inner)

    return changed


def _terms(change):
    return _hinges(lambda hinge: replace(hinge, dynamics=change(hinge.dynamics)))


class _Reversed(Passed):
    """Turns motors the other way."""

    def command(self, values):
        self.inner.command(-values)


class _ReversedBetween(Passed):
    """Turns motors between bodies the other way."""

    def command(self, values):
        self.inner.command(-values if self.scene.body_hinges else values)


class _SoftFriction(Passed):
    """Dry friction with MuJoCo's own impedance."""

    def begin(self):
        self.inner.model.dof_solimp[:] = (0.9, 0.95, 0.001, 0.5, 2.0)
        self.inner.model.dof_solref[:] = (0.02, 1.0)


class _RestingRotor(Passed):
    """Starts rotors with play at rest, and bodies with their rate."""

    def reset(self, seed):
        super().reset(seed)
        model, rates = self.inner.model, self.inner.data.qvel
        for joint in map(model.joint, range(model.njnt)):
            if joint.name.endswith("/play"):
                rates[joint.dofadr], rates[joint.dofadr - 1] = (
                    rates[joint.dofadr - 1],
                    0.0,
                )


def _grasps(change):
    """Return a fault that changes scenes in which bodies with motors touch others."""
    return lambda scene: change(scene) if scene.motors and scene.contacts else scene


def _pads(kind, shape):
    """Return a fault that gives bodies of a kind of shape on hinges another shape."""
    return lambda scene: replace(
        scene,
        bodies=tuple(
            replace(one, shape=shape)
            if one.name in scene.hung and isinstance(one.shape, kind)
            else one
            for one in scene.bodies
        ),
    )


class _SoftPads(Passed):
    """Contacts of bodies with motors have MuJoCo's largest softness."""

    def begin(self):
        if self.scene.motors:
            self.inner.model.pair_solref[:] = (0.05, 1.0)
            self.inner.model.pair_solimp[:] = (0.9, 0.9, 0.001, 0.5, 2.0)


class _CreepingPads(Passed):
    """Friction of bodies with motors has the impedance of the normal force."""

    def begin(self):
        if self.scene.motors:
            self.inner.model.opt.impratio = 0.1


FAULTS = dict(
    (
        fault(
            "joint-dry-viscous",
            "dry friction of joints is viscous",
            "joint-dry",
            "does not depend on speed",
            scene=_terms(
                lambda one: (
                    replace(
                        one,
                        dry_friction_n_m=0.0,
                        viscous_friction_n_m_s_per_rad=one.dry_friction_n_m,
                    )
                    if one.dry_friction_n_m
                    else one
                )
            ),
        ),
        fault(
            "joint-dry-soft",
            "dry friction of joints creeps",
            "joint-stick",
            "dry friction of its hinge were",
            simulation=_SoftFriction,
            engine="mujoco",
        ),
        fault(
            "joint-backlash-rotor",
            "rotors with play start at rest",
            "joint-backlash-cycle",
            "the rotor starts without the rate",
            simulation=_RestingRotor,
            engine="mujoco",
        ),
        fault(
            "motor-reversed",
            "motors turn the other way",
            "joint-torque",
            "torque were -1",
            simulation=_Reversed,
        ),
        fault(
            "motor-between-reversed",
            "motors between bodies turn the other way",
            "joint-between",
            "the second body relative to the first",
            simulation=_ReversedBetween,
        ),
        fault(
            "grasp-soft",
            "pads are soft",
            "grasp-sink",
            "its stiffness",
            simulation=_SoftPads,
            engine="mujoco",
        ),
        fault(
            "grasp-creeps",
            "pads creep",
            "grasp-creep",
            "friction is regularized",
            simulation=_CreepingPads,
            engine="mujoco",
        ),
        fault(
            "grasp-points",
            "a pad touches at one point",
            "grasp-torsion",
            "turns freely",
            scene=_grasps(_pads(Box, Sphere(radius_m=0.005))),
        ),
        fault(
            "grasp-faces",
            "a fingertip touches with a face",
            "grasp-swing",
            "holds a torque",
            scene=_grasps(_pads(Sphere, Box(size_m=(0.01, 0.01, 0.01)))),
        ),
    )
)
"""Faults by id."""
