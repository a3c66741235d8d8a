"""A biped and a hand that have no flag, and mistakes in them, in an arm and in a quadruped."""

from __future__ import annotations

import arm_faults
import robot_faults
from arm_faults import DEGREE, replaced, scaled

DEFAULTS = """<option timestep="0.002" integrator="implicitfast" cone="elliptic" impratio="100"/>
  <default><geom friction="0.8 0.005 0.0001" solref="0.004 1" solimp="0.95 0.95 0.001"/></default>"""


def biped_xml() -> str:
    """Return the biped: 30 kg, 0.9 m, legs of five joints, and a keyframe with bent knees over its feet."""
    legs, servos = "", ""
    for side, y in (("left", 0.1), ("right", -0.1)):
        roll = "-.3 .6" if side == "left" else "-.6 .3"
        legs += f"""
      <body name="{side}_hip" pos="0 {y} 0"><joint name="{side}_hip_roll" axis="1 0 0" range="{roll}"/>
        <geom name="{side}_hip" size=".05" mass="1.5" contype="0" conaffinity="0"/>
        <body name="{side}_thigh"><joint name="{side}_hip_pitch" axis="0 1 0" range="-1.6 1"/>
          <geom name="{side}_thigh" type="capsule" fromto="0 0 -.05 0 0 -.3" size=".05" mass="3"
            contype="0" conaffinity="0"/>
          <body name="{side}_shin" pos="0 0 -.35"><joint name="{side}_knee" axis="0 1 0" range="0 2.3"/>
            <geom name="{side}_shin" type="capsule" fromto="0 0 -.05 0 0 -.3" size=".04" mass="2"
              contype="0" conaffinity="0"/>
            <body name="{side}_foot" pos="0 0 -.35"><joint name="{side}_ankle" axis="0 1 0" range="-1 1"/>
              <geom name="{side}_foot" type="box" pos=".03 0 -.04" size=".11 .04 .02" mass=".8"/>
            </body></body></body></body>"""
        for joint in ("hip_roll", "hip_pitch", "knee", "ankle"):
            servos += f'<position joint="{side}_{joint}" kp="400" kv="15" forcerange="-120 120"/>'
    pose = "0 -.3 .6 -.3 0 -.3 .6 -.3"
    return f"""<mujoco model="biped"><compiler angle="radian"/>
  {DEFAULTS}<default class="joints"><joint armature="0.02" damping="1" frictionloss="0.5"/></default>
  <worldbody><geom name="floor" type="plane" size="5 5 .1"/>
    <body name="torso" pos="0 0 .7287" childclass="joints"><freejoint/>
      <geom name="torso" type="box" pos="0 0 .2" size=".08 .13 .18" mass="15"/>{legs}</body></worldbody>
  <actuator>{servos}</actuator>
  <keyframe><key name="home" qpos="0 0 .7287 1 0 0 0 {pose}" ctrl="{pose}"/></keyframe>
</mujoco>""".replace(
        DEFAULTS + '<default class="joints">',
        DEFAULTS.replace("</default>", '<default class="joints">'),
    ).replace(
        'frictionloss="0.5"/></default>', 'frictionloss="0.5"/></default></default>'
    )


def hand_xml() -> str:
    """Return the hand: a palm of 0.5 kg on a wrist, and three fingers whose outer hinge follows the inner one."""
    digits, servos, couplings = "", "", ""
    for name, y in (("index", 0.03), ("ring", -0.03), ("thumb", 0.0)):
        x = -0.035 if name == "thumb" else 0.035
        axis = "0 -1 0" if name == "thumb" else "0 1 0"
        digits += f"""
      <body name="{name}" pos="{x} {y} .11"><joint name="{name}_inner" axis="{axis}" range="-1.5 .3"/>
        <geom name="{name}" type="capsule" fromto="0 0 .01 0 0 .04" size=".009" mass=".02"/>
        <body name="{name}_tip" pos="0 0 .05"><joint name="{name}_outer" axis="{axis}" range="-1.5 .3"/>
          <geom name="{name}_pad" type="capsule" fromto="0 0 0 0 0 .02" size=".009" mass=".012" condim="4"
            priority="1" friction="1 0.005 0.0001"/></body></body>"""
        servos += (
            f'<position joint="{name}_inner" kp="2" kv=".05" forcerange="-.6 .6"/>'
        )
        couplings += (
            f'<joint name="{name}" joint1="{name}_outer" joint2="{name}_inner" polycoef="0 1 0 0 0" '
            'solref="0.005 1" solimp="0.95 0.99 0.001"/>'
        )
    return f"""<mujoco model="hand"><compiler angle="radian"/>
  {DEFAULTS.replace("</default>", '<joint armature="0.0005" damping="0.01" frictionloss="0.01"/></default>')}
  <worldbody><geom name="floor" type="plane" size="2 2 .1" pos="0 0 -.3"/>
    <body name="palm"><joint name="wrist" axis="0 1 0" range="-1.2 1.2" armature=".01" damping=".1" frictionloss=".1"/>
      <geom name="palm" type="box" pos="0 0 .05" size=".045 .045 .045" mass=".5"/>{digits}</body></worldbody>
  <equality>{couplings}</equality>
  <contact><exclude body1="palm" body2="index"/><exclude body1="palm" body2="ring"/>
    <exclude body1="palm" body2="thumb"/>
  </contact>
  <actuator><position joint="wrist" kp="30" kv="1" forcerange="-8 8"/>{servos}</actuator>
</mujoco>"""


GOOD = {
    "arm": arm_faults.good_xml,
    "quadruped": robot_faults.good_xml,
    "biped": biped_xml,
    "hand": hand_xml,
}
"""Robots without a flag."""


def option(text: str):
    """Return a function that adds attributes to `<option>`."""
    return replaced("<option", f"<option {text}")


def millimetres(text: str) -> str:
    """Return a model with lengths in millimetres and the masses of the right one."""
    for name in ("pos", "fromto", "size"):
        text = scaled(name, 1000.0)(text)
    return text


def drawn(name: str):
    """Return a function that doubles a geom by a visual one with the same mass."""

    def change(text: str) -> str:
        (geom,) = [
            part for part in text.split("<") if part.startswith(f'geom name="{name}"')
        ]
        visual = geom.replace(f'name="{name}"', f'name="{name}_visual" group="2"', 1)
        visual = visual.replace("/>", ' contype="0" conaffinity="0"/>', 1)
        return text.replace(f"<{geom}", f"<{geom}<{visual}", 1)

    return change


def several(*changes):
    """Return a function that makes one change after the other."""

    def change(text: str) -> str:
        for one in changes:
            text = one(text)
        return text

    return change


KNEES = replaced('(_knee" axis="0 )1( 0")', r"\1-1\2")
SOFT = 'solreflimit="0.5 1" solimplimit="0.5 0.6 0.01"'

MISTAKES = {
    "arm, visual geoms counted in the mass": (
        several(*(drawn(f"link{n}") for n in (1, 2, 3))),
        "robot-visual-mass",
    ),
    "arm, soft limits": (replaced("<joint ", f"<joint {SOFT} "), "robot-stops"),
    "arm, limits switched off": (
        replaced("(<option[^>]*)/>", r'\1><flag limit="disable"/></option>'),
        "robot-unlimited",
    ),
    "arm, under water": (option('density="1000" viscosity="0.001"'), "robot-medium"),
    "arm, lengths in millimetres": (millimetres, "robot-size"),
    "quadruped, wind": (option('density="1.2" wind="20 0 0"'), "robot-medium"),
    "quadruped, torsional friction of 0.8 m": (
        replaced('friction="0.8 0.005', 'condim="4" friction="0.8 0.8'),
        "robot-torsion",
    ),
    "quadruped, negative damping": (
        replaced('damping="0.5"', 'damping="-0.5"'),
        "robot-damping",
    ),
    "biped, a reversed knee": (
        replaced('(left_knee" axis="0 )1', r"\1-1"),
        "robot-mirror",
    ),
    "biped, both knees reversed": (KNEES, "robot-balance"),
    "biped, uneven feet": (
        replaced('(left_foot" pos="0 0 )-.35', r"\1-.31"),
        "robot-level",
    ),
    "biped, feet that cannot collide": (
        replaced('(<geom name="left_foot")', r'\1 contype="0" conaffinity="0"'),
        "robot-feet",
    ),
    "hand, friction of 0.05": (
        replaced('friction="1 0', 'friction="0.05 0'),
        "robot-friction",
    ),
    "hand, soft couplings": (
        replaced(
            'solref="0.005 1" solimp="0.95 0.99 0.001"',
            'solref="0.5 1" solimp="0.5 0.6 0.01"',
        ),
        "robot-coupling",
    ),
    "hand, masses in grams": (scaled("mass", 1000.0), "robot-density"),
    "hand, two servos on one joint": (
        replaced('<position joint="ring_inner"', '<position joint="index_inner"'),
        "robot-command",
    ),
    "hand, commands in degrees": (
        replaced("<position joint", '<position ctrlrange="-86 17" joint'),
        "robot-command",
    ),
    "hand, fingers without limits": (
        replaced(' range="-1.5 .3"', ""),
        "robot-unlimited",
    ),
}
"""Mistakes that were known while the rows were written."""

LATER = {
    "arm, one soft stop": (
        replaced('(name="joint3")', rf"\1 {SOFT}"),
        "robot-stops",
    ),
    "arm, oil": (option('viscosity="1"'), "robot-medium"),
    "arm, constraints switched off": (
        replaced("(<option[^>]*)/>", r'\1><flag constraint="disable"/></option>'),
        "robot-unlimited",
    ),
    "hand, contacts switched off": (
        replaced("(<option[^>]*)/>", r'\1><flag contact="disable"/></option>'),
        "robot-overlap",
    ),
    "biped, ranges that are not kept": (
        replaced('(<joint[^>]*)range="', r'\1limited="false" range="'),
        "robot-unlimited",
    ),
    "arm, centimetres": (
        several(*(scaled(n, 100.0) for n in ("pos", "fromto", "size"))),
        "robot-size",
    ),
    "arm, a visual geom of the elbow": (drawn("link2"), "robot-visual-mass"),
    "quadruped, water": (option('density="1000"'), "robot-medium"),
    "quadruped, rolling friction of 0.5 m": (
        replaced('friction="0.8 0.005 0.0001', 'condim="6" friction="0.8 0.005 0.5'),
        "robot-torsion",
    ),
    "quadruped, millimetres": (millimetres, "robot-size"),
    "quadruped, one knee with negative damping": (
        replaced('(name="RL_knee")', r'\1 damping="-0.1"'),
        "robot-damping",
    ),
    "quadruped, a hip that turns the other way": (
        replaced('(name="FL_hip" axis="0 )1', r"\1-1"),
        "robot-mirror",
    ),
    "quadruped, stops of cotton wool": (
        replaced("<joint armature", f"<joint {SOFT} armature"),
        "robot-stops",
    ),
    "biped, a trunk that leans": (
        replaced('type="box" pos="0 0 .2"', 'type="box" pos=".5 0 .2"'),
        "robot-balance",
    ),
    "biped, a longer thigh": (
        replaced('(right_shin" pos="0 0 )-.35', r"\1-.4"),
        "robot-level",
    ),
    "biped, an ankle whose range was not turned": (
        several(
            replaced('(right_ankle" axis="0 1 0" range=")-1 1', r"\1-1.4 .2"),
        ),
        "robot-mirror",
    ),
    "biped, masses in grams": (scaled("mass", 1000.0), "robot-density"),
    "biped, kp per degree": (
        several(scaled("kp", DEGREE), scaled("kv", DEGREE)),
        "robot-stiffness",
    ),
    "biped, visual geoms counted": (
        several(drawn("torso"), drawn("left_foot"), drawn("right_foot")),
        "robot-visual-mass",
    ),
    "hand, one soft coupling": (
        replaced(
            '(joint1="thumb_outer".*?)solref="0.005 1" solimp="0.95 0.99 0.001"',
            r'\1solref="0.3 1"',
        ),
        "robot-coupling",
    ),
    "hand, one slippery pad": (
        replaced('(name="ring_pad".*?\n.*?)friction="1 0', r'\1friction="0.01 0'),
        "robot-friction",
    ),
    "hand, torsional friction of the pads": (
        replaced('friction="1 0.005', 'friction="1 0.5'),
        "robot-torsion",
    ),
    "hand, soft stops": (
        replaced(" axis=", f" {SOFT} axis="),
        "robot-stops",
    ),
    "hand, millimetres": (millimetres, "robot-size"),
    "hand, armature in g cm^2": (scaled("armature", 1e4), "robot-armature"),
    "hand, weak motors": (scaled("forcerange", 0.01), "robot-torque"),
    "hand, a finger without a limit": (
        replaced('range="-1.5 .3"', 'range="-1.5 .3" limited="false"'),
        "robot-unlimited",
    ),
    "arm, kv as a damping ratio": (
        replaced('kv="[0-9]+"', 'kv="1"'),
        "robot-ringing",
    ),
    "arm, servos that do not read their bias": (
        replaced(
            '<position (.*?) kp="([0-9]+)" kv="([0-9]+)"',
            r'<general \1 gainprm="\2" biasprm="0 -\2 -\3"',
        ),
        "robot-command",
    ),
    "arm, gains ten times those of the bias": (
        replaced(
            '<position (.*?) kp="([0-9]+)" kv="([0-9]+)"',
            r'<general \1 biastype="affine" gainprm="\g<2>0" biasprm="0 -\2 -\3" ctrlrange="-3 3"',
        ),
        "robot-command",
    ),
    "quadruped, springs in its legs": (
        replaced("<joint armature", '<joint stiffness="80" armature'),
        "robot-sag",
    ),
    "quadruped, torques of one sign": (
        replaced('forcerange="-40', 'forcerange="0'),
        "robot-torque",
    ),
    "quadruped, a floor that is drawn alone": (
        replaced('type="plane"', 'type="plane" contype="0" conaffinity="0"'),
        "robot-feet",
    ),
    "biped, ankles without servos": (
        several(
            replaced('<position joint="[a-z]+_ankle"[^>]*>', ""),
            replaced(' ctrl="[^"]*"', ' ctrl="0 -.3 .6 0 -.3 .6"'),
        ),
        "robot-torque",
    ),
    "quadruped, a trunk whose centre is far ahead": (
        replaced('(name="trunk" type="box")', r'\1 pos=".12 0 0"'),
        "robot-sides",
    ),
    "biped, knees with a twentieth of their torque": (
        replaced('(_knee".*?forcerange=)"-120 120"', r'\1"-6 6"'),
        "robot-torque",
    ),
    "quadruped, a floor that is 10 cm higher": (
        replaced('(name="floor" type="plane")', r'\1 pos="0 0 .1"'),
        "robot-stands",
    ),
    "biped, a start in the ground": (
        replaced("[.]7287", ".5"),
        "robot-stands",
    ),
}
"""Mistakes that were written after the rows and their limits."""


def servo(attributes: str, joint: str = "joint3"):
    """Return a function that adds attributes to the servo of a joint."""
    return replaced(f'(<position [^>]*joint="{joint}")', rf"\1 {attributes}")


def general(joint: str, gain: str, bias: str, more: str = ""):
    """Return a function that states the gain and the bias of a servo."""
    stated = f'biastype="affine" gainprm="{gain}" biasprm="{bias}" {more}'
    return replaced(
        f'<position ([^>]*joint="{joint}") kp="[^"]*" kv="[^"]*"',
        rf"<general \1 {stated}",
    )


FURTHER = {
    "quadruped, a bent shin": (
        replaced('name="RL_calf" pos', 'name="RL_calf" euler="0 46 0" pos'),
        "robot-sides",
    ),
    "quadruped, a limb on the other side": (
        replaced('name="FL_thigh" pos="0.19 0.12', 'name="FL_thigh" pos="0.19 -0.12'),
        "robot-sides",
    ),
    "hand, a servo without kv": (
        replaced('(joint="ring_inner" kp="2") kv=".05"', r"\1"),
        "robot-sides",
    ),
    "arm, a turned command": (servo('gear="-1"'), "robot-command"),
    "arm, a narrow command": (servo('ctrlrange="-.1 .1"'), "robot-command"),
    "quadruped, a command of half a range": (
        servo('ctrlrange="-.5 2"', "FL_hip"),
        "robot-command",
    ),
    "hand, a servo of speed": (general("ring_inner", "2", "0 0 -2"), "robot-command"),
    "arm, a servo that pushes": (
        general("joint3", "2000", "0 2000 -200"),
        "robot-command",
    ),
    "biped, two swapped motors": (
        several(
            replaced('<position joint="([^"]*)"', r'<position name="\1" joint="\1"'),
            replaced('joint="left_knee" kp', 'joint="X" kp'),
            replaced('joint="right_ankle" kp', 'joint="left_knee" kp'),
            replaced('joint="X" kp', 'joint="right_ankle" kp'),
        ),
        "robot-command",
    ),
    "arm, a link of ten times its mass": (
        replaced('(name="link2" type[^>]*)density="1000"', r'\1density="10000"'),
        "robot-alike",
    ),
    "arm, a filter": (
        general("joint3", "2000", "0 -2000 -200", 'dyntype="filter" dynprm=".5"'),
        "robot-delay",
    ),
    "arm, a range without the pose": (
        replaced('(name="joint3".*?range=)"[^"]*"', r'\1"80 115"'),
        "robot-stops",
    ),
    "arm, a range of degrees as radians": (
        replaced('(name="joint3".*?range=)"[^"]*"', r'\1"-8594 8594"'),
        "robot-range",
    ),
    "arm, a torque in N mm": (
        replaced('forcerange="-28 28"', 'forcerange="-28000 28000"', 1),
        "robot-rotor",
    ),
    "arm, a torque in N cm": (
        replaced('forcerange="-28 28"', 'forcerange="-.28 .28"', 1),
        "robot-frictionloss",
    ),
    "arm, a weightless link": (
        replaced('<body name="link4"', '<body name="link4" gravcomp="1"'),
        "robot-gravcomp",
    ),
    "hand, a foot of condim 1": (
        replaced('(name="ring_pad"[^>]*)condim="4"', r'\1condim="1"'),
        "robot-friction",
    ),
    "hand, a coupling per degree": (
        replaced('polycoef="0 1 0', 'polycoef="0 57.3 0', 1),
        "robot-coupling",
    ),
    "hand, a coupling that is off": (
        replaced('joint1="ring_outer"', 'joint1="ring_outer" active="false"'),
        "robot-coupling",
    ),
    "quadruped, a gear beside its torque": (
        servo('gear="100"', "FL_hip"),
        "robot-torque",
    ),
    "biped, a spring": (
        replaced('name="left_knee"', 'name="left_knee" stiffness="20"'),
        "robot-alike",
    ),
    "arm, a stop that throws back": (
        replaced('name="joint3"', 'name="joint3" solreflimit=".02 .1"'),
        "robot-stops",
    ),
    "biped, contacts that bounce": (
        replaced('solref="0.004 1"', 'solref="0.004 0.2"'),
        "robot-solref",
    ),
    "hand, a link of centimetres": (
        replaced('name="ring_tip" pos="0 0 .05"', 'name="ring_tip" pos="0 0 5"'),
        "robot-joined",
    ),
    "arm, a keyframe of other commands": (
        replaced('ctrl="0 -.5', 'ctrl="0 .5'),
        "robot-keyframe",
    ),
    "biped, a free joint with the defaults of the others": (
        replaced("<freejoint/>", '<joint name="root" type="free"/>'),
        "robot-free",
    ),
    "arm, a lost armature": (
        replaced('(name="joint3".*?armature=)"0.1"', r'\1"0.0001"'),
        "robot-rotor",
    ),
    "arm, a centre of mass in the frame of the world": (
        replaced(
            '(<body name="link2"[^>]*>)',
            r'\1<inertial pos=".3 0 1" mass="5" diaginertia=".1 .1 .1"/>',
        ),
        "robot-inertia",
    ),
}
"""Single parts that one row alone names."""
