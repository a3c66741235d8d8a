"""Each pair of bodies touches with its own constants, also where no values of bodies give those of all pairs."""

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from gauge_envs.backends.base import scene_support
from gauge_envs.backends.shared.pair_values import body_values, pair_values
from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.scene import GRAVITY_M_PER_S2, Motion, Pose, Scene
from gauge_envs.scene.geometry import vector
from gauge_envs.scoring.estimators import acceleration_m_per_s2
from gauge_envs.tools.bench.parts import ball, box, contact, fixed_box, ground
from gauge_envs.tools.bench.recording import record

ENGINES = ["mujoco", "newton", "physx", "pybullet", "rapier"]
FRICTIONS = {
    ("one", "low"): 0.1,
    ("one", "high"): 0.5,
    ("two", "low"): 0.5,
    ("two", "high"): 0.1,
}
"""Friction of each cube on each board: no coefficients of the four bodies have these means or products."""


def crossed_slides(boards, motion):
    """Two cubes that may touch both of two leaning boards, each on the board that is named."""
    lean = (0.0, 30.0, 0.0)
    bodies = []
    for cube, board in boards.items():
        place = Pose.from_euler_deg((0.0, 3.0 * len(bodies), 1.0), lean)
        above = vector(place.to_world(np.array([0.0, 0.0, 0.035])))
        support = fixed_box(board, place.position_m, (2.0, 0.4, 0.02), euler_deg=lean)
        bodies.append(replace(support, motion=motion))
        bodies.append(box(cube, above, (0.05,) * 3, euler_deg=lean, mass_kg=0.1))
    contacts = tuple(
        contact(*pair, friction=friction) for pair, friction in FRICTIONS.items()
    )
    return Scene(bodies=tuple(bodies), contacts=contacts, duration_s=0.5)


@pytest.mark.parametrize("engine", ENGINES, indirect=True)
@pytest.mark.parametrize(
    ("motion", "boards"),
    [(Motion.FIXED, ("low", "high")), (Motion.KINEMATIC, ("high", "low"))],
)
def test_pairs_have_their_friction(engine, motion, boards):
    pairs = list(zip(("one", "two"), boards, strict=True))
    scene = crossed_slides(dict(pairs), motion)
    for rule in ("mean", "product"):
        with pytest.raises(UnsupportedSceneError, match="no values of bodies"):
            body_values(pair_values(scene, "friction"), rule)
    assert scene_support(engine, scene)
    with closing(engine.build(scene)) as simulation:
        rollout = record(simulation, scene, 0.5)
    down = scene.body("low").pose.rotation.apply([1.0, 0.0, 0.0])
    for pair in pairs:
        moved = rollout.position(pair[0]) @ down
        found = acceleration_m_per_s2(rollout.times_s, moved - moved[0])
        normal = GRAVITY_M_PER_S2 * np.cos(np.pi / 6)
        friction = (0.5 * GRAVITY_M_PER_S2 - found) / normal
        # A step of the soft contacts of MuJoCo's solver ends before their friction does.
        limit = 0.012 if engine.name in ("mujoco", "newton") else 0.0015
        assert friction == pytest.approx(FRICTIONS[pair], abs=limit)


@pytest.mark.parametrize("engine", ENGINES, indirect=True)
def test_pairs_have_their_restitution(engine):
    """Two balls that may touch each other rebound from a plane, each with its own speed."""
    drop_m, restitutions = 0.2, {"first": 0.8, "second": 0.4}
    balls = (
        ball(name, (place, 0.0, drop_m + 0.03))
        for name, place in (("first", 1.0), ("second", -1.0))
    )
    contacts = [
        contact(name, "ground", friction=0.0, restitution=value)
        for name, value in restitutions.items()
    ]
    contacts.append(contact("first", "second", friction=0.0, restitution=0.2))
    scene = Scene(bodies=(*balls, ground()), contacts=tuple(contacts), duration_s=0.25)
    assert scene_support(engine, scene)
    with closing(engine.build(scene)) as simulation:
        rollout = record(simulation, scene, 0.25)
    fallen = np.sqrt(2.0 * GRAVITY_M_PER_S2 * drop_m)
    since_s = 0.25 - fallen / GRAVITY_M_PER_S2
    for name, value in restitutions.items():
        rising = rollout.states[name][-1, 9] + GRAVITY_M_PER_S2 * since_s
        assert rising / fallen == pytest.approx(value, abs=0.01)
