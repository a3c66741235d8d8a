"""Scenes of rigid bodies for the tests of several engines, and the states of their bodies."""

from contextlib import closing
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.fixtures.parts import body, contact
from gauge_envs.fixtures.recording import Recording
from gauge_envs.scene import GRAVITY_M_PER_S2, Box, Motion, Plane, Pose, Scene

FRICTION = 0.273673
SLOPE = Rotation.from_euler("y", 30, degrees=True)
SLIDE_M_PER_S2 = GRAVITY_M_PER_S2 * (np.sin(np.pi / 6) - FRICTION * np.cos(np.pi / 6))


def solid(name, shape, position_m=(0.0, 0.0, 0.0), **changes):
    """Return a dynamic body of 0.1 kg with some changes."""
    return replace(body(name, shape, Pose(position_m=position_m)), **changes)


def target(pose, velocity, acceleration=(0.0,) * 6):
    """Return the target of a driven body in one world for `Simulation.drive`, shape [1, 19]."""
    return np.array([[*pose.position_m, *pose.quaternion, *velocity, *acceleration]])


def plane_deg(lean_deg=0.0, name="ground"):
    """Return a fixed plane through the origin, tilted about y."""
    pose = Pose.from_euler_deg((0.0, 0.0, 0.0), (0.0, lean_deg, 0.0))
    return body(name, Plane(), pose, mass_kg=0.0, motion=Motion.FIXED)


def scene_of(*bodies, seconds=1.0, **parts):
    """Return a scene of bodies."""
    return Scene(bodies=bodies, duration_s=seconds, **parts)


def states(engine, scene, names, seconds, *, interval_s=1 / 180, **settings):
    """Return states at the start and after each interval, shape [interval_count + 1, len(names), 13]."""
    with closing(engine.build(scene, settings)) as simulation:
        rows = [simulation.body_states(names)[0]]
        for _ in range(round(seconds / interval_s)):
            simulation.advance(interval_s)
            rows.append(simulation.body_states(names)[0])
    return np.array(rows)


def sliding_scene():
    """Return a cube on a board with a slope of 30 degrees."""

    def on_slope(position_m):
        return Pose.from_rotation(tuple(SLOPE.apply(position_m).tolist()), SLOPE)

    board = solid(
        "board",
        Box(size_m=(2.0, 0.3, 0.02)),
        motion=Motion.FIXED,
        pose=on_slope((0, 0, -0.01)),
    )
    cube = solid("cube", Box(size_m=(0.05, 0.05, 0.05)), pose=on_slope((0, 0, 0.025)))
    return scene_of(
        board, cube, contacts=(contact("cube", "board", friction=FRICTION),)
    )


def slide(engine, seconds, **settings):
    """Return the acceleration of the cube over Coulomb's law, and its largest height over the board [m]."""
    places = states(engine, sliding_scene(), ["cube"], seconds, **settings)[:, 0, :3]
    along = SLOPE.inv().apply(places)
    times_s = np.arange(len(along)) / 180
    acceleration = 2.0 * np.polyfit(times_s, along[:, 0], 2)[0]
    return acceleration / SLIDE_M_PER_S2, float(along[:, 2].max() - 0.025)


def recording_of(scene, times_s, **moved):
    """Return a recording in which bodies move by displacements [m], shape [sample_count, 3]; the others rest."""
    states = {}
    for part in scene.bodies:
        rows = np.zeros((len(times_s), 13))
        rows[:, :3] = part.pose.position_m + moved.get(part.name, np.zeros(3))
        rows[:, 3:7] = part.pose.quaternion
        states[part.name] = rows
    return Recording(scene=scene, times_s=times_s, states=states)
