"""The MuJoCo model of pictures: shapes without physics on a light ground with a grid."""

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from gauge_envs.backends.mujoco.model import add_geoms
from gauge_envs.rendering.camera import FIELD_OF_VIEW_DEG, View
from gauge_envs.rendering.materials import LOOKS, material_of
from gauge_envs.rendering.skin import Skin
from gauge_envs.scene import Attachment, Motion, Plane, RigidBody, Scene, SoftBody
from gauge_envs.scene.geometry import FloatArray

STUDIO = """
<mujoco>
  <visual>
    <quality shadowsize="2048"/>
    <headlight ambient="0.54 0.54 0.54" diffuse="0 0 0" specular="0 0 0"/>
    <map znear="0.02" zfar="40" shadowclip="1.2" haze="0.35"/>
    <rgba haze="0.925 0.93 0.94 1"/>
  </visual>
  <asset>
    <texture name="sky" type="skybox" builtin="flat" width="8" height="8"
      rgb1="0.925 0.93 0.94" rgb2="0.925 0.93 0.94"/>
    <texture name="ground" type="2d" builtin="flat" mark="edge" width="100" height="100"
      rgb1="0.925 0.93 0.94" rgb2="0.925 0.93 0.94" markrgb="0.83 0.845 0.865"/>
    <material name="ground" texture="ground" texuniform="true" specular="0"/>
  </asset>
  <worldbody>
    <light name="key" type="directional" diffuse="0.3 0.3 0.3" specular="0.5 0.5 0.5"/>
    <light name="fill" type="directional" diffuse="0.3 0.3 0.3" specular="0.1 0.1 0.1" castshadow="false"/>
  </worldbody>
</mujoco>
"""
"""Ground and background of one colour, even light, a light from above, and one from the camera."""
GRID_PITCHES_M = (0.025, 0.1)
"""Pitch of the grid [m]: the hole pitch of the real optical table, and a coarser pitch for wide views."""
WIDE_VIEW_M = 0.5
"""Height of the view above which the grid is coarse [m]."""
STILL = 0.84
"""Brightness of fixed and driven bodies relative to dynamic bodies."""


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
        view: The camera.
        width: Picture width [pixels].
        height: Picture height [pixels].
    """
    spec = mujoco.MjSpec.from_string(STUDIO)
    visual = spec.visual.global_
    visual.offwidth, visual.offheight, visual.fovy = width, height, FIELD_OF_VIEW_DEG
    # Clipping planes and shadows are relative to these two.
    spec.stat.center, spec.stat.extent = view.target_m, view.distance_m
    _place_lights(spec, view)
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
            _add_clamped_part(spec, scene, attachment, block, rest_nodes_m, material)
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


def _add_clamped_part(
    spec: mujoco.MjSpec,
    scene: Scene,
    attachment: Attachment,
    block: SoftBody,
    rest_nodes_m: Mapping[str, FloatArray],
    material: str,
) -> None:
    """Add the clamped part of a block, whose nodes an engine may omit."""
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


def _place_lights(spec: mujoco.MjSpec, view: View) -> None:
    """Rotate the lights with the camera, and give the ground the colour of the background."""
    right, _, forward = view.axes
    level = forward * [1.0, 1.0, 0.0]
    directions = {
        "key": 0.6 * right + 0.2 * level - [0.0, 0.0, 1.3],
        "fill": forward - 0.5 * right,
    }
    brightness = spec.visual.headlight.ambient[0]
    for name, axis in directions.items():
        direction = axis / np.linalg.norm(axis)
        light = spec.light(name)
        light.dir = direction
        light.pos = view.target_m - 2.0 * view.distance_m * direction
        brightness -= light.diffuse[0] * direction[2]
    ground = spec.material("ground")
    ground.emission = 1.0 - brightness
    # MuJoCo repeats a uniform texture this often in two metres.
    pitch_m = GRID_PITCHES_M[int(view.height_m > WIDE_VIEW_M)]
    ground.texrepeat = [2.0 / pitch_m] * 2
