"""The lines that put a change into MJCF and the map."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from gauge_envs.files import write_whole
from gauge_envs.tools.replay.log import LogMap, with_joints
from gauge_envs.tools.replay.model import Replayer, Setup

JOINT_FIELDS = {
    "armature": "dof_armature",
    "frictionloss": "dof_frictionloss",
    "damping": "dof_damping",
}
"""Field of the model by attribute of a joint."""
BODY_FIELDS = {
    "mass": "body_mass",
    "pos": "body_ipos",
    "quat": "body_iquat",
    "diaginertia": "body_inertia",
}
"""Field of the model by attribute of an inertial."""


SPEC_FIELDS = {"pos": "ipos", "quat": "iquat", "diaginertia": "inertia"}
"""Field of the body of a specification by attribute of an inertial."""


@dataclass(frozen=True)
class Change:
    """What predicts a log without and with a change.

    Attributes:
        before, after: The setups.
        replayer: The log.
        in_degrees: Whether the angles of the file of the model are in degrees.
        given: The map that the user gave.
        mapped: The map by which the log was read.
    """

    before: Setup
    after: Setup
    replayer: Replayer
    in_degrees: bool
    given: LogMap
    mapped: LogMap

    def lines(self) -> dict[str, str]:
        """Return the lines by place: `map` and `MJCF`.

        An element of MJCF has the attributes that change; a `<position>` takes the place of a `<general>`.
        """
        mjcf = [_element(tag, values) for tag, values in self._elements()]
        places = {"map": [*self._map()], "MJCF": mjcf}
        return {place: "\n".join(lines) for place, lines in places.items() if lines}

    def write(self, model: Path, out: Path) -> None:
        """Write a model file with the change, except for what stands in the map."""
        spec = mujoco.MjSpec.from_file(str(model))
        for tag, values in self._elements():
            if tag == "option":
                part = spec.option
            elif tag == "joint":
                part = spec.joint(values["name"])
            else:
                parts = spec.bodies if tag == "body" else spec.actuators
                part = parts[values["id"]]
            for name, value in values.items():
                _set_attribute(part, name, value)
        spec.compile()
        write_whole(out, spec.to_xml().encode())

    def _elements(self) -> Iterator[tuple[str, dict[str, Any]]]:
        for part in (self._joints, self._actuators, self._bodies, self._options):
            yield from part()

    def _rows(self, *fields: str) -> list[int]:
        """Return the rows of fields of the model that change."""
        found: set[int] = set()
        for field in fields:
            old, new = (
                getattr(each.model, field) for each in (self.before, self.after)
            )
            found |= set(np.nonzero(old != new)[0].tolist())
        return sorted(found)

    def _joints(self) -> Iterator[tuple[str, dict[str, Any]]]:
        model = self.after.model
        for attribute, field in JOINT_FIELDS.items():
            for dof in self._rows(field):
                name = model.joint(model.dof_jntid[dof]).name
                value = getattr(model, field)[dof]
                yield "joint", {"name": name, attribute: value}
        for index in self._rows("jnt_range"):
            joint = model.joint(index)
            is_hinge = joint.type[0] == mujoco.mjtJoint.mjJNT_HINGE.value
            unit = np.rad2deg(1.0) if is_hinge and self.in_degrees else 1.0
            limits = {"limited": "true", "range": unit * joint.range}
            yield "joint", {"name": joint.name, **limits}

    def _actuators(self) -> Iterator[tuple[str, dict[str, Any]]]:
        laws = self._rows("actuator_gainprm", "actuator_biasprm")
        efforts = self._rows("actuator_forcerange")
        for index in sorted({*laws, *efforts}):
            drive = self.after.model.actuator(index)
            file = self.replayer.model.actuator(index)
            joint = self.replayer.model.joint(file.trnid[0]).name
            values: dict[str, Any] = {"id": index, "name": file.name, "joint": joint}
            gear, is_servo = abs(file.gear[0]), file.biasprm[1] != 0.0
            if is_servo:
                values["kp"], values["kv"] = -drive.biasprm[1:3] / gear**2
            if index in efforts:
                values["forcerange"] = drive.forcerange / gear
            if len(values) > 3:
                yield "position" if is_servo else "motor", values

    def _bodies(self) -> Iterator[tuple[str, dict[str, Any]]]:
        model = self.after.model
        for index in self._rows(*BODY_FIELDS.values()):
            name = model.body(index).name
            numbers = {
                attribute: getattr(model, field)[index]
                for attribute, field in BODY_FIELDS.items()
            }
            yield "body", {"id": index, "name": name, **numbers}

    def _options(self) -> Iterator[tuple[str, dict[str, Any]]]:
        old, new = self.before.model.opt, self.after.model.opt
        for name in ("gravity", "timestep"):
            if np.any(getattr(old, name) != getattr(new, name)):
                yield "option", {name: getattr(new, name)}

    def _map(self) -> Iterator[str]:
        mapped = self.mapped
        for joint, zero in zip(self.replayer.log.joints, self.after.zero, strict=True):
            if zero:
                offset = mapped.joint(joint).offset_rad + zero
                change = {"offset_rad": float(_text(offset))}
                mapped = with_joints(mapped, {joint: change})
        for name in ("unit", "up", "up_of"):
            if getattr(mapped, name) != getattr(self.given, name):
                yield f'{name} = "{getattr(mapped, name)}"'
        for joint, entry in mapped.joints.items():
            if entry != self.given.joints.get(joint):
                yield f'[joints."{joint}"]'
                yield from _items(entry.model_dump(exclude_defaults=True))
        if control := self._control():
            yield "[control]"
            yield from _items(control)

    def _control(self) -> dict[str, Any]:
        """Return what changes in the controller outside of the model; a table has all joints."""
        before, after = self.before, self.after
        control: dict[str, Any] = {}
        if after.delay_s != before.delay_s:
            control["delay_s"] = float(_text(after.delay_s))
        model = self.replayer.model
        driven = np.flatnonzero(before.is_driven)
        joints = [model.joint(model.actuator_trnid[k, 0]).name for k in driven]
        outside = driven[model.actuator_biasprm[driven, 1] == 0.0]
        laws = [-each.model.actuator_biasprm[:, 1:3].T for each in (before, after)]
        tables = {"kp": (laws[0][0], laws[1][0]), "kd": (laws[0][1], laws[1][1])}
        if not len(outside):
            tables = {}
        if self.replayer.log.command_kind == "action":
            tables["action_scale"] = before.scale, after.scale
            tables["default_rad"] = before.offset, after.offset
        for name, (old, new) in tables.items():
            if (old != new).any():
                numbers = [float(_text(value)) for value in new[driven]]
                control[name] = dict(zip(joints, numbers, strict=True))
        return control


def _items(table: Mapping[str, Any]) -> Iterator[str]:
    """Yield the lines of a table of TOML."""
    for name, value in table.items():
        if isinstance(value, dict):
            inner = ", ".join(f'"{key}" = {number}' for key, number in value.items())
            yield f"{name} = {{ {inner} }}"
        else:
            yield f"{name} = {value!r}".replace("'", '"')


def _element(tag: str, attributes: Mapping[str, Any]) -> str:
    texts = {
        name: f'{name}="{_text(value)}"'
        for name, value in attributes.items()
        if name != "id" and (not isinstance(value, str) or value)
    }
    if tag != "body":
        return f"<{tag} {' '.join(texts.values())}/>"
    body = f"body {texts.pop('name', '')}".rstrip()
    return f"<{body}><inertial {' '.join(texts.values())}/></body>"


def _set_attribute(part: Any, name: str, value: Any) -> None:
    """Give a number to a part of a specification."""
    if name == "kp":
        part.gainprm[0], part.biasprm[1] = value, -value
        part.gaintype = mujoco.mjtGain.mjGAIN_FIXED
        part.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    elif name == "kv":
        part.biasprm[2] = -value
    elif name == "damping":
        part.damping[0] = value
    elif name == "limited":
        part.limited = mujoco.mjtLimited.mjLIMITED_TRUE
    elif name == "forcerange":
        part.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
        part.forcerange = value
    elif name in BODY_FIELDS:
        part.explicitinertial = True
        setattr(part, SPEC_FIELDS.get(name, name), value)
    elif name not in ("id", "name", "joint"):
        setattr(part, name, value)


def _text(value: ArrayLike | str) -> str:
    """Return numbers as in MJCF; four digits are more than a log tells."""
    if isinstance(value, str):
        return value
    return " ".join(f"{number:.4g}" for number in np.ravel(value).tolist())
