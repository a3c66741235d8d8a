"""Ranges of a robot file, and justified ranges as Python files of training stacks, each of which loads its file."""

import json
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.metadata import version
from pathlib import Path
from string import Template
from textwrap import wrap
from typing import Any

import mujoco

from gauge_envs.errors import ParameterError, UnknownNameError
from gauge_envs.experiments.experiment import TaskExperiment
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.uncertain import uncertain_parameters
from gauge_envs.pages.text import with_unit
from gauge_envs.tools.identify import read_mjcf
from gauge_envs.tools.transfer.ranges import (
    Justified,
    JustifiedRange,
    LeftOut,
    Scatter,
    friction_of_materials,
    justified_ranges,
    payload,
    ranges_like,
)

STACKS = ("mjlab", "isaaclab", "playground", "maniskill", "mujoco", "gymnasium")

ROBOT_SUFFIXES = (".xml", ".mjcf", ".urdf")

NO_REBOUND = (
    "MuJoCo has no coefficient of restitution: gauge recipe gives contacts that rebound"
)
PLACED = "draw it where your environment places the body"
HELD = "hold the commands back where your environment applies them"
NO_DRAG = "apply the torque -c rate |rate| where your environment steps"
EVERYWHERE = {"position_m": PLACED, "quadratic_friction_n_m_s2_per_rad2": NO_DRAG}
NOT_SET: Mapping[str, Mapping[str, str]] = {
    "mjlab": {"restitution": NO_REBOUND, **EVERYWHERE},
    "isaaclab": EVERYWHERE,
    "playground": {"restitution": NO_REBOUND, **EVERYWHERE, "delay_s": HELD},
    "maniskill": {**EVERYWHERE, "delay_s": HELD},
    "mujoco": {"restitution": NO_REBOUND, **EVERYWHERE},
}
"""Constants that the file of a stack does not set, with the reason."""

ISAAC_FRICTION = (
    "Isaac Lab draws the viscous friction from the same range (randomize_joint_parameters): state the friction in the "
    "asset, and draw a factor"
)
FACTOR_OF = "dry_friction_n_m"
"""Constant of joints of which a factor on the value of the file may be known."""

WIDTH = 120
"""Longest line of a heading [characters]."""

SCATTERS = {
    Scatter.TRIALS: "trials",
    Scatter.FILES: "files",
    Scatter.UNITS: "units",
    Scatter.LAWS: "laws",
    Scatter.PAIRS: "pairs of materials",
}


def is_robot_file(subject: str) -> bool:
    """Return whether a text names a file of a robot, and not an id."""
    return Path(subject).suffix.lower() in ROBOT_SUFFIXES


def robot_ranges(
    path: Path,
    *,
    like: Sequence[str] = (),
    payload_kg: tuple[float, float] | None = None,
    body: str = "",
) -> Justified:
    """Return the ranges that data justify for a robot.

    Args:
        path: MJCF or URDF file.
        like: Ids whose contact or joints are those of the robot: the same pair of materials, the same servo.
        payload_kg: Smallest and largest mass that is added to `body` [kg]; None for none.
        body: Body that carries the payload.
    """
    model = read_mjcf(path).compile()
    found, left_out = ranges_like(like)
    named = {one.name for one in found} | {one.name for one in left_out}
    if not any(one.name == "contact.friction" for one in found):
        found.append(friction_of_materials())
    if "contact.restitution" not in named:
        left_out.append(
            LeftOut(
                name="contact.restitution",
                reason="no rebound of this robot was measured; that of another pair says nothing about it",
            )
        )
    joints = _driven_joints(model)
    if not any(one.startswith("joints.") for one in named):
        left_out.append(
            LeftOut(
                name="joints: friction, damping, armature, gain, delay",
                reason="nothing was measured on these joints: fit logs (gauge recipe joint), or name an id with the "
                "same servo (--like ServoArm-so101)",
            )
        )
    elif not all(joints) or not joints:
        raise ParameterError(
            f"{path}: --like {','.join(like)} is for joints, and the file has no driven hinge or slide joint with a "
            "name: name them"
        )
    elif still := [
        name
        for name in joints
        if not model.dof_frictionloss[model.joint(name).dofadr[0]]
    ]:
        factors = [one for one in found if one.name == f"joints.{FACTOR_OF}"]
        found = [one for one in found if one not in factors]
        left_out += [
            LeftOut(
                name=one.name,
                reason="a factor was measured, and the file states no frictionloss for "
                f"{', '.join(still)}: fit logs (gauge recipe joint)",
            )
            for one in factors
        ]
    left_out.append(
        LeftOut(
            name="start",
            reason="no repeated placement of this robot was recorded: state how well you place it",
        )
    )
    bodies = {model.body(number).name for number in range(1, model.nbody)}
    loaded = payload(payload_kg, body, bodies, str(path))
    if isinstance(loaded, JustifiedRange):
        found.append(loaded)
    else:
        left_out.append(loaded)
    return Justified(
        subject=path.name, ranges=tuple(found), left_out=tuple(left_out), joints=joints
    )


def _driven_joints(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the names of joints with one axis: those that actuators drive, or all in a file without actuators."""
    axes = [
        number
        for number in range(model.njnt)
        if int(model.jnt_type[number])
        in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
    ]
    driven = {
        int(model.actuator_trnid[motor, 0])
        for motor in range(model.nu)
        if model.actuator_trntype[motor] == mujoco.mjtTrn.mjTRN_JOINT
    }
    return tuple(
        model.joint(number).name for number in axes if number in driven or not driven
    )


# --- files -----------------------------------------------------------------------------------------------------------


def for_stack(justified: Justified, stack: str) -> Justified:
    """Return what the file of a stack sets; what it does not set is left out, with the reason."""
    if stack not in STACKS:
        raise UnknownNameError("stack", stack, STACKS)
    gone = NOT_SET.get(stack, {})
    if stack == "gymnasium" and is_robot_file(justified.subject):
        gone = NOT_SET["mujoco"]
    kept = []
    without = []
    for one in justified.ranges:
        reason = gone.get(one.constant, "")
        if stack == "isaaclab" and one.constant == FACTOR_OF and one.operation == "abs":
            reason = ISAAC_FRICTION
        if reason:
            without.append(LeftOut(name=one.name, reason=reason))
        else:
            kept.append(one)
    return Justified(
        subject=justified.subject,
        ranges=tuple(kept),
        left_out=(*justified.left_out, *without),
        joints=justified.joints,
    )


def stack_file(justified: Justified, stack: str) -> str:
    """Return ranges as a Python file of a training stack.

    Args:
        justified: Ranges of an id or of a robot file.
        stack: Name of the stack, one of `STACKS`.
    """
    found = for_stack(justified, stack)
    if not found.ranges:
        reasons = "; ".join(f"{one.name}: {one.reason}" for one in found.left_out)
        raise ParameterError(
            f"{found.subject} for {stack}: no range is justified, so that there is no file to write. {reasons}"
        )
    is_robot = is_robot_file(found.subject)
    values = {
        "heading": _heading(found, stack),
        "ranges": _ranges(found.ranges),
        "joints": json.dumps(list(found.joints)),
        "id": found.subject,
    }
    if stack != "gymnasium":
        return _template(stack).substitute(values)
    if not is_robot:
        return _template(stack).substitute(values, stated=_stated(found.subject))
    imports = values["heading"] + "\n\nimport gymnasium\nimport numpy as np"
    text = _template("mujoco").substitute(values | {"heading": imports})
    # One block of imports.
    text = text.replace(
        "import numpy as np\n\nimport mujoco\n", "import mujoco\nimport numpy as np\n"
    )
    return text + _template("gymnasium_model").substitute(values)


@cache
def _template(name: str) -> Template:
    file = Path(__file__).with_name("stacks") / f"{name}.txt"
    return Template(file.read_text(encoding="utf-8"))


def _heading(found: Justified, stack: str) -> str:
    lines = [
        f"Randomization of {found.subject} for {stack}, by gauge-envs {version('gauge-envs')}: uniform draws.",
        "",
        "Left out:",
    ]
    for one in found.left_out:
        lines += _wrapped(f"- {one.name}: {one.reason}", "  ")
    return '"""' + "\n".join(lines).replace('"""', "'''") + '\n"""'


def _wrapped(text: str, indent: str) -> list[str]:
    return wrap(
        text, WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )  # fmt: skip


def _ranges(ranges: Sequence[JustifiedRange]) -> str:
    """Return the table of ranges as Python code, each with its unit, count and source in a comment."""
    lines = ["{"]
    for one in ranges:
        unit = "factor" if one.operation == "scale" else with_unit("", one.unit).strip()
        note = "; ".join(filter(None, (unit, evidence(one), one.source)))
        lines += [f"    {line}" for line in _wrapped(f"# {note}", "# ")]
        ends = f'"low": {one.low:.6g}, "high": {one.high:.6g}'
        lines.append(f'    "{one.name}": {{{ends}, "operation": "{one.operation}"}},')
    return "\n".join([*lines, "}"])


def evidence(one: JustifiedRange) -> str:
    """Return in words what scatters and how many of it made a range."""
    if one.scatter is Scatter.STATED:
        return "stated"
    if one.inside is None:
        return f"n = {one.count} {SCATTERS[one.scatter]} of one joint, others not known"
    return f"n = {one.count} {SCATTERS[one.scatter]}, {100 * one.inside:.0f} % of further ones inside"


def _stated(subject: str) -> str:
    """Return the values of an id as Python code: constants; for a start its place and the steepest free direction."""
    experiment = load_experiment(subject)
    assert isinstance(experiment, TaskExperiment)
    stated: dict[str, Any] = {}
    for one in uncertain_parameters(experiment):
        if isinstance(one.value, tuple):
            assert one.direction is not None, "a start has a direction"
            _, before = stated.get(one.key, (None, (0.0, 0.0, 0.0)))
            if abs(one.direction[2]) > abs(before[2]):
                stated[one.key] = (one.value, one.direction)
        else:
            stated[one.key] = one.value
    lines = [
        f"    {json.dumps(key)}: {json.dumps(value)}," for key, value in stated.items()
    ]
    return "\n".join(["{", *lines, "}"])


def subject_ranges(
    subject: str,
    *,
    like: Sequence[str] = (),
    payload_kg: tuple[float, float] | None = None,
    body: str = "",
) -> Justified:
    """Return the ranges of an id or of a robot file.

    Args:
        subject: Variant or id; or an MJCF or URDF file.
        like: Ids whose contact or joints are those of the robot.
        payload_kg: Smallest and largest mass that is added to `body` [kg]; None for none.
        body: Body that carries the payload.
    """
    if is_robot_file(subject):
        return robot_ranges(Path(subject), like=like, payload_kg=payload_kg, body=body)
    if like:
        raise ParameterError(
            f"--like is for a robot file, and {subject} is an id, whose contacts and joints are its own"
        )
    return justified_ranges(subject, payload_kg=payload_kg, body=body)
