"""Scene -> USD -> Scene is exact."""

from dataclasses import replace

import pytest
from places import first_of_each_kind
from pxr import Usd

from gauge_envs import load_experiment
from gauge_envs.errors import ParameterError, ResultFileError
from gauge_envs.experiments.variants import variants
from gauge_envs.formats.usd.reader import from_usd, read_usd
from gauge_envs.formats.usd.writer import to_usd
from gauge_envs.scene import (
    Box,
    Contact,
    ContactMode,
    Cylinder,
    Motion,
    Pose,
    RigidBody,
    Scene,
    Sphere,
    Tether,
)
from gauge_envs.scene.drivers import Driver, DriverMotion
from gauge_envs.scene.profiles import SampledProfile
from gauge_envs.tools.assets.build import assets_folder

# --- exact return ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name", first_of_each_kind(variant.name for variant in variants())
)
def test_checked_in_layers_are_the_scenes_to_the_bit(name):
    read = read_usd(assets_folder() / "usd" / f"{name}.usda")
    assert read.scene == load_experiment(name).scene
    assert read.metadata["variant"] == name


def test_a_cloth_that_is_cut_at_an_angle_comes_back_to_the_bit(tmp_path):
    scene = load_experiment("BiasStretching-satin").scene
    to_usd(scene, tmp_path / "strip.usda")
    assert read_usd(tmp_path / "strip.usda").scene == scene


def test_a_scene_with_every_feature_comes_back_to_the_bit(tmp_path):
    """Names that USD does not allow, start velocities, a string of a third of a metre, and a motion by samples."""
    bob = RigidBody(
        name="a_1",
        shape=Sphere(radius_m=0.1),
        motion=Motion.DYNAMIC,
        pose=Pose.from_euler_deg((0.1, 0.2, 1 / 3), (50.0, -20.0, 70.0)),
        mass_kg=0.7,
        inertia_kg_m2=1 / 900,
    )
    cube = replace(
        bob,
        name="a-1",
        shape=Box(size_m=(0.1, 1 / 3, 0.2)),
        linear_velocity_m_per_s=(1.2, -0.8, 1 / 3),
        angular_velocity_rad_per_s=(2.0, 1 / 7, -3.0),
    )
    shape = Cylinder(radius_m=0.1, length_m=1 / 3)
    drum = replace(bob, name="Contacts", shape=shape, motion=Motion.KINEMATIC)
    profile = SampledProfile(times_s=(0.0, 0.1, 1 / 3), values=(0.0, 0.5, 1 / 7))
    motions = [
        DriverMotion(kind=kind, axis=(0.0, 0.6, 0.8), profiles=(profile,))
        for kind in ("translate", "rotate")
    ]
    driver = Driver(body="Contacts", motions=tuple(motions), provenance="video")
    contact = Contact(
        first=("a-1", "a_1"),
        second=("Contacts",),
        friction=1 / 3,
        restitution=0.1,
        mode=ContactMode.IMPACT,
        rolling_m=1e-3,
    )
    scene = Scene(
        bodies=(cube, bob, drum, replace(drum, name="Würfel")),
        joints=(Tether(body="a_1", anchor_m=(0.0, 0.1, 1.7), length_m=1 / 3),),
        contacts=(contact,),
        drivers=(driver,),
        duration_s=0.777,
        gravity_m_per_s2=1 / 3,
    )
    for name in ("scene.usda", "scene.usdc"):
        to_usd(scene, tmp_path / name)
        assert from_usd(tmp_path / name) == scene
    stage = Usd.Stage.Open(str(tmp_path / name))
    stage.GetAttributeAtPath("/World/Joints/joint_0.physics:maxDistance").Set(0.75)
    stage.Save()
    assert from_usd(tmp_path / name).joints[0].length_m == 0.75


def test_what_cannot_be_written_is_an_error(tmp_path):
    scene = load_experiment("Turntable-1-wood").scene
    with pytest.raises(ParameterError, match=r"ends in \.usd"):
        to_usd(scene, tmp_path / "a.obj")
    (tmp_path / "file").touch()
    with pytest.raises(ResultFileError, match="cannot be written"):
        to_usd(scene, tmp_path / "file" / "a.usda")
