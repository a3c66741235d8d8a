"""The window of a scene, and pictures of depth."""

import subprocess
import sys
from shutil import which

import gymnasium
import numpy as np
import pytest
from opengl import needs_opengl
from places import ROOT

import gauge_envs  # noqa: F401
from gauge_envs.errors import RenderError
from gauge_envs.rendering.camera import FIELD_OF_VIEW_DEG

SIZE = {"width": 80, "height": 60}
BALL = "GAUGE/BouncingBall-rubber"

EPISODE = """
import gymnasium, gauge_envs
env = gymnasium.make("GAUGE/SlopeSlider-2-wood", render_mode="human", width=80, height=60)
env.reset(seed=0)
window = env.unwrapped._pictures._window
shown = []
swap = window._glfw.swap_buffers
window._glfw.swap_buffers = lambda handle: (shown.append(1), swap(handle))
assert env.step(0) and env.render() is None and len(shown) == 2, shown
azimuth_deg, distance_m = window.camera.azimuth, window.camera.distance
window._glfw.get_mouse_button = lambda handle, button: button == window._glfw.MOUSE_BUTTON_LEFT
window._on_cursor(window._handle, 30.0, 0.0)
window._on_wheel(window._handle, 0.0, 1.0)
assert window.camera.azimuth == azimuth_deg - 90.0 and window.camera.distance < distance_m
env.reset(seed=1, options={"jitter": True})
assert env.unwrapped._pictures._window is window and window.camera.azimuth == azimuth_deg - 90.0
window._glfw.set_window_should_close(window._handle, True)
env.step(0)
count = len(shown)
env.step(0)
assert not window.is_open and len(shown) == count
env.close()
"""


@pytest.mark.skipif(not which("xvfb-run"), reason="no virtual display")
def test_steps_draw_in_a_window_and_the_mouse_rotates_the_view():
    subprocess.run(
        ["xvfb-run", "-a", sys.executable, "-c", EPISODE], cwd=ROOT, check=True
    )


def test_no_display_gives_an_error_with_alternatives(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    env = gymnasium.make(BALL, render_mode="human")
    with pytest.raises(RenderError, match=r"no display.*rgb_array"):
        env.reset(seed=0)


@needs_opengl
def test_depth_is_the_distance_from_the_plane_of_the_camera():
    """The camera looks at bare ground, whose distance in each row is known."""
    camera = {
        "target_m": (5.0, 5.0, 0.0),
        "distance_m": 0.7,
        "azimuth_deg": 90.0,
        "elevation_deg": -30.0,
    }
    env = gymnasium.make(BALL, render_mode="rgbd_tuple", camera=camera, **SIZE)
    env.reset(seed=0)
    picture, depth_m = env.render()
    assert (picture.shape, picture.dtype) == ((60, 80, 3), np.uint8)
    assert (depth_m.shape, depth_m.dtype) == ((60, 80), np.float32)
    ground_m = env.unwrapped.experiment.scene.floor_height_m
    # A ray of a depth d along the view falls by d (sin e - tan(row) cos e). A stored depth is that of a sample of the
    # pixel, which is not its middle: it lies between those of the pixel's upper and lower edge.
    edges = 0.5 - np.arange(61) / 60.0
    slope = 2.0 * edges * np.tan(np.radians(0.5 * FIELD_OF_VIEW_DEG))
    fall = np.sin(np.radians(30.0)) - slope * np.cos(np.radians(30.0))
    edges_m = (0.7 * np.sin(np.radians(30.0)) - ground_m) / fall
    assert (depth_m[:, 40] < edges_m[:-1]).all()
    assert (depth_m[:, 40] > edges_m[1:]).all()


@needs_opengl
def test_the_camera_is_an_argument_of_every_id():
    for name in (BALL, "GAUGE/SlopeSlider-Limit-wood"):
        pictures = []
        for camera in (None, {"azimuth_deg": 10.0}):
            env = gymnasium.make(name, render_mode="rgb_array", camera=camera, **SIZE)
            env.reset(seed=0)
            pictures.append(env.render().astype(int))
            env.close()
        assert np.abs(pictures[0] - pictures[1]).max() > 40
