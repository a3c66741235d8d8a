"""Contact constants of pairs as materials and collision groups of shapes. Needs no engine."""

from dataclasses import replace
from itertools import combinations

from hypothesis import given, strategies as st

from gauge_envs import load_experiment
from gauge_envs.backends import backend
from gauge_envs.backends.physx.contacts import constants_of, groups_of_bodies
from gauge_envs.scene import (
    ContactMode,
    Scene,
)
from gauge_envs.tools.bench.parts import ball, contact as touching

NAMES = "abcde"
GROUPS = st.sets(st.sampled_from(NAMES), min_size=1).map(
    lambda names: tuple(sorted(names))
)


def scene_of(*contacts, bodies=NAMES, **parts):
    return Scene(
        bodies=tuple(ball(name, (0, 0, 1)) for name in bodies),
        contacts=contacts,
        duration_s=1.0,
        **parts,
    )


def materials_that_touch(groups, one, other):
    """Materials of the copies of two bodies that SAPIEN lets collide: its documented rule, in Python."""
    found = set()
    for constants, (first, second, _, number) in groups[one].items():
        for others, (third, fourth, _, other_number) in groups[other].items():
            if number == other_number and (first & fourth or third & second):
                assert constants == others  # The mean of equal values is exact.
                found.add(constants)
    return found


@given(
    st.lists(
        st.tuples(
            GROUPS,
            GROUPS,
            st.sampled_from([0.0, 0.2, 0.7]),
            st.sampled_from([0.0, 0.5]),
        ),
        max_size=6,
    )
)
def test_bodies_touch_with_the_constants_of_their_contact_and_no_others(rows):
    contacts, seen = [], set()
    for first, second, friction, restitution in rows:
        contact = touching(first, second, friction=friction, restitution=restitution)
        pairs = {frozenset(pair) for pair in scene_of(contact).colliding_pairs(contact)}
        if not pairs & seen:
            contacts.append(contact)
            seen |= pairs
    scene = scene_of(*contacts)
    expected = {
        frozenset(pair): {(contact.friction, contact.restitution)}
        for contact in contacts
        for pair in scene.colliding_pairs(contact)
    }
    groups = groups_of_bodies(scene, sustained_restitution=False)
    found = {
        frozenset(pair): materials_that_touch(groups, *pair)
        for pair in combinations(NAMES, 2)
    }
    assert {pair: values for pair, values in found.items() if values} == expected


def test_a_sustained_contact_has_no_restitution_unless_the_setting_keeps_it():
    impact = touching("a", "b", friction=0.3, restitution=0.6)
    contact = replace(impact, mode=ContactMode.SUSTAINED)
    assert constants_of(contact, sustained_restitution=False) == (0.3, 0.0)
    assert constants_of(contact, sustained_restitution=True) == (0.3, 0.6)
    assert constants_of(impact, sustained_restitution=False) == (0.3, 0.6)


def test_every_rigid_scene_is_supported():
    for name in (
        "WallBreaking-wood",
        "NewtonsCradle-metal",
        "Turntable-3-metal",
        "NonsmoothContact-3-wood",
    ):
        assert list(backend("physx").unsupported(load_experiment(name).scene)) == []
