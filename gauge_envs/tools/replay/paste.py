"""The lines that put the values of a cause into MJCF, Isaac Lab, mjlab or Playground."""

from __future__ import annotations

from collections.abc import Sequence

from gauge_envs.tools.replay.schema import Explained

SHARED_CONFIG = {
    "kp": "stiffness={numbers}",
    "kd": "damping={numbers}",
    "armature": "armature={numbers}",
    "damping": "damping={numbers}",
    "action scale": "JointPositionActionCfg: scale={numbers}",
    "action offset": "JointPositionActionCfg: offset={numbers}",
}
"""Lines of the configurations of Isaac Lab and mjlab that are alike."""

TEMPLATES = {
    "MJCF": {
        "kp": '<position joint="{name}" kp="{value:.4g}"/>',
        "kd": '<position joint="{name}" kv="{value:.4g}"/>',
        "effort limit": '<position joint="{name}" forcerange="-{value:.4g} {value:.4g}"/>',
        "armature": '<joint name="{name}" armature="{value:.4g}"/>',
        "dry friction": '<joint name="{name}" frictionloss="{value:.4g}"/>',
        "damping": '<joint name="{name}" damping="{value:.4g}"/>',
        "delay": '<position delay="{value:.4g}" nsample="{samples}"/>',
        "gravity or tilt": '<option gravity="{together}"/>',
        "mass or centre of a link": "<inertial .../> of {name}: {value:.4g}",
        "payload": '<geom type="sphere" size="0.01" mass="{value:.4g}"/> in the body {name}',
        "joint limit": '<joint range="..."/>: {name} {value:.4g}',
        "floor friction": '<geom friction="..."/>: first number times {value:.4g}',
        "contact softness": '<geom solref="..."/>: first number times {value:.4g}',
    },
    "Isaac Lab": {
        **SHARED_CONFIG,
        "effort limit": "effort_limit_sim={numbers}",
        "dry friction": "friction={numbers}",
        "delay": "DelayedPDActuatorCfg(min_delay={steps}, max_delay={steps})",
    },
    "mjlab": {
        **SHARED_CONFIG,
        "effort limit": "effort_limit={numbers}",
        "dry friction": "frictionloss={numbers}",
        "delay": "BuiltinPositionActuatorCfg(delay_min_lag={steps}, delay_max_lag={steps})",
    },
    "Playground": {
        "kp": "m.actuator({name!r}).gainprm[0] = {value:.4g}; m.actuator({name!r}).biasprm[1] = -{value:.4g}",
        "kd": "m.actuator({name!r}).biasprm[2] = -{value:.4g}",
        "effort limit": "m.actuator({name!r}).forcerange[:] = -{value:.4g}, {value:.4g}",
        "armature": "m.joint({name!r}).armature[:] = {value:.4g}",
        "dry friction": "m.joint({name!r}).frictionloss[:] = {value:.4g}",
        "damping": "m.joint({name!r}).damping[0] = {value:.4g}",
        "action scale": "action_scale of {name} = {value:.4g}",
        "gravity or tilt": "m.opt.gravity[:] = {together}",
    },
}
"""Line to paste for a value of each cause, by stack. In Playground m is `self._mj_model`."""


def paste_lines(causes: Sequence[Explained], step_s: float) -> dict[str, str]:
    """Return the lines for each stack; values whose interval has the present one are left out.

    Args:
        causes: What was named.
        step_s: Physics step of the model, in which Isaac Lab and mjlab count a delay.
    """
    pasted: dict[str, list[str]] = {}
    for cause in causes:
        # Four digits are more than a log tells.
        changed = {
            value.parameter: float(f"{value.fitted:.4g}")
            for value in cause.values
            if value.changes
        }
        together = " ".join(f"{value.fitted:.4g}" for value in cause.values)
        for stack, templates in TEMPLATES.items():
            if cause.cause not in templates:
                continue
            for name, number in changed.items():
                steps = round(number / step_s)
                text = templates[cause.cause].format(
                    name=name,
                    value=number,
                    numbers=changed,
                    together=together,
                    steps=steps,
                    samples=steps + 2,
                )
                pasted.setdefault(stack, []).append(text)
    # Values that share a line have it once.
    return {stack: "\n".join(dict.fromkeys(texts)) for stack, texts in pasted.items()}
