"""The renderer of a scene: one for all engines, from poses and nodes, without a display."""

from __future__ import annotations

import os
from collections.abc import Mapping
from ctypes.util import find_library
from itertools import pairwise
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from gauge_envs.envs.rendering.camera import FIELD_OF_VIEW_DEG, View, scene_view
from gauge_envs.envs.rendering.decor import add_overlay, add_tube, overlay_geom_count
from gauge_envs.envs.rendering.flat import FlatView, flat_model, light_camera
from gauge_envs.envs.rendering.materials import STRING, look_of
from gauge_envs.envs.rendering.overlay import Overlay
from gauge_envs.envs.rendering.skin import Skin
from gauge_envs.envs.rendering.studio import Studio
from gauge_envs.errors import RenderError
from gauge_envs.scene import Cloth, Rod, Rope, Scene, SoftBody

STRING_RADIUS_M = 0.0015
"""Radius of a string in pictures [m]."""
STRING_PX = 1.1
"""Smallest radius of strings and ropes in pictures of a perspective camera [pixels]."""

DEBIAN_PACKAGES = "libegl1 libegl-mesa0 libgl1-mesa-dri libgl1 libopengl0"


def _graphics_context(width: int, height: int) -> Any:
    """Return an off-screen OpenGL context: that of MUJOCO_GL, or else EGL or OSMesa, whichever is installed."""
    wanted = os.environ.get("MUJOCO_GL", "").lower()
    if not wanted:
        wanted = "egl" if find_library("EGL") else "osmesa" if find_library("OSMesa") else ""
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
        view: Perspective camera, or a parallel projection; None for a camera that frames the expected action.
        materials: Material of bodies by name, as `wood`; others have colours by how they move. A parallel projection
            states its own colours.

    Attributes:
        camera: The perspective camera; None for a parallel projection.
    """

    def __init__(
        self,
        scene: Scene,
        rest_nodes_m: Mapping[str, NDArray[np.float64]],
        width: int,
        height: int,
        *,
        view: View | FlatView | None = None,
        materials: Mapping[str, str] | None = None,
    ) -> None:
        self._context = _graphics_context(width, height)
        self._scene = scene
        self._viewport = mujoco.MjrRect(0, 0, width, height)
        self._skins = [
            Skin(body, rest_nodes_m[body.name]) for body in scene.deformables if isinstance(body, Cloth | SoftBody)
        ]
        self._lines = [body for body in scene.deformables if isinstance(body, Rope | Rod)]
        self._looks = {body.name: look_of(body, (materials or {}).get(body.name)) for body in self._lines}
        self._flat = view if isinstance(view, FlatView) else None
        self.camera: View | None = None
        if isinstance(view, FlatView):
            self._model = flat_model(scene, self._skins, width, height, view)
            self._pixel_m, self._least_radius_m = view.scale_m_per_px, 0.0
        else:
            self.camera = view or scene_view(scene, aspect=width / height)
            studio = Studio(
                scene=scene,
                skins=self._skins,
                rest_nodes_m=rest_nodes_m,
                materials=materials or {},
                view=self.camera,
            )
            self._model = studio.model(width, height)
            # Size of a pixel in the middle of the scene.
            self._pixel_m = 2.0 * self.camera.distance_m * np.tan(np.radians(0.5 * FIELD_OF_VIEW_DEG)) / height
            self._least_radius_m = STRING_PX * self._pixel_m
        self._free_camera = light_camera(scene) if self.camera is None else self.camera.mujoco_camera()
        self._data = mujoco.MjData(self._model)
        self._mocap_ids = {body.name: int(self._model.body(body.name).mocapid[0]) for body in scene.bodies}
        self._option = mujoco.MjvOption()
        segments = sum(len(rest_nodes_m[line.name]) for line in self._lines)
        self._own_geoms = self._model.ngeom + len(scene.joints) + segments + 100
        self._drawing = self._drawing_of(self._own_geoms)
        self._device = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._device)

    def picture(
        self,
        poses: Mapping[str, NDArray[np.float64]],
        nodes_m: Mapping[str, NDArray[np.float64]],
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
        for name, pose in poses.items():
            index = self._mocap_ids[name]
            self._data.mocap_pos[index] = pose[:3]
            self._data.mocap_quat[index] = pose[3:]
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        extra = 0 if overlay is None else overlay_geom_count(self._model, overlay)
        if self._own_geoms + extra > self._drawing.maxgeom:
            self._drawing = self._drawing_of(self._own_geoms + 2 * extra)
        self._context.make_current()
        for skin in self._skins:
            skin.upload(self._model, self._device, nodes_m[skin.name])
        mujoco.mjv_updateScene(
            self._model, self._data, self._option, None, self._free_camera, mujoco.mjtCatBit.mjCAT_ALL, self._drawing
        )
        self._add_lines(nodes_m)
        if self._flat is not None:
            self._flat.aim(self._drawing, width=self._viewport.width, height=self._viewport.height)
        picture = self._rendered()
        return picture if overlay is None else self._with_overlay(picture, overlay)

    def _with_overlay(self, picture: NDArray[np.uint8], overlay: Overlay) -> NDArray[np.uint8]:
        """Return a picture with an overlay.

        MuJoCo lets all that it draws cast shadows. An overlay must cast none, so its pixels are those that it changes
        in a picture without shadows.
        """
        shadow = mujoco.mjtRndFlag.mjRND_SHADOW
        had_shadows, self._drawing.flags[shadow] = self._drawing.flags[shadow], 0
        bare = self._rendered()
        add_overlay(self._drawing, self._model, overlay, pixel_m=self._pixel_m)
        marked = self._rendered()
        self._drawing.flags[shadow] = had_shadows
        # Software rasterizers round a pixel now and then by one level.
        touched = (np.abs(marked.astype(np.int16) - bare) > 1).any(axis=2, keepdims=True)
        return np.where(touched, marked, picture)

    def _rendered(self) -> NDArray[np.uint8]:
        pixels = np.empty((self._viewport.height, self._viewport.width, 3), dtype=np.uint8)
        mujoco.mjr_render(self._viewport, self._drawing, self._device)
        mujoco.mjr_readPixels(pixels, None, self._viewport, self._device)
        return np.ascontiguousarray(pixels[::-1])

    def _add_lines(self, nodes_m: Mapping[str, NDArray[np.float64]]) -> None:
        """Add strings, ropes and rods; far ones are drawn thicker than they are, so that they stay visible."""
        radius_m = max(STRING_RADIUS_M if self._flat is not None else 0.0, self._least_radius_m)
        for joint in self._scene.joints:
            end = self._data.mocap_pos[self._mocap_ids[joint.body]]
            add_tube(self._drawing, np.asarray(joint.anchor_m), end, radius_m=radius_m, color=STRING.color)
        for line in self._lines:
            radius_m = max(line.radius_m, self._least_radius_m)
            for start, end in pairwise(nodes_m[line.name]):
                add_tube(self._drawing, start, end, radius_m=radius_m, color=self._looks[line.name].color)

    def _drawing_of(self, geom_count: int) -> mujoco.MjvScene:
        """Return an empty drawing with room for a number of shapes."""
        drawing = mujoco.MjvScene(self._model, maxgeom=geom_count)
        if self._flat is not None:
            drawing.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
            drawing.flags[mujoco.mjtRndFlag.mjRND_HAZE] = 0
        return drawing

    def close(self) -> None:
        """Free the OpenGL context."""
        self._device.free()
        self._context.free()
