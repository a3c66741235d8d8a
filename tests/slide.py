"""A cube that slides by Coulomb's law: g(t) in closed form and as a CSV file."""

import numpy as np

from gauge_envs import load_experiment
from gauge_envs.scene import GRAVITY_M_PER_S2

NAME = "SlopeSlider-2-wood"
RESOLVED = load_experiment(NAME)
FRAMES = RESOLVED.frame_count


def coulomb_slide(times_s):
    """g(t) [mm] of a cube that slides from its start with the published friction, shape [T, 3]."""
    slope, friction = np.radians(30.0), 0.273673
    acceleration = GRAVITY_M_PER_S2 * (np.sin(slope) - friction * np.cos(slope))
    downhill = np.array([np.cos(slope), 0.0, -np.sin(slope)])
    start = np.array(RESOLVED.scene.body("cube").pose.position_m)
    return 1e3 * (start + 0.5 * acceleration * np.square(times_s)[:, None] * downhill)


TIMES = np.arange(FRAMES) / 30.0
SLIDE = coulomb_slide(TIMES)


def write_csv(path, values, *, header="cube.x,cube.y,cube.z", times=None):
    table = values if times is None else np.column_stack([times, values])
    lines = [",".join(repr(float(v)) for v in row) for row in table]
    path.write_text("\n".join([*([header] if header else []), *lines]) + "\n")
    return path
