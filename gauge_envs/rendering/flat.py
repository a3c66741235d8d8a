"""The parallel projection of scenes for films that are measured: even light, a still backdrop, plain colours."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.backends.mujoco.model import add_geoms
from gauge_envs.rendering.camera import scene_view
from gauge_envs.rendering.materials import USUAL
from gauge_envs.rendering.overlay import Color
from gauge_envs.rendering.skin import Skin
from gauge_envs.rendering.studio import material_textures
from gauge_envs.scene import Motion, Plane, Scene

FIELD_OF_VIEW_DEG = 40.0
"""Field of view of the camera that the projection replaces [deg]."""
BACKDROP_M = 2.0
"""Distance of the backdrop and of the camera of a parallel projection from the middle of the scene [m]."""
BACKDROP_TEXELS = 512


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
    colors: Mapping[str, Color] = field(default_factory=dict)
    grain: frozenset[str] = frozenset()

    @property
    def forward(self) -> NDArray[np.float64]:
        """Unit vector into the picture, shape [3]."""
        return np.cross(self.right, self.down)

    def aim(self, drawing: mujoco.MjvScene, *, width: int, height: int) -> None:
        """Replace the camera of a drawing by the projection, for a picture of a size [pixels]."""
        for camera in drawing.camera:
            camera.pos[:] = self.centre_m - BACKDROP_M * self.forward
            camera.forward[:] = self.forward
            camera.up[:] = -self.down
            camera.orthographic = 1
            camera.frustum_center = 0.0
            camera.frustum_width = 0.5 * width * self.scale_m_per_px
            camera.frustum_top = 0.5 * height * self.scale_m_per_px
            camera.frustum_bottom = -camera.frustum_top
            camera.frustum_near = 0.01 * BACKDROP_M
            camera.frustum_far = 3.0 * BACKDROP_M


def flat_model(
    scene: Scene, skins: Sequence[Skin], width: int, height: int, view: FlatView
) -> mujoco.MjModel:
    """Return a model of shapes without physics for a parallel projection: every body is a mocap body.

    Args:
        scene: The scene.
        skins: Surfaces of its deformable bodies.
        width: Picture width [pixels].
        height: Picture height [pixels].
        view: The projection.
    """
    spec = mujoco.MjSpec()
    spec.visual.global_.offwidth = width
    spec.visual.global_.offheight = height
    spec.visual.global_.fovy = FIELD_OF_VIEW_DEG
    # A parallel projection has even light, so that a colour does not depend on where a body is.
    spec.visual.headlight.ambient = [0.9] * 3
    spec.visual.headlight.diffuse = [0.1] * 3
    spec.visual.headlight.specular = [0.0] * 3
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
    textures = material_textures("table")
    # One checker square is 25 mm, the hole pitch of the real optical table.
    spec.add_material(
        name="table",
        textures=textures,
        texrepeat=[40, 40],
        texuniform=True,
        reflectance=0.0,
    )
    for body in scene.bodies:
        frame = spec.worldbody.add_body(
            name=body.name,
            pos=body.pose.position_m,
            quat=body.pose.quaternion,
            mocap=True,
        )
        for geom in add_geoms(spec, frame, body.name, body.shape):
            if isinstance(body.shape, Plane):
                geom.material = "table"
                geom.size = [0.0, 0.0, 0.05]
            else:
                geom.rgba = USUAL[body.motion].color
            if body.name in view.colors:
                geom.rgba = view.colors[body.name]
            if body.name in view.grain:
                geom.material = "grain"
    _add_backdrop(spec, view, width, height)
    for skin in skins:
        skin.add(spec, USUAL[Motion.DYNAMIC])
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
        cycles = np.hypot(
            np.fft.fftfreq(BACKDROP_TEXELS)[:, None],
            np.fft.rfftfreq(BACKDROP_TEXELS)[None, :],
        )
        smooth = np.fft.irfft2(
            spectrum * np.exp(-0.5 * (2.0 * np.pi * cycles * blur) ** 2)
        )
        grey = np.clip(
            brightness + contrast * smooth / smooth.std(), 0.0, 255.0
        ).astype(np.uint8)
        texture = spec.add_texture(
            name=name,
            type=kind,
            width=BACKDROP_TEXELS,
            height=BACKDROP_TEXELS,
            nchannel=3,
        )
        texture.data = np.repeat(grey[:, :, None], 3, axis=2).tobytes()
        spec.add_material(
            name=name,
            textures=material_textures(name),
            texrepeat=[1, 1],
            specular=0.0,
            reflectance=0.0,
        )
    plane = spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, name="backdrop")
    half = 0.55 * view.scale_m_per_px * np.array([width, height])
    plane.size = [*half, 1.0]
    plane.material = "backdrop"
    plane.pos = view.centre_m + BACKDROP_M * view.forward
    axes = np.column_stack([view.right, -view.down, -view.forward])
    plane.quat = Rotation.from_matrix(axes).as_quat(scalar_first=True)


def light_camera(scene: Scene) -> mujoco.MjvCamera:
    """Return the camera whose headlight shines on a film; the projection replaces its view, but not its light."""
    return scene_view(scene, field_of_view_deg=FIELD_OF_VIEW_DEG).mujoco_camera()
