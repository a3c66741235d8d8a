"""Ranges of domain randomization from measured uncertainties, as code for common training stacks."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from gauge_envs.errors import ParameterError, ResultFileError
from gauge_envs.experiments.uncertain import UncertainParameter
from gauge_envs.files import write_whole
from gauge_envs.scene import Box, Pose, RigidBody, Scene, Sphere

ALONG_AXIS = 0.99999
"""Smallest component of a unit vector that counts as along an axis: 0.3 degrees."""


@dataclass(frozen=True, kw_only=True)
class ConstantRange:
    """Range of one constant of a body.

    Attributes:
        parameter: The parameter.
        low: Lower end.
        high: Upper end.
    """

    parameter: UncertainParameter
    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class StartRange:
    """Range of one coordinate of a start.

    Attributes:
        parameter: The parameter, with its direction.
        half_m: Half width of the range of displacements [m].
    """

    parameter: UncertainParameter
    half_m: float


def ranges_of(parameters: Sequence[UncertainParameter], width: float = 2.0) -> list[ConstantRange | StartRange]:
    """Return ranges of so many standard uncertainties to each side, within the physical values.

    Args:
        parameters: The parameters.
        width: Number of standard uncertainties, above 0.
    """
    if not width > 0.0:
        raise ParameterError(f"width {width}: give a number of standard uncertainties above 0")
    return [
        ConstantRange(parameter=one, low=one.at(-width), high=one.at(width))
        if one.direction is None
        else StartRange(parameter=one, half_m=width * one.std)
        for one in parameters
    ]


def write_randomization(
    folder: Path, task: str, scene: Scene, parameters: Sequence[UncertainParameter], width: float = 2.0
) -> list[Path]:
    """Write the files of `randomization_files` to a folder, and return their paths."""
    files = randomization_files(task, scene, parameters, width)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in files.items():
            write_whole(folder / name, text.encode())
    except OSError as error:
        raise ResultFileError(f"{folder}: cannot be written: {error.strerror or error}") from error
    return [folder / name for name in files]


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
    heading = "\n".join(_heading(task, ranges, width))
    files = {
        "randomized_gymnasium.py": _gymnasium(task, ranges),
        "randomized_isaac_lab.py": "\n".join(_isaac_lab(scene, ranges)),
        "randomized_maniskill.py": "\n".join(_maniskill(scene, ranges)),
        "randomized_playground.py": "\n".join(_playground(scene, ranges)),
    }
    return {name: f"{heading}\n{text.rstrip()}\n" for name, text in files.items()}


def _heading(task: str, ranges: Sequence[ConstantRange | StartRange], width: float) -> Iterator[str]:
    yield f'"""Randomization of {task} within its measured uncertainty: {width:g} sigma to each side, uniform.'
    yield ""
    for one in ranges:
        unit = "" if one.parameter.unit == "1" else f" {one.parameter.unit}"
        limits = f"+- {one.half_m:.4g}" if isinstance(one, StartRange) else f"{one.low:.6g} to {one.high:.6g}"
        yield f"{one.parameter.name}: {limits}{unit}"
        yield f"    sigma {one.parameter.std:.3g}{unit}; {one.parameter.source}"
    yield '"""'
    yield ""


def _bodies(scene: Scene, ranges: Sequence[ConstantRange | StartRange]) -> dict[str, dict[str, ConstantRange]]:
    """Return the ranges of constants by body and constant; counted bodies share those of their entry."""
    found: dict[str, dict[str, ConstantRange]] = {}
    for one in ranges:
        if isinstance(one, ConstantRange):
            owner, _, constant = one.parameter.key.rpartition(".")
            for body in scene.bodies:
                if body.name == owner or body.name.rpartition("-")[0] == owner:
                    found.setdefault(body.name, {})[constant] = one
    return found


def _starts(ranges: Sequence[ConstantRange | StartRange]) -> dict[str, list[StartRange]]:
    found: dict[str, list[StartRange]] = {}
    for one in ranges:
        if isinstance(one, StartRange):
            found.setdefault(one.parameter.key, []).append(one)
    return found


def _pair(one: ConstantRange) -> str:
    return f"({one.low:.6g}, {one.high:.6g})"


def _gymnasium(task: str, ranges: Sequence[ConstantRange | StartRange]) -> str:
    constants = {one.parameter.key: (one.low, one.high) for one in ranges if isinstance(one, ConstantRange)}
    starts = {
        key: [list(value[0].parameter.value), [[list(one.parameter.direction or ()), one.half_m] for one in value]]
        for key, value in _starts(ranges).items()
        if isinstance(value[0].parameter.value, tuple)
    }
    return GYMNASIUM.replace("{TASK}", task).replace("{CONSTANTS}", _literal(constants)).replace(
        "{STARTS}", _literal(starts)
    )  # fmt: skip


def _literal(values: Mapping[str, object]) -> str:
    """Return a dictionary as Python code, one entry a line."""
    if not values:
        return "{}"
    lines = [f"    {json.dumps(key)}: {json.dumps(value)}," for key, value in values.items()]
    return "\n".join(["{", *lines, "}"])


GYMNASIUM = '''import gymnasium
import gauge_envs  # Registers the ids.
import numpy as np

CONSTANTS = {CONSTANTS}
"""Lower and upper end of each constant."""

STARTS = {STARTS}
"""Calibrated position of each body [m], and directions with their half widths [m]."""


def drawn_parameters(random):
    """Return constants and starts that are drawn uniformly from their ranges."""
    parameters = {key: random.uniform(low, high) for key, (low, high) in CONSTANTS.items()}
    for key, (position, directions) in STARTS.items():
        moved = np.array(position)
        for direction, half_width in directions:
            moved += random.uniform(-half_width, half_width) * np.array(direction)
        parameters[key] = moved.tolist()
    return parameters


class RandomizedConstants(gymnasium.Wrapper):
    """Environment whose constants are drawn anew at each reset; `info["constants"]` holds them."""

    def __init__(self, **arguments):
        self._arguments = arguments
        self._random = np.random.default_rng()
        super().__init__(gymnasium.make("{TASK}", **arguments))

    def reset(self, *, seed=None, options=None):
        if seed is not None:
            self._random = np.random.default_rng(seed)
        parameters = drawn_parameters(self._random)
        self.env.close()
        self.env = gymnasium.make("{TASK}", parameters=parameters, **self._arguments)
        observation, info = self.env.reset(seed=seed, options=options)
        return observation, info | {"constants": parameters}
'''


def _isaac_lab(scene: Scene, ranges: Sequence[ConstantRange | StartRange]) -> Iterator[str]:
    yield from (
        "import isaaclab.envs.mdp as mdp",
        "from isaaclab.managers import EventTermCfg as EventTerm",
        "from isaaclab.managers import SceneEntityCfg",
        "from isaaclab.utils import configclass",
        "",
        "# Friction and restitution are those of a pair. PhysX combines the materials of both bodies: give the",
        '# support friction 1, restitution 1 and the combine mode "multiply", so that the pair has these values.',
        "",
        "",
        "@configclass",
        "class EventCfg:",
    )
    bodies, starts = _bodies(scene, ranges), _starts(ranges)
    for body, constants in bodies.items():
        name = body.replace("-", "_")
        if "friction" in constants:
            restitution = _pair(constants["restitution"]) if "restitution" in constants else "(0.0, 0.0)"
            yield from (
                f"    {name}_material = EventTerm(",
                "        func=mdp.randomize_rigid_body_material,",
                '        mode="startup",',
                "        params={",
                f'            "asset_cfg": SceneEntityCfg("{name}"),',
                f'            "static_friction_range": {_pair(constants["friction"])},',
                f'            "dynamic_friction_range": {_pair(constants["friction"])},',
                f'            "restitution_range": {restitution},',
                '            "num_buckets": 256,',
                "            # Isaac Lab draws both frictions on their own; with this the dynamic one is the smaller",
                "            # of the two, on average a third up its range. One for both needs a function of your own.",
                '            "make_consistent": True,',
                "        },",
                "    )",
            )
        if "mass_kg" in constants:
            yield from (
                f"    {name}_mass = EventTerm(",
                "        func=mdp.randomize_rigid_body_mass,",
                '        mode="startup",',
                "        params={",
                f'            "asset_cfg": SceneEntityCfg("{name}"),',
                f'            "mass_distribution_params": {_pair(constants["mass_kg"])},',
                '            "operation": "abs",',
                "        },",
                "    )",
            )
    for key, directions in starts.items():
        name = key.rpartition(".")[0].replace("-", "_")
        widths = {axis: one for one in directions if (axis := _world_axis(one)) is not None}
        if len(widths) < len(directions):
            # Independent ranges of x and z would lift the body off a tilted face, or push it into the face.
            yield f"    # {key}: its face is tilted; in an event function of your own, add uniform displacements [m]:"
            yield from (f"    #   {_displacement(one)}" for one in directions)
            continue
        shown = ", ".join(f'"{axis}": ({-one.half_m:.6g}, {one.half_m:.6g})' for axis, one in widths.items())
        yield from (
            f"    {name}_start = EventTerm(",
            "        func=mdp.reset_root_state_uniform,",
            '        mode="reset",',
            "        params={",
            f'            "asset_cfg": SceneEntityCfg("{name}"),',
            f'            "pose_range": {{{shown}}},',
            '            "velocity_range": {},',
            "        },",
            "    )",
        )
    yield "    pass"


def _world_axis(one: StartRange) -> str | None:
    """Return the axis of the world along which a start moves; None for another direction."""
    for axis, part in zip("xyz", one.parameter.direction or (), strict=False):
        if abs(part) > ALONG_AXIS:
            return axis
    return None


def _displacement(one: StartRange) -> str:
    return f"+- {one.half_m:.6g} along {[round(part, 6) for part in one.parameter.direction or ()]}"


def _maniskill(scene: Scene, ranges: Sequence[ConstantRange | StartRange]) -> Iterator[str]:
    yield from (
        "import numpy as np",
        "import sapien",
        "from mani_skill.utils.structs import Actor",
        "",
        "# Friction and restitution are those of a pair. SAPIEN averages the materials of both bodies: give the",
        "# support of each sub-scene the values of its body as well.",
        "",
    )
    for body, constants in _bodies(scene, ranges).items():
        shape = _collision(scene.body(body))
        if shape is None:
            yield f"# {body}: its shape has no snippet; set its material and mass as for the others."
            continue
        name = body.replace("-", "_")
        values = {key: (one.low, one.high) for key, one in constants.items()}
        friction, restitution = (_drawn(values, key) for key in ("friction", "restitution"))
        mass = _drawn(values, "mass_kg") if "mass_kg" in values else f"{scene.body(body).mass_kg:.6g}"
        yield from (
            "",
            f"def build_{name}(task, seed=0):",
            f'    """Build {body} in each sub-scene with constants of its own; call it in `_load_scene`."""',
            "    random = np.random.default_rng(seed)",
            "    actors = []",
            "    for index in range(task.num_envs):",
            f"        friction, restitution = {friction}, {restitution}",
            "        material = sapien.physx.PhysxMaterial(",
            "            static_friction=friction, dynamic_friction=friction, restitution=restitution",
            "        )",
            f"        density = {mass} / {shape[1]:.8g}",
            "        builder = task.scene.create_actor_builder()",
            f"        builder.add_{shape[0]}, material=material, density=density)",
            "        builder.set_scene_idxs([index])",
            f"        builder.initial_pose = sapien.Pose({_pose(scene.body(body).pose)})",
            f'        actors.append(builder.build(name=f"{body}-{{index}}"))',
            f'    return Actor.merge(actors, name="{body}")',
            "",
        )
    for key, directions in _starts(ranges).items():
        yield f"# {key}: add at each reset, in `_initialize_episode`, uniform displacements [m]:"
        for one in directions:
            yield f"#   {_displacement(one)}"


def _pose(pose: Pose) -> str:
    """Return the arguments of SAPIEN's pose; its quaternions are w, x, y, z too."""
    return f"p={list(pose.position_m)}, q={list(pose.quaternion)}"


def _drawn(values: dict[str, tuple[float, float]], key: str) -> str:
    return "random.uniform({:.6g}, {:.6g})".format(*values[key]) if key in values else "0.0"


def _collision(body: RigidBody) -> tuple[str, float] | None:
    """Return the call of SAPIEN's builder without its end, and the volume [m^3]; None for other shapes."""
    if isinstance(body.shape, Box):
        x, y, z = body.shape.size_m
        return f"box_collision(half_size={[0.5 * x, 0.5 * y, 0.5 * z]}", x * y * z
    if isinstance(body.shape, Sphere):
        radius = body.shape.radius_m
        return f"sphere_collision(radius={radius}", 4.18879020478639 * radius**3
    return None


def _playground(scene: Scene, ranges: Sequence[ConstantRange | StartRange]) -> Iterator[str]:
    bodies = _bodies(scene, ranges)
    yield from (
        "import jax",
        "from mujoco import mjx",
        "",
        "# Indices in your model: mj_model.geom(NAME).id and mj_model.body(NAME).id.",
        f"GEOM_IDS = {{{', '.join(f'{json.dumps(name)}: {number}' for number, name in enumerate(bodies))}}}",
        f"BODY_IDS = {{{', '.join(f'{json.dumps(name)}: {number + 1}' for number, name in enumerate(bodies))}}}",
        "",
        "# Friction is that of a pair. MuJoCo takes the larger friction of two geoms with the same priority: give",
        "# these geoms a higher priority than the support's. It has no coefficient of restitution.",
        "",
        "",
        "def domain_randomize(model: mjx.Model, rng: jax.Array):",
        '    """Return the model with constants for each key of rng, and the axes for jax.vmap."""',
        "",
        "    @jax.vmap",
        "    def drawn(key):",
        "        friction, mass, inertia = model.geom_friction, model.body_mass, model.body_inertia",
    )
    for body, constants in bodies.items():
        if "friction" in constants:
            one = constants["friction"]
            yield from (
                "        key, used = jax.random.split(key)",
                f"        value = jax.random.uniform(used, minval={one.low:.6g}, maxval={one.high:.6g})",
                f"        friction = friction.at[GEOM_IDS[{json.dumps(body)}], 0].set(value)",
            )
        if "mass_kg" in constants:
            one = constants["mass_kg"]
            yield from (
                "        key, used = jax.random.split(key)",
                f"        value = jax.random.uniform(used, minval={one.low:.6g}, maxval={one.high:.6g})",
                f"        index = BODY_IDS[{json.dumps(body)}]",
                "        inertia = inertia.at[index].multiply(value / mass[index])",
                "        mass = mass.at[index].set(value)",
            )
    yield from (
        "        return friction, mass, inertia",
        "",
        "    friction, mass, inertia = drawn(rng)",
        '    changed = {"geom_friction": friction, "body_mass": mass, "body_inertia": inertia}',
        "    in_axes = jax.tree_util.tree_map(lambda _: None, model).tree_replace(dict.fromkeys(changed, 0))",
        "    return model.tree_replace(changed), in_axes",
        "",
    )
    for key, directions in _starts(ranges).items():
        yield f"# {key}: add in `reset` of the environment, to qpos, uniform displacements [m]:"
        for start in directions:
            yield f"#   {_displacement(start)}"
