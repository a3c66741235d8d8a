"""A mistake in a quadruped with position servos for each check of robots."""

from quadruped import quadruped_xml

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


INERTIAL = (
    '<inertial pos="0 0 0" mass="9.6" diaginertia="{0} {0} {0}"/><geom name="trunk"'
)

FAULTS = {
    ("density", "densest metal"): ('mass="7.84"', 'density="150000"'),
    ("inertia", "trunk"): ('<geom name="trunk"', INERTIAL.format("9")),
    ("inertia", "times the inertia"): ('<geom name="trunk"', INERTIAL.format("1e-4")),
    ("start-overlap", "RL_foot and FL_foot"): (
        'pos="-0.19 0.12 0"',
        'pos="0.18 0.12 0"',
    ),
    ("robot-stands", "above the ground"): ('qpos="0 0 .322', 'qpos="0 0 .9'),
    ("robot-torque", "0.4"): ('forcerange="-40 40"', 'forcerange="-.4 .4"'),
    ("robot-joint", "7 more"): (
        'armature="0.005" damping="0.5"',
        'armature="1" damping="30"',
    ),
    ("robot-joint", "friction 200"): ('frictionloss="0.2"', 'frictionloss="200"'),
    ("robot-drive", "step of 2 ms"): (
        "implicitfast",
        "Euler",
        'kp="80" kv="2"',
        'kp="800" kv="400"',
    ),
    ("robot-drive", "half of a small step"): ('kv="2"', 'kv="400"'),
    ("robot-drive", "swings"): (
        'damping="0.5" frictionloss="0.2"',
        "",
        'kv="2"',
        'kv="0"',
    ),
    ("robot-free", "in the air"): ("<freejoint/>", '<joint type="free"/>'),
    ("robot-feet", "FL_foot"): (
        'name="FL_foot"',
        'name="FL_foot" contype="2" conaffinity="2"',
    ),
    ("robot-friction", "condim 1"): (
        'name="FL_foot"',
        'name="FL_foot" condim="1" priority="1"',
    ),
    ("stated-friction", "floor states friction 0.1"): (
        'name="floor"',
        'name="floor" friction="0.1 0.005 0.0001"',
    ),
}
"""Texts of the good quadruped and what replaces them, by the check that detects it and a part of its remark."""


def faulty_xml(key):
    """Return the quadruped with the mistake that a check detects."""
    text, texts = good_xml(), FAULTS[key]
    for old, new in zip(texts[::2], texts[1::2], strict=True):
        assert old in text, old
        text = text.replace(old, new)
    return text
