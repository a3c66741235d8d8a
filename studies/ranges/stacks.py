"""Generated randomization files, loaded and drawn from 1,000 times by their stacks: stacks.csv, stacks.png.

python -m studies.ranges.stacks write FOLDER           # this package: files of a leg and of an id
PYTHON studies/ranges/stacks.py STACK FOLDER           # the Python that has the stack: adds its rows
PYTHON studies/ranges/stacks.py isaaclab FOLDER SOURCE # the folder isaaclab/source/isaaclab/isaaclab of its wheel
python -m studies.ranges.stacks picture FOLDER         # this package: the draws that the stacks left in FOLDER
"""

import ast
import csv
import importlib.util
import json
import sys
from collections.abc import Callable, Mapping
from importlib.metadata import version
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np

TABLE = Path(__file__).with_name("stacks.csv")
HEADER = (
    "stack",
    "loaded by",
    "constant",
    "low",
    "high",
    "draws",
    "least",
    "largest",
    "std",
    "real values",
    "real std",
)
DRAWS, ID = 1000, "SlopeSlider-2-wood"
DRY, VISCOUS, ARMATURE, KP = (
    "dry_friction_n_m",
    "viscous_friction_n_m_s_per_rad",
    "armature_kg_m2",
    "kp_n_m_per_rad",
)
LEG_DRY_N_M, THIGH_KG = 0.1, 0.5
XML = f"""<mujoco><worldbody><body name="base"><freejoint/><geom type="box" size=".05 .05 .05" mass="2"/>
<body name="thigh"><joint name="knee" axis="0 1 0" frictionloss="{LEG_DRY_N_M}"/>
<geom type="capsule" fromto="0 0 0 0 0 -.2" size=".02" mass="{THIGH_KG}"/></body></body></worldbody>
<actuator><position name="knee" joint="knee" kp="20"/></actuator></mujoco>"""
Draws = Mapping[str, Any]
PANELS = {
    f"joints.{KP}": "kp [N m/rad], 3 servos",
    f"joints.{VISCOUS}": "damping [N m s/rad], 6 servos",
    f"joints.{ARMATURE}": "armature [kg m^2], 6 laws of a bench",
    "contact.friction": "friction, 37 pairs of materials",
    "cube.friction": "friction, 20 slides of wood on wood",
    f"joints.{DRY}": "factor of dry friction, no single values",
}
"""Title of each constant of the picture."""


def write(folder: Path) -> None:
    """Write the leg, the file of each stack, and the real values of each constant."""
    from gauge_envs.tools.transfer.ranges import measured_constants
    from gauge_envs.tools.transfer.stack_files import STACKS, stack_file, subject_ranges

    folder.mkdir(parents=True, exist_ok=True)
    robot = folder / "leg.xml"
    robot.write_text(XML, encoding="utf-8")
    leg = subject_ranges(
        str(robot), like=["ServoArm-so101"], payload_kg=(0.0, 0.3), body="thigh"
    )
    for stack in STACKS:
        found = subject_ranges(ID) if stack == "gymnasium" else leg
        (folder / f"{stack}_ranges.py").write_text(
            stack_file(found, stack), encoding="utf-8"
        )
    real = {
        f"joints.{name}": list(one.values)
        for name, one in measured_constants()["so101"].items()
    }
    real["contact.friction"] = frictions_of_materials()
    real["cube.friction"] = slides("wood")
    (folder / "real.json").write_text(json.dumps(real), encoding="utf-8")


def frictions_of_materials() -> list[float]:
    """Return a friction of each pair of materials of this package, the mean of those that its source states."""
    from gauge_envs.experiments.task_files import task_spec
    from gauge_envs.references.tables import scoring_folder
    from gauge_envs.tools.transfer.ranges import PAIRS

    found = []
    for family, body, material in PAIRS:
        found.append(
            float(
                task_spec(family).constants_of(body, material, None)["friction"] or 0.0
            )
        )
    table = scoring_folder("facts") / "friction_tables.csv"
    for row in csv.DictReader(table.read_text(encoding="utf-8").splitlines()):
        stated = " to ".join(row[key] for key in ("static", "dynamic") if row[key])
        if stated:
            found.append(float(np.mean([float(end) for end in stated.split(" to ")])))
    return found


def slides(material: str) -> list[float]:
    """Return the friction of single slides down 30 degrees: a = g (sin - mu cos), with a from a parabola."""
    from gauge_envs.references.tables import scoring_folder

    lines = (
        (scoring_folder("facts") / "slope_slider_30deg.csv")
        .read_text(encoding="utf-8")
        .splitlines()
    )
    places: dict[str, list[float]] = {}
    for one in csv.DictReader(line for line in lines if not line.startswith("#")):
        if one["material"] == material:
            places.setdefault(one["trial"], []).append(1e-3 * float(one["downhill_mm"]))
    found = []
    for path in places.values():
        acceleration = 2.0 * np.polyfit(np.arange(len(path)) / 30.0, path, 2)[0]
        found.append(float((0.5 - acceleration / 9.81) / np.cos(np.pi / 6.0)))
    return found


def picture(folder: Path) -> None:
    """Draw a histogram of each constant and stack, one above the other, over the real values."""
    from gauge_envs.pages.figures import OURS, REAL, new_figure, save_png, tidy_axis

    real = json.loads((folder / "real.json").read_text(encoding="utf-8"))
    stacks = (*LOADED, "isaaclab")
    figure = new_figure(10.5, 6.5)
    for place, (name, title) in enumerate(PANELS.items()):
        axis = figure.add_subplot(2, 3, place + 1)
        shown = {"real": (np.array(real[name]), REAL)} if real.get(name) else {}
        for colour, stack in zip(OURS, stacks, strict=True):
            draws = dict(np.load(folder / f"{stack}.npz"))
            if name in draws:
                shown[stack] = draws[name], colour
        for height, (values, colour) in enumerate(shown.values()):
            counts, ends = np.histogram(values, bins=12)
            tall = 0.8 * counts / max(counts.max(), 1)
            axis.bar(
                ends[:-1],
                tall,
                np.diff(ends),
                height,
                align="edge",
                color=colour,
                alpha=0.6,
            )
        axis.set_yticks(np.arange(len(shown)), shown, fontsize=8)
        axis.set_xlabel(title, fontsize=8)
        axis.tick_params(axis="x", labelsize=8)
        tidy_axis(axis)
    save_png(figure, TABLE.with_name("stacks.png"))


def generated(folder: Path, stack: str) -> ModuleType:
    """Return the file of a stack, imported."""
    spec = importlib.util.spec_from_file_location(
        "ranges", folder / f"{stack}_ranges.py"
    )
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def of_fields(model: Any) -> dict[str, Any]:
    """Return what fields of one or many models of MuJoCo state of the leg, whose knee is degree of freedom 6."""
    return {
        f"joints.{DRY}": np.asarray(model.dof_frictionloss)[..., 6] / LEG_DRY_N_M,
        f"joints.{VISCOUS}": np.ravel(np.asarray(model.dof_damping)[..., 6]),
        f"joints.{ARMATURE}": np.asarray(model.dof_armature)[..., 6],
        f"joints.{KP}": np.asarray(model.actuator_gainprm)[..., 0, 0],
        "thigh.mass_kg": np.asarray(model.body_mass)[..., 2] - THIGH_KG,
        "contact.friction": np.asarray(model.geom_friction)[..., 0, 0],
    }


def joined(rows: list[dict[str, Any]]) -> Draws:
    """Return the columns of rows."""
    return {name: np.ravel([one[name] for one in rows]) for name in rows[0]}


def mujoco(file: ModuleType, folder: Path) -> Draws:
    """Draw models of plain MuJoCo."""
    import mujoco as engine

    model = engine.MjModel.from_xml_path(str(folder / "leg.xml"))
    draw, random = file.Randomizer(model), np.random.default_rng(0)
    rows = []
    for _ in range(DRAWS):
        draw(random)
        rows.append({name: np.copy(value) for name, value in of_fields(model).items()})
    return joined(rows)


def gymnasium(file: ModuleType, folder: Path) -> Draws:
    """Draw an id anew at each reset."""
    env = file.RandomizedConstants()
    rows = []
    for _ in range(DRAWS):
        _, info = env.reset()
        drawn = info["constants"]
        names = [one for one in file.RANGES if not one.endswith("position_m")]
        rows.append({name: drawn[name] for name in names})
    return joined(rows)


def playground(file: ModuleType, folder: Path) -> Draws:
    """Draw models of MJX as Brax's training does."""
    import jax
    import mujoco as engine
    from mujoco import mjx

    model = engine.MjModel.from_xml_path(str(folder / "leg.xml"))
    keys = jax.random.split(jax.random.PRNGKey(0), DRAWS)
    drawn, _ = file.domain_randomizer(model)(mjx.put_model(model), keys)
    return {
        name: value
        for name, value in of_fields(drawn).items()
        if np.size(value) == DRAWS
    }


def mjlab(file: ModuleType, folder: Path) -> Draws:
    """Reset the event terms of an environment of 1,000 worlds on the CPU."""
    import mujoco as engine
    from mjlab.actuator import XmlActuatorCfg
    from mjlab.entity import EntityArticulationInfoCfg, EntityCfg
    from mjlab.envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg
    from mjlab.scene import SceneCfg

    motors = (XmlActuatorCfg(target_names_expr=("knee",)),)
    robot = EntityCfg(
        spec_fn=lambda: engine.MjSpec.from_file(str(folder / "leg.xml")),
        articulation=EntityArticulationInfoCfg(actuators=motors),
    )
    scene = SceneCfg(num_envs=DRAWS, entities={"robot": robot})
    env = ManagerBasedRlEnv(
        ManagerBasedRlEnvCfg(decimation=1, scene=scene, events=file.events()),
        device="cpu",
    )
    env.reset()
    model = env.sim.model
    fields = (
        "dof_frictionloss",
        "dof_damping",
        "dof_armature",
        "actuator_gainprm",
        "body_mass",
        "geom_friction",
    )
    values = {name: getattr(model, name)[:].cpu().numpy() for name in fields}
    body = env.sim.mj_model.body("robot/thigh").id
    values["body_mass"] = values["body_mass"][:, body - 2 :]
    return of_fields(SimpleNamespace(**values))


def maniskill(file: Any, folder: Path) -> Draws:
    """Draw the Panda of ManiSkill's empty scene, whose fingers and hand take the names of the file."""
    import gymnasium as gym
    import mani_skill.envs  # noqa: F401  Registers the ids.

    env: Any = gym.make(
        "Empty-v1", robot_uids="panda", sim_backend="cpu", render_backend="none"
    )
    env.reset(seed=0)
    robot = env.unwrapped.agent.robot
    name, link = "panda_joint1", "panda_hand"
    (joint,) = robot.joints_map[name]._objs  # noqa: SLF001
    (body,) = robot.links_map[link]._objs  # noqa: SLF001
    joint.set_friction(LEG_DRY_N_M)
    mass_kg = body.mass
    file.JOINTS = [name]
    file.RANGES = {
        one.replace("thigh", link): ends for one, ends in file.RANGES.items()
    }
    draw, random = file.Randomizer(robot), np.random.default_rng(0)
    rows = []
    for _ in range(DRAWS):
        draw(random)
        material = body.get_collision_shapes()[0].physical_material
        rows.append(
            {
                f"joints.{DRY}": joint.friction / LEG_DRY_N_M,
                f"joints.{VISCOUS}": joint.damping,
                f"joints.{ARMATURE}": float(np.ravel(joint.armature)[0]),
                f"joints.{KP}": joint.stiffness,
                "thigh.mass_kg": body.mass - mass_kg,
                "contact.friction": material.static_friction,
            }
        )
    file.RANGES = {
        one.replace(link, "thigh"): ends for one, ends in file.RANGES.items()
    }
    return joined(rows)


def isaaclab(
    file_of: Callable[[], ModuleType], source: Path
) -> tuple[ModuleType, Draws]:
    """Check parameters against the event functions of Isaac Lab's source, and draw by its own sampling functions.

    Kit does not install here: functions of the two files are taken without their imports.
    """
    import torch

    tree = ast.parse((source / "envs/mdp/events.py").read_text(encoding="utf-8"))
    calls: dict[str, list[str]] = {}
    for node in tree.body:
        call = node
        if isinstance(node, ast.ClassDef):
            inner = [one for one in node.body if isinstance(one, ast.FunctionDef)]
            call = next((one for one in inner if one.name == "__call__"), node)
        if isinstance(call, ast.FunctionDef):
            calls[node.name] = [one.arg for one in call.args.args]  # type: ignore[attr-defined]
    maths = ast.parse((source / "utils/math.py").read_text(encoding="utf-8"))
    taken: dict[str, Any] = {"torch": torch}
    for some, name in ((maths, "sample_uniform"), (tree, "_randomize_prop_by_op")):
        (found,) = [one for one in some.body if getattr(one, "name", "") == name]
        found.decorator_list = []  # type: ignore[attr-defined]
        exec("from __future__ import annotations\n" + ast.unparse(found), taken)
        taken["math_utils"] = SimpleNamespace(sample_uniform=taken["sample_uniform"])

    def configuration(*given: str, **named: Any) -> SimpleNamespace:
        return SimpleNamespace(given=given, **named)

    names = ("isaaclab", "isaaclab.envs", "isaaclab.envs.mdp", "isaaclab.managers")
    modules = {name: ModuleType(name) for name in names}
    for name in calls:
        setattr(modules["isaaclab.envs.mdp"], name, name)
    modules["isaaclab.envs"].mdp = modules["isaaclab.envs.mdp"]  # type: ignore[attr-defined]
    modules["isaaclab"].envs = modules["isaaclab.envs"]  # type: ignore[attr-defined]
    for name in ("EventTermCfg", "SceneEntityCfg"):
        setattr(modules["isaaclab.managers"], name, configuration)
    sys.modules.update(modules)
    file = file_of()
    parameters = {
        "mass_kg": "mass_distribution_params",
        "friction": "static_friction_range",
    }
    for constant, (_, parameter) in file.PARAMETERS.items():
        parameters[constant] = f"{parameter}_distribution_params"
    drawn = {}
    constants = [one for one in file.RANGES if not one.endswith("delay_s")]
    for term, name in zip(file.event_terms().values(), constants, strict=True):
        strange = [one for one in term.params if one not in calls[term.func]]
        assert not strange, f"{term.func} has no {strange}"
        ends = term.params[parameters[name.rpartition(".")[2]]]
        operation = term.params.get("operation", "abs")
        before = torch.zeros(DRAWS, 1) if operation == "add" else torch.ones(DRAWS, 1)
        values = taken["_randomize_prop_by_op"](
            before, ends, None, slice(None), operation, "uniform"
        )
        drawn[name] = values.numpy()
    return file, drawn


LOADED = {
    "mujoco": ("mujoco", "MjModel", mujoco),
    "gymnasium": ("gymnasium", f"gymnasium.make, {ID}", gymnasium),
    "playground": ("mujoco-mjx", "MJX model, keys of Brax", playground),
    "mjlab": ("mjlab", "ManagerBasedRlEnv, CPU", mjlab),
    "maniskill": ("mani-skill", "Empty-v1, Panda, CPU", maniskill),
}
"""Distribution, what loads the file, and the function that draws."""


def main(stack: str, folder: Path, source: Path | None = None) -> None:
    """Replace the rows of a stack."""
    if source is not None:
        file, drawn = isaaclab(lambda: generated(folder, stack), source)
        extension = (source.parent / "config" / "extension.toml").read_text()
        title = f"{stack} {extension.split('version = ')[1].split()[0]}"
        loaded = "functions of its source"
    else:
        file = generated(folder, stack)
        distribution, loaded, function = LOADED[stack]
        title, drawn = f"{stack} {version(distribution)}", function(file, folder)
    real = json.loads((folder / "real.json").read_text(encoding="utf-8"))
    before: list[list[str]] = []
    if TABLE.is_file():
        before = list(csv.reader(TABLE.read_text(encoding="utf-8").splitlines()))[1:]
    rows = [one for one in before if one[0].split()[0] != stack]
    np.savez(folder / stack, **{name: np.ravel(one) for name, one in drawn.items()})
    for name, values in drawn.items():
        ends = file.RANGES[name]
        known = real.get(name, [])
        rows.append(
            [
                title.replace('"', ""),
                loaded,
                name,
                f"{ends['low']:.4g}",
                f"{ends['high']:.4g}",
                str(np.size(values)),
                f"{np.min(values):.4g}",
                f"{np.max(values):.4g}",
                f"{np.std(values):.3g}",
                str(len(known)),
                f"{np.std(known, ddof=1):.3g}" if len(known) > 1 else "",
            ]
        )
        assert np.size(values) == DRAWS
        margin = 1e-6 * abs(ends["high"])
        assert (
            ends["low"] - margin
            <= np.min(values)
            <= np.max(values)
            <= ends["high"] + margin
        )
    with TABLE.open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerows([HEADER, *rows])


if __name__ == "__main__":
    if sys.argv[1] == "write":
        write(Path(sys.argv[2]))
    elif sys.argv[1] == "picture":
        picture(Path(sys.argv[2]))
    else:
        main(sys.argv[1], Path(sys.argv[2]), *map(Path, sys.argv[3:]))
