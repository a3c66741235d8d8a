"""Scenes that nobody designed, with all that a USD layer holds of a scene, and edits of what is written of one."""

import math
from dataclasses import replace

import numpy as np
from hypothesis import strategies as st
from pxr import Sdf, Usd

from gauge_envs.scene import (
    Box,
    Contact,
    ContactMode,
    ConvexUnion,
    Cylinder,
    Hinge,
    Motion,
    Plane,
    Pose,
    RigidBody,
    Scene,
    Sphere,
    Tether,
)
from gauge_envs.scene.drivers import Driver, DriverMotion
from gauge_envs.scene.profiles import SampledProfile, TrapezoidProfile
from gauge_envs.tools.assets.build import assets_folder
from gauge_envs.tools.usd.reader import from_usd
from gauge_envs.tools.usd.writer import scene_stage

# --- scenes ----------------------------------------------------------------------------------------------------------

NAMES = ("cube", "a-1", "a_1", "Contacts", "ball 2", "Würfel", "plate", "wall")

lengths = st.floats(1e-3, 2.0)
coordinates = st.floats(-3.0, 3.0)
positive = st.floats(1e-6, 1e6)
maybe = st.just(0.0) | positive
points = st.tuples(coordinates, coordinates, coordinates)
directions = points.filter(lambda point: math.hypot(*point) > 0.1).map(
    lambda point: tuple((np.asarray(point) / np.linalg.norm(point)).tolist())
)
poses = st.builds(
    Pose.from_euler_deg, points, st.tuples(*[st.floats(-180.0, 180.0)] * 3)
)


solids = st.one_of(
    st.builds(Box, size_m=st.tuples(lengths, lengths, lengths)),
    st.builds(Sphere, radius_m=lengths),
    st.builds(Cylinder, radius_m=lengths, length_m=lengths),
    st.just(
        ConvexUnion(
            pieces_m=(tuple(map(tuple, np.vstack([np.zeros(3), np.eye(3)]).tolist())),)
        )
    ),
)
profiles = st.one_of(
    st.builds(
        TrapezoidProfile,
        start_s=st.floats(0.0, 1.0),
        duration_s=st.floats(1.0, 2.0),
        accelerate_s=st.floats(0.0, 0.5),
        brake_s=st.floats(0.0, 0.5),
        amount=coordinates,
    ),
    st.builds(
        SampledProfile,
        times_s=st.just((0.0, 0.1, 1 / 3)),
        values=st.tuples(coordinates, coordinates, coordinates),
    ),
)
movements = st.builds(
    DriverMotion,
    kind=st.sampled_from(["translate", "rotate"]),
    axis=directions,
    point_m=points,
    residual_rate=st.floats(0.0, 1.0),
    profiles=st.lists(profiles, max_size=2).map(tuple),
)
hinge_terms = {"anchor_m": points, "axis": directions}


@st.composite
def scenes(draw):
    names = draw(st.permutations(NAMES))
    count = draw(st.integers(1, 5))
    bodies, drivers, joints = [], [], []
    for name in names[:count]:
        motion = draw(st.sampled_from(Motion))
        is_plane = motion is Motion.FIXED and draw(st.booleans())
        body = RigidBody(
            name=name,
            shape=Plane() if is_plane else draw(solids),
            motion=motion,
            pose=draw(poses),
            mass_kg=0.0 if is_plane else draw(positive),
        )
        match motion, draw(st.integers(0, 3)):
            case Motion.DYNAMIC, 0:
                velocities = {
                    "linear_velocity_m_per_s": draw(points),
                    "angular_velocity_rad_per_s": draw(points),
                }
                body = replace(body, **velocities)
            case Motion.DYNAMIC, 1:
                joints.append(
                    Hinge(body=name, **draw(st.fixed_dictionaries(hinge_terms)))
                )
            case Motion.DYNAMIC, 2:
                tether = {"anchor_m": draw(points), "length_m": draw(lengths)}
                joints.append(Tether(body=name, **tether))
            case Motion.KINEMATIC, 0 | 1:
                motions = draw(st.lists(movements, min_size=1, max_size=2))
                source = draw(st.sampled_from(["video", "nominal"]))
                driver = Driver(body=name, motions=tuple(motions), provenance=source)
                drivers.append(driver)
        bodies.append(body)
    group = st.lists(st.sampled_from(names[:count]), min_size=1, unique=True).map(tuple)
    contact = st.builds(
        Contact,
        first=group,
        second=group,
        friction=st.floats(1e-3, 2.0),
        restitution=st.floats(0.0, 1.0),
        mode=st.sampled_from(ContactMode),
        torsion_m=maybe,
        rolling_m=maybe,
    )
    return Scene(
        bodies=tuple(bodies),
        joints=tuple(draw(st.permutations(joints))),
        contacts=(draw(contact),),
        drivers=tuple(draw(st.permutations(drivers))),
        duration_s=draw(st.floats(0.1, 3.0)),
        gravity_m_per_s2=draw(st.floats(0.0, 30.0)),
    )


# --- edits -----------------------------------------------------------------------------------------------------------


def edited(source, folder, edit):
    """Return the scene of a layer after an edit, as a USD tool would save it.

    Args:
        source: A variant, whose layer is read, or a scene.
        folder: Where the layer is written.
        edit: New values of attributes by path, or a function of the stage.
    """
    if isinstance(source, str):
        file = assets_folder() / "usd" / f"{source}.usda"
        stage = Usd.Stage.CreateInMemory()
        stage.GetRootLayer().TransferContent(Sdf.Layer.FindOrOpen(str(file)))
    else:
        stage = scene_stage(source)
    if callable(edit):
        edit(stage)
    else:
        for path, value in edit.items():
            attribute = stage.GetAttributeAtPath(path)
            assert attribute.HasAuthoredValue(), path
            attribute.Set(value)
    stage.GetRootLayer().Export(str(folder / "edited.usda"))
    return from_usd(folder / "edited.usda")


def changed(value, place, to):
    """Return a scene, or a part of one, with another value at a place such as `bodies.cube.mass_kg`."""
    if not place:
        return to
    name, _, rest = place.partition(".")
    if not isinstance(value, tuple):
        return replace(value, **{name: changed(getattr(value, name), rest, to)})
    names = [getattr(one, "name", "") for one in value]
    index = int(name) if name.isdecimal() else names.index(name)
    return (*value[:index], changed(value[index], rest, to), *value[index + 1 :])


def pairs(scene):
    """Return the pairs that collide; no contact lists one of another."""
    found = [
        frozenset(pair)
        for contact in scene.contacts
        for pair in scene.colliding_pairs(contact)
    ]
    assert len(found) == len(set(found))
    return set(found)
