"""The lines that put a change into MJCF and the map."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from gauge_envs.files import write_whole
from gauge_envs.tools.replay.log import ANGLES, LogMap, with_joints
from gauge_envs.tools.replay.model import Replayer, Setup

JOINT_FIELDS = {
    "armature": "dof_armature",
    "frictionloss": "dof_frictionloss",
    "damping": "dof_damping",
    "range": "jnt_range",
}
"""Field of the model by attribute of a joint."""
BODY_FIELDS = {
    "mass": "body_mass",
    "pos": "body_ipos",
    "quat": "body_iquat",
    "diaginertia": "body_inertia",
}
"""Field of the model by attribute of an inertial."""


@dataclass(frozen=True)
class Change:
    """What predicts a log without and with a change.

    Attributes:
        before, after: The setups.
        replayer: The log.
        file: The file of the model.
        given: The map that the user gave.
    """

    before: Setup
    after: Setup
    replayer: Replayer
    file: Path
    given: LogMap

    def lines(self) -> dict[str, str]:
        """Return the lines by place: `map` and `MJCF`.

        An element of MJCF has the attributes that change; a `<position>` takes the place of a `<general>`.
        """
        places = {"map": [*self._map()], "MJCF": [*self._elements()]}
        return {place: "\n".join(lines) for place, lines in places.items() if lines}

    def _spec(self) -> mujoco.MjSpec:
        return mujoco.MjSpec.from_file(str(self.file))

    def write(self, out: Path) -> None:
        """Write a model file with the change, except for what stands in the map."""
        spec = self._spec()
        changed, after = spec.compile(), self.after.model
        for field in (*JOINT_FIELDS.values(), *BODY_FIELDS.values()):
            rows = self._rows(field)
            getattr(changed, field)[rows] = getattr(after, field)[rows]
        changed.jnt_limited[self._rows("jnt_range")] = 1
        changed.opt.gravity[:] = after.opt.gravity
        changed.opt.timestep = after.opt.timestep
        for index, values in self._drives():
            drive = changed.actuator(index)
            if "kp" in values:
                drive.gainprm[0] = values["kp"]
                drive.biasprm[1:3] = -values["kp"], -values["kv"]
            if "forcerange" in values:
                drive.forcelimited, drive.forcerange = 1, values["forcerange"]
        spec.copy_back(changed)
        write_whole(out, spec.to_xml().encode())

    def _rows(self, *fields: str) -> list[int]:
        """Return the rows of fields of the model that change."""
        found: set[int] = set()
        for field in fields:
            old, new = (
                getattr(each.model, field) for each in (self.before, self.after)
            )
            found |= set(np.nonzero(old != new)[0].tolist())
        return sorted(found)

    def _elements(self) -> Iterator[str]:
        """Yield the elements of MJCF that change."""
        model = self.after.model
        for attribute, field in JOINT_FIELDS.items():
            for row in self._rows(field):
                is_range = attribute == "range"
                joint = model.joint(row if is_range else model.dof_jntid[row])
                numbers = getattr(model, field)[row]
                is_hinge = joint.type[0] == mujoco.mjtJoint.mjJNT_HINGE.value
                if is_range and is_hinge and self._spec().compiler.degree:
                    numbers = np.rad2deg(numbers)
                limited = {"limited": "true"} if is_range else {}
                values = {"name": joint.name, **limited, attribute: numbers}
                yield f"<joint {_attributes(values)}/>"
        for index, values in self._drives():
            file = self.replayer.model.actuator(index)
            joint = self.replayer.model.joint(file.trnid[0]).name
            tag = "position" if "kp" in values else "motor"
            yield f"<{tag} {_attributes({'name': file.name, 'joint': joint, **values})}/>"
        for row in self._rows(*BODY_FIELDS.values()):
            numbers = {
                name: getattr(model, key)[row] for name, key in BODY_FIELDS.items()
            }
            body = f"body {_attributes({'name': model.body(row).name})}".rstrip()
            yield f"<{body}><inertial {_attributes(numbers)}/></body>"
        for name in ("gravity", "timestep"):
            old, new = (
                getattr(each.model.opt, name) for each in (self.before, self.after)
            )
            if np.any(old != new):
                yield f"<option {_attributes({name: new})}/>"

    def _drives(self) -> Iterator[tuple[int, dict[str, Any]]]:
        """Yield the actuators that change, with gains and limit in the unit of the file."""
        efforts = self._rows("actuator_forcerange")
        for index in sorted({*self._rows("actuator_biasprm"), *efforts}):
            drive = self.after.model.actuator(index)
            file = self.replayer.model.actuator(index)
            gear, values = abs(file.gear[0]), {}
            if file.biasprm[1] != 0.0:
                values["kp"], values["kv"] = -drive.biasprm[1:3] / gear**2
            if index in efforts:
                values["forcerange"] = drive.forcerange / gear
            if values:
                yield index, values

    def _map(self) -> Iterator[str]:
        mapped = self.replayer.log.mapped
        for joint, zero in zip(self.replayer.log.joints, self.after.zero, strict=True):
            if zero:
                offset = mapped.joint(joint).offset_rad + zero
                change = {"offset_rad": float(_text(offset))}
                mapped = with_joints(mapped, {joint: change})
        mapped = with_joints(mapped, dict(self._commands()))
        for name, value in mapped.model_dump(exclude={"joints", "control"}).items():
            if value != getattr(self.given, name):
                yield from _items({name: value})
        for joint, entry in mapped.joints.items():
            if entry != self.given.joints.get(joint):
                yield f'[joints."{joint}"]'
                yield from _items(entry.model_dump(exclude_defaults=True))
        if control := self._control():
            yield "[control]"
            yield from _items(control)

    def _commands(self) -> Iterator[tuple[str, dict[str, Any]]]:
        """Yield the joints whose commands change, with their column, scale and offset; a table has those of actions."""
        before, after, log = self.before, self.after, self.replayer.log
        mapped, names = log.mapped, self._driven()
        zeros = dict(zip(log.joints, after.zero, strict=True))
        for k, name in names.items():
            entry, column = mapped.joint(name), after.command[:, k]
            for sign, other in ((1.0, k), *product((1.0, -1.0), names)):
                if np.array_equal(column, sign * before.command[:, other]):
                    break
            else:
                continue
            scale, offset = sign, 0.0
            if log.command_kind != "action":
                scale = sign * after.scale[k]
                pose = before.offset[other] * (log.command_kind == "target")
                offset = after.offset[k] - scale * pose
                offset -= zeros.get(name, 0.0) * (log.command_kind in ANGLES)
            change: dict[str, Any] = {
                "command_scale": float(_text(scale * entry.command_scale)),
                "command_offset": float(_text(scale * entry.command_offset + offset)),
            }
            if other != k:
                change["command"] = mapped.title(names[other], log.command_kind)
            if entry.model_copy(update=change) != entry:
                yield name, change

    def _driven(self) -> dict[int, str]:
        """Return the joints of the actuators that have commands."""
        model = self.replayer.model
        driven = np.flatnonzero(self.before.is_driven).tolist()
        return {k: model.joint(model.actuator_trnid[k, 0]).name for k in driven}

    def _control(self) -> dict[str, Any]:
        """Return what changes in the controller outside of the model; a table has all joints."""
        setups, joints = (self.before, self.after), self._driven()
        tables: dict[str, list[Any]] = {}
        if (self.replayer.model.actuator_biasprm[[*joints], 1] == 0.0).any():
            laws = [-each.model.actuator_biasprm for each in setups]
            tables = {
                "kp": [law[:, 1] for law in laws],
                "kd": [law[:, 2] for law in laws],
            }
        if self.replayer.log.command_kind == "action":
            tables["action_scale"] = [each.scale for each in setups]
            tables["default_rad"] = [each.offset for each in setups]
        control: dict[str, Any] = {}
        if self.after.delay_s != self.before.delay_s:
            control["delay_s"] = float(_text(self.after.delay_s))
        for name, (old, new) in tables.items():
            if (old != new).any():
                control[name] = {
                    joint: float(_text(new[k])) for k, joint in joints.items()
                }
        return control


def _items(table: Mapping[str, Any]) -> Iterator[str]:
    """Yield the lines of a table of TOML."""
    for name, value in table.items():
        if isinstance(value, dict):
            inner = ", ".join(f'"{key}" = {number}' for key, number in value.items())
            yield f"{name} = {{ {inner} }}"
        else:
            yield f"{name} = {value!r}".replace("'", '"')


def _attributes(values: Mapping[str, Any]) -> str:
    """Return attributes of XML without empty names."""
    texts = {name: _text(value) for name, value in values.items()}
    return " ".join(f'{name}="{text}"' for name, text in texts.items() if text)


def _text(value: ArrayLike | str) -> str:
    """Return numbers as in MJCF; four digits are more than a log tells."""
    if isinstance(value, str):
        return value
    return " ".join(f"{number:.4g}" for number in np.ravel(value).tolist())
