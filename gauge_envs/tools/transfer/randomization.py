"""Ranges of domain randomization from measured uncertainties, as code for common training stacks.

The code is in `templates`: parts of a file below a line with their name, with `$name` for what a task fills in.
"""

import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from string import Template
from typing import Any

from gauge_envs.errors import ParameterError
from gauge_envs.experiments.uncertain import UncertainParameter
from gauge_envs.pages.text import with_unit
from gauge_envs.references.sensitivities import input_uncertainties
from gauge_envs.scene import Box, RigidBody, Scene, Sphere

ALONG_AXIS = 0.99999
"""Smallest component of a unit vector that counts as along an axis: 0.3 degrees."""


@dataclass(frozen=True, kw_only=True)
class ParameterRange:
    """Range of one constant of a body, or of the displacement of its start along a direction.

    Attributes:
        parameter: The parameter; that of a start has a direction.
        low: Lower end.
        high: Upper end; of a displacement the half width [m].
    """

    parameter: UncertainParameter
    low: float
    high: float

    @property
    def is_start(self) -> bool:
        """Whether it is of a start."""
        return self.parameter.direction is not None

    @property
    def ends(self) -> str:
        """Both ends as a tuple in Python."""
        return f"({self.low:.6g}, {self.high:.6g})"


def ranges_of(parameters: Sequence[UncertainParameter], width: float = 2.0) -> list[ParameterRange]:
    """Return ranges of so many standard uncertainties to each side, within the physical values."""
    if not width > 0.0:
        raise ParameterError(f"width {width}: give a number of standard uncertainties above 0")
    return [
        ParameterRange(parameter=one, low=one.at(-width), high=one.at(width))
        if one.direction is None
        else ParameterRange(parameter=one, low=-width * one.std, high=width * one.std)
        for one in parameters
    ]


def randomization_files(
    task: str, scene: Scene, parameters: Sequence[UncertainParameter], width: float = 2.0
) -> dict[str, str]:
    """Return Python files by their names: for Gymnasium, Isaac Lab, ManiSkill and MuJoCo Playground.

    Args:
        task: Gymnasium id.
        scene: Scene of the task.
        parameters: Its uncertain parameters.
        width: Number of standard uncertainties to each side.
    """
    ranges = ranges_of(parameters, width)
    bodies: dict[str, dict[str, ParameterRange]] = {}
    starts: dict[str, list[ParameterRange]] = {}
    for one in ranges:
        key = one.parameter.key
        if one.is_start:
            starts.setdefault(key, []).append(one)
            continue
        owner, _, constant = key.rpartition(".")
        # Counted bodies share the constants of their entry.
        for body in scene.bodies:
            if owner in (body.name, body.name.rpartition("-")[0]):
                bodies.setdefault(body.name, {})[constant] = one
    texts = {
        "gymnasium": _gymnasium(task, ranges, starts),
        "isaac_lab": "".join(_isaac_lab(bodies, starts)),
        "maniskill": "".join(_maniskill(scene, bodies, starts)),
        "playground": "".join(_playground(bodies, starts)),
    }
    heading = "\n".join(_heading(task, ranges, width))
    return {f"randomized_{stack}.py": f"{heading}\n{text.rstrip()}\n" for stack, text in texts.items()}


def _heading(task: str, ranges: Sequence[ParameterRange], width: float) -> Iterator[str]:
    yield f'"""Randomization of {task} within its measured uncertainty: {width:g} sigma to each side, uniform.'
    yield ""
    for one in ranges:
        limits = f"+- {one.high:.4g}" if one.is_start else f"{one.low:.6g} to {one.high:.6g}"
        unit, std = one.parameter.unit, f"{one.parameter.std:.3g}"
        yield with_unit(f"{one.parameter.name}: {limits}", unit)
        yield f"    sigma {with_unit(std, unit)}; {one.parameter.source}"
    if any(one.parameter.key.rpartition(".")[2] in input_uncertainties().joint for one in ranges):
        yield "Constants of joints are drawn in the file for Gymnasium alone."
    yield '"""'
    yield ""


@cache
def _parts(stack: str) -> Mapping[str, Template]:
    text = (files("gauge_envs.tools.transfer") / "templates" / f"{stack}.txt").read_text(encoding="utf-8")
    _, *found = re.split(r"^=== (\w+)\n", text, flags=re.MULTILINE)
    return {name: Template(part) for name, part in zip(found[::2], found[1::2], strict=True)}


def _filled(stack: str, part: str, **values: Any) -> str:
    return _parts(stack)[part].substitute(values)


def _displacements(ranges: Sequence[ParameterRange], indent: str = "") -> str:
    """Return a comment with the displacement of a start along each direction."""
    directions = (([round(part, 6) for part in one.parameter.direction or ()], one.high) for one in ranges)
    return "".join(f"{indent}#   +- {half:.6g} along {direction}\n" for direction, half in directions)


def _gymnasium(task: str, ranges: Sequence[ParameterRange], starts: Mapping[str, Sequence[ParameterRange]]) -> str:
    constants = {one.parameter.key: (one.low, one.high) for one in ranges if not one.is_start}
    moved = {
        key: [list(some[0].parameter.value), [[list(one.parameter.direction or ()), one.high] for one in some]]
        for key, some in starts.items()
        if isinstance(some[0].parameter.value, tuple)
    }
    return _filled("gymnasium", "file", task=task, constants=_literal(constants), starts=_literal(moved))


def _literal(values: Mapping[str, object]) -> str:
    """Return a dictionary as Python code, one entry a line."""
    lines = [f"    {json.dumps(key)}: {json.dumps(value)}," for key, value in values.items()]
    return "\n".join(["{", *lines, "}"]) if values else "{}"


def _isaac_lab(
    bodies: Mapping[str, Mapping[str, ParameterRange]], starts: Mapping[str, Sequence[ParameterRange]]
) -> Iterator[str]:
    yield _filled("isaac_lab", "head")
    for body, constants in bodies.items():
        name = body.replace("-", "_")
        if "friction" in constants:
            restitution = constants["restitution"].ends if "restitution" in constants else "(0.0, 0.0)"
            friction = constants["friction"].ends
            yield _filled("isaac_lab", "friction", name=name, friction=friction, restitution=restitution)
        if "mass_kg" in constants:
            yield _filled("isaac_lab", "mass", name=name, mass=constants["mass_kg"].ends)
    for key, directions in starts.items():
        widths = [f'"{axis}": {one.ends}' for one in directions if (axis := _world_axis(one)) is not None]
        if len(widths) < len(directions):
            # Independent ranges of x and z would lift the body off a tilted face, or push it into the face.
            yield _filled("isaac_lab", "tilted", key=key) + _displacements(directions, "    ")
        else:
            name = key.rpartition(".")[0].replace("-", "_")
            yield _filled("isaac_lab", "start", name=name, widths=", ".join(widths))
    yield _filled("isaac_lab", "tail")


def _world_axis(one: ParameterRange) -> str | None:
    """Return the axis of the world along which a start moves; None for another direction."""
    components = zip("xyz", one.parameter.direction or (), strict=False)
    return next((axis for axis, part in components if abs(part) > ALONG_AXIS), None)


def _maniskill(
    scene: Scene, bodies: Mapping[str, Mapping[str, ParameterRange]], starts: Mapping[str, Sequence[ParameterRange]]
) -> Iterator[str]:
    yield _filled("maniskill", "head")
    for name, constants in bodies.items():
        body = scene.body(name)
        if (solid := _solid(body)) is None:
            yield _filled("maniskill", "other", body=name)
            continue
        drawn = {key: f"random.uniform{one.ends}" for key, one in constants.items()}
        yield _filled(
            "maniskill",
            "body",
            body=name,
            name=name.replace("-", "_"),
            friction=drawn.get("friction", "0.0"),
            restitution=drawn.get("restitution", "0.0"),
            mass=drawn.get("mass_kg", f"{body.mass_kg:.6g}"),
            shape=solid[0],
            volume=f"{solid[1]:.8g}",
            position=list(body.pose.position_m),
            # SAPIEN's quaternions are w, x, y, z too.
            quaternion=list(body.pose.quaternion),
        )
    for key, directions in starts.items():
        yield _filled("maniskill", "start", key=key) + _displacements(directions)


def _solid(body: RigidBody) -> tuple[str, float] | None:
    """Return the call of SAPIEN's builder without its end, and the volume [m^3]; None for other shapes."""
    if isinstance(body.shape, Box):
        half_m = [0.5 * side for side in body.shape.size_m]
        return f"box_collision(half_size={half_m}", math.prod(body.shape.size_m)
    if isinstance(body.shape, Sphere):
        radius = body.shape.radius_m
        return f"sphere_collision(radius={radius}", 4.0 / 3.0 * math.pi * radius**3
    return None


def _playground(
    bodies: Mapping[str, Mapping[str, ParameterRange]], starts: Mapping[str, Sequence[ParameterRange]]
) -> Iterator[str]:
    def numbered(first: int) -> str:
        return ", ".join(f"{json.dumps(name)}: {number}" for number, name in enumerate(bodies, first))

    yield _filled("playground", "head", geoms=numbered(0), bodies=numbered(1))
    for body, constants in bodies.items():
        for part, key in (("friction", "friction"), ("mass", "mass_kg")):
            if key in constants:
                low, high = constants[key].low, constants[key].high
                yield _filled("playground", part, body=json.dumps(body), low=f"{low:.6g}", high=f"{high:.6g}")
    yield _filled("playground", "tail")
    for key, directions in starts.items():
        yield _filled("playground", "start", key=key) + _displacements(directions)
