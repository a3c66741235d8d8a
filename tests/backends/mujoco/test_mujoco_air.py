"""Air on cloth in MuJoCo: sums over triangles, a plate's quadratic damping, exact continuation, no effect when off."""

import mujoco
import numpy as np
import pytest

from gauge_envs import load_experiment
from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.scene.prescribed_motion import prescribed_motions
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S

FLING = "TextileFlinging-satin"
ZERO = np.zeros((1, 1))


def fling(parameters="air"):
    experiment = load_experiment(FLING, parameters)
    scene = experiment.scene
    simulation = BackendMuJoCo().build(scene)
    simulation.reset()
    (motion,) = prescribed_motions(scene, scene.duration_s)
    return scene, simulation, motion


def advance(simulation, motion, first, last):
    for index in range(first, last):
        simulation.drive(motion.body, motion.targets(index, ZERO)[0])
        simulation.advance(SAMPLE_INTERVAL_S)


def air_of(simulation):
    (air,) = simulation._air
    (part,) = simulation._parts.values()
    return air, part


def test_vertices_receive_the_force_and_the_power_of_the_triangles():
    _, simulation, _ = fling()
    air, part = air_of(simulation)
    simulation.data.qvel[part.points.dofs] = np.random.default_rng(0).normal(
        size=part.points.dofs.shape
    )
    forces = air.triangle_forces_n()
    on_vertices = air._to_vertices @ forces
    assert on_vertices.sum(axis=0) == pytest.approx(forces.sum(axis=0), rel=1e-12)
    speeds = part.points.velocities()
    assert np.vdot(on_vertices, speeds) == pytest.approx(
        np.vdot(forces, air._to_triangles @ speeds), rel=1e-12
    )
    air.apply()
    assert simulation.data.qfrc_applied[part.points.dofs] == pytest.approx(
        on_vertices[part.points.free]
    )
    others = np.setdiff1d(np.arange(simulation.model.nv), part.points.dofs.ravel())
    assert not simulation.data.qfrc_applied[others].any()


def test_a_uniform_load_gives_each_vertex_the_load_of_its_area():
    _, simulation, _ = fling()
    air, part = air_of(simulation)
    areas = np.full(
        len(part.grid.triangles), 0.5 * part.grid.cell_m[0] * part.grid.cell_m[1]
    )
    assert air._to_vertices @ areas == pytest.approx(part.grid.vertex_areas_m2())


def test_vertex_velocities_are_those_of_mujoco():
    """Also those of the vertices on the rod, which turns and moves."""
    _, simulation, _ = fling()
    _, part = air_of(simulation)
    model, data = simulation.model, simulation.data
    data.qvel[:] = np.random.default_rng(1).normal(size=model.nv)
    before = part.points.positions()
    step = 1e-7
    mujoco.mj_integratePos(model, data.qpos, data.qvel, step)
    assert (part.points.positions() - before) / step == pytest.approx(
        part.points.velocities(), abs=1e-5
    )


def test_without_air_the_model_steps_as_mujoco_alone():
    _, simulation, motion = fling("calibrated")
    _, other, _ = fling("calibrated")
    steps = round(SAMPLE_INTERVAL_S / other.settings["timestep_s"])
    advance(simulation, motion, 0, 20)
    for index in range(20):
        other.drive(motion.body, motion.targets(index, ZERO)[0])
        mujoco.mj_step(other.model, other.data, nstep=steps)
    assert np.array_equal(simulation.nodes("textile")[0], other.nodes("textile")[0])
    assert not simulation.data.qfrc_applied.any()
