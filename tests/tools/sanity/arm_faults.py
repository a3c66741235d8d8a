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


def planted(mistakes):
    """Return each mistake as a function that changes a model, and the row that names it.

    Args:
        mistakes: Row, and the function, or the pattern that is replaced and its new text, by name.
    """
    found = {}
    for name, (row, *change) in mistakes.items():
        found[name] = change[0] if callable(change[0]) else replaced(*change), row
    return found


DEGREE = 57.29577951308232

MISTAKES = planted(
    {
        "armature of 50": ("robot-armature", 'armature="0.1"', 'armature="50"'),
        "a wrist without armature": (
            "robot-rotor",
            '(name="joint6".*?)armature="0.1"',
            r'\1armature="0"',
        ),
        "kp per degree": ("robot-sag", scaled("kp", 1 / DEGREE)),
        "kp times 57": ("robot-stiffness", scaled("kp", DEGREE)),
        "torque of half a newton metre": (
            "robot-torque",
            'forcerange="[^"]*"',
            'forcerange="-.5 .5"',
        ),
        "friction of 60 Nm in a wrist": (
            "robot-frictionloss",
            'frictionloss="1.0"',
            'frictionloss="60"',
        ),
        "damping of 400": ("robot-damping", 'damping="1"', 'damping="400"'),
        "degrees read as radians": (
            "robot-range",
            "<option",
            '<compiler angle="radian"/><option',
        ),
        "radians read as degrees": ("robot-range", scaled("range", 1 / DEGREE)),
        "limits off": (
            "robot-unlimited",
            '(<joint[^>]*)range="',
            r'\1limited="false" range="',
        ),
        "negative damping": ("robot-damping", 'damping="1"', 'damping="-1"'),
        "density in g/cm^3": ("robot-density", 'density="1000"', 'density="1"'),
        "inertia over 1000": (
            "robot-inertia",
            '(<geom name="link2")',
            r'<inertial pos="0 0 .2" mass="4" diaginertia="6e-5 6e-5 2e-5"/>\1',
        ),
    }
)
"""Mistakes that were known while the rows were written: what changes the model, and the row that names it."""

LATER = planted(
    {
        "armature in kg cm^2": ("robot-armature", 'armature="0.1"', 'armature="1000"'),
        "a shoulder without armature": (
            "robot-rotor",
            '(name="joint2".*?)armature="0.1"',
            r'\1armature="0"',
        ),
        "kv times 57": ("robot-lag", scaled("kv", DEGREE)),
        "gear of a hundredth": (
            "robot-torque",
            'forcerange="-([0-9]+) [0-9]+"',
            r'gear=".01" forcerange="-\1 \1"',
        ),
        "torque in kN m": ("robot-torque", scaled("forcerange", 1e-3)),
        "friction in N cm": ("robot-frictionloss", scaled("frictionloss", 100.0)),
        "damping per degree": ("robot-damping", scaled("damping", 100.0 * DEGREE)),
        "one joint with negative damping": (
            "robot-damping",
            '(name="joint4".*?)damping="1"',
            r'\1damping="-2"',
        ),
        "links in grams": ("robot-density", 'density="1000"', 'mass="3000"'),
        "inertia in kg cm^2": (
            "robot-inertia",
            '(<geom name="link3")',
            r'<inertial pos="0 0 .17" mass="3" diaginertia="300 300 40"/>\1',
        ),
        "inertia of a point": (
            "robot-inertia",
            '(<geom name="link5")',
            r'<inertial pos="0 0 .05" mass="1" diaginertia="1e-9 1e-9 1e-9"/>\1',
        ),
        "limits of the wrist alone": (
            "robot-unlimited",
            '(<joint[^>]*)range="-1[27]0 1[27]0"',
            r"\1",
        ),
        "bound of the mass": (
            "robot-bound",
            "<option",
            '<compiler boundmass="5"/><option',
        ),
        "a step of 20 ms with explicit servos": (
            "robot-servo",
            lambda text: replaced("implicitfast", "Euler")(
                replaced('timestep="0.002"', 'timestep="0.02"')(text)
            ),
        ),
    }
)
"""Mistakes that were written after the rows and their limits."""


def read(xml: str):
    """Return the training configuration of a model."""
    spec = mujoco.MjSpec.from_string(xml)
    return mujoco_configuration(
        spec.compile(), name="arm.xml", source="test", spec=spec
    )
