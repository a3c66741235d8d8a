"""Air on cloth in MuJoCo: sums over triangles, a plate's quadratic damping, exact continuation, no effect when off."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from gauge_envs import load_experiment
from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.backends.mujoco.cloth import AirOnCloth, ClothPartMuJoCo
from gauge_envs.backends.mujoco.simulation import SimulationMuJoCo
from gauge_envs.scene import Air, Pose, Region, Scene
from gauge_envs.scene.driver_path import DriverPath
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from gauge_envs.tools.conformance.lab import clamped, fabric, sheet

FLING = "TextileFlinging-satin"
ZERO = np.zeros(1)


def fling(parameters: str = "air") -> tuple[Scene, SimulationMuJoCo, DriverPath]:
    experiment = load_experiment(FLING, parameters)
    scene = experiment.scene
    simulation = BackendMuJoCo().build(scene)
    simulation.reset(0)
    return scene, simulation, DriverPath(scene.drivers[0], scene, 11)


def advance(
    simulation: SimulationMuJoCo, path: DriverPath, first: int, last: int
) -> None:
    for index in range(first, last):
        state = path.interval(index, ZERO)
        simulation.drive(path.body, *state)
        simulation.advance(SAMPLE_INTERVAL_S)


def air_of(simulation: SimulationMuJoCo) -> tuple[AirOnCloth, ClothPartMuJoCo]:
    (air,) = simulation._air
    (part,) = simulation._parts.values()
    assert isinstance(part, ClothPartMuJoCo)
    return air, part


def test_vertices_receive_the_force_and_the_power_of_the_triangles() -> None:
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


def test_a_uniform_load_gives_each_vertex_the_load_of_its_area() -> None:
    _, simulation, _ = fling()
    air, part = air_of(simulation)
    areas = np.full(
        len(part.grid.triangles), 0.5 * part.grid.cell_m[0] * part.grid.cell_m[1]
    )
    assert air._to_vertices @ areas == pytest.approx(part.grid.vertex_areas_m2())


def test_vertex_velocities_are_those_of_mujoco() -> None:
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


def test_cloth_that_drifts_with_the_wind_feels_no_force() -> None:
    wind = (0.5, -1.0, 0.25)
    cloth = sheet(
        fabric(0.1, 110.0, 1e-4), Pose(position_m=(0.0, 0.0, 1.0)), (0.1, 0.1)
    )
    air = Air(
        density_kg_per_m3=1.2,
        normal_coefficient=1.0,
        tangential_coefficient=0.1,
        lift_coefficient=1.0,
    )
    scene = replace(
        clamped(cloth, duration_s=1.0, gravity_m_per_s2=0.0),
        air=replace(air, wind_m_per_s=wind),
    )
    simulation = BackendMuJoCo().build(scene)
    _, part = air_of(simulation)
    simulation.data.qvel[part.points.dofs] = wind
    start = simulation.nodes("cloth")
    simulation.advance(0.1)
    assert simulation.nodes("cloth") - start == pytest.approx(
        np.tile(0.1 * np.array(wind), (len(start), 1)), abs=1e-9
    )


@pytest.mark.slow
def test_a_hanging_plate_loses_amplitude_by_quadratic_damping() -> None:
    """One stiff cell that hangs from an edge: theta'' = -w^2 theta - b |theta'| theta'.

    Over a cycle of amplitude a, the drag takes 8/3 b a^2, so 1/a grows by 8/3 b per cycle: the energy
    balance over a cosine. The free vertices carry half of the mass. The triangles have 1/4
    and 3/4 of their speed.
    """
    side, density, coefficient, amplitude = 0.1, 0.1, 1.5, 0.2
    pose = Pose.from_euler_deg((0.0, 0.0, 1.0), (0.0, -90.0, 0.0))
    cloth = sheet(fabric(density, 110.0, 0.1), pose, (side, side))
    air = Air(density_kg_per_m3=1.2, normal_coefficient=coefficient)
    scene = replace(
        clamped(cloth, Region(axis="x", side="high"), duration_s=3.0), air=air
    )

    def inverse_amplitudes(one: Scene) -> np.ndarray:
        simulation = BackendMuJoCo().build(
            one, {"cell_m": side, "timestep_s": 1.0 / 7200.0}
        )
        (part,) = simulation._parts.values()
        frequency = np.sqrt(9.80665 / side)
        simulation.data.qvel[part.points.dofs[:, 0]] = amplitude * frequency * side
        low = part.points.free
        angles = []
        for _ in range(360):
            simulation.advance(SAMPLE_INTERVAL_S)
            angles.append(np.arctan2(simulation.nodes("cloth")[low, 0].mean(), side))
        values = np.array(angles)
        peaks = (
            np.flatnonzero((values[1:-1] > values[:-2]) & (values[1:-1] >= values[2:]))
            + 1
        )
        before, top, after = values[peaks - 1], values[peaks], values[peaks + 1]
        return np.asarray(
            1.0 / (top - (after - before) ** 2 / (8.0 * (before - 2.0 * top + after)))
        )

    rate = 0.5 * 1.2 * coefficient * (0.25**3 + 0.75**3) * side / density
    growth = np.diff(inverse_amplitudes(scene))
    own = np.diff(inverse_amplitudes(replace(scene, air=None)))
    assert len(growth) >= 2
    assert abs(own).max() < 0.05 * growth.min()
    assert growth == pytest.approx(np.full(len(growth), 8.0 / 3.0 * rate), rel=0.05)


def test_without_air_the_model_steps_as_mujoco_alone() -> None:
    _, simulation, path = fling("calibrated")
    _, other, _ = fling("calibrated")
    steps = round(SAMPLE_INTERVAL_S / other.settings["timestep_s"])
    advance(simulation, path, 0, 20)
    for index in range(20):
        other.drive(path.body, *path.interval(index, ZERO))
        mujoco.mj_step(other.model, other.data, nstep=steps)
    assert np.array_equal(simulation.nodes("textile"), other.nodes("textile"))
    assert not simulation.data.qfrc_applied.any()
