"""The renderer of a scene: one for all engines, from poses and nodes, without a display."""

import os
from collections.abc import Mapping
from contextlib import suppress
from ctypes.util import find_library
from importlib import import_module
from itertools import pairwise
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.errors import RenderError, UnknownNameError
from gauge_envs.rendering.camera import FIELD_OF_VIEW_DEG, View, scene_view
from gauge_envs.rendering.materials import STRING, look_of
from gauge_envs.rendering.overlay import RECORDED_COLOR, SIMULATED_COLOR, Color, Overlay
from gauge_envs.rendering.skin import Skin
from gauge_envs.rendering.studio import studio_model
from gauge_envs.rendering.window import Window
from gauge_envs.scene import Cloth, Rod, Rope, Scene, SoftBody
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ

STRING_PX = 1.1
"""Smallest radius of strings and ropes in pictures [pixels]."""
MARKER_PX = 4.0
"""Radius of a marker [pixels]."""
RECORDED_MARKER_PX = 3.4
"""Radius of a marker of the reference [pixels]: where a simulation follows it, its own marker covers it."""
PATH_PX = 1.6
"""Radius of the tube of a path [pixels]."""
RECORDED_PATH_PX = 1.3
"""Radius of a path in the colour of the reference [pixels]: where a simulation follows it, its own path covers it."""
GHOST_OPACITY = 0.35
GHOST_AHEAD_PX = 3.0
"""Distance by which a ghost is drawn nearer to the camera than it is [pixels].

Surfaces of a ghost and its body that coincide are at the same depth, so that rounding would decide for each pixel, and
differently in each picture, which one is in front. A ghost that is displaced by less than can be seen is in front.
"""

DEBIAN_PACKAGES = "libegl1 libegl-mesa0 libgl1-mesa-dri libgl1 libopengl0"

_drawing_processes: set[int] = set()
"""Process that has made an off-screen context; a fork inherits the number of the one that it copies."""


def _graphics_context(width: int, height: int) -> Any:
    """Return an off-screen OpenGL context: that of MUJOCO_GL, or else EGL or OSMesa, whichever is installed."""
    if _drawing_processes - {os.getpid()}:
        raise RenderError(
            "this process is a fork of one that has drawn pictures. A fork copies OpenGL without the threads of its "
            "driver, so that its first picture would never end. Start new processes instead, as by "
            "gymnasium.make_vec(..., vectorization_mode='async', vector_kwargs={'context': 'spawn'})"
        )
    _drawing_processes.add(os.getpid())
    wanted = os.environ.get("MUJOCO_GL", "").lower()
    if not wanted:
        wanted = (
            "egl" if find_library("EGL") else "osmesa" if find_library("OSMesa") else ""
        )
    try:
        if wanted == "egl":
            from mujoco.egl import GLContext
        elif wanted == "osmesa":
            from mujoco.osmesa import GLContext
        elif wanted:
            from mujoco.gl_context import GLContext
        else:
            raise ImportError("neither libEGL nor libOSMesa is installed")
        context = GLContext(width, height)
        context.make_current()
    except Exception as error:
        # OpenGL bindings raise many errors: ImportError, AttributeError, their own.
        raise RenderError(
            f"no off-screen OpenGL (MUJOCO_GL={os.environ.get('MUJOCO_GL', '')!r}): {error}. On Debian or Ubuntu: "
            f"apt-get install {DEBIAN_PACKAGES}; or libosmesa6 alone, with MUJOCO_GL=osmesa"
        ) from error
    return context


class SceneRenderer:
    """Renderer of a scene from poses and nodes, without physics.

    Args:
        scene: The scene.
        rest_nodes_m: For each deformable body its nodes at the start [m], shape [node_count, 3].
        width: Picture width [pixels].
        height: Picture height [pixels].
        view: The camera; None for one by the rule.
        materials: Material of bodies by name, as `wood`; others have colours by how they move.
        window: Window that `show` draws in, or None for pictures alone.

    Attributes:
        camera: The camera.
    """

    def __init__(
        self,
        scene: Scene,
        rest_nodes_m: Mapping[str, FloatArray],
        width: int,
        height: int,
        *,
        view: View | None = None,
        materials: Mapping[str, str] | None = None,
        window: Window | None = None,
    ) -> None:
        # After Mesa's LLVM, loading that of triton, which PyTorch for CUDA brings, ends in a segmentation fault.
        with suppress(ImportError):
            import_module("triton")
        self._window = window
        self._context = window or _graphics_context(width, height)
        self._context.make_current()
        self._scene = scene
        self._viewport = mujoco.MjrRect(0, 0, width, height)
        self._skins = [
            Skin(body, rest_nodes_m[body.name])
            for body in scene.deformables
            if isinstance(body, Cloth | SoftBody)
        ]
        self._lines = [
            body for body in scene.deformables if isinstance(body, Rope | Rod)
        ]
        self._looks = {
            body.name: look_of(body, (materials or {}).get(body.name))
            for body in self._lines
        }
        self.camera = view or scene_view(scene)
        self._model = studio_model(
            scene,
            self._skins,
            rest_nodes_m,
            materials or {},
            self.camera,
            width,
            height,
        )
        # Size of a pixel in the middle of the scene.
        self._pixel_m = (
            2.0
            * self.camera.distance_m
            * np.tan(np.radians(0.5 * FIELD_OF_VIEW_DEG))
            / height
        )
        self._least_radius_m = STRING_PX * self._pixel_m
        self._free_camera = self.camera.mujoco_camera()
        if window is not None:
            # The next renderer of a window keeps what the mouse has done.
            window.camera = window.camera or self._free_camera
            self._free_camera = window.camera
        self._data = mujoco.MjData(self._model)
        self._mocap_ids = {
            body.name: int(self._model.body(body.name).mocapid[0])
            for body in scene.bodies
        }
        self._option = mujoco.MjvOption()
        segments = sum(len(rest_nodes_m[line.name]) for line in self._lines)
        self._own_geoms = self._model.ngeom + len(scene.joints) + segments + 100
        self._drawing = self._drawing_of(self._own_geoms)
        self._device = mujoco.MjrContext(
            self._model, mujoco.mjtFontScale.mjFONTSCALE_100
        )
        buffers = mujoco.mjtFramebuffer
        mujoco.mjr_setBuffer(
            buffers.mjFB_OFFSCREEN if window is None else buffers.mjFB_WINDOW,
            self._device,
        )

    def picture(
        self,
        poses: Mapping[str, FloatArray],
        nodes_m: Mapping[str, FloatArray],
        overlay: Overlay | None = None,
    ) -> NDArray[np.uint8]:
        """Return a picture of the scene with bodies at given poses.

        Args:
            poses: For each body that has moved, position [m] and quaternion w x y z, shape [7].
            nodes_m: For each deformable body its nodes [m], in the order of `rest_nodes_m`.
            overlay: What is drawn on top of the scene, or None.

        Returns:
            Picture, shape [height, width, 3], top row first.
        """
        self._update(poses, nodes_m, overlay)
        picture = self._rendered()
        return picture if overlay is None else self._with_overlay(picture, overlay)

    def depth_m(
        self, poses: Mapping[str, FloatArray], nodes_m: Mapping[str, FloatArray]
    ) -> NDArray[np.float32]:
        """Return the distance of what each pixel shows from the plane of the camera [m].

        Args:
            poses: As for `picture`.
            nodes_m: As for `picture`.

        Returns:
            Distances along the view, shape [height, width], top row first; each is that of a point within the pixel.
            The background is at the far plane.
        """
        self._update(poses, nodes_m, None)
        stored = np.empty(
            (self._viewport.height, self._viewport.width), dtype=np.float32
        )
        # The nearest values are 1 and the farthest 0, where floating point numbers are densest.
        self._device.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
        mujoco.mjr_render(self._viewport, self._drawing, self._device)
        mujoco.mjr_readPixels(None, stored, self._viewport, self._device)
        planes = self._model.vis.map
        near_m = planes.znear * self._model.stat.extent
        far_m = planes.zfar * self._model.stat.extent
        depth_m = near_m * far_m / (near_m + stored[::-1] * (far_m - near_m))
        return depth_m.astype(np.float32)

    def show(
        self,
        poses: Mapping[str, FloatArray],
        nodes_m: Mapping[str, FloatArray],
        overlay: Overlay | None = None,
    ) -> None:
        """Draw the scene in the window, at most as often as there are frames; the arguments are those of `picture`."""
        window = self._window
        assert window is not None

        def draw() -> None:
            self._update(poses, nodes_m, overlay)
            if overlay is not None:
                _add_overlay(self._drawing, self._model, overlay, pixel_m=self._pixel_m)
            viewport = mujoco.MjrRect(0, 0, *window.size)
            mujoco.mjr_render(viewport, self._drawing, self._device)

        window.show(draw, interval_s=1.0 / FRAME_RATE_HZ)

    def _update(
        self,
        poses: Mapping[str, FloatArray],
        nodes_m: Mapping[str, FloatArray],
        overlay: Overlay | None,
    ) -> None:
        """Bring the drawing to poses and nodes, with room for an overlay."""
        for name, pose in poses.items():
            index = self._mocap_ids[name]
            self._data.mocap_pos[index] = pose[:3]
            self._data.mocap_quat[index] = pose[3:]
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        extra = 0 if overlay is None else _overlay_geom_count(self._model, overlay)
        if self._own_geoms + extra > self._drawing.maxgeom:
            self._drawing = self._drawing_of(self._own_geoms + 2 * extra)
        self._context.make_current()
        for skin in self._skins:
            skin.upload(self._model, self._device, nodes_m[skin.name])
        mujoco.mjv_updateScene(
            self._model,
            self._data,
            self._option,
            None,
            self._free_camera,
            mujoco.mjtCatBit.mjCAT_ALL,
            self._drawing,
        )
        self._add_lines(nodes_m)

    def _with_overlay(
        self, picture: NDArray[np.uint8], overlay: Overlay
    ) -> NDArray[np.uint8]:
        """Return a picture with an overlay.

        MuJoCo lets all that it draws cast shadows. An overlay must cast none, so its pixels are those that it changes
        in a picture without shadows.
        """
        shadow = mujoco.mjtRndFlag.mjRND_SHADOW
        had_shadows, self._drawing.flags[shadow] = self._drawing.flags[shadow], 0
        bare = self._rendered()
        _add_overlay(self._drawing, self._model, overlay, pixel_m=self._pixel_m)
        marked = self._rendered()
        self._drawing.flags[shadow] = had_shadows
        # Software rasterizers round a pixel now and then by one level.
        touched = (np.abs(marked.astype(np.int16) - bare) > 1).any(
            axis=2, keepdims=True
        )
        return np.where(touched, marked, picture)

    def _rendered(self) -> NDArray[np.uint8]:
        pixels = np.empty(
            (self._viewport.height, self._viewport.width, 3), dtype=np.uint8
        )
        mujoco.mjr_render(self._viewport, self._drawing, self._device)
        mujoco.mjr_readPixels(pixels, None, self._viewport, self._device)
        return np.ascontiguousarray(pixels[::-1])

    def _add_lines(self, nodes_m: Mapping[str, FloatArray]) -> None:
        """Add strings, ropes and rods; far ones are drawn thicker than they are, so that they stay visible."""
        radius_m = self._least_radius_m
        for joint in self._scene.joints:
            end = self._data.mocap_pos[self._mocap_ids[joint.body]]
            _add_tube(
                self._drawing,
                np.asarray(joint.anchor_m),
                end,
                radius_m=radius_m,
                color=STRING.color,
            )
        for line in self._lines:
            radius_m = max(line.radius_m, self._least_radius_m)
            for start, end in pairwise(nodes_m[line.name]):
                _add_tube(
                    self._drawing,
                    start,
                    end,
                    radius_m=radius_m,
                    color=self._looks[line.name].color,
                )

    def _drawing_of(self, geom_count: int) -> mujoco.MjvScene:
        """Return an empty drawing with room for a number of shapes."""
        return mujoco.MjvScene(self._model, maxgeom=geom_count)

    def close(self) -> None:
        """Free the OpenGL context."""
        self._device.free()
        self._context.free()


# --- what is drawn after the bodies ---


def _add_tube(
    drawing: mujoco.MjvScene,
    start: FloatArray,
    end: FloatArray,
    *,
    radius_m: float,
    color: Color,
) -> None:
    """Add a straight tube with round ends between two points [m], shape [3] each."""
    kind = mujoco.mjtGeom.mjGEOM_CAPSULE
    geom = _next_geom(drawing)
    mujoco.mjv_initGeom(
        geom,
        kind,
        np.zeros(3),
        np.zeros(3),
        np.eye(3).ravel(),
        np.array(color, dtype=np.float32),
    )
    mujoco.mjv_connector(geom, kind, radius_m, start, end)


def _add_ball(
    drawing: mujoco.MjvScene, centre: FloatArray, *, radius_m: float, color: Color
) -> None:
    """Add a ball around a point [m], shape [3]."""
    kind = mujoco.mjtGeom.mjGEOM_SPHERE
    geom = _next_geom(drawing)
    size = np.full(3, radius_m)
    mujoco.mjv_initGeom(
        geom, kind, size, centre, np.eye(3).ravel(), np.array(color, dtype=np.float32)
    )
    # Light of its own keeps the colour of a small ball readable in the shade.
    geom.emission = 0.4


def _overlay_geom_count(model: mujoco.MjModel, overlay: Overlay) -> int:
    """Return the number of shapes of an overlay."""
    return overlay.geom_count + sum(
        int(model.body(_known(model, name)).geomnum[0]) for name in overlay.ghosts
    )


def _add_overlay(
    drawing: mujoco.MjvScene, model: mujoco.MjModel, overlay: Overlay, *, pixel_m: float
) -> None:
    """Add an overlay to a drawing that has room for `_overlay_geom_count` more shapes.

    Args:
        drawing: The drawing.
        model: Model of the bodies.
        overlay: The overlay.
        pixel_m: Size of a pixel in the middle of the scene [m]. Balls and tubes have the same size in pixels there,
            whatever the size of the scene.
    """
    for points, color, radius_px in (
        (overlay.recorded_m, RECORDED_COLOR, RECORDED_MARKER_PX),
        (overlay.markers_m, SIMULATED_COLOR, MARKER_PX),
    ):
        for point in points[np.isfinite(points).all(axis=1)]:
            _add_ball(drawing, point, radius_m=radius_px * pixel_m, color=color)
    for paths, color, radius_px in (
        (overlay.paths, SIMULATED_COLOR, PATH_PX),
        (overlay.recorded_paths, RECORDED_COLOR, RECORDED_PATH_PX),
    ):
        for start, end in (pair for path in paths for pair in pairwise(path)):
            if np.isfinite([start, end]).all():
                _add_tube(
                    drawing, start, end, radius_m=radius_px * pixel_m, color=color
                )
                drawing.geoms[drawing.ngeom - 1].emission = 0.4
    for name, pose in overlay.ghosts.items():
        if np.isfinite(pose).all():
            ahead = GHOST_AHEAD_PX * pixel_m * _to_camera(drawing, pose[:3])
            _add_ghost(
                drawing, model, name, np.concatenate([pose[:3] + ahead, pose[3:]])
            )


def _to_camera(drawing: mujoco.MjvScene, point_m: FloatArray) -> FloatArray:
    """Return the unit vector from a point [m] to the camera of a drawing, shape [3]."""
    # A drawing has a camera for each eye; a picture is taken from between them.
    left, right = drawing.camera
    way = (
        -left.forward.astype(np.float64)
        if left.orthographic
        else 0.5 * (left.pos + right.pos) - point_m
    )
    return way / np.linalg.norm(way)


def _add_ghost(
    drawing: mujoco.MjvScene, model: mujoco.MjModel, name: str, pose: FloatArray
) -> None:
    turn = Rotation.from_quat(pose[3:], scalar_first=True)
    body = model.body(_known(model, name))
    for index in range(int(body.geomadr[0]), int(body.geomadr[0] + body.geomnum[0])):
        place = pose[:3] + turn.apply(model.geom_pos[index])
        axes = (
            turn * Rotation.from_quat(model.geom_quat[index], scalar_first=True)
        ).as_matrix()
        geom = _next_geom(drawing)
        kind = mujoco.mjtGeom(int(model.geom_type[index]))
        rgba = np.array((*RECORDED_COLOR[:3], GHOST_OPACITY), dtype=np.float32)
        mujoco.mjv_initGeom(
            geom, kind, model.geom_size[index], place, axes.ravel(), rgba
        )
        if kind == mujoco.mjtGeom.mjGEOM_MESH:
            # A drawing numbers each mesh twice: as itself, then as its convex hull.
            geom.dataid = 2 * int(model.geom_dataid[index])


def _known(model: mujoco.MjModel, name: str) -> str:
    names = [model.body(index).name for index in range(1, model.nbody)]
    if name not in names:
        raise UnknownNameError("body", name, names)
    return name


def _next_geom(drawing: mujoco.MjvScene) -> mujoco.MjvGeom:
    geom = drawing.geoms[drawing.ngeom]
    drawing.ngeom += 1
    return geom
