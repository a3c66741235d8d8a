"""Identified numbers of joints in the language of each engine."""

import math
import tomllib
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from string import Formatter

from gauge_envs.scene.servo_friction import SERVO_FRICTION, rule
from gauge_envs.tools.identify.rig import BACKLASH

LAW = (
    'before each mj_step: i = model.joint("{name}").dofadr[0]; '
    "rate, m, e = data.qvel[i], data.qfrc_actuator[i], -data.qfrc_bias[i]; "
    "model.dof_frictionloss[i] = {law}"
)
"""Python that sets what friction of a joint can hold in MuJoCo."""
PLAYED = ("mujoco", "playground")
PLAY = (
    'behind {name}, in the same body with its pos and axis: <joint name="{name}/play" limited="true" '
    'range="-{half} {half}" solimplimit="0.99 0.999 0.0001" solreflimit="0.001 1"/>, in radians'
)
"""Backlash of a joint in MuJoCo, whose armature is the rotor's."""
STEPS = {"delay_samples": "delay_s", "delay_steps": "delay_s"}
"""Fields that state a number in steps of the simulation."""


def snippet_lines(
    engine: str,
    names: Sequence[str],
    joints: Sequence[Mapping[str, float]],
    left_out: Sequence[Collection[str]],
    marked: Sequence[Mapping[str, str]],
    timestep_s: float,
) -> str:
    """Return the numbers of joints in the language of an engine, and in comments those that no line of it sets.

    Args:
        engine: Name of the engine, or of a training stack.
        names: Names of the joints.
        joints: All numbers of each joint, by name.
        left_out: Names of those of each joint without which the joint moves as well; no attribute states them.
        marked: Names of undetermined numbers of each joint, with the reason.
        timestep_s: Step of the simulation in which the numbers were found [s].
    """
    engines = tomllib.loads(
        (Path(__file__).parent / "snippets.toml").read_text(encoding="utf-8")
    )
    comment = engines["comments"].get(engine, "# {}")
    lines = [
        comment.format(text.format(timestep_s=f"{timestep_s:.6g}"))
        for text in engines["first"].get(engine, ())
    ]
    for number, (name, terms, gone, unsure) in enumerate(
        zip(names, joints, left_out, marked, strict=True)
    ):
        said: set[str] = set(gone)
        values = {
            **{one: f"{value:.5g}" for one, value in terms.items()},
            "joint": str(number),
            "name": name,
            "delay_samples": str(math.ceil(terms["delay_s"] / timestep_s) + 2),
            "delay_steps": str(round(terms["delay_s"] / timestep_s)),
        }
        for one in engines.get(engine, ()):
            needs = one.get("needs", ())
            is_refused = any(map(terms.get, one.get("without", ())))
            if is_refused or not all(
                terms[term] and term not in gone for term in needs
            ):
                continue
            line = one["line"]
            end = "/>" if line.endswith("/>") else ")"
            for option in one.get("options", ()):
                fields = {STEPS.get(field, field) for field in _fields(option)}
                used = fields & set(terms)
                if not used & set(gone) and all(terms[term] for term in used):
                    line = line.removesuffix(end) + option + end
            lines.append(line.format_map(values))
            said |= {STEPS.get(field, field) for field in _fields(line)}
        # An engine whose lines name no joint counts them.
        label = name if engine in engines["first"] else f"joint {number}, {name}"
        if law := rule(terms, terms["dry_friction_n_m"]):
            lines.append(comment.format(LAW.format(name=name, law=law)))
            said |= {*SERVO_FRICTION}
        if engine in PLAYED and terms[BACKLASH]:
            half = f"{0.5 * terms[BACKLASH]:.5g}"
            lines.append(comment.format(PLAY.format(name=name, half=half)))
            said.add(BACKLASH)
        lines += [
            comment.format(
                f"{label}: {term} is not determined ({reason}), "
                + ("left out" if term in gone else "pasted all the same")
            )
            for term, reason in unsure.items()
        ]
        lines += [
            comment.format(
                f"{label}: {term} = {values[term]}, which no line above sets: apply it in your controller"
            )
            for term, value in terms.items()
            if value and term not in said
        ]
    return "\n".join(lines) + "\n"


def _fields(line: str) -> list[str]:
    return [name for _, name, _, _ in Formatter().parse(line) if name]
