"""An arm on a fixed base that has no flag, and mistakes of people, each planted in a copy of it."""

from __future__ import annotations

import re

import mujoco

from gauge_envs.tools.sanity.robot.mujoco_model import mujoco_configuration

LINKS = (
    # Length [m], radius [m], axis, range [deg], kp, kv, largest torque [Nm], friction loss [Nm].
    (0.15, 0.060, "0 0 1", "-170 170", 2000, 200, 150, 4.0),
    (0.40, 0.055, "0 1 0", "-120 120", 2000, 200, 150, 4.0),
    (0.35, 0.050, "0 1 0", "-150 150", 2000, 200, 150, 4.0),
    (0.12, 0.045, "0 1 0", "-170 170", 500, 25, 28, 1.0),
    (0.10, 0.040, "0 0 1", "-170 170", 500, 25, 28, 1.0),
    (0.08, 0.035, "0 1 0", "-170 170", 500, 25, 28, 1.0),
)
"""Links from the base to the wrist, of the size and strength of an arm for 5 kg."""


def good_xml() -> str:
    """Return the arm: 18 kg, geared servos, friction and armature in every joint, and a keyframe with a bent elbow."""
    bodies, servos, place = "", "", 0.1
    for number, (long, radius, axis, span, kp, kv, torque, loss) in enumerate(LINKS, 1):
        bodies += f"""
      <body name="link{number}" pos="0 0 {place}">
        <joint name="joint{number}" axis="{axis}" range="{span}" armature="0.1" damping="1" frictionloss="{loss}"/>
        <geom name="link{number}" type="capsule" fromto="0 0 {radius} 0 0 {long - 0.2 * radius:.4g}" size="{radius}"
          density="1000"/>"""
        servos += (
            f'<position name="servo{number}" joint="joint{number}" kp="{kp}" kv="{kv}" '
            f'forcerange="-{torque} {torque}"/>\n    '
        )
        place = long + 0.6 * radius
    return f"""<mujoco model="arm">
  <option timestep="0.002" integrator="implicitfast" cone="elliptic" impratio="100"/>
  <default><geom friction="0.8 0.005 0.0001" solref="0.004 1" solimp="0.95 0.95 0.001" contype="0" conaffinity="1"/>
  </default>
  <worldbody><geom name="floor" type="plane" size="2 2 .1" contype="1"/>
    <geom name="base" type="cylinder" size=".08 .05" pos="0 0 .05"/>{bodies}{"</body>" * len(LINKS)}
  </worldbody>
  <actuator>
    {servos}</actuator>
  <keyframe><key name="home" qpos="0 -.5 1.2 -.7 0 0" ctrl="0 -.5 1.2 -.7 0 0"/></keyframe>
</mujoco>"""


def scaled(name: str, factor: float):
    """Return a function that scales the numbers of an attribute wherever it stands."""

    def change(text: str) -> str:
        def number(found: re.Match[str]) -> str:
            values = " ".join(f"{factor * float(v):.8g}" for v in found[1].split())
            return f'{name}="{values}"'

        return re.sub(rf'\b{name}="([^"]*)"', number, text)

    return change


def replaced(old: str, new: str, count: int = 0):
    """Return a function that replaces a pattern."""

    def change(text: str) -> str:
        assert re.search(old, text), old
        return re.sub(old, new, text, count=count)

    return change


DEGREE = 57.29577951308232

MISTAKES = {
    "armature of 50": (replaced('armature="0.1"', 'armature="50"'), "robot-armature"),
    "a wrist without armature": (
        replaced('(name="joint6".*?)armature="0.1"', r'\1armature="0"'),
        "robot-rotor",
    ),
    "kp per degree": (scaled("kp", 1 / DEGREE), "robot-sag"),
    "kp times 57": (scaled("kp", DEGREE), "robot-stiffness"),
    "torque of half a newton metre": (
        replaced('forcerange="[^"]*"', 'forcerange="-.5 .5"'),
        "robot-torque",
    ),
    "friction of 60 Nm in a wrist": (
        replaced('frictionloss="1.0"', 'frictionloss="60"'),
        "robot-frictionloss",
    ),
    "damping of 400": (replaced('damping="1"', 'damping="400"'), "robot-damping"),
    "degrees read as radians": (
        replaced("<option", '<compiler angle="radian"/><option'),
        "robot-range",
    ),
    "radians read as degrees": (scaled("range", 1 / DEGREE), "robot-range"),
    "limits off": (
        replaced('(<joint[^>]*)range="', r'\1limited="false" range="'),
        "robot-unlimited",
    ),
    "negative damping": (replaced('damping="1"', 'damping="-1"'), "robot-damping"),
    "density in g/cm^3": (
        replaced('density="1000"', 'density="1"'),
        "robot-density",
    ),
    "inertia over 1000": (
        replaced(
            '(<geom name="link2")',
            r'<inertial pos="0 0 .2" mass="4" diaginertia="6e-5 6e-5 2e-5"/>\1',
        ),
        "robot-inertia",
    ),
}
"""Mistakes that were known while the rows were written: what changes the model, and the row that names it."""

LATER = {
    "armature in kg cm^2": (
        replaced('armature="0.1"', 'armature="1000"'),
        "robot-armature",
    ),
    "a shoulder without armature": (
        replaced('(name="joint2".*?)armature="0.1"', r'\1armature="0"'),
        "robot-rotor",
    ),
    "kv times 57": (scaled("kv", DEGREE), "robot-lag"),
    "gear of a hundredth": (
        replaced('forcerange="-([0-9]+) [0-9]+"', r'gear=".01" forcerange="-\1 \1"'),
        "robot-torque",
    ),
    "torque in kN m": (scaled("forcerange", 1e-3), "robot-torque"),
    "friction in N cm": (scaled("frictionloss", 100.0), "robot-frictionloss"),
    "damping per degree": (scaled("damping", 100.0 * DEGREE), "robot-damping"),
    "one joint with negative damping": (
        replaced('(name="joint4".*?)damping="1"', r'\1damping="-2"'),
        "robot-damping",
    ),
    "links in grams": (replaced('density="1000"', 'mass="3000"'), "robot-density"),
    "inertia in kg cm^2": (
        replaced(
            '(<geom name="link3")',
            r'<inertial pos="0 0 .17" mass="3" diaginertia="300 300 40"/>\1',
        ),
        "robot-inertia",
    ),
    "inertia of a point": (
        replaced(
            '(<geom name="link5")',
            r'<inertial pos="0 0 .05" mass="1" diaginertia="1e-9 1e-9 1e-9"/>\1',
        ),
        "robot-inertia",
    ),
    "limits of the wrist alone": (
        replaced('(<joint[^>]*)range="-1[27]0 1[27]0"', r"\1"),
        "robot-unlimited",
    ),
    "bound of the mass": (
        replaced("<option", '<compiler boundmass="5"/><option'),
        "robot-bound",
    ),
    "a step of 20 ms with explicit servos": (
        lambda text: replaced("implicitfast", "Euler")(
            replaced('timestep="0.002"', 'timestep="0.02"')(text)
        ),
        "robot-servo",
    ),
}
"""Mistakes that were written after the rows and their limits."""


def read(xml: str):
    """Return the training configuration of a model."""
    spec = mujoco.MjSpec.from_string(xml)
    return mujoco_configuration(
        spec.compile(), name="arm.xml", source="test", spec=spec
    )
