"""A cube that slides by Coulomb's law: g(t) in closed form and as a CSV file."""

import numpy as np
from closed_forms import slide_mm

from gauge_envs import load_experiment

NAME = "SlopeSlider-2-wood"
RESOLVED = load_experiment(NAME)
FRAMES = RESOLVED.frame_count


def coulomb_slide(times_s):
    """g(t) [mm] of a cube that slides from its start with the published friction, shape [T, 3]."""
    start_m = np.array(RESOLVED.scene.body("cube").pose.position_m)
    return slide_mm(start_m, times_s, friction=0.273673)


TIMES = np.arange(FRAMES) / 30.0
SLIDE = coulomb_slide(TIMES)


def write_csv(path, values, *, header="cube.x,cube.y,cube.z", times=None):
    table = values if times is None else np.column_stack([times, values])
    lines = [",".join(repr(float(v)) for v in row) for row in table]
    path.write_text("\n".join([*([header] if header else []), *lines]) + "\n")
    return path
