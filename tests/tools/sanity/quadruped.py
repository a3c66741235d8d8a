"""A quadruped of 12 kg built from primitives, with spherical feet."""

GOOD = {
    "option": 'timestep="0.002" integrator="implicitfast" cone="elliptic" impratio="100"',
    "geom": 'solref="0.004 1" solimp="0.95 0.95 0.001"',
}
"""Attributes of `<option>` and `<default><geom>` that this package recommends."""

FEET = ("FL_foot", "FR_foot", "RL_foot", "RR_foot")
FOOT_RADIUS_M = 0.022


def quadruped_xml(
    *, option=GOOD["option"], geom=GOOD["geom"], foot="", friction=0.6, locked=False
):
    """Return the model.

    Args:
        option: Attributes of `<option>`.
        geom: Attributes of `<default><geom>`.
        foot: Attributes of the feet's own geoms.
        friction: Sliding friction of all geoms.
        locked: Whether constraints hold the joints of the legs.
    """
    legs, locks = "", ""
    for name in FEET:
        leg = name.split("_", maxsplit=1)[0]
        x, y = (0.19 if leg[0] == "F" else -0.19), (0.12 if leg[1] == "L" else -0.12)
        legs += f"""<body name="{leg}_thigh" pos="{x} {y} 0"><joint name="{leg}_hip" axis="0 1 0" range="-60 240"/>
          <geom type="capsule" fromto="0 0 0 -.15 0 -.15" size=".02" mass=".8" contype="0" conaffinity="0"/>
          <body name="{leg}_calf" pos="-.15 0 -.15"><joint name="{leg}_knee" axis="0 1 0" range="-170 170"/>
            <geom name="{leg}_calf" type="capsule" fromto="0 0 0 .15 0 -.15" size=".012" mass=".2"/>
            <geom name="{name}" pos=".15 0 -.15" size="{FOOT_RADIUS_M}" mass=".04" {foot}/></body></body>"""
        if locked:
            lock = 'polycoef="0 0 0 0 0" solref="0.004 1" solimp="0.9999 0.9999 0.001"'
            locks += (
                f'<joint joint1="{leg}_hip" {lock}/><joint joint1="{leg}_knee" {lock}/>'
            )
    return f"""<mujoco model="quadruped"><option {option}/>
      <default><geom friction="{friction} 0.005 0.0001" {geom}/><joint armature="0.005"/></default>
      <worldbody><geom name="floor" type="plane" size="5 5 .1"/>
        <body name="trunk" pos="0 0 .322"><freejoint/>
          <geom name="trunk" type="box" size=".2 .08 .05" mass="7.84"/>{legs}</body></worldbody>
      <equality>{locks}</equality></mujoco>"""


JOINT = 'armature="0.005" damping="0.5" frictionloss="0.2"'


def good_xml():
    """Return the quadruped of 12 kg with servos of 80 N m/rad and a keyframe, which passes all checks."""
    text = quadruped_xml(friction=0.8).replace('armature="0.005"', JOINT)
    servos = "".join(
        f'<position joint="{leg}_{joint}" kp="80" kv="2" forcerange="-40 40"/>'
        for leg in ("FL", "FR", "RL", "RR")
        for joint in ("hip", "knee")
    )
    home = '<keyframe><key name="home" qpos="0 0 .322 1 0 0 0 0 0 0 0 0 0 0 0"/></keyframe>'
    return text.replace("</mujoco>", f"<actuator>{servos}</actuator>{home}</mujoco>")
