"""The renderer of a scene: one for all engines, from poses and nodes, without a display."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from ctypes.util import find_library
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.backends.mujoco.model import add_geoms
from gauge_envs.envs.rendering.decor import add_overlay, add_tube, overlay_geom_count
from gauge_envs.envs.rendering.overlay import Overlay
from gauge_envs.envs.rendering.skin import Skin
from gauge_envs.errors import RenderError
from gauge_envs.scene import Box, Cloth, Deformable, Hinge, Motion, Plane, Rod, Rope, Scene, SoftBody

__all__ = [
    "COLORS",
    "FIELD_OF_VIEW_DEG",
    "STRING_RADIUS_M",
    "FlatView",
    "SceneRenderer",
    "scene_camera",
]

COLORS = {
    Motion.DYNAMIC: (0.90, 0.52, 0.17, 1.0),
    Motion.KINEMATIC: (0.30, 0.50, 0.75, 1.0),
    Motion.FIXED: (0.72, 0.66, 0.56, 1.0),
}
"""Colours of bodies: red, green, blue and opacity from 0 to 1."""
STRING_COLOR = (0.25, 0.25, 0.25, 1.0)
STRING_RADIUS_M = 0.0015
"""Radius of a string in pictures [m]."""
ELEVATION_DEG = -18.0
AZIMUTH_DEG = 125.0
FIELD_OF_VIEW_DEG = 40.0
"""Vertical field of view of the camera [deg]."""
FLOOR_IN_VIEW_M = 0.6
"""Largest distance of the floor below all bodies at which the picture shows it [m]."""

BACKDROP_M = 2.0
"""Distance of the backdrop and of the camera of a parallel projection from the middle of the scene [m]."""
BACKDROP_TEXELS = 512

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


@dataclass(frozen=True, kw_only=True)
class FlatView:
    """Parallel projection of a scene, before a still backdrop: lengths in the picture do not depend on the depth.

    Attributes:
        centre_m: World point in the middle of the picture [m], shape [3].
        right: Unit vector to the right of the picture, shape [3].
        down: Unit vector down the picture, shape [3].
        scale_m_per_px: Size of a pixel [m].
        colors: Colour of bodies by name, red, green, blue and opacity from 0 to 1; others have their usual colour.
        grain: Names of bodies with a grain on their surface.
    """

    centre_m: NDArray[np.float64]
    right: NDArray[np.float64]
    down: NDArray[np.float64]
    scale_m_per_px: float
    colors: Mapping[str, tuple[float, float, float, float]] = field(default_factory=dict)
    grain: frozenset[str] = frozenset()

    @property
    def forward(self) -> NDArray[np.float64]:
        """Unit vector into the picture, shape [3]."""
        return np.cross(self.right, self.down)


class SceneRenderer:
    """Renderer of a scene from poses and nodes, without physics.

    Args:
        scene: The scene.
        rest_nodes_m: For each deformable body its nodes at the start [m], shape [node_count, 3].
        width: Picture width [pixels].
        height: Picture height [pixels].
        view: Parallel projection; None for a camera that sees the whole experiment.

    Raises:
        RenderError: The machine has no OpenGL library; the message names the packages.
    """

    def __init__(
        self,
        scene: Scene,
        rest_nodes_m: Mapping[str, NDArray[np.float64]],
        width: int,
        height: int,
        *,
        view: FlatView | None = None,
    ) -> None:
        self._context = _graphics_context(width, height)
        self._scene = scene
        self._viewport = mujoco.MjrRect(0, 0, width, height)
        self._skins = [
            Skin(body, rest_nodes_m[body.name]) for body in scene.deformables if isinstance(body, Cloth | SoftBody)
        ]
        self._lines = [body for body in scene.deformables if isinstance(body, Rope | Rod)]
        self._view = view
        self._model = _visual_model(scene, self._skins, width, height, view)
        self._data = mujoco.MjData(self._model)
        self._mocap_ids = {body.name: int(self._model.body(body.name).mocapid[0]) for body in scene.bodies}
        self._option = mujoco.MjvOption()
        segments = sum(len(rest_nodes_m[line.name]) for line in self._lines)
        self._own_geoms = self._model.ngeom + len(scene.joints) + segments + 100
        self._drawing = self._drawing_of(self._own_geoms)
        self._camera = scene_camera(scene)
        # Height of a pixel in the middle of the scene.
        half_height_m = self._camera.distance * np.tan(np.radians(0.5 * FIELD_OF_VIEW_DEG))
        self._pixel_m = 2.0 * half_height_m / height if view is None else view.scale_m_per_px
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

        Raises:
            UnknownNameError: The overlay has a ghost of a body that the scene does not have.
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
            self._model, self._data, self._option, None, self._camera, mujoco.mjtCatBit.mjCAT_ALL, self._drawing
        )
        for joint in self._scene.joints:
            end = self._data.mocap_pos[self._mocap_ids[joint.body]]
            add_tube(self._drawing, np.asarray(joint.anchor_m), end, radius_m=STRING_RADIUS_M, color=STRING_COLOR)
        for line in self._lines:
            for start, end in pairwise(nodes_m[line.name]):
                add_tube(self._drawing, start, end, radius_m=line.radius_m, color=COLORS[Motion.DYNAMIC])
        if overlay is not None:
            add_overlay(self._drawing, self._model, overlay, pixel_m=self._pixel_m)
        if self._view is not None:
            self._look_along(self._view)
        pixels = np.empty((self._viewport.height, self._viewport.width, 3), dtype=np.uint8)
        mujoco.mjr_render(self._viewport, self._drawing, self._device)
        mujoco.mjr_readPixels(pixels, None, self._viewport, self._device)
        return np.ascontiguousarray(pixels[::-1])

    def _drawing_of(self, geom_count: int) -> mujoco.MjvScene:
        """Return an empty drawing with room for a number of shapes."""
        drawing = mujoco.MjvScene(self._model, maxgeom=geom_count)
        drawing.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
        if self._view is not None:
            drawing.flags[mujoco.mjtRndFlag.mjRND_HAZE] = 0
        return drawing

    def _look_along(self, view: FlatView) -> None:
        """Replace the camera of the drawing by a parallel projection."""
        for camera in self._drawing.camera:
            camera.pos[:] = view.centre_m - BACKDROP_M * view.forward
            camera.forward[:] = view.forward
            camera.up[:] = -view.down
            camera.orthographic = 1
            camera.frustum_center = 0.0
            camera.frustum_width = 0.5 * self._viewport.width * view.scale_m_per_px
            camera.frustum_top = 0.5 * self._viewport.height * view.scale_m_per_px
            camera.frustum_bottom = -camera.frustum_top
            camera.frustum_near = 0.01 * BACKDROP_M
            camera.frustum_far = 3.0 * BACKDROP_M

    def close(self) -> None:
        """Free the OpenGL context."""
        self._device.free()
        self._context.free()


def _visual_model(
    scene: Scene, skins: Sequence[Skin], width: int, height: int, view: FlatView | None
) -> mujoco.MjModel:
    """Return a model of shapes without physics: every body is a mocap body."""
    spec = mujoco.MjSpec()
    spec.visual.global_.offwidth = width
    spec.visual.global_.offheight = height
    spec.visual.global_.fovy = FIELD_OF_VIEW_DEG
    # A parallel projection has even light, so that a colour does not depend on where a body is.
    spec.visual.headlight.ambient = [0.45 if view is None else 0.9] * 3
    spec.visual.headlight.diffuse = [0.45 if view is None else 0.1] * 3
    spec.visual.headlight.specular = [0.1 if view is None else 0.0] * 3
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.95, 0.96, 0.98],
        rgb2=[0.72, 0.76, 0.82],
        width=64,
        height=64,
    )
    spec.add_texture(
        name="table",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=[0.33, 0.35, 0.38],
        rgb2=[0.38, 0.40, 0.43],
        width=256,
        height=256,
    )
    textures = [""] * mujoco.mjtTextureRole.mjNTEXROLE
    textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "table"
    # One checker square is 25 mm, the hole pitch of the real optical table.
    spec.add_material(name="table", textures=textures, texrepeat=[40, 40], texuniform=True, reflectance=0.0)
    if view is None:
        direction = [0.2, 0.5, -1.0]
        spec.worldbody.add_light(pos=[0.0, -1.0, 2.5], dir=direction, type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)
    for body in scene.bodies:
        frame = spec.worldbody.add_body(name=body.name, pos=body.pose.position_m, quat=body.pose.quaternion, mocap=True)
        for geom in add_geoms(spec, frame, body.name, body.shape):
            if isinstance(body.shape, Plane):
                geom.material = "table"
                geom.size = [0.0, 0.0, 0.05]
            else:
                geom.rgba = COLORS[body.motion]
            if view is not None and body.name in view.colors:
                geom.rgba = view.colors[body.name]
            if view is not None and body.name in view.grain:
                geom.material = "grain"
    if view is not None:
        _add_backdrop(spec, view, width, height)
    for skin in skins:
        skin.add(spec, COLORS[Motion.DYNAMIC])
    model = spec.compile()
    for skin in skins:
        skin.place(model)
    return model


def _add_backdrop(spec: mujoco.MjSpec, view: FlatView, width: int, height: int) -> None:
    """Add a still plane with spots behind the scene, which fills the picture, and the material of grained bodies."""
    for name, kind, brightness, contrast, blur in (
        ("backdrop", mujoco.mjtTexture.mjTEXTURE_2D, 205.0, 14.0, 3),
        ("grain", mujoco.mjtTexture.mjTEXTURE_2D, 205.0, 30.0, 2),
    ):
        spots = np.random.default_rng(0).normal(size=(BACKDROP_TEXELS, BACKDROP_TEXELS))
        spectrum = np.fft.rfft2(spots)
        cycles = np.hypot(np.fft.fftfreq(BACKDROP_TEXELS)[:, None], np.fft.rfftfreq(BACKDROP_TEXELS)[None, :])
        smooth = np.fft.irfft2(spectrum * np.exp(-0.5 * (2.0 * np.pi * cycles * blur) ** 2))
        grey = np.clip(brightness + contrast * smooth / smooth.std(), 0.0, 255.0).astype(np.uint8)
        texture = spec.add_texture(name=name, type=kind, width=BACKDROP_TEXELS, height=BACKDROP_TEXELS, nchannel=3)
        texture.data = np.repeat(grey[:, :, None], 3, axis=2).tobytes()
        textures = [""] * mujoco.mjtTextureRole.mjNTEXROLE
        textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
        spec.add_material(name=name, textures=textures, texrepeat=[1, 1], specular=0.0, reflectance=0.0)
    plane = spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, name="backdrop")
    half = 0.55 * view.scale_m_per_px * np.array([width, height])
    plane.size = [*half, 1.0]
    plane.material = "backdrop"
    plane.pos = view.centre_m + BACKDROP_M * view.forward
    axes = np.column_stack([view.right, -view.down, -view.forward])
    plane.quat = Rotation.from_matrix(axes).as_quat(scalar_first=True)


def scene_camera(scene: Scene) -> mujoco.MjvCamera:
    """Return a camera that sees the bodies at the start and their reach: driven motion, swings, and a floor below."""
    points = [body.pose.to_world(body.shape.corners_m) for body in scene.bodies if not isinstance(body.shape, Plane)]
    points += [body.pose.to_world(_outline_m(body)) for body in scene.deformables]
    for driver in scene.drivers:
        start = scene.body(driver.body).pose
        away = np.subtract(driver.pose(start, scene.duration_s).position_m, start.position_m)
        carried = {a.deformable for a in scene.attachments if a.to == driver.body}
        points.append(start.to_world(scene.body(driver.body).shape.corners_m) + away)
        points += [body.pose.to_world(_outline_m(body)) + away for body in scene.deformables if body.name in carried]
    azimuth_deg = AZIMUTH_DEG
    for joint in scene.joints:
        anchor = np.asarray(joint.anchor_m)
        arm = np.linalg.norm(anchor - scene.body(joint.body).pose.position_m)
        axis = np.asarray(joint.axis if isinstance(joint, Hinge) else (0.0, 1.0, 0.0))
        sideways = np.cross(axis, (0.0, 0.0, 1.0))
        points.append(anchor + arm * np.array([sideways, -sideways, (0.0, 0.0, -1.0), (0.0, 0.0, 0.0)]))
        # The view is nearly along the axis, so that the swing is seen face on.
        azimuth_deg = float(np.degrees(np.arctan2(axis[1], axis[0]))) + 20.0
    corners = np.concatenate(points) if points else np.zeros((1, 3))
    low, high = corners.min(axis=0), corners.max(axis=0)
    hanging = {joint.body for joint in scene.joints}
    falls = any(body.name not in hanging for body in scene.dynamic_bodies)
    if falls and low[2] - scene.floor_height_m < FLOOR_IN_VIEW_M:
        low[2] = min(low[2], scene.floor_height_m)
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.lookat[:] = 0.5 * (low + high)
    radius = 0.5 * float(np.linalg.norm(high - low))
    camera.distance = 1.25 * radius / np.sin(np.radians(0.5 * FIELD_OF_VIEW_DEG))
    camera.azimuth, camera.elevation = azimuth_deg, ELEVATION_DEG
    return camera


def _outline_m(body: Deformable) -> NDArray[np.float64]:
    """Return the corners of a deformable body in its own frame [m], shape [8, 3]."""
    if isinstance(body, SoftBody):
        return body.shape.corners_m
    if isinstance(body, Cloth):
        return Box(size_m=(*body.size_m, 0.0)).corners_m
    return Box(size_m=(body.length_m, 0.0, 0.0) if isinstance(body, Rope) else (0.0, 0.0, body.length_m)).corners_m
