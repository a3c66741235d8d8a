"""A quadruped with position servos that has no flag, and mistakes of people, each planted in a copy of it."""

from __future__ import annotations

import re

FEET = {
    "FL": (0.19, 0.12),
    "FR": (0.19, -0.12),
    "RL": (-0.19, 0.12),
    "RR": (-0.19, -0.12),
}


def good_xml():
    """Return the quadruped: 15 kg, feet of 22 mm, servos of 80 Nm/rad, and the contact settings of docs/sanity.md."""
    legs, servos = "", ""
    for leg, (x, y) in FEET.items():
        legs += f"""
      <body name="{leg}_thigh" pos="{x} {y} 0"><joint name="{leg}_hip" axis="0 1 0" range="-60 240"/>
        <geom name="{leg}_thigh" type="capsule" fromto="0 0 0 -.15 0 -.15" size=".025" density="1200"
          contype="0" conaffinity="0"/>
        <body name="{leg}_calf" pos="-.15 0 -.15"><joint name="{leg}_knee" axis="0 1 0" range="-170 170"/>
          <geom name="{leg}_calf" type="capsule" fromto="0 0 0 .15 0 -.15" size=".015" density="1200"/>
          <geom name="{leg}_foot" pos=".15 0 -.15" size=".022" density="1200"/></body></body>"""
        for joint in ("hip", "knee"):
            servos += f'<position name="{leg}_{joint}" joint="{leg}_{joint}" kp="80" kv="2" forcerange="-40 40"/>'
    return f"""<mujoco model="quadruped">
  <option timestep="0.002" integrator="implicitfast" cone="elliptic" impratio="100"/>
  <default><geom friction="0.8 0.005 0.0001" solref="0.004 1" solimp="0.95 0.95 0.001"/>
    <joint armature="0.005" damping="0.5" frictionloss="0.2"/></default>
  <worldbody><geom name="floor" type="plane" size="5 5 .1"/>
    <body name="trunk" pos="0 0 .322"><freejoint/>
      <geom name="trunk" type="box" size=".2 .08 .05" density="1500"/>{legs}</body></worldbody>
  <actuator>{servos}</actuator>
  <keyframe><key name="home" qpos="0 0 .322 1 0 0 0 0 0 0 0 0 0 0 0"/></keyframe>
</mujoco>"""


class Fault:
    """A mistake.

    Attributes:
        thread: Issue or pull request in which people made it.
        rows: Rows in which it must show, at least one of them.
        changes: Texts of the model and what replaces them.
    """

    def __init__(self, thread, rows, *texts):
        self.thread, self.rows = thread, tuple(rows.split())
        self.changes = [*zip(texts[::2], texts[1::2], strict=True)]

    def xml(self):
        """Return the model with the fault."""
        text = good_xml()
        for old, new in self.changes:
            assert re.search(old, text), old
            text = re.sub(old, new, text)
        return text


OPTION = 'timestep="0.002" integrator="implicitfast" cone="elliptic" impratio="100"'
SOLREF = 'solref="0.004 1" solimp="0.95 0.95 0.001"'

FAULTS = {
    "foot_cannot_collide": Fault(
        "mjlab#477", "robot-feet", '(name="FL_foot")', r'\1 contype="0" conaffinity="0"'
    ),
    "feet_cannot_collide": Fault(
        "kos-sim#38",
        "robot-feet",
        '(name=".._foot")',
        r'\1 contype="0" conaffinity="0"',
    ),
    "feet_have_other_bits": Fault(
        "urdf2mjcf#49",
        "robot-feet",
        '(name="R._foot")',
        r'\1 contype="2" conaffinity="2"',
    ),
    "one_foot_condim_1": Fault(
        "dm_control#28",
        "robot-friction",
        '(name="FL_foot")',
        r'\1 condim="1" priority="1"',
    ),
    "all_condim_1": Fault(
        "dm_control#28",
        "robot-friction",
        "(<geom friction)",
        '<geom condim="1" friction',
    ),
    "zero_friction_randomized": Fault(
        "mjlab#267",
        "robot-friction",
        'friction="0.8 0.005 0.0001"',
        'friction="0 0.005 0.0001"',
    ),
    "friction_of_8": Fault(
        "mujoco#449", "robot-friction", 'friction="0.8', 'friction="8'
    ),
    "slippery_floor_loses": Fault(
        "genesis-world#2718",
        "robot-floor-friction",
        '(name="floor")',
        r'\1 friction="0.1 0.005 0.0001"',
    ),
    "slippery_foot_loses": Fault(
        "newton#2422",
        "robot-floor-friction",
        '(name="FL_foot")',
        r'\1 friction="0.3 0.005 0.0001"',
    ),
    "floor_tilted_3_degrees": Fault(
        "Replica-Dataset#22", "floor-tilt", '(name="floor")', r'\1 euler="3.4 0 0"'
    ),
    "floor_tilted_1_degree": Fault(
        "Replica-Dataset#22", "floor-tilt", '(name="floor")', r'\1 euler="0 1 0"'
    ),
    "gravity_sideways": Fault(
        "mujoco#207", "gravity robot-stands", "<option", '<option gravity="0 -9.81 0"'
    ),
    "gravity_of_the_moon": Fault(
        "mujoco#464", "gravity", "<option", '<option gravity="0 0 -1.62"'
    ),
    "gravity_up": Fault("circus#7", "gravity", "<option", '<option gravity="0 0 9.81"'),
    "density_in_g_per_cm3": Fault(
        "mujoco#1472", "robot-density", 'density="1500"', 'density="1.5"'
    ),
    "trunk_in_grams": Fault(
        "mujoco#152", "robot-density", 'density="1500"', 'mass="9600"'
    ),
    "links_without_mass": Fault(
        "newton#3592", "robot-density", 'density="1200"', 'mass="0.0001"'
    ),
    "inertia_in_kg_mm2": Fault(
        "compas_fab#486",
        "robot-inertia",
        '<geom name="trunk"',
        '<inertial pos="0 0 0" mass="9.6" diaginertia="29000 136000 149000"/><geom name="trunk"',
    ),
    "boundmass": Fault(
        "newton#3741", "robot-bound", "<option", '<compiler boundmass="1"/><option'
    ),
    "boundinertia": Fault(
        "mujoco#320", "robot-bound", "<option", '<compiler boundinertia="0.05"/><option'
    ),
    "inertia_of_a_larger_body": Fault(
        "mujoco_menagerie#281",
        "robot-inertia",
        '<geom name="trunk"',
        '<inertial pos="0 0 0" mass="9.6" diaginertia="5 5 5"/><geom name="trunk"',
    ),
    "gravcomp": Fault(
        "mujoco_menagerie#254",
        "robot-gravcomp",
        '<body name="trunk"',
        '<body name="trunk" gravcomp="1"',
    ),
    "forcerange_by_100": Fault(
        "mujoco#2748",
        "robot-torque robot-saturation robot-stands",
        'forcerange="-40 40"',
        'forcerange="-.4 .4"',
    ),
    "gear_of_a_tenth": Fault(
        "mujoco#250",
        "robot-stands robot-torque robot-loads",
        'kp="80" kv="2" forcerange="-40 40"',
        'kp="80" kv="2" forcerange="-40 40" gear=".1"',
    ),
    "no_kp": Fault(
        "mujoco#1371", "robot-stands robot-loads", 'kp="80" kv="2"', 'kp="1" kv="0.1"'
    ),
    "kp_diverges": Fault("mujoco#3443", "robot-servo", 'kp="80"', 'kp="80000"'),
    "kp_and_kv_explode": Fault(
        "mujoco_menagerie#232",
        "robot-servo",
        OPTION,
        'timestep="0.01" integrator="Euler" cone="elliptic" impratio="100"',
        'kp="80" kv="2"',
        'kp="2000" kv="100"',
    ),
    "no_armature": Fault(
        "mujoco#989",
        "robot-servo",
        'armature="0.005"',
        'armature="0"',
        'kp="80" kv="2"',
        'kp="40000" kv="2"',
    ),
    "damping_by_40": Fault(
        "mujoco#184", "robot-damping", 'damping="0.5"', 'damping="20"'
    ),
    "friction_loss_by_60": Fault(
        "unitree_ros#130",
        "robot-frictionloss",
        'frictionloss="0.2"',
        'frictionloss="12"',
    ),
    "armature_by_100": Fault(
        "mujoco#1593", "robot-armature", 'armature="0.005"', 'armature="1"'
    ),
    "trunk_too_large": Fault(
        "mujoco_menagerie#73",
        "robot-overlap",
        'size=".2 .08 .05" density="1500"',
        'size=".4 .16 .34" mass="10"',
    ),
    "legs_overlap": Fault(
        "mujoco#168", "robot-overlap", '(pos="-0.19 0.12 0")', 'pos="0.18 0.12 0"'
    ),
    "parts_of_a_leg_overlap": Fault(
        "mujoco#1751",
        "robot-overlap",
        '(name="trunk" type="box" size=")[^"]*',
        r"\1.2 .16 .05",
        '(_thigh" type="capsule"[^/]*)contype="0" conaffinity="0"',
        r"\1",
        '<body name="(..)_thigh" pos="(\\S+) (\\S+) 0">',
        r'<body name="\1_hipbox" pos="\2 \3 0"><joint axis="1 0 0" range="-1 1"/>'
        r'<geom size=".01" contype="0" conaffinity="0"/><body name="\1_thigh">',
        "</body></body>(?=\n|</body></worldbody>)",
        "</body></body></body>",
        'qpos="[^"]*"',
        'qpos="0 0 .322 1 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0"',
    ),
    "starts_in_the_ground": Fault(
        "mujoco_menagerie#70",
        "robot-stands robot-loads robot-holds",
        'qpos="0 0 .322',
        'qpos="0 0 .1',
    ),
    "margin_of_the_floor": Fault(
        "mujoco#1817", "rest-height release", '(name="floor")', r'\1 margin="0.02"'
    ),
    "margin_of_all": Fault(
        "mujoco#773",
        "rest-height release",
        "<geom friction",
        '<geom margin="0.01" friction',
    ),
    "soft_ground": Fault(
        "robosuite#75",
        "rest-height creep-wood",
        SOLREF,
        'solref="0.2 1" solimp="0.95 0.95 0.001"',
    ),
    "solimp_from_zero": Fault(
        "mujoco#1124",
        "rest-height creep-wood",
        SOLREF,
        'solref="0.02 1" solimp="0 0.8 0.01"',
    ),
    "stiffness_as_solref": Fault(
        "mujoco#1165",
        "rest-height",
        SOLREF,
        'solref="-50 -14" solimp="0.95 0.95 0.001"',
    ),
    "tiny_solref_without_refsafe": Fault(
        "mujoco#546",
        "creep-wood foot-creep rest-height",
        f"<option {OPTION}/>",
        f'<option {OPTION}><flag refsafe="disable"/></option>',
        'solref="0.004 1"',
        'solref="0.0005 1"',
    ),
    "pyramidal_cone": Fault(
        "mujoco#3328",
        "slide-turned",
        'cone="elliptic" impratio="100"',
        'cone="pyramidal"',
    ),
    "impratio_of_a_tenth": Fault(
        "mujoco_warp#261",
        "creep-wood foot-creep robot-slip",
        'impratio="100"',
        'impratio="0.1"',
    ),
    "no_impratio": Fault(
        "mujoco#565",
        "foot-creep robot-slip",
        OPTION,
        'timestep="0.002" integrator="implicitfast" cone="elliptic"',
        SOLREF,
        'solref="0.02 1"',
    ),
    "one_iteration": Fault(
        "mujoco#1545",
        "foot-push foot-slide slide-wood slide-turned",
        OPTION,
        'timestep="0.004" iterations="1" ls_iterations="5"',
        SOLREF,
        "",
    ),
    "override": Fault(
        "moveit_pro_example_ws#811",
        "creep-wood rest-height foot-creep",
        f"<option {OPTION}/>",
        f'<option {OPTION} o_solref="0.02 1" o_solimp="0 0.8 0.01" '
        'o_friction="0.8 0.8 0.005 0.0001 0.0001"><flag override="enable"/></option>',
    ),
    "step_of_20_ms": Fault(
        "mujoco#954",
        "point robot-servo robot-stands",
        'timestep="0.002"',
        'timestep="0.02"',
    ),
    "euler_without_eulerdamp": Fault(
        "mujoco#548",
        "robot-servo robot-holds",
        f"<option {OPTION}/>",
        '<option timestep="0.01" cone="elliptic" impratio="100"><flag eulerdamp="disable"/></option>',
        'damping="0.5"',
        'damping="4"',
    ),
    "scaled_ten_times_smaller": Fault(
        "mujoco#989",
        "robot-density",
        '(name="trunk" type="box" size=")[^"]*" density="1500"',
        r'\1.02 .008 .005" mass="9.6"',
    ),
}
"""Mistakes by name."""
