"""The look of pictures: light ground with a fine grid, soft light, and the colours of the materials."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import mujoco
import numpy as np

from gauge_envs.backends.mujoco.model import add_geoms
from gauge_envs.rendering.camera import FIELD_OF_VIEW_DEG, View
from gauge_envs.rendering.materials import Look, look_of
from gauge_envs.rendering.skin import Skin
from gauge_envs.scene import (
    Attachment,
    Box,
    Cylinder,
    Motion,
    Plane,
    RigidBody,
    Scene,
    SoftBody,
)
from gauge_envs.scene.geometry import FloatArray

GRID_PITCHES_M = (0.025, 0.1)
"""Pitch of the grid on the ground [m]: the hole pitch of the real optical table, and a coarser one for wide views."""
WIDE_VIEW_M = 0.5
"""Height of the view in the middle of the scene from which the grid is coarse [m]."""

GROUND = (0.925, 0.93, 0.94)
"""Colour of ground and background."""
GRID_LINE = (0.83, 0.845, 0.865)
TEXELS = 256
LINE_TEXELS = 5
"""Width of a line of the grid, of `TEXELS` for a pitch."""
GRAIN_TEXELS = 128
MOST_GRAINED = 40
"""Largest number of bodies of a scene in which wood has a grain."""
STILL = 0.84
"""Brightness of still and driven bodies, relative to free ones of the same material, from which they stay apart."""

AMBIENT, KEY, FILL = 0.54, 0.30, 0.30
"""Brightness of even light, key lights together, and fill light."""
KEY_DIRECTIONS = ((0.6, 0.2),)
"""Parts of each key light to the right of the camera and away from it; the part down is 1.3."""

SHADOW_TEXELS_PER_PIXEL = 2.4
"""Width of the shadow map, relative to the longer side of the picture: small pictures do not pay for a large map."""
SHADOW_TEXELS = (256, 4096)
"""Smallest and largest width of the shadow map."""
SAMPLES = 4
"""Samples of each pixel; software rendering has no more."""


def grid_pitch_m(view: View) -> float:
    """Return the pitch of the grid on the ground [m]: 25 mm, or 100 mm in wide views."""
    height_m = 2.0 * view.distance_m * np.tan(np.radians(0.5 * FIELD_OF_VIEW_DEG))
    return GRID_PITCHES_M[int(height_m > WIDE_VIEW_M)]


def studio_model(
    scene: Scene,
    skins: Sequence[Skin],
    rest_nodes_m: Mapping[str, FloatArray],
    materials: Mapping[str, str],
    view: View,
    width: int,
    height: int,
) -> mujoco.MjModel:
    """Return a model of shapes without physics: every body is a mocap body.

    Args:
        scene: The scene.
        skins: Surfaces of its deformable bodies.
        rest_nodes_m: For each deformable body its nodes at the start [m], shape [node_count, 3].
        materials: Material of bodies by name.
        view: Where the camera is.
        width: Picture width [pixels].
        height: Picture height [pixels].
    """
    spec = mujoco.MjSpec()
    _set_quality(spec, view, width, height)
    _add_light(spec, view)
    _add_ground(spec, view)
    for body in scene.bodies:
        _add_body(spec, scene, body, look_of(body, materials.get(body.name)))
    soft = {one.name: one for one in scene.deformables}
    for skin in skins:
        look = look_of(soft[skin.name], materials.get(skin.name))
        skin.add(spec, look, _material(spec, look))
    for attachment in scene.attachments:
        block = soft.get(attachment.deformable)
        if isinstance(block, SoftBody):
            look = look_of(block, materials.get(block.name))
            _add_gripped(spec, scene, attachment, block, rest_nodes_m[block.name], look)
    model = spec.compile()
    for skin in skins:
        skin.place(model)
    return model


def _add_body(spec: mujoco.MjSpec, scene: Scene, body: RigidBody, look: Look) -> None:
    frame = spec.worldbody.add_body(
        name=body.name, pos=body.pose.position_m, quat=body.pose.quaternion, mocap=True
    )
    if not isinstance(body.shape, Box | Cylinder) or len(scene.bodies) > MOST_GRAINED:
        # The grain of a mesh radiates from its middle, which looks like no wood; on many bodies it costs time.
        look = replace(look, has_grain=False)
    if body.motion is not Motion.DYNAMIC:
        red, green, blue, opacity = look.color
        look = replace(look, color=(STILL * red, STILL * green, STILL * blue, opacity))
    material = "ground" if isinstance(body.shape, Plane) else _material(spec, look)
    for geom in add_geoms(spec, frame, body.name, body.shape):
        geom.material = material
        if isinstance(body.shape, Plane):
            geom.size = [0.0, 0.0, 0.05]
        else:
            geom.rgba = look.color


def _add_gripped(
    spec: mujoco.MjSpec,
    scene: Scene,
    attachment: Attachment,
    block: SoftBody,
    rest_m: FloatArray,
    look: Look,
) -> None:
    """Add the material of a block in a grip to the body that holds it.

    Engines may leave it out of the nodes, because it moves rigidly.
    """
    holder = next((body for body in scene.bodies if body.name == attachment.to), None)
    if holder is None:
        return
    nodes, axis = block.pose.to_body(rest_m), "xyz".index(attachment.region.axis)
    low, high = block.shape.corners_m.min(axis=0), block.shape.corners_m.max(axis=0)
    if attachment.region.side == "low":
        high[axis] = nodes[:, axis].min()
    else:
        low[axis] = nodes[:, axis].max()
    if high[axis] - low[axis] < 1e-4:
        return
    pose = block.pose.relative_to(holder.pose)
    spec.body(holder.name).add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        name=f"{block.name}/{attachment.region.side} {attachment.region.axis}",
        size=(0.5 * (high - low)).tolist(),
        pos=pose.to_world(0.5 * (low + high)[None])[0].tolist(),
        quat=pose.quaternion,
        rgba=look.color,
        material=_material(spec, look),
        contype=0,
        conaffinity=0,
    )


def _set_quality(spec: mujoco.MjSpec, view: View, width: int, height: int) -> None:
    visual = spec.visual
    visual.global_.offwidth, visual.global_.offheight = width, height
    visual.global_.fovy = FIELD_OF_VIEW_DEG
    wanted = SHADOW_TEXELS_PER_PIXEL * max(width, height)
    visual.quality.shadowsize = int(np.clip(wanted, *SHADOW_TEXELS))
    visual.quality.offsamples = SAMPLES
    # Clipping planes, haze and shadows are relative to these two.
    spec.stat.center = view.target_m
    spec.stat.extent = view.distance_m
    visual.map.znear, visual.map.zfar = 0.02, 40.0
    # Ground outside of the shadow map shows specks near its border: the map is wider than the picture.
    visual.map.shadowclip = 1.2
    visual.map.haze = 0.35
    visual.rgba.haze = (*GROUND, 1.0)


def _lights(view: View) -> list[tuple[str, FloatArray, float, float]]:
    """Return name, direction, brightness and highlight of each light.

    Key lights come from above, the left and the near side. They are several, so that a shadow has a soft edge. The fill
    light brightens the sides that face the camera.
    """
    right, _, forward = view.axes
    level = np.array([forward[0], forward[1], 0.0]) / np.hypot(forward[0], forward[1])
    down = np.array([0.0, 0.0, -1.3])
    lights = []
    for number, (to_right, to_back) in enumerate(KEY_DIRECTIONS):
        key = down + to_right * right + to_back * level
        lights.append(
            (f"key-{number}", key, KEY / len(KEY_DIRECTIONS), 0.5 / len(KEY_DIRECTIONS))
        )
    lights.append(("fill", forward - 0.5 * right, FILL, 0.1))
    return [
        (name, way / np.linalg.norm(way), light, highlight)
        for name, way, light, highlight in lights
    ]


def _add_light(spec: mujoco.MjSpec, view: View) -> None:
    spec.visual.headlight.ambient = [AMBIENT] * 3
    spec.visual.headlight.diffuse = [0.0] * 3
    spec.visual.headlight.specular = [0.0] * 3
    for name, direction, diffuse, specular in _lights(view):
        spec.worldbody.add_light(
            name=name,
            pos=np.asarray(view.target_m) - 2.0 * view.distance_m * direction,
            dir=direction,
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            diffuse=[diffuse] * 3,
            specular=[specular] * 3,
            castshadow=name != "fill",
        )
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
        rgb1=GROUND,
        rgb2=GROUND,
        width=8,
        height=8,
    )


def _add_ground(spec: mujoco.MjSpec, view: View) -> None:
    """Add the material of the ground: under all lights it has the colour of its texture, which is that of the sky."""
    pitch_m = grid_pitch_m(view)
    cell = np.empty((TEXELS, TEXELS, 3))
    cell[:] = GROUND
    half = LINE_TEXELS // 2
    for lines in (cell, cell.transpose(1, 0, 2)):
        lines[: half + 1] = lines[-half:] = GRID_LINE
    texture = spec.add_texture(
        name="ground",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        width=TEXELS,
        height=TEXELS,
        nchannel=3,
    )
    texture.data = (255.0 * cell).round().astype(np.uint8).tobytes()
    lit = AMBIENT - sum(light * way[2] for _, way, light, _ in _lights(view))
    spec.add_material(
        name="ground",
        textures=material_textures("ground"),
        # MuJoCo repeats a uniform texture this often in two metres.
        texrepeat=[2.0 / pitch_m] * 2,
        texuniform=True,
        emission=float(1.0 - lit),
        specular=0.0,
        reflectance=0.0,
    )


def _material(spec: mujoco.MjSpec, look: Look) -> str:
    """Return the name of the material of a look, which is added at its first use."""
    name = f"{look.specular:g} {look.shininess:g} {look.has_grain}"
    if any(one.name == name for one in spec.materials):
        return name
    grain = {}
    if look.has_grain:
        _add_grain(spec)
        grain = {"textures": material_textures("grain")}
    spec.add_material(
        name=name,
        specular=look.specular,
        shininess=look.shininess,
        reflectance=0.0,
        **grain,
    )
    return name


def _add_grain(spec: mujoco.MjSpec) -> None:
    """Add a wood grain: smooth noise, drawn out along one direction."""
    rng = np.random.default_rng(3)
    cycles = np.fft.fftfreq(GRAIN_TEXELS)
    along, across = np.meshgrid(cycles, cycles, indexing="xy")
    noise = np.fft.fft2(rng.normal(size=(GRAIN_TEXELS, GRAIN_TEXELS)))
    smooth = np.real(
        np.fft.ifft2(noise * np.exp(-((90.0 * along) ** 2) - (7.0 * across) ** 2))
    )
    brightness = np.clip(0.96 + 0.03 * smooth / smooth.std(), 0.8, 1.0)
    texture = spec.add_texture(
        name="grain",
        type=mujoco.mjtTexture.mjTEXTURE_CUBE,
        width=GRAIN_TEXELS,
        height=GRAIN_TEXELS,
        nchannel=3,
    )
    face = np.repeat((255.0 * brightness).astype(np.uint8)[:, :, None], 3, axis=2)
    texture.data = face.tobytes()


def material_textures(name: str) -> list[str]:
    """Return the textures of a material that has one, by role."""
    textures = [""] * mujoco.mjtTextureRole.mjNTEXROLE
    textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    return textures
