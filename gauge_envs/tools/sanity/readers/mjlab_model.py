"""Build the model of an mjlab scene: a ground plane, the robots' XML files, and the collision settings of each."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco

from gauge_envs.errors import TargetError

INTEGRATORS = {
    "euler": mujoco.mjtIntegrator.mjINT_EULER,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
}
CONES = {"pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL, "elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC}
SOLVERS = {
    "newton": mujoco.mjtSolver.mjSOL_NEWTON,
    "cg": mujoco.mjtSolver.mjSOL_CG,
    "pgs": mujoco.mjtSolver.mjSOL_PGS,
}
NAMED = {"integrator": INTEGRATORS, "cone": CONES, "solver": SOLVERS}
"""Options that mjlab states by name, and MuJoCo's constants."""

NUMBERS = ("timestep", "impratio", "tolerance", "ls_tolerance")
WHOLE_NUMBERS = ("iterations", "ls_iterations", "ccd_iterations")

STRUCTURE = ("contype", "conaffinity", "condim", "priority")
CONSTANTS = ("friction", "solref", "solimp")
SCALARS = ("margin", "gap", "solmix")

LONGEST_PATTERN = 200
"""Longest pattern of names of geoms."""

REPEATED_GROUP = re.compile(r"\)[*+{]")
"""Patterns that may take forever; mjlab has none."""

MOST_ENTITIES = 32
"""Most entities of a scene."""


@dataclass(frozen=True, kw_only=True)
class MjlabModel:
    """A compiled scene.

    Attributes:
        model: The compiled model, with the options of the configuration.
        notes: What is left out.
        incomplete: Why its contacts cannot be counted; empty when they can.
    """

    model: mujoco.MjModel
    notes: tuple[str, ...] = ()
    incomplete: str = ""


class MjlabTable:
    """Configuration of a task as plain values, with checked types. Keys are paths with dots.

    Args:
        values: The values.
        source: Name of their origin, for messages.
        path: Key of the table in the whole configuration.
    """

    def __init__(self, values: Any, source: str, path: str = "") -> None:
        if not isinstance(values, Mapping):
            raise TargetError(f"{source}: {path or 'the configuration'} is no table")
        self._values, self._source, self._path = values, source, path

    def value(self, key: str) -> Any:
        """Return a value; None when it is absent."""
        value: Any = self._values
        for part in key.split("."):
            value = value.get(part) if isinstance(value, Mapping) else None
        return value

    def table(self, key: str) -> MjlabTable:
        """Return a table; an empty one when it is absent."""
        return MjlabTable(self.value(key) or {}, self._source, self._name(key))

    def items(self) -> list[tuple[str, Any]]:
        """Return the keys of the table with their values."""
        return [(str(key), value) for key, value in self._values.items()]

    def number(self, key: str) -> float | None:
        """Return a number; None when it is absent."""
        value = self.value(key)
        if value is None or (isinstance(value, int | float) and not isinstance(value, bool)):
            return value
        raise TargetError(f"{self._source}: {self._name(key)} is {value!r:.60}, and a number is expected")

    def whole(self, key: str) -> int | None:
        """Return a whole number; None when it is absent."""
        value = self.number(key)
        if value is None or value == int(value):
            return None if value is None else int(value)
        raise TargetError(f"{self._source}: {self._name(key)} is {value!r}, and a whole number is expected")

    def texts(self, key: str) -> tuple[str, ...]:
        """Return a list of texts; an empty one when it is absent."""
        value = self.value(key) or ()
        if isinstance(value, list | tuple) and all(isinstance(one, str) for one in value):
            return tuple(value)
        raise TargetError(f"{self._source}: {self._name(key)} is {value!r:.60}, and a list of texts is expected")

    def one_of(self, key: str, known: Mapping[str, int]) -> int | None:
        """Return the constant that a text names; None when it is absent."""
        value = self.value(key)
        if value is None or value in known:
            return None if value is None else int(known[value])
        raise TargetError(f"{self._source}: {self._name(key)} is {value!r:.60}; it may be {', '.join(known)}")

    def _name(self, key: str) -> str:
        return f"{self._path}.{key}" if self._path else key


def mjlab_model(table: MjlabTable, file_of: Callable[[str], Path | None]) -> MjlabModel:
    """Build the model of a configuration.

    Args:
        table: The configuration.
        file_of: Function from the name of a function of mjlab that loads an MJCF file to that file; None when unknown.
    """
    notes = []
    spec = mujoco.MjSpec()
    ground = spec.worldbody.add_body(name="terrain")
    ground.add_geom(name="terrain", type=mujoco.mjtGeom.mjGEOM_PLANE, size=(0.0, 0.0, 0.01))
    terrain = table.value("scene.terrain.terrain_type")
    if terrain not in (None, "plane"):
        notes.append("a plane stands for the terrain, which mjlab generates")
    left_out = []
    for name, entity in table.table("scene.entities").items()[:MOST_ENTITIES]:
        function = entity.get("spec_fn") if isinstance(entity, Mapping) else None
        file = file_of(function.replace(":", ".")) if isinstance(function, str) else None
        if file is None:
            left_out.append(name)
            continue
        part = _entity(file, MjlabTable(entity, f"entity {name}"))
        spec.attach(part, prefix=f"{name}/", frame=spec.worldbody.add_frame())
    if left_out:
        notes.append(f"left out: {', '.join(left_out)}, whose model mjlab builds in code, or is not installed here")
    try:
        model = spec.compile()
    except ValueError as error:
        raise TargetError(f"MuJoCo cannot compile the scene: {' '.join(str(error).split())}") from None
    _set_options(model, table.table("sim.mujoco"))
    incomplete = "its scene is not complete here" if left_out or terrain not in (None, "plane") else ""
    return MjlabModel(model=model, notes=tuple(notes), incomplete=incomplete)


def _entity(file: Path, table: MjlabTable) -> mujoco.MjSpec:
    try:
        spec = mujoco.MjSpec.from_file(str(file))
    except ValueError as error:
        raise TargetError(f"{file}: MuJoCo cannot load it: {' '.join(str(error).split())}") from None
    for key in list(spec.keys):
        spec.delete(key)
    for policy in table.value("collisions") or ():
        _apply_collisions(spec, MjlabTable(policy, "collisions"))
    return spec


def _apply_collisions(spec: mujoco.MjSpec, policy: MjlabTable) -> None:
    """Set the collision attributes of the geoms whose names match; of several patterns of a value, the first counts."""
    patterns = policy.texts("geom_names_expr")
    for geom in spec.geoms:
        if not any(_matches(pattern, geom.name) for pattern in patterns):
            if policy.value("disable_other_geoms") is not False:
                geom.contype = geom.conaffinity = 0
            continue
        for name in (*STRUCTURE, *SCALARS):
            value = _for_geom(policy.value(name), geom.name)
            if isinstance(value, int | float):
                setattr(geom, name, value)
        for name in CONSTANTS:
            value = _for_geom(policy.value(name), geom.name)
            if isinstance(value, Sequence) and all(isinstance(one, int | float) for one in value):
                constants = getattr(geom, name)
                constants[: len(value)] = value[: len(constants)]


def _for_geom(value: Any, geom: str) -> Any:
    if not isinstance(value, Mapping):
        return value
    return next((one for pattern, one in value.items() if _matches(str(pattern), geom)), None)


def _matches(pattern: str, name: str) -> bool:
    if len(pattern) > LONGEST_PATTERN or REPEATED_GROUP.search(pattern):
        raise TargetError(f"the pattern {pattern[:40]!r} of names of geoms is too long or repeats a group")
    try:
        return re.match(pattern, name) is not None
    except re.error as error:
        raise TargetError(f"the pattern {pattern!r} of names of geoms is not valid: {error}") from None


def _set_options(model: mujoco.MjModel, options: MjlabTable) -> None:
    for name in NUMBERS:
        _set(model, name, options.number(name))
    for name in WHOLE_NUMBERS:
        _set(model, name, options.whole(name))
    for name, known in NAMED.items():
        _set(model, name, options.one_of(name, known))
    gravity = options.value("gravity")
    if isinstance(gravity, list | tuple) and len(gravity) == 3:
        model.opt.gravity[:] = gravity
    for flag in options.texts("disableflags"):
        model.opt.disableflags |= _flag("mjDSBL_", flag, mujoco.mjtDisableBit)
    for flag in options.texts("enableflags"):
        model.opt.enableflags |= _flag("mjENBL_", flag, mujoco.mjtEnableBit)


def _set(model: mujoco.MjModel, name: str, value: float | None) -> None:
    if value is not None:
        setattr(model.opt, name, value)


def _flag(start: str, name: str, kind: Any) -> int:
    bit = getattr(kind, f"{start}{name.upper()}", None)
    if bit is None:
        raise TargetError(f"{name!r} is no flag of MuJoCo {mujoco.__version__}")
    return int(bit)
