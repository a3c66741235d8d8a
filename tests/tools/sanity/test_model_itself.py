"""Checks of the model itself: planted faults with their size from mechanics, and right models that pass."""

import re

import mujoco
import pytest
from quadruped import good_xml

from gauge_envs.tools.sanity import configuration
from gauge_envs.tools.sanity.model_checks import at_rest, runs
from gauge_envs.tools.sanity.target_checks import TARGET_CHECKS

FLOOR = '<geom name="floor" type="plane" size="5 5 1"/>'

FREE = '<body name="{0}" pos="{1}"><freejoint/><geom name="{0}" {2}/></body>'

BOX = 'type="box" size=".05 .05 .05" mass="{}"'


def mjcf(bodies, option="", rest=""):
    return f"<mujoco><option {option}</option><worldbody>{bodies}</worldbody>{rest}</mujoco>"


def stack(heavy_kg, option=">", constants=""):
    boxes = [
        FREE.format(f"box{n}", f"0 0 {0.05 + 0.1 * n:g}", BOX.format(mass_kg))
        for n, mass_kg in enumerate([1, heavy_kg])
    ]
    default = f"<default><geom {constants}/></default>"
    return mjcf(FLOOR + "".join(boxes), option, default)


def hang(hook_kg, mass_kg):
    hook = f'<body name="hook" pos="0 0 1"><joint type="slide"/><geom size=".05" mass="{hook_kg}"/></body>'
    load = FREE.format("load", "0 0 .8", f'size=".05" mass="{mass_kg}"')
    connects = (
        '<connect body1="hook" anchor="0 0 0"/>'
        '<connect body1="load" body2="hook" anchor="0 0 .2"/>'
    )
    return mjcf(hook + load, ">", f"<equality>{connects}</equality>")


ROD = FREE.format("rod", "0 0 1", 'type="box" size=".2 .01 .01" mass="1"')

TOSSED = mjcf(
    ROD,
    'timestep=".002">',
    '<keyframe><key qpos="0 0 1 1 0 0 0" qvel="0 0 0 {0} {0} {0}"/></keyframe>',
)

STIFF = FREE.format("box", "0 0 .08", f'{BOX.format(1)} solref="-1e6 -100"')

SLEEP = '<flag sleep="enable"/>'

ARM = """<body name="upper" gravcomp="1"><joint name="j1" axis="0 1 0" armature=".1"/><geom size=".03" mass="2"/>
 <body name="fore" pos=".4 0 0" {}><joint name="j2" axis="0 1 0" armature=".1"/><geom size=".03" mass="1"/></body>
 </body>"""

MOTORS = '<actuator><position joint="j1" kp="250" kv="9"/><position joint="j2" kp="100" kv="9"/></actuator>'

PRESSED = """<geom name="block" type="box" size=".1 .1 .1"/><body name="finger" pos="0 0 .11">
  <joint name="down" type="slide"/><geom size=".01" mass=".01"/></body>"""

PRESS = (
    '<actuator><motor joint="down"/></actuator><keyframe><key ctrl="-1"/></keyframe>'
)

BALL = FREE.format("ball", "0 0 .1", 'size=".1" friction="1 .005 .01" condim="{}"')

ROLLING_PAIR = mjcf(
    FLOOR + FREE.format("ball", "0 0 .1", 'size=".1"'),
    ">",
    '<contact><pair geom1="floor" geom2="ball" condim="{}" friction="1 1 .005 .01 .01"/></contact>',
)


def result(name, xml):
    read = configuration(mujoco.MjModel.from_xml_string(xml))
    return TARGET_CHECKS[name].result(read)


@pytest.mark.parametrize(
    ("name", "xml", "value", "words"),
    [
        ("model-overlap", stack(2000), None, "box0 sinks"),
        # A servo presses a finger, which counts like a body without a motor.
        ("model-overlap", mjcf(PRESSED, ">", PRESS), None, "finger sinks"),
        ("model-constraints", hang(0.02, 20), None, "hook"),
        # Explicit steps of 20 ms make a rod that turns once a second gain 29 % of its momentum in 2 s.
        ("model-spin", mjcf(ROD, 'timestep=".02">'), 0.29, "rod"),
        # A keyframe that turns it four times a second shows what one turn does not.
        ("model-spin", TOSSED.format(25), None, "rod"),
        (
            "model-creep",
            # A damping of 1,200 / s overshoots in a step of 2 ms, as 1,200 * 0.002 > 2, and not in one of 0.2 ms.
            stack(1, constants='solref="-20000 -1200"'),
            None,
            "box",
        ),
        # A contact that swings at 1,000 rad / s gains energy in a step of 25 ms, as 1,000 * 0.025 > 2.
        ("model-creep", mjcf(FLOOR + STIFF, 'timestep=".025">'), None, "box moves"),
        ("stated-rolling", mjcf(FLOOR + BALL.format(3), ">"), 1.0, "rolling"),
        ("stated-rolling", ROLLING_PAIR.format(3), 1.0, "pair 0"),
    ],
)
def test_a_fault_is_named_with_its_size(name, xml, value, words):
    found = result(name, xml)
    assert found.verdict.is_off, found
    assert words in found.remark
    assert value is None or found.configured == pytest.approx(value, rel=0.1)


@pytest.mark.parametrize(
    "xml",
    [
        good_xml(),
        stack(1),
        stack(10),
        hang(1, 1),
        mjcf(ROD, ">"),
        mjcf(ROD, 'timestep=".02" integrator="RK4">'),
        mjcf(ARM.format('gravcomp="1"'), ">", MOTORS),
        ROLLING_PAIR.format(6),
        mjcf(FLOOR + FREE.format("ball", "0 0 .1", 'size=".1"'), f">{SLEEP}"),
    ],
)
def test_a_right_model_passes(xml):
    read = configuration(mujoco.MjModel.from_xml_string(xml))
    modules = at_rest.__name__, runs.__name__
    itself = [
        check for check in TARGET_CHECKS.values() if check.finding.__module__ in modules
    ]
    results = [check.result(read) for check in itself]
    assert len(itself) == 9
    assert [result.remark for result in results if result.verdict.is_off] == []


def test_the_solver_is_compared_with_an_exact_one():
    rough = result("model-solver", stack(10, 'iterations="1" solver="PGS">'))
    exact = result("model-solver", stack(10))
    assert rough.verdict.is_off and rough.configured > exact.configured
    creep = result("model-creep", stack(10, 'iterations="1" solver="PGS">'))
    assert (creep.applies, creep.remark) == (False, "model-solver has the cause")


def test_a_load_inside_the_cone_of_friction_rests():
    """Friction 0.5 holds 4.905 N of a crate of 1 kg; a soft contact lets it slip under 4.9 N."""
    crate = FLOOR + FREE.format(
        "crate", "0 0 .05", BOX.format(1) + ' friction=".5" priority="1"'
    )
    push = 'cone="elliptic" gravity="{} 0 -9.81" {}>'
    found = result("model-slip", mjcf(crate, push.format(4.9, "")))
    assert found.verdict.is_off and "0.999 of the friction" in found.remark
    for option in (
        push.format(0, ""),
        push.format(4.9, 'impratio="100"'),
        push.format(6, ""),
    ):
        assert not result("model-slip", mjcf(crate, option)).verdict.is_off


HELD = """<body pos="0 0 1"><joint name="arm" axis="0 1 0" frictionloss="{}"/>
  <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass="1"/></body>"""


def test_a_load_below_the_dry_friction_of_a_joint_rests():
    """A soft constraint lets an arm of 1.5 N m turn that 3 N m hold; without weight, or with 1 N m, it is right."""
    found = result("model-slip", mjcf(HELD.format(3), ">"))
    assert found.verdict.is_off and "0.49 of its dry friction" in found.remark
    for loss, option in ((3, 'gravity="0 0 0">'), (0.01, ">")):
        assert not result("model-slip", mjcf(HELD.format(loss), option)).verdict.is_off


SLIDING = """<mujoco><option timestep="0.002"/><worldbody><geom type="plane" size="9 9 1" friction="{mu}" priority="1"
  solref="{solref} 1"/><body name="puck" pos="0 0 {height}"><freejoint/><geom type="{kind}" size=".01 .01 .01"/></body>
  </worldbody><keyframe><key qvel="{speed} 0 0 0 0 0"/></keyframe></mujoco>"""

SLIDE = {"mu": 0.257, "solref": 0.004, "height": 0.01, "kind": "box", "speed": 4}


@pytest.mark.parametrize("speed", [2, 4])
def test_a_body_that_slides_on_a_plane_stays_on_it(speed):
    """A contact that stops a body within a step lifts it with mu v: it hops by mu^2 v^2 / (2 g)."""
    found = result("model-hop", SLIDING.format(**SLIDE | {"speed": speed}))
    law_mm = 1e3 * (0.257 * speed) ** 2 / (2.0 * 9.81)
    assert found.configured == pytest.approx(law_mm, rel=0.15)
    for right in ({"speed": 0.5, "solref": 0.02}, {"height": 0.1}, {"kind": "sphere"}):
        changed = SLIDE | {"solref": 0.02, "speed": 1} | right
        assert not result("model-hop", SLIDING.format(**changed)).verdict.is_off


def test_the_energy_of_a_motion_without_damping_stays():
    """Euler's method brakes a pole on a cart; the method of fourth order does not."""
    pole = """<body><joint type="slide" axis="1 0 0"{}/><geom size=".1" mass="2"/><body><joint axis="0 1 0"/>
      <geom size=".02" pos=".1 0 .3" mass=".5" contype="0"/></body></body>"""
    option = 'timestep=".01" integrator="{}">'
    loss = result("robot-energy", mjcf(pole.format(""), option.format("Euler")))
    assert "have no damping and lose" in loss.remark and loss.verdict.is_off
    for damping, integrator in (("", "RK4"), (' damping=".1"', "Euler")):
        xml = mjcf(pole.format(damping), option.format(integrator))
        assert not result("robot-energy", xml).verdict.is_off


def test_energy_that_a_motion_gains_is_compared_with_its_kinetic_energy():
    pendulum = """<body pos="0 0 1"><joint axis="0 1 0" damping="1e-9"/><geom size=".02" pos=".3 0 0" mass="1"/>
      <body pos=".3 0 0"><joint axis="0 1 0"/><geom size=".02" pos=".3 0 0" mass="1"/></body></body>"""
    flags = '<flag eulerdamp="disable"/>'
    found = result("robot-energy", mjcf(pendulum, f'timestep=".05">{flags}'))
    (numbers,) = re.findall(r"([\d.e+-]+) of ([\d.e+-]+) J", found.remark)
    gained_j, kinetic_j = map(float, numbers)
    assert found.verdict.is_off
    assert found.configured == pytest.approx(gained_j / kinetic_j, rel=0.01)
