"""A window that shows a scene; the mouse rotates the view."""

import time
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from gauge_envs.errors import RenderError
from gauge_envs.rendering.camera import View, free_camera

ROTATION_DEG = 180.0
"""Rotation of the scene by a drag over the height of the window [deg]."""
STEEPEST_DEG = 89.0
"""Largest elevation of the camera, up and down [deg]."""
ZOOM_OF_NOTCH = 0.95
"""Factor on the distance of the camera per notch of the wheel."""
REST_S = 0.005
"""Longest time between two reads of the mouse [s]."""


class Window:
    """A window with an OpenGL context; drag left to rotate, drag right to move, and use the wheel to zoom.

    Closing it or Escape ends the drawing, but not the simulation.

    Args:
        width: Width [pixels].
        height: Height [pixels].
        title: Title of the window.
        view: The initial camera.

    Attributes:
        is_open: Whether the window is open.
        camera: Camera that the mouse moves.

    Raises:
        RenderError: There is no display.
    """

    def __init__(self, width: int, height: int, title: str, view: View) -> None:
        # MuJoCo installs this package.
        import glfw

        self._glfw: Any = glfw
        self._handle = None
        with warnings.catch_warnings():
            # glfw warns without a display.
            warnings.simplefilter("ignore")
            if glfw.init():
                glfw.window_hint(glfw.SAMPLES, 4)
                self._handle = glfw.create_window(width, height, title, None, None)
        if not self._handle:
            raise RenderError(
                "render_mode 'human' found no display for its window. Without one, use render_mode='rgb_array', or "
                "start the program with xvfb-run"
            )
        self.is_open = True
        self.camera = free_camera(view)
        self._is_turned = False
        self._next_s = 0.0
        self._mouse = (0.0, 0.0)
        self.make_current()
        # Frames set the time between pictures, not the screen.
        glfw.swap_interval(0)
        glfw.set_cursor_pos_callback(self._handle, self._on_cursor)
        glfw.set_scroll_callback(self._handle, self._on_wheel)
        glfw.set_key_callback(self._handle, self._on_key)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the drawing [pixels], which the user can change."""
        width, height = self._glfw.get_framebuffer_size(self._handle)
        return max(width, 1), max(height, 1)

    def make_current(self) -> None:
        """Make this window the target of OpenGL."""
        self._glfw.make_context_current(self._handle)

    def show(self, draw: Callable[[], None], *, interval_s: float) -> None:
        """Show a picture, and wait until the next one is due; meanwhile the mouse rotates the view.

        Args:
            draw: Function that draws the scene.
            interval_s: Shortest time between two pictures [s].
        """
        is_drawn = False
        while self.is_open:
            self._glfw.poll_events()
            self.is_open = not self._glfw.window_should_close(self._handle)
            if not self.is_open:
                self._glfw.hide_window(self._handle)
                return
            if not is_drawn or self._is_turned:
                is_drawn, self._is_turned = True, False
                draw()
                self._glfw.swap_buffers(self._handle)
            left_s = self._next_s - time.perf_counter()
            if left_s <= 0.0:
                break
            time.sleep(min(left_s, REST_S))
        self._next_s = time.perf_counter() + interval_s

    def close(self) -> None:
        """Close the window."""
        if self._handle:
            self._glfw.destroy_window(self._handle)
            self._handle, self.is_open = None, False

    def _on_cursor(self, handle: Any, x: float, y: float) -> None:
        glfw = self._glfw
        height = max(glfw.get_window_size(handle)[1], 1)
        right = (x - self._mouse[0]) / height
        down = (y - self._mouse[1]) / height
        self._mouse = (x, y)
        camera = self.camera
        if glfw.get_mouse_button(handle, glfw.MOUSE_BUTTON_LEFT) == glfw.PRESS:
            camera.azimuth -= ROTATION_DEG * right
            elevation_deg = camera.elevation - ROTATION_DEG * down
            camera.elevation = np.clip(elevation_deg, -STEEPEST_DEG, STEEPEST_DEG)
            self._is_turned = True
        elif glfw.get_mouse_button(handle, glfw.MOUSE_BUTTON_RIGHT) == glfw.PRESS:
            view = View(
                target_m=tuple(camera.lookat.tolist()),
                distance_m=camera.distance,
                azimuth_deg=camera.azimuth,
                elevation_deg=camera.elevation,
            )
            to_right, up, _ = view.axes
            camera.lookat += view.height_m * (down * up - right * to_right)
            self._is_turned = True

    def _on_wheel(self, _: Any, __: float, notches: float) -> None:
        self.camera.distance *= ZOOM_OF_NOTCH**notches
        self._is_turned = True

    def _on_key(self, handle: Any, key: int, _: int, action: int, __: int) -> None:
        if key == self._glfw.KEY_ESCAPE and action == self._glfw.PRESS:
            self._glfw.set_window_should_close(handle, True)
