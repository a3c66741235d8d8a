"""Lines to paste into MJCF, Isaac Lab, mjlab and MuJoCo Playground."""

from __future__ import annotations

from collections.abc import Sequence

from gauge_envs.tools.replay.schema import Explained

MJCF = {
    "kp": '<position joint="{name}" kp="{value:.4g}"/>',
    "kd": '<position joint="{name}" kv="{value:.4g}"/>',
    "effort limit": '<position joint="{name}" forcerange="-{value:.4g} {value:.4g}"/>',
    "armature": '<joint name="{name}" armature="{value:.4g}"/>',
    "dry friction": '<joint name="{name}" frictionloss="{value:.4g}"/>',
    "damping": '<joint name="{name}" damping="{value:.4g}"/>',
    "delay": '<position delay="{value:.4g}" nsample="{samples}"/>',
    "gravity or tilt": '<option gravity="{all}"/>',
    "mass or centre of a link": "<inertial .../> of {name}: {value:.4g}",
    "payload": '<geom type="sphere" size="0.01" mass="{value:.4g}"/> in the body {name}',
    "joint limit": '<joint range="..."/>: {name} {value:.4g}',
    "floor friction": '<geom friction="..."/>: first number times {value:.4g}',
    "contact softness": '<geom solref="..."/>: first number times {value:.4g}',
}
"""Line of each value in MJCF."""

PLAYGROUND = {
    "kp": "m.actuator({name!r}).gainprm[0] = {value:.4g}; m.actuator({name!r}).biasprm[1] = -{value:.4g}",
    "kd": "m.actuator({name!r}).biasprm[2] = -{value:.4g}",
    "effort limit": "m.actuator({name!r}).forcerange[:] = -{value:.4g}, {value:.4g}",
    "armature": "m.joint({name!r}).armature[:] = {value:.4g}",
    "dry friction": "m.joint({name!r}).frictionloss[:] = {value:.4g}",
    "damping": "m.joint({name!r}).damping[0] = {value:.4g}",
    "action scale": "action_scale of {name} = {value:.4g}",
    "gravity or tilt": "m.opt.gravity[:] = {all}",
}
"""Line of each value in the constructor of a Playground environment, where m is `self._mj_model`."""

CONFIG = {
    "kp": ("stiffness", "stiffness"),
    "kd": ("damping", "damping"),
    "damping": ("damping", "damping"),
    "armature": ("armature", "armature"),
    "effort limit": ("effort_limit_sim", "effort_limit"),
    "dry friction": ("friction", "frictionloss"),
    "action scale": ("JointPositionActionCfg: scale", "JointPositionActionCfg: scale"),
    "action offset": (
        "JointPositionActionCfg: offset",
        "JointPositionActionCfg: offset",
    ),
}
"""Keyword of an actuator of Isaac Lab and of mjlab."""

DELAYED = (
    "DelayedPDActuatorCfg(min_delay={0}, max_delay={0})",
    "BuiltinPositionActuatorCfg(delay_min_lag={0}, delay_max_lag={0})",
)
"""A delay in physics steps, in Isaac Lab and mjlab."""


def paste_lines(causes: Sequence[Explained], step_s: float) -> dict[str, str]:
    """Return the lines for each stack; values whose interval has the present one are left out.

    Args:
        causes: What was named.
        step_s: Physics step of the model, in which Isaac Lab and mjlab count a delay.
    """
    found: dict[str, list[str]] = {
        "MJCF": [],
        "Isaac Lab": [],
        "mjlab": [],
        "Playground": [],
    }
    for cause in causes:
        values = [value for value in cause.values if value.changes]
        together = " ".join(f"{value.fitted:.4g}" for value in cause.values)
        numbers = {value.parameter: round(value.fitted, 6) for value in values}
        for value in values:
            steps = round(value.fitted / step_s)
            fields = {
                "name": value.parameter,
                "value": value.fitted,
                "all": together,
                "samples": steps + 2,
            }
            for stack, templates in (("MJCF", MJCF), ("Playground", PLAYGROUND)):
                if cause.cause in templates:
                    found[stack].append(templates[cause.cause].format(**fields))
        for place, stack in enumerate(("Isaac Lab", "mjlab")):
            if values and cause.cause in CONFIG:
                found[stack].append(f"{CONFIG[cause.cause][place]}={numbers}")
            if values and cause.cause == "delay":
                found[stack].append(DELAYED[place].format(steps))
    return {
        stack: "\n".join(dict.fromkeys(lines))
        for stack, lines in found.items()
        if lines
    }
