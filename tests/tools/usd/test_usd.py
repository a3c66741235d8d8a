"""Scene -> USD -> Scene is exact: for every variant, and for scenes that nobody designed."""

from __future__ import annotations

import math
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from gauge_envs import load_experiment
from gauge_envs.errors import ParameterError, ResultFileError
from gauge_envs.experiments.variants import variants
from gauge_envs.scene import (
    Attachment,
    Box,
    Cloth,
    Contact,
    ContactMode,
    ConvexUnion,
    Cylinder,
    Hinge,
    Markers,
    Motion,
    Plane,
    Pose,
    Region,
    RigidBody,
    Rod,
    Rope,
    Scene,
    SoftBody,
    Sphere,
    Tether,
)
from gauge_envs.scene.drivers import Driver, DriverMotion
from gauge_envs.scene.profiles import CosineProfile, SampledProfile, TrapezoidProfile
from gauge_envs.tools.assets.build import assets_folder
from gauge_envs.tools.assets.export import experiment_stage
from gauge_envs.tools.usd.reader import from_usd, read_usd
from gauge_envs.tools.usd.writer import export_stage, to_usd

# --- every variant ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [variant.name for variant in variants()])
def test_checked_in_layers_are_the_scenes_to_the_bit(name: str) -> None:
    file = assets_folder() / "usd" / f"{name}.usda"
    assert from_usd(file) == load_experiment(name).scene


def test_friction_about_the_normal_and_against_rolling_is_kept(tmp_path: Path) -> None:
    experiment = load_experiment("SlopeSlider-2-wood")
    first, *others = experiment.scene.contacts
    scene = replace(
        experiment.scene,
        contacts=(replace(first, torsion_m=0.0031, rolling_m=0.0007), *others),
    )
    to_usd(scene, tmp_path / "a.usda")
    assert from_usd(tmp_path / "a.usda") == scene


@pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usd"])
@pytest.mark.parametrize(
    "name", ["Turntable-3-metal", "NewtonsCradle-metal", "FoamTwisting-soft"]
)
def test_every_kind_of_file_keeps_every_double(
    name: str, suffix: str, tmp_path: Path
) -> None:
    experiment = load_experiment(name)
    export_stage(experiment_stage(experiment), tmp_path / f"a{suffix}")
    assert from_usd(tmp_path / f"a{suffix}") == experiment.scene


def test_overrides_come_back() -> None:
    experiment = load_experiment(
        "SlopeSlider-2-wood", {"cube.mass_kg": 0.123456789012, "cube.friction": 1 / 3}
    )
    with tempfile.TemporaryDirectory() as folder:
        export_stage(experiment_stage(experiment), Path(folder) / "a.usda")
        assert from_usd(Path(folder) / "a.usda") == experiment.scene


def test_a_layer_says_where_its_bodies_are_and_whose_they_are() -> None:
    read = read_usd(assets_folder() / "usd" / "SlopeSlider-2-wood.usda")
    assert read.paths["cube"] == "/World/cube"
    assert read.metadata["variant"] == "SlopeSlider-2-wood"
    assert set(read.paths) == {body.name for body in read.scene.bodies}


# --- scenes at random ------------------------------------------------------------------------------------------------

NAMES = (
    "cube",
    "a-1",
    "a_1",
    "Contacts",
    "ball 2",
    "Würfel",
    "plate",
    "wall",
    "cloth",
    "rope",
)

lengths = st.floats(1e-3, 2.0)
coordinates = st.floats(-3.0, 3.0)
positive = st.floats(1e-6, 1e6)
points = st.tuples(coordinates, coordinates, coordinates)
unit_vectors = points.filter(lambda p: math.hypot(*p) > 0.1).map(
    lambda p: tuple((np.asarray(p) / np.linalg.norm(p)).tolist())
)
poses = st.builds(
    Pose.from_euler_deg, points, st.tuples(*[st.floats(-180.0, 180.0)] * 3)
)
boxes = st.builds(Box, size_m=st.tuples(lengths, lengths, lengths))


@st.composite
def convex_unions(draw: st.DrawFn) -> ConvexUnion:
    """Tetrahedra in a row."""
    pieces = []
    for index in range(draw(st.integers(1, 3))):
        x, edge = 4.0 * index, draw(st.floats(0.1, 1.0))
        corner = (x, draw(coordinates), draw(coordinates))
        rest = [
            tuple(np.add(corner, edge * np.eye(3)[axis]).tolist()) for axis in range(3)
        ]
        pieces.append((corner, *rest))
    return ConvexUnion(pieces_m=tuple(pieces))


solids = st.one_of(
    boxes,
    st.builds(Sphere, radius_m=lengths),
    st.builds(Cylinder, radius_m=lengths, length_m=lengths),
    convex_unions(),
)


@st.composite
def profiles(draw: st.DrawFn) -> TrapezoidProfile | CosineProfile | SampledProfile:
    start_s, duration_s, amount = (
        draw(st.floats(0.0, 1.0)),
        draw(st.floats(0.1, 2.0)),
        draw(coordinates),
    )
    kind = draw(st.sampled_from(["trapezoid", "cosine", "sampled"]))
    if kind == "trapezoid":
        part = draw(st.floats(0.0, 0.5))
        return TrapezoidProfile(
            start_s=start_s,
            duration_s=duration_s,
            accelerate_s=part * duration_s,
            brake_s=0.1 * duration_s,
            amount=amount,
        )
    if kind == "cosine":
        return CosineProfile(start_s=start_s, duration_s=duration_s, amount=amount)
    steps = draw(st.lists(st.floats(0.01, 1.0), min_size=2, max_size=6))
    values = draw(st.lists(coordinates, min_size=len(steps), max_size=len(steps)))
    return SampledProfile(
        times_s=tuple(np.cumsum(steps).tolist()), values=tuple(values)
    )


motions = st.builds(
    DriverMotion,
    kind=st.sampled_from(["translate", "rotate"]),
    axis=unit_vectors,
    point_m=points,
    residual_rate=st.floats(0.0, 1.0),
    profiles=st.lists(profiles(), max_size=2).map(tuple),
)


@st.composite
def deformables(draw: st.DrawFn, name: str) -> Cloth | SoftBody | Rope | Rod:
    common = {"name": name, "pose": draw(poses), "mass_kg": draw(positive)}
    kind = draw(st.sampled_from([Cloth, SoftBody, Rope, Rod]))
    if kind is Cloth:
        stiffness = draw(st.floats(1.0, 1e4))
        return Cloth(
            **common,
            size_m=(draw(lengths), draw(lengths)),
            areal_density_kg_per_m2=draw(lengths),
            thickness_m=draw(st.floats(1e-4, 1e-2)),
            stretch_stiffness_n_per_m=stiffness,
            shear_stiffness_n_per_m=stiffness * draw(st.floats(0.1, 1.0)),
            bend_stiffness_n_m_per_rad=draw(st.floats(1e-9, 1e-3)),
        )
    common["young_modulus_pa"] = draw(positive)
    if kind is Rope:
        return Rope(**common, length_m=draw(lengths), radius_m=draw(lengths))
    common["poisson_ratio"] = draw(st.floats(-0.9, 0.499))
    if kind is Rod:
        return Rod(**common, length_m=draw(lengths), radius_m=draw(lengths))
    return SoftBody(
        **common,
        shape=draw(
            boxes.map(
                lambda box: replace(box, size_m=tuple(0.1 * e for e in box.size_m))
            )
        ),
    )


def _of_different_pairs(contacts: list[Contact]) -> tuple[Contact, ...]:
    """Return the contacts that list no pair of an earlier one."""
    seen: set[frozenset[str]] = set()
    kept = []
    for contact in contacts:
        pairs = {
            frozenset((first, second))
            for first in contact.first
            for second in contact.second
        }
        if not pairs & seen:
            kept.append(contact)
        seen |= pairs
    return tuple(kept)


@st.composite
def scenes(draw: st.DrawFn) -> Scene:
    names = draw(st.permutations(NAMES))
    count = draw(st.integers(1, 5))
    bodies, drivers, joints = [], [], []
    for name in names[:count]:
        motion = draw(st.sampled_from(list(Motion)))
        shape = (
            draw(st.one_of(solids, st.just(Plane())))
            if motion is Motion.FIXED
            else draw(solids)
        )
        mass = 0.0 if isinstance(shape, Plane) else draw(positive)
        body = RigidBody(
            name=name, shape=shape, motion=motion, pose=draw(poses), mass_kg=mass
        )
        bodies.append(body)
        is_free = motion is Motion.DYNAMIC and draw(st.booleans())
        if is_free:
            bodies[-1] = replace(
                body,
                linear_velocity_m_per_s=draw(points),
                angular_velocity_rad_per_s=draw(points),
            )
        if motion is Motion.KINEMATIC and draw(st.booleans()):
            moves = tuple(draw(st.lists(motions, min_size=1, max_size=2)))
            drivers.append(
                Driver(
                    body=name,
                    motions=moves,
                    provenance=draw(st.sampled_from(["video", "nominal"])),
                )
            )
        if motion is Motion.DYNAMIC and not is_free and draw(st.booleans()):
            joint = st.one_of(
                st.builds(
                    Hinge, body=st.just(name), anchor_m=points, axis=unit_vectors
                ),
                st.builds(
                    Tether, body=st.just(name), anchor_m=points, length_m=lengths
                ),
            )
            joints.append(draw(joint))
    soft = [
        draw(deformables(name))
        for name in names[count : count + draw(st.integers(0, 2))]
    ]
    everybody = [body.name for body in (*bodies, *soft)]
    group = st.lists(
        st.sampled_from(everybody), min_size=1, max_size=4, unique=True
    ).map(tuple)
    contact = st.builds(
        Contact,
        first=group,
        second=group,
        friction=st.floats(0.0, 2.0),
        restitution=st.floats(0.0, 1.0),
        mode=st.sampled_from(ContactMode),
    )
    # A deformable body starts at rest, and so does what it is attached to.
    moving = {body.name for body in bodies if not body.starts_at_rest}
    attachments = [
        Attachment(
            deformable=body.name,
            region=Region(
                axis=draw(st.sampled_from("xyz")),
                side=draw(st.sampled_from(["low", "high"])),
                depth_m=draw(lengths),
            ),
            to=draw(
                st.sampled_from(
                    [
                        name
                        for name in everybody
                        if name != body.name and name not in moving
                    ]
                )
            ),
        )
        for body in soft
        if {*everybody} - moving - {body.name}
    ]
    markers = None
    if soft:
        placed = draw(st.lists(points, min_size=3, max_size=5).map(tuple))
        markers = Markers(
            bodies=tuple(body.name for body in soft),
            positions_m=placed,
            faces=((0, 1, 2),),
            lines=((2, 0),),
            corner=(1,),
        )
    return Scene(
        bodies=tuple(bodies),
        deformables=tuple(soft),
        joints=tuple(draw(st.permutations(joints))),
        attachments=tuple(attachments),
        contacts=_of_different_pairs(draw(st.lists(contact, max_size=4))),
        drivers=tuple(draw(st.permutations(drivers))),
        markers=markers,
        duration_s=draw(st.floats(0.1, 3.0)),
        gravity_m_per_s2=draw(st.floats(0.0, 30.0)),
    )


@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
@given(scene=scenes())
def test_any_scene_comes_back_to_the_bit(scene: Scene) -> None:
    with tempfile.TemporaryDirectory() as folder:
        for suffix in (".usda", ".usdc"):
            file = Path(folder) / f"scene{suffix}"
            to_usd(scene, file)
            assert from_usd(file) == scene


@pytest.mark.slow
@settings(max_examples=2000, deadline=None, suppress_health_check=list(HealthCheck))
@given(scene=scenes())
def test_very_many_scenes_come_back_to_the_bit(scene: Scene) -> None:
    with tempfile.TemporaryDirectory() as folder:
        to_usd(scene, Path(folder) / "scene.usdc")
        assert from_usd(Path(folder) / "scene.usdc") == scene


# --- what cannot be written ------------------------------------------------------------------------------------------


def test_what_is_named_or_driven_twice_is_not_written(tmp_path: Path) -> None:
    scene = load_experiment("Turntable-1-wood").scene
    with pytest.raises(ParameterError, match="'cube' has more than one name"):
        to_usd(
            replace(scene, bodies=(*scene.bodies, scene.body("cube"))),
            tmp_path / "a.usda",
        )
    with pytest.raises(ParameterError, match="'plate' has more than one driver"):
        to_usd(replace(scene, drivers=scene.drivers * 2), tmp_path / "a.usda")
    with pytest.raises(ParameterError, match=r"ends in \.usda"):
        to_usd(scene, tmp_path / "a.obj")
    (tmp_path / "file").touch()
    with pytest.raises(ResultFileError, match="cannot be written"):
        to_usd(scene, tmp_path / "file" / "a.usda")
