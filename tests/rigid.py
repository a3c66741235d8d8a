"""Scenes of rigid bodies for the tests of several engines, and the states of their bodies."""

from contextlib import closing
from dataclasses import replace

import numpy as np

from gauge_envs.scene import Motion, Plane, Pose, Scene
from gauge_envs.tools.bench.parts import body


def solid(name, shape, position_m=(0.0, 0.0, 0.0), **changes):
    """A body of 0.1 kg that moves under forces, but for the changes."""
    return replace(body(name, shape, Pose(position_m=position_m)), **changes)


def plane_deg(lean_deg=0.0, name="ground"):
    """A fixed plane through the origin that leans about y."""
    pose = Pose.from_euler_deg((0.0, 0.0, 0.0), (0.0, lean_deg, 0.0))
    return body(name, Plane(), pose, mass_kg=0.0, motion=Motion.FIXED)


def scene_of(*bodies, seconds=1.0, **parts):
    """A scene of bodies."""
    return Scene(bodies=bodies, duration_s=seconds, **parts)


def states(engine, scene, names, seconds, *, interval_s=1 / 180, **settings):
    """States at the start and after each interval, shape [interval_count + 1, len(names), 13]."""
    with closing(engine.build(scene, settings)) as simulation:
        simulation.reset(0)
        rows = [simulation.body_states(names)]
        for _ in range(round(seconds / interval_s)):
            simulation.advance(interval_s)
            rows.append(simulation.body_states(names))
    return np.array(rows)
