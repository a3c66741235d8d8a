"""The MuJoCo model that pictures show: shapes without physics, on light ground with a grid."""

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from gauge_envs.backends.mujoco.model import add_geoms
from gauge_envs.rendering.camera import FIELD_OF_VIEW_DEG, View
from gauge_envs.rendering.materials import LOOKS, Color, material_of
from gauge_envs.rendering.skin import Skin
from gauge_envs.scene import Attachment, Motion, Plane, RigidBody, Scene, SoftBody
from gauge_envs.scene.geometry import FloatArray

GROUND: Color = (0.925, 0.93, 0.94)
"""Colour of ground and background."""
GRID_LINE: Color = (0.83, 0.845, 0.865)
GRID_PITCHES_M = (0.025, 0.1)
"""Pitch of the grid [m]: the hole pitch of the real optical table, and a coarser one for wide views."""
WIDE_VIEW_M = 0.5
"""Height of the view from which the grid is coarse [m]."""
STILL = 0.84
"""Brightness of fixed and driven bodies relative to free ones, which stand out from them."""
AMBIENT, KEY, FILL = 0.54, 0.30, 0.30
"""Brightness of the even light, of the light from above, which casts shadows, and of that from the camera."""


def visual_model(
    scene: Scene,
    skins: Sequence[Skin],
    rest_nodes_m: Mapping[str, FloatArray],
    materials: Mapping[str, str],
    view: View,
    width: int,
    height: int,
) -> mujoco.MjModel:
    """Return the model of a scene; every rigid body is a mocap body.

    Args:
        scene: The scene.
        skins: Surfaces of its deformable bodies.
        rest_nodes_m: Nodes of each deformable body at the start [m], shape [node_count, 3].
        materials: Material of bodies by name.
        view: Where the camera is.
        width: Picture width [pixels].
        height: Picture height [pixels].
    """
    spec = mujoco.MjSpec()
    visual = spec.visual
    visual.global_.offwidth, visual.global_.offheight = width, height
    visual.global_.fovy = FIELD_OF_VIEW_DEG
    visual.quality.shadowsize = 2048
    # Clipping planes and shadows are relative to these two.
    spec.stat.center, spec.stat.extent = view.target_m, view.distance_m
    visual.map.znear, visual.map.zfar, visual.map.shadowclip = 0.02, 40.0, 1.2
    visual.map.haze, visual.rgba.haze = 0.35, [*GROUND, 1.0]
    _add_light_and_ground(spec, view)
    for name, look in LOOKS.items():
        spec.add_material(name=name, specular=look.specular, shininess=look.shininess)
    for body in scene.bodies:
        _add_body(spec, body, material_of(body, materials.get(body.name)))
    soft = {body.name: body for body in scene.deformables}
    for skin in skins:
        skin.add(spec, material_of(soft[skin.name], materials.get(skin.name)))
    for attachment in scene.attachments:
        block = soft[attachment.deformable]
        if isinstance(block, SoftBody):
            material = material_of(block, materials.get(block.name))
            _add_gripped(spec, scene, attachment, block, rest_nodes_m, material)
    return spec.compile()


def _add_body(spec: mujoco.MjSpec, body: RigidBody, material: str) -> None:
    pose = body.pose
    frame = spec.worldbody.add_body(
        name=body.name, pos=pose.position_m, quat=pose.quaternion, mocap=True
    )
    brightness = 1.0 if body.motion is Motion.DYNAMIC else STILL
    for geom in add_geoms(spec, frame, body.name, body.shape):
        if isinstance(body.shape, Plane):
            geom.size, geom.material = [0.0, 0.0, 0.05], "ground"
        else:
            geom.material = material
            geom.rgba = [*(brightness * np.array(LOOKS[material].color)), 1.0]


def _add_gripped(
    spec: mujoco.MjSpec,
    scene: Scene,
    attachment: Attachment,
    block: SoftBody,
    rest_nodes_m: Mapping[str, FloatArray],
    material: str,
) -> None:
    """Add the part of a block that a rigid body holds, which engines may leave out of its nodes."""
    if attachment.to not in {body.name for body in scene.bodies}:
        return
    nodes_m = block.pose.to_body(rest_nodes_m[block.name])
    low_m = block.shape.corners_m.min(axis=0)
    high_m = block.shape.corners_m.max(axis=0)
    axis = "xyz".index(attachment.region.axis)
    if attachment.region.side == "low":
        high_m[axis] = nodes_m[:, axis].min()
    else:
        low_m[axis] = nodes_m[:, axis].max()
    if high_m[axis] - low_m[axis] < 1e-4:
        return
    pose = block.pose.relative_to(scene.body(attachment.to).pose)
    spec.body(attachment.to).add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=0.5 * (high_m - low_m),
        pos=pose.to_world(0.5 * (low_m + high_m)[None])[0],
        quat=pose.quaternion,
        rgba=[*LOOKS[material].color, 1.0],
        material=material,
    )


def _add_light_and_ground(spec: mujoco.MjSpec, view: View) -> None:
    """Add the lights, and a ground that has the colour of the background in them."""
    right, _, forward = view.axes
    headlight = spec.visual.headlight
    headlight.ambient, headlight.diffuse, headlight.specular = np.outer(
        [AMBIENT, 0.0, 0.0], np.ones(3)
    )
    brightness = AMBIENT
    key = 0.6 * right + [0.2 * forward[0], 0.2 * forward[1], -1.3]
    fill = forward - 0.5 * right
    for direction, diffuse, specular in ((key, KEY, 0.5), (fill, FILL, 0.1)):
        direction /= np.linalg.norm(direction)
        brightness -= diffuse * direction[2]
        spec.worldbody.add_light(
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            pos=view.target_m - 2.0 * view.distance_m * direction,
            dir=direction,
            diffuse=[diffuse] * 3,
            specular=[specular] * 3,
            castshadow=direction is key,
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
    spec.add_texture(
        name="ground",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
        mark=mujoco.mjtMark.mjMARK_EDGE,
        rgb1=GROUND,
        rgb2=GROUND,
        markrgb=GRID_LINE,
        width=100,
        height=100,
    )
    ground = spec.add_material(
        name="ground",
        # MuJoCo repeats a uniform texture this often in two metres.
        texrepeat=[2.0 / GRID_PITCHES_M[int(view.height_m > WIDE_VIEW_M)]] * 2,
        texuniform=True,
        emission=1.0 - brightness,
        specular=0.0,
    )
    ground.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "ground"
