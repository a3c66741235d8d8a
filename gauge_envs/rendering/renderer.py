"""Renderer of a scene from poses and nodes, the same for all engines."""

import os
import sys
from collections.abc import Mapping
from contextlib import suppress
from ctypes.util import find_library
from importlib import import_module
from itertools import pairwise
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import RenderError
from gauge_envs.rendering.camera import View, free_camera
from gauge_envs.rendering.materials import LOOKS, STRING_COLOR, Color, material_of
from gauge_envs.rendering.overlay import Overlay
from gauge_envs.rendering.skin import Skin
from gauge_envs.rendering.visual_model import visual_model
from gauge_envs.rendering.window import Window
from gauge_envs.scene import Cloth, Rod, Rope, Scene, SoftBody
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ

SIMULATED_COLOR: Color = (0.07, 0.33, 0.85)
"""Colour of tracked points of a simulation and of their paths."""
RECORDED_COLOR: Color = (0.85, 0.05, 0.38)
"""Colour of the reference."""
STRING_PX = 1.1
"""Smallest radius of strings and ropes in pictures [pixels]."""
MARKER_PX = 4.0
"""Radius of a tracked point [pixels]."""
PATH_PX = 1.6
"""Radius of a path [pixels]."""
STEP_PX = 4.0
"""Shortest drawn part of a path [pixels]."""
MAX_EXTRA_SHAPES = 10_000
"""Largest number of shapes in overlays, strings, ropes and rods."""
BALL = mujoco.mjtGeom.mjGEOM_SPHERE
TUBE = mujoco.mjtGeom.mjGEOM_CAPSULE

DEBIAN_PACKAGES = "libegl1 libegl-mesa0 libgl1-mesa-dri libgl1 libopengl0"

_drawing_processes: set[int] = set()
"""Process that has created an off-screen context; a fork inherits the number of its parent."""


def _graphics_context(width: int, height: int) -> Any:
    """Return an off-screen OpenGL context: as MUJOCO_GL says, else EGL or OSMesa on Linux, else MuJoCo's choice."""
    if _drawing_processes - {os.getpid()}:
        raise RenderError(
            "this process is a fork of one that has drawn pictures, and OpenGL does not survive a fork. Start new "
            "processes, as by gymnasium.make_vec(..., vectorization_mode='async', vector_kwargs={'context': 'spawn'})"
        )
    _drawing_processes.add(os.getpid())
    wanted = os.environ.get("MUJOCO_GL", "").lower()
    chosen = wanted
    if not wanted and sys.platform == "linux":
        chosen = "egl" if find_library("EGL") else "osmesa"
    module = chosen if chosen in ("egl", "osmesa") else "gl_context"
    try:
        context = import_module(f"mujoco.{module}").GLContext(width, height)
        context.make_current()
    except Exception as error:
        # OpenGL bindings raise many errors: ImportError, AttributeError, their own.
        raise RenderError(
            f"no off-screen OpenGL (MUJOCO_GL={wanted!r}): {error}. On Debian or Ubuntu: "
            f"apt-get install {DEBIAN_PACKAGES}; or libosmesa6 alone, with MUJOCO_GL=osmesa"
        ) from error
    return context


class SceneRenderer:
    """Renderer of a scene, without physics.

    Args:
        scene: The scene.
        rest_nodes_m: Nodes of each deformable body at the start [m], shape [node_count, 3].
        width: Picture width [pixels].
        height: Picture height [pixels].
        view: The camera.
        materials: Material of bodies by name, as `wood`; without one, the kind of motion gives the colour.
        window: Window that `show` draws in, or None for pictures.
    """

    def __init__(
        self,
        scene: Scene,
        rest_nodes_m: Mapping[str, FloatArray],
        width: int,
        height: int,
        *,
        view: View,
        materials: Mapping[str, str],
        window: Window | None = None,
    ) -> None:
        # The process crashes if PyTorch for CUDA loads triton after Mesa has loaded its own LLVM.
        with suppress(ImportError):
            import_module("triton")
        self._context = window or _graphics_context(width, height)
        self._context.make_current()
        self._scene = scene
        self._viewport = mujoco.MjrRect(0, 0, width, height)
        self._skins: list[Skin] = []
        self._line_looks: dict[str, tuple[float, Color]] = {}
        for body in scene.deformables:
            if isinstance(body, Cloth | SoftBody):
                self._skins.append(Skin(body, rest_nodes_m[body.name]))
            elif isinstance(body, Rope | Rod):
                material = material_of(body, materials.get(body.name))
                self._line_looks[body.name] = (body.radius_m, LOOKS[material].color)
        self._model = visual_model(
            scene, self._skins, rest_nodes_m, materials, view, width, height
        )
        self._data = mujoco.MjData(self._model)
        self._option = mujoco.MjvOption()
        max_shapes = self._model.ngeom + MAX_EXTRA_SHAPES
        self._drawing = mujoco.MjvScene(self._model, maxgeom=max_shapes)
        self._pixel_m = view.height_m / height
        self._camera = free_camera(view) if window is None else window.camera
        self._device = mujoco.MjrContext(
            self._model, mujoco.mjtFontScale.mjFONTSCALE_100
        )
        # Store the nearest depth as 1 and the farthest as 0, where floating point numbers are densest.
        self._device.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
        buffers = mujoco.mjtFramebuffer
        buffer = buffers.mjFB_OFFSCREEN if window is None else buffers.mjFB_WINDOW
        mujoco.mjr_setBuffer(buffer, self._device)

    def picture(
        self,
        poses: Mapping[str, FloatArray],
        nodes_m: Mapping[str, FloatArray],
        overlay: Overlay | None = None,
    ) -> NDArray[np.uint8]:
        """Return a picture of the scene.

        Args:
            poses: Position [m] and quaternion w x y z of each body that has moved, shape [7].
            nodes_m: Nodes of each deformable body [m], in the order of `rest_nodes_m`.
            overlay: Overlay on the scene, or None.

        Returns:
            Picture, shape [height, width, 3], top row first.
        """
        shape = (self._viewport.height, self._viewport.width, 3)
        pixels = np.empty(shape, dtype=np.uint8)
        self._render(self._viewport, poses, nodes_m, overlay)
        mujoco.mjr_readPixels(pixels, None, self._viewport, self._device)
        return np.ascontiguousarray(pixels[::-1])

    def depth_m(
        self, poses: Mapping[str, FloatArray], nodes_m: Mapping[str, FloatArray]
    ) -> NDArray[np.float32]:
        """Return the distance of each pixel's point from the camera plane [m].

        Args:
            poses: See `picture`.
            nodes_m: See `picture`.

        Returns:
            Distances, shape [height, width], top row first; the background is at the far plane.
        """
        shape = (self._viewport.height, self._viewport.width)
        stored = np.empty(shape, dtype=np.float32)
        self._render(self._viewport, poses, nodes_m, None)
        mujoco.mjr_readPixels(None, stored, self._viewport, self._device)
        planes = self._model.vis.map
        near_m = planes.znear * self._model.stat.extent
        far_m = planes.zfar * self._model.stat.extent
        depth_m = near_m * far_m / (near_m + stored[::-1] * (far_m - near_m))
        return depth_m.astype(np.float32)

    def show(
        self,
        window: Window,
        poses: Mapping[str, FloatArray],
        nodes_m: Mapping[str, FloatArray],
        overlay: Overlay | None = None,
    ) -> None:
        """Draw the scene in its window, at most once a frame; see `picture` for the arguments."""

        def draw() -> None:
            viewport = mujoco.MjrRect(0, 0, *window.size)
            self._render(viewport, poses, nodes_m, overlay)

        window.show(draw, interval_s=1.0 / FRAME_RATE_HZ)

    def close(self) -> None:
        """Free the graphics context; a window stays open."""
        self._device.free()
        if not isinstance(self._context, Window):
            self._context.free()

    def _render(
        self,
        viewport: mujoco.MjrRect,
        poses: Mapping[str, FloatArray],
        nodes_m: Mapping[str, FloatArray],
        overlay: Overlay | None,
    ) -> None:
        """Draw the scene."""
        for name, pose in poses.items():
            index = self._model.body(name).mocapid[0]
            self._data.mocap_pos[index] = pose[:3]
            self._data.mocap_quat[index] = pose[3:]
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        self._context.make_current()
        for skin in self._skins:
            skin.move(self._model, nodes_m[skin.name])
        drawing = self._drawing
        mujoco.mjv_updateScene(
            self._model,
            self._data,
            self._option,
            None,
            self._camera,
            mujoco.mjtCatBit.mjCAT_ALL,
            drawing,
        )
        # Draw distant strings and ropes thicker than they are, so that they stay visible.
        min_radius_m = STRING_PX * self._pixel_m
        for joint in self._scene.joints:
            ball_m = self._data.body(joint.body).xpos
            anchor_m = np.asarray(joint.anchor_m)
            _add_tube(drawing, anchor_m, ball_m, min_radius_m, STRING_COLOR)
        for body, (line_radius_m, color) in self._line_looks.items():
            radius_m = max(line_radius_m, min_radius_m)
            for start_m, end_m in pairwise(nodes_m[body]):
                _add_tube(drawing, start_m, end_m, radius_m, color)
        if overlay is not None:
            _add_overlay(drawing, overlay, self._pixel_m)
        mujoco.mjr_render(viewport, drawing, self._device)


# --- shapes drawn after the bodies ---


def _add_overlay(drawing: mujoco.MjvScene, overlay: Overlay, pixel_m: float) -> None:
    """Add an overlay in front of the scene: points before paths, and the simulation before the reference.

    Args:
        drawing: The drawing.
        overlay: The overlay.
        pixel_m: Size of a pixel at the distance of the target [m].
    """
    first = drawing.ngeom
    eye_m = 0.5 * np.sum([camera.pos for camera in drawing.camera], axis=0)
    # A point moved towards the camera stays at the same place of the picture.
    for share, color, paths in (
        (0.5, RECORDED_COLOR, overlay.recorded_paths),
        (0.45, SIMULATED_COLOR, overlay.paths),
    ):
        radius_m = share * PATH_PX * pixel_m
        for path_m in paths:
            near_m = eye_m + share * (_thinned(path_m, STEP_PX * pixel_m) - eye_m)
            for start_m, end_m in pairwise(near_m):
                if np.isfinite([start_m, end_m]).all():
                    _add_tube(drawing, start_m, end_m, radius_m, color)
    for share, color, points_m in (
        (0.4, RECORDED_COLOR, overlay.recorded_m),
        (0.35, SIMULATED_COLOR, overlay.markers_m),
    ):
        size_m = np.full(3, share * MARKER_PX * pixel_m)
        for near_m in eye_m + share * (points_m - eye_m):
            if np.isfinite(near_m).all():
                _add_shape(drawing, BALL, color, size_m, near_m)
    for geom in drawing.geoms[first : drawing.ngeom]:
        # The overlay casts no shadow. Emission keeps its colour visible in the shade.
        geom.category = mujoco.mjtCatBit.mjCAT_DECOR
        geom.emission = 0.4


def _thinned(path_m: FloatArray, step_m: float) -> FloatArray:
    """Return the points of a path at which its length passes a multiple of a step, and its last point."""
    steps_m = np.linalg.norm(np.diff(path_m, axis=0), axis=1)
    lengths_m = np.nancumsum(steps_m)
    _, first = np.unique(lengths_m // step_m, return_index=True)
    return path_m[[0, *(first[1:] + 1), len(path_m) - 1]]


def _add_tube(
    drawing: mujoco.MjvScene,
    start_m: FloatArray,
    end_m: FloatArray,
    radius_m: float,
    color: Color,
) -> None:
    """Add a straight tube with round ends between two points [m], shape [3] each."""
    geom = _add_shape(drawing, TUBE, color, np.zeros(3), np.zeros(3))
    mujoco.mjv_connector(geom, TUBE, radius_m, start_m, end_m)


def _add_shape(
    drawing: mujoco.MjvScene,
    kind: mujoco.mjtGeom,
    color: Color,
    size_m: FloatArray,
    place_m: FloatArray,
) -> mujoco.MjvGeom:
    """Add a shape that casts a shadow, and return it; its size and place have the shape [3]."""
    geom = drawing.geoms[drawing.ngeom]
    drawing.ngeom += 1
    rgba = np.array([*color, 1.0], dtype=np.float32)
    mujoco.mjv_initGeom(geom, kind, size_m, place_m, np.eye(3).ravel(), rgba)
    geom.category = mujoco.mjtCatBit.mjCAT_DYNAMIC
    return geom
