"""A biped and a hand that have no flag, and mistakes in them, in an arm and in a quadruped."""

from __future__ import annotations

import arm_faults
import robot_faults
from arm_faults import DEGREE, planted, replaced, scaled

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

MISTAKES = planted(
    {
        "arm, visual geoms counted in the mass": (
            "robot-visual-mass",
            several(*(drawn(f"link{n}") for n in (1, 2, 3))),
        ),
        "arm, soft limits": ("robot-stops", "<joint ", f"<joint {SOFT} "),
        "arm, limits switched off": (
            "robot-unlimited",
            "(<option[^>]*)/>",
            r'\1><flag limit="disable"/></option>',
        ),
        "arm, under water": (
            "robot-medium",
            option('density="1000" viscosity="0.001"'),
        ),
        "arm, lengths in millimetres": ("robot-size", millimetres),
        "quadruped, wind": ("robot-medium", option('density="1.2" wind="20 0 0"')),
        "quadruped, torsional friction of 0.8 m": (
            "robot-torsion",
            'friction="0.8 0.005',
            'condim="4" friction="0.8 0.8',
        ),
        "quadruped, negative damping": (
            "robot-damping",
            'damping="0.5"',
            'damping="-0.5"',
        ),
        "biped, a reversed knee": ("robot-mirror", '(left_knee" axis="0 )1', r"\1-1"),
        "biped, both knees reversed": ("robot-balance", KNEES),
        "biped, uneven feet": ("robot-level", '(left_foot" pos="0 0 )-.35', r"\1-.31"),
        "biped, feet that cannot collide": (
            "robot-feet",
            '(<geom name="left_foot")',
            r'\1 contype="0" conaffinity="0"',
        ),
        "hand, friction of 0.05": (
            "robot-friction",
            'friction="1 0',
            'friction="0.05 0',
        ),
        "hand, soft couplings": (
            "robot-coupling",
            'solref="0.005 1" solimp="0.95 0.99 0.001"',
            'solref="0.5 1" solimp="0.5 0.6 0.01"',
        ),
        "hand, masses in grams": ("robot-density", scaled("mass", 1000.0)),
        "hand, two servos on one joint": (
            "robot-command",
            '<position joint="ring_inner"',
            '<position joint="index_inner"',
        ),
        "hand, commands in degrees": (
            "robot-command",
            "<position joint",
            '<position ctrlrange="-86 17" joint',
        ),
        "hand, fingers without limits": ("robot-unlimited", ' range="-1.5 .3"', ""),
    }
)
"""Mistakes that were known while the rows were written."""

LATER = planted(
    {
        "arm, one soft stop": ("robot-stops", '(name="joint3")', rf"\1 {SOFT}"),
        "arm, oil": ("robot-medium", option('viscosity="1"')),
        "arm, constraints switched off": (
            "robot-unlimited",
            "(<option[^>]*)/>",
            r'\1><flag constraint="disable"/></option>',
        ),
        "hand, contacts switched off": (
            "robot-overlap",
            "(<option[^>]*)/>",
            r'\1><flag contact="disable"/></option>',
        ),
        "biped, ranges that are not kept": (
            "robot-unlimited",
            '(<joint[^>]*)range="',
            r'\1limited="false" range="',
        ),
        "arm, centimetres": (
            "robot-size",
            several(*(scaled(n, 100.0) for n in ("pos", "fromto", "size"))),
        ),
        "arm, a visual geom of the elbow": ("robot-visual-mass", drawn("link2")),
        "quadruped, water": ("robot-medium", option('density="1000"')),
        "quadruped, rolling friction of 0.5 m": (
            "robot-torsion",
            'friction="0.8 0.005 0.0001',
            'condim="6" friction="0.8 0.005 0.5',
        ),
        "quadruped, millimetres": ("robot-size", millimetres),
        "quadruped, one knee with negative damping": (
            "robot-damping",
            '(name="RL_knee")',
            r'\1 damping="-0.1"',
        ),
        "quadruped, a hip that turns the other way": (
            "robot-mirror",
            '(name="FL_hip" axis="0 )1',
            r"\1-1",
        ),
        "quadruped, stops of cotton wool": (
            "robot-stops",
            "<joint armature",
            f"<joint {SOFT} armature",
        ),
        "biped, a trunk that leans": (
            "robot-balance",
            'type="box" pos="0 0 .2"',
            'type="box" pos=".5 0 .2"',
        ),
        "biped, a longer thigh": (
            "robot-level",
            '(right_shin" pos="0 0 )-.35',
            r"\1-.4",
        ),
        "biped, an ankle whose range was not turned": (
            "robot-mirror",
            several(
                replaced('(right_ankle" axis="0 1 0" range=")-1 1', r"\1-1.4 .2"),
            ),
        ),
        "biped, masses in grams": ("robot-density", scaled("mass", 1000.0)),
        "biped, kp per degree": (
            "robot-stiffness",
            several(scaled("kp", DEGREE), scaled("kv", DEGREE)),
        ),
        "biped, visual geoms counted": (
            "robot-visual-mass",
            several(drawn("torso"), drawn("left_foot"), drawn("right_foot")),
        ),
        "hand, one soft coupling": (
            "robot-coupling",
            '(joint1="thumb_outer".*?)solref="0.005 1" solimp="0.95 0.99 0.001"',
            r'\1solref="0.3 1"',
        ),
        "hand, one slippery pad": (
            "robot-friction",
            '(name="ring_pad".*?\n.*?)friction="1 0',
            r'\1friction="0.01 0',
        ),
        "hand, torsional friction of the pads": (
            "robot-torsion",
            'friction="1 0.005',
            'friction="1 0.5',
        ),
        "hand, soft stops": ("robot-stops", " axis=", f" {SOFT} axis="),
        "hand, millimetres": ("robot-size", millimetres),
        "hand, armature in g cm^2": ("robot-armature", scaled("armature", 1e4)),
        "hand, weak motors": ("robot-torque", scaled("forcerange", 0.01)),
        "hand, a finger without a limit": (
            "robot-unlimited",
            'range="-1.5 .3"',
            'range="-1.5 .3" limited="false"',
        ),
        "arm, kv as a damping ratio": ("robot-ringing", 'kv="[0-9]+"', 'kv="1"'),
        "arm, servos that do not read their bias": (
            "robot-command",
            '<position (.*?) kp="([0-9]+)" kv="([0-9]+)"',
            r'<general \1 gainprm="\2" biasprm="0 -\2 -\3"',
        ),
        "arm, gains ten times those of the bias": (
            "robot-command",
            '<position (.*?) kp="([0-9]+)" kv="([0-9]+)"',
            r'<general \1 biastype="affine" gainprm="\g<2>0" biasprm="0 -\2 -\3" ctrlrange="-3 3"',
        ),
        "quadruped, springs in its legs": (
            "robot-sag",
            "<joint armature",
            '<joint stiffness="80" armature',
        ),
        "quadruped, torques of one sign": (
            "robot-torque",
            'forcerange="-40',
            'forcerange="0',
        ),
        "quadruped, a floor that is drawn alone": (
            "robot-feet",
            'type="plane"',
            'type="plane" contype="0" conaffinity="0"',
        ),
        "biped, ankles without servos": (
            "robot-torque",
            several(
                replaced('<position joint="[a-z]+_ankle"[^>]*>', ""),
                replaced(' ctrl="[^"]*"', ' ctrl="0 -.3 .6 0 -.3 .6"'),
            ),
        ),
        "quadruped, a trunk whose centre is far ahead": (
            "robot-sides",
            '(name="trunk" type="box")',
            r'\1 pos=".12 0 0"',
        ),
        "biped, knees with a twentieth of their torque": (
            "robot-torque",
            '(_knee".*?forcerange=)"-120 120"',
            r'\1"-6 6"',
        ),
        "quadruped, a floor that is 10 cm higher": (
            "robot-stands",
            '(name="floor" type="plane")',
            r'\1 pos="0 0 .1"',
        ),
        "biped, a start in the ground": ("robot-stands", "[.]7287", ".5"),
    }
)
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


FURTHER = planted(
    {
        "quadruped, a bent shin": (
            "robot-sides",
            'name="RL_calf" pos',
            'name="RL_calf" euler="0 46 0" pos',
        ),
        "quadruped, a limb on the other side": (
            "robot-sides",
            'name="FL_thigh" pos="0.19 0.12',
            'name="FL_thigh" pos="0.19 -0.12',
        ),
        "hand, a servo without kv": (
            "robot-sides",
            '(joint="ring_inner" kp="2") kv=".05"',
            r"\1",
        ),
        "arm, a turned command": ("robot-command", servo('gear="-1"')),
        "arm, a narrow command": ("robot-command", servo('ctrlrange="-.1 .1"')),
        "quadruped, a command of half a range": (
            "robot-command",
            servo('ctrlrange="-.5 2"', "FL_hip"),
        ),
        "hand, a servo of speed": (
            "robot-command",
            general("ring_inner", "2", "0 0 -2"),
        ),
        "arm, a servo that pushes": (
            "robot-command",
            general("joint3", "2000", "0 2000 -200"),
        ),
        "biped, two swapped motors": (
            "robot-command",
            several(
                replaced(
                    '<position joint="([^"]*)"', r'<position name="\1" joint="\1"'
                ),
                replaced('joint="left_knee" kp', 'joint="X" kp'),
                replaced('joint="right_ankle" kp', 'joint="left_knee" kp'),
                replaced('joint="X" kp', 'joint="right_ankle" kp'),
            ),
        ),
        "arm, a link of ten times its mass": (
            "robot-alike",
            '(name="link2" type[^>]*)density="1000"',
            r'\1density="10000"',
        ),
        "arm, a filter": (
            "robot-delay",
            general("joint3", "2000", "0 -2000 -200", 'dyntype="filter" dynprm=".5"'),
        ),
        "arm, a range without the pose": (
            "robot-stops",
            '(name="joint3".*?range=)"[^"]*"',
            r'\1"80 115"',
        ),
        "arm, a range of degrees as radians": (
            "robot-range",
            '(name="joint3".*?range=)"[^"]*"',
            r'\1"-8594 8594"',
        ),
        "arm, a torque in N mm": (
            "robot-rotor",
            'forcerange="-28 28"',
            'forcerange="-28000 28000"',
            1,
        ),
        "arm, a torque in N cm": (
            "robot-frictionloss",
            'forcerange="-28 28"',
            'forcerange="-.28 .28"',
            1,
        ),
        "arm, a weightless link": (
            "robot-gravcomp",
            '<body name="link4"',
            '<body name="link4" gravcomp="1"',
        ),
        "hand, a foot of condim 1": (
            "robot-friction",
            '(name="ring_pad"[^>]*)condim="4"',
            r'\1condim="1"',
        ),
        "hand, a coupling per degree": (
            "robot-coupling",
            'polycoef="0 1 0',
            'polycoef="0 57.3 0',
            1,
        ),
        "hand, a coupling that is off": (
            "robot-coupling",
            'joint1="ring_outer"',
            'joint1="ring_outer" active="false"',
        ),
        "quadruped, a gear beside its torque": (
            "robot-torque",
            servo('gear="100"', "FL_hip"),
        ),
        "biped, a spring": (
            "robot-alike",
            'name="left_knee"',
            'name="left_knee" stiffness="20"',
        ),
        "arm, a stop that throws back": (
            "robot-stops",
            'name="joint3"',
            'name="joint3" solreflimit=".02 .1"',
        ),
        "biped, contacts that bounce": (
            "robot-solref",
            'solref="0.004 1"',
            'solref="0.004 0.2"',
        ),
        "hand, a link of centimetres": (
            "robot-joined",
            'name="ring_tip" pos="0 0 .05"',
            'name="ring_tip" pos="0 0 5"',
        ),
        "arm, a keyframe of other commands": (
            "robot-keyframe",
            'ctrl="0 -.5',
            'ctrl="0 .5',
        ),
        "biped, a free joint with the defaults of the others": (
            "robot-free",
            "<freejoint/>",
            '<joint name="root" type="free"/>',
        ),
        "biped, a foot that is lower": (
            "robot-sides",
            '(name="left_foot" type="box" pos=".03 0 )-.04',
            r"\1-.055",
        ),
        "biped, a leg apart in the keyframe": (
            "robot-sides",
            '0 -.3 .6 -.3 0 -.3 .6 -.3" ctrl',
            '.2 -.3 .6 -.3 0 -.3 .6 -.3" ctrl',
        ),
        "arm, a command of the other sign": (
            "robot-keyframe",
            several(
                replaced('qpos="0 -.5', 'qpos="0 -.2'),
                replaced('ctrl="0 -.5', 'ctrl="0 .2'),
            ),
        ),
        "hand, an uncoupled finger": (
            "robot-wiring",
            '<joint name="ring" joint1="ring_outer"[^>]*>',
            "",
        ),
        "hand, masses by geoms": (
            "robot-bound",
            several(
                replaced("<compiler", '<compiler inertiafromgeom="true"'),
                replaced(
                    '(<body name="palm">)',
                    r'\1<inertial pos="0 0 0" mass="2" diaginertia=".01 .01 .01"/>',
                ),
            ),
        ),
        "biped, a rotor of another motor": (
            "robot-armature",
            'name="left_hip_roll"',
            'name="left_hip_roll" armature="3"',
        ),
        "hand, an object of another layer": (
            "robot-wiring",
            "</worldbody>",
            '<body name="cube" pos="0 0 -.2"><freejoint/><geom size=".03" contype="2"'
            ' conaffinity="2"/></body><geom type="plane" size="1 1 1" pos="0 0 -.3" contype="2"/></worldbody>',
        ),
        "hand, an object in honey": (
            "robot-free",
            "</worldbody>",
            '<body pos="0 0 -.2"><joint type="free" damping="2"/><geom size=".03"/></body></worldbody>',
        ),
        "hand, an object in g/cm3": (
            "robot-density",
            "</worldbody>",
            '<body pos="0 0 -.2"><freejoint/><geom size=".03" density="1.2"/></body></worldbody>',
        ),
        "arm, a sensor of another joint": (
            "robot-wiring",
            "</mujoco>",
            '<sensor><jointvel name="joint1_vel" joint="joint1"/><jointvel name="joint2_vel" joint="joint3"/>'
            '<jointvel name="joint3_vel" joint="joint3"/></sensor></mujoco>',
        ),
        "hand, a fingertip that touches nothing": (
            "robot-wiring",
            'name="ring_pad"',
            'name="ring_pad" contype="0" conaffinity="0"',
        ),
        "arm, a keyframe beyond a range": (
            "robot-wiring",
            'qpos="0 -.5 1.2',
            'qpos="0 -.5 4.2',
        ),
        "quadruped, friction in another order": (
            "robot-torsion",
            'friction="0.8 0.005 0.0001"',
            'friction="0.0001 0.8 0.005"',
        ),
        "biped, a keyframe turned in the order x y z w": (
            "robot-wiring",
            'qpos="0 0 .7287 1 0 0 0',
            'qpos="0 0 .7287 0 0 0 1',
        ),
        "arm, a gyro of another site": (
            "robot-wiring",
            several(
                replaced('(<body name="link1"[^>]*>)', r'\1<site name="base"/>'),
                replaced('(<body name="link3"[^>]*>)', r'\1<site name="tip"/>'),
                replaced(
                    "</mujoco>",
                    '<sensor><gyro name="tip_gyro" site="base"/><gyro name="base_gyro" site="base"/></sensor></mujoco>',
                ),
            ),
        ),
        "arm, a site in millimetres": (
            "robot-wiring",
            '(<body name="link3"[^>]*>)',
            r'\1<site name="imu" pos="30 0 20"/>',
        ),
        "arm, a lost armature": (
            "robot-rotor",
            '(name="joint3".*?armature=)"0.1"',
            r'\1"0.0001"',
        ),
        "arm, a centre of mass in the frame of the world": (
            "robot-inertia",
            '(<body name="link2"[^>]*>)',
            r'\1<inertial pos=".3 0 1" mass="5" diaginertia=".1 .1 .1"/>',
        ),
    }
)
"""Single parts that one row alone names."""
