"""Faults that only an engine itself can have, planted in MuJoCo's model or state."""

from __future__ import annotations

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.scene import Box, Compound, ConvexUnion, Rope
from gauge_envs.scene.hinged import parent_hinges
from gauge_envs.scene.meshes import mass_properties
from mutations.mutant import Passed, fault


def _model(change):
    """Return a simulation whose MuJoCo model is changed after it is built."""

    class Changed(Passed):
        def begin(self):
            change(self.inner.model, self.scene)
            # MuJoCo keeps the mass matrix of simple bodies as a constant.
            mujoco.mj_setConst(self.inner.model, self.inner.data)

    return Changed


def _dynamic(scene, kind):
    return [one for one in scene.dynamic_bodies if isinstance(one.shape, kind)]


def _inertia_times(kind, factor):
    def change(model, scene):
        for one in _dynamic(scene, kind):
            model.body(one.name).inertia[:] *= factor

    return change


def _mean_of_vertices(model, scene):
    for one in _dynamic(scene, ConvexUnion):
        model.body(one.name).ipos[:] = one.shape.corners_m.mean(axis=0)


def _mean_of_pieces(model, scene):
    for one in _dynamic(scene, ConvexUnion):
        centres = [
            mass_properties(ConvexUnion(pieces_m=(piece,)), 1.0)[0]
            for piece in one.shape.pieces_m
        ]
        model.body(one.name).ipos[:] = np.mean(centres, axis=0)


def _damped(model, scene):
    model.dof_damping[:] = 1e-4


def _hanging(change):
    """Return a change of the bodies that hang on other bodies in MuJoCo's model, which gets each of their names."""

    def change_all(model, scene):
        for name in parent_hinges(scene.body_hinges, scene.hung):
            change(model, name)

    return change_all


def _side(model, name):
    side = np.cross(model.joint(name).axis, [0.3, -0.5, 0.8])
    return side / np.linalg.norm(side)


def _hinge_tilted(model, name):
    turn = Rotation.from_rotvec(3.0 * _side(model, name), degrees=True)
    model.joint(name).axis[:] = turn.apply(model.joint(name).axis)


def _hinge_shifted(model, name):
    model.joint(name).pos += 2e-3 * _side(model, name)


def _hinge_heavy(model, name):
    model.body(name).inertia[:] *= 1.5


class _HangingWeightless(Passed):
    """Bodies that hang on other bodies feel no gravity."""

    def reset(self, seed):
        super().reset(seed)
        for name in parent_hinges(self.scene.body_hinges, self.scene.hung):
            weight = self.scene.body(name).mass_kg * self.scene.gravity_m_per_s2
            self.inner.apply_wrench(name, np.array([0.0, 0.0, weight, 0.0, 0.0, 0.0]))


class _HingeBackwards(Passed):
    """Starts hinges between bodies in the other direction."""

    def reset(self, seed):
        super().reset(seed)
        for name in parent_hinges(self.scene.body_hinges, self.scene.hung):
            self.inner.data.qvel[self.inner.model.joint(name).dofadr[0]] *= -1.0


def _gravity_tilted(model, scene):
    model.opt.gravity[:2] = 0.1


class _RestoreForgetsWarmStart(Passed):
    """Drops the solver's warm start when a state is restored."""

    def restore(self, state):
        super().restore(state)
        self.inner.data.qacc_warmstart[:] = 0.0


class _GainsEnergy(Passed):
    """Gains 2 % of speed in each interval."""

    def advance(self, seconds):
        super().advance(seconds)
        self.inner.data.qvel[:] *= 1.02


class _Blast(Passed):
    """Throws fast bodies off with a speed that the scene cannot give, yet finite."""

    def advance(self, seconds):
        super().advance(seconds)
        speed = np.abs(self.inner.data.qvel)
        self.inner.data.qvel[speed > 1.0] *= 1.5


def _centre_elsewhere(model, scene):
    for one in _dynamic(scene, ConvexUnion):
        model.body(one.name).ipos[0] += 0.005


def _rope_ends(model, scene):
    if any(isinstance(one, Rope) for one in scene.deformables):
        masses = model.body_mass
        masses[np.isclose(masses, 0.5 * np.median(masses[masses > 0.0]))] *= 2.0


def _torsional(model, scene):
    model.geom_condim[:] = 4
    model.geom_friction[:, 1] = 5e-3
    model.pair_dim[:] = 4
    model.pair_friction[:, 2] = 5e-3


class _HeavySpin(Passed):
    """Pulls spinning bodies down by 1 % more."""

    def advance(self, seconds):
        for one in self.scene.dynamic_bodies:
            if (
                np.linalg.norm(self.body_states([one.name])[0, 10:]) > 5.0
                and self.scene.gravity_m_per_s2
            ):
                force = -0.01 * one.mass_kg * self.scene.gravity_m_per_s2
                self.inner.apply_wrench(
                    one.name, np.array([0.0, 0.0, force, 0.0, 0.0, 0.0])
                )
        super().advance(seconds)


def _compound_centre(model, scene):
    for one in _dynamic(scene, Compound):
        model.body(one.name).ipos[0] += 0.01


def _limit_forward(model, scene):
    model.actuator_forcerange[:, 0] *= 100.0


def _friction_across(model, scene):
    model.pair_friction[:, 1] *= 0.8


def _stops_early(model, scene):
    if not scene.deformables:
        model.opt.solver = mujoco.mjtSolver.mjSOL_PGS
        model.opt.iterations = 10


def _tether_centre(model, scene):
    for site in range(model.nsite):
        model.site_pos[site] += model.body_ipos[model.site_bodyid[site]]


class _SpeedLimited(Passed):
    """Limits the speed of free bodies to 4 m/s."""

    def advance(self, seconds):
        super().advance(seconds)
        if self.inner.model.nq == 7 * len(self.scene.dynamic_bodies):
            speeds = self.inner.data.qvel.reshape(-1, 6)[:, :3]
            sizes = np.linalg.norm(speeds, axis=1, keepdims=True)
            speeds *= np.minimum(1.0, 4.0 / np.maximum(sizes, 1e-12))


def _own(id, what, caught_by, says, **how):
    return fault(id, what, caught_by, says, engine="mujoco", **how)


FAULTS = dict(
    (
        _own(
            "compound-inertia",
            "inertia of a compound times 1.5",
            "inertia-compound",
            "1.5, 1.5 and 1.5 times",
            simulation=_model(_inertia_times(Compound, 1.5)),
        ),
        _own(
            "compound-centre",
            "centre of a compound 10 mm off",
            "centre-compound",
            "its centre of mass should be",
            simulation=_model(_compound_centre),
        ),
        _own(
            "limit-forward",
            "torque limit of a servo for positive torques alone",
            "joint-limit-back",
            "torque limit of its servo were inf",
            simulation=_model(_limit_forward),
        ),
        _own(
            "friction-across",
            "friction 20 % low along one axis of the contact",
            "pucks-friction",
            "a pyramid of friction",
            simulation=_model(_friction_across),
        ),
        _own(
            "tether-centre",
            "string at the centre of mass",
            "tether-origin",
            "acts at another point of the body",
            simulation=_model(_tether_centre),
        ),
        _own(
            "box-inertia",
            "inertia of a box times 1.5",
            "inertia-box",
            "1.5, 1.5 and 1.5 times",
            simulation=_model(_inertia_times(Box, 1.5)),
        ),
        _own(
            "union-inertia",
            "inertia of a convex union times 2",
            "inertia-union",
            "2, 2 and 2 times",
            simulation=_model(_inertia_times(ConvexUnion, 2.0)),
        ),
        _own(
            "union-centre",
            "centre of a union at the mean of its vertices",
            "centre-union",
            "at the mean of the vertices",
            simulation=_model(_mean_of_vertices),
        ),
        _own(
            "gravity-tilted",
            "gravity tilted",
            "free-fall-drift",
            "gravity is tilted",
            simulation=_model(_gravity_tilted),
        ),
        _own(
            "union-unweighted",
            "pieces of a union weighted equally",
            "centre-union",
            "mean of the pieces' centres",
            simulation=_model(_mean_of_pieces),
        ),
        _own(
            "restore-warm-start",
            "restore forgets warm starts",
            "restore-rest",
            "warm starts",
            simulation=_RestoreForgetsWarmStart,
        ),
        _own(
            "hinge-damping",
            "damped joints and bodies",
            "pendulum-period",
            "viscous friction",
            simulation=_model(_damped),
        ),
        _own(
            "hinged-axis",
            "axis of a hinge between bodies tilted by 3 degrees",
            "hinged-closed",
            "3 degrees from the axis of its hinge",
            simulation=_model(_hanging(_hinge_tilted)),
        ),
        _own(
            "hinged-anchor",
            "anchor of a hinge between bodies 2 mm off",
            "hinged-closed",
            "the anchor",
            simulation=_model(_hanging(_hinge_shifted)),
        ),
        fault(
            "hinged-weightless",
            "no gravity on a body that hangs on another one",
            "hinged-fall",
            "gravity acts on both",
            simulation=_HangingWeightless,
        ),
        _own(
            "hinged-inertia",
            "inertia of a body that hangs on another one times 1.5",
            "hinged-momentum",
            "the inertia of both",
            simulation=_model(_hanging(_hinge_heavy)),
        ),
        _own(
            "hinged-backwards",
            "hinges between bodies start in the other direction",
            "hinged-angle",
            "it turns the other way",
            simulation=_HingeBackwards,
        ),
        _own(
            "soft-contacts",
            "contacts ten times too slow",
            "contact-listed",
            "so soft",
            settings={"sustained_solref": (0.2, 1.0)},
        ),
        _own(
            "contacts-yield",
            "sustained contacts ten times as soft",
            "tower-stands",
            "yield under the weight",
            settings={"sustained_solimp": (0.5, 0.5, 0.001)},
        ),
        _own(
            "solver-stops",
            "solver with ten iterations",
            "tower-stands",
            "a solver ends before",
            simulation=_model(_stops_early),
        ),
        _own(
            "blast",
            "fast bodies thrown off",
            "time",
            "each call changes its speed",
            simulation=_Blast,
        ),
        _own(
            "centre-elsewhere",
            "centre of mass 5 mm off",
            "start-velocity-of-origin",
            "centre of mass does not follow",
            simulation=_model(_centre_elsewhere),
        ),
        _own(
            "gains-energy",
            "2 % more speed in each interval",
            "time",
            "each call changes its speed",
            simulation=_GainsEnergy,
        ),
        _own(
            "rope-ends",
            "ends of a rope have the mass of a whole segment",
            "rope-period",
            "mass at the ends",
            simulation=_model(_rope_ends),
        ),
        _own(
            "torsional-friction",
            "torsional friction of 5 mm",
            "spin-on-point",
            "torsional friction",
            simulation=_model(_torsional),
        ),
        _own(
            "speed-limited",
            "speed of at most 4 m/s",
            "free-fall",
            "limit of speed",
            simulation=_SpeedLimited,
        ),
        _own(
            "gravity-of-spin",
            "1 % more gravity while a body spins",
            "free-fall-spinning",
            "gravity is 1.01 of the scene's",
            simulation=_HeavySpin,
        ),
    )
)
"""Faults by id."""
