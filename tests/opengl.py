"""Requirements of tests of pictures, and the projection of points by a camera."""

from ctypes.util import find_library

import numpy as np
import pytest

from gauge_envs.rendering.camera import View
from gauge_envs.scene.geometry import FloatArray

needs_opengl = pytest.mark.skipif(
    not (find_library("EGL") or find_library("OSMesa")),
    reason="no OpenGL library: the error is tested instead",
)


def pixels_of(
    view: View, points_m: FloatArray, *, width: int, height: int
) -> FloatArray:
    """Return columns and rows of points [m] in a picture [pixels], by similar triangles, shape [point_count, 2]."""
    eye_m = view.target_m - view.distance_m * view.axes[2]
    right_m, up_m, depth_m = ((points_m - eye_m) @ view.axes.T).T
    pixel_m = view.height_m / height * depth_m / view.distance_m
    return np.column_stack(
        [0.5 * width + right_m / pixel_m, 0.5 * height - up_m / pixel_m]
    )
