"""MuJoCo Playground: tasks by name, without importing Playground or JAX, and its environments.

The settings of a task stand in its Python source, in its XML files, and for contact limits in its configuration. All
are read as data. Robots whose meshes Playground downloads are compiled with substitutes, which a note names. Changes
are overrides of the configuration, `config_overrides={"sim_dt": 0.002}`, and elements of the task's XML file.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Any

import mujoco

from gauge_envs.errors import TargetError
from gauge_envs.files import MEGABYTE
from gauge_envs.tools.sanity.model import CapacityLimits, TrainingConfiguration
from gauge_envs.tools.sanity.python_source.source import Source, package_folder, package_version
from gauge_envs.tools.sanity.python_source.values import UNKNOWN, Config, External, Instance, source_path
from gauge_envs.tools.sanity.robot.contact_capacity import contact_capacity
from gauge_envs.tools.sanity.robot.mujoco_model import mujoco_configuration
from gauge_envs.tools.sanity.stacks.dialect import Setting
from gauge_envs.tools.sanity.stacks.documents import file_content
from gauge_envs.tools.sanity.stacks.mjcf import MODEL_SETTINGS, Mjcf
from gauge_envs.tools.sanity.stacks.reader import GeomPair, Reader, has_start

PREFIX = "playground:"
"""Start of the name of a task."""

PACKAGE, DISTRIBUTION = "mujoco_playground", "playground"

SUITES = ("dm_control_suite", "locomotion", "manipulation")
"""Parts of Playground that register tasks."""

WARP = "warp"
"""Implementation whose memory for contacts is limited."""

MODEL_EDITORS = ("etree", "MjSpec.")
"""Texts in a task's code that show that it changes its XML before it compiles it."""

OVERRIDE = '"{key}": {value}'

PLAYGROUND = Mjcf(
    name="playground",
    settings=(
        *MODEL_SETTINGS,
        # Keys of a task's configuration. Other options stand in the task's XML file alone.
        Setting("timestep_s", "config", "sim_dt", pattern=OVERRIDE),
        Setting("njmax", "config", "njmax", pattern=OVERRIDE),
        Setting("naconmax", "config", "naconmax", pattern=OVERRIDE),
    ),
)


@dataclass(frozen=True, kw_only=True)
class PlaygroundTask:
    """What Playground's source states about a task.

    Attributes:
        name: Registered name.
        model_file: Its XML file.
        folders: Folders in which it looks for further files.
        options: Options of the engine that its code sets after it has compiled the model.
        config: Its configuration.
        world_count: Environments of Playground's own training; None when not stated.
        edits: Whether its code changes the XML before it compiles it.
    """

    name: str
    model_file: Path
    folders: tuple[Path, ...]
    options: Mapping[str, float]
    config: Mapping[str, Any]
    world_count: int | None
    edits: bool


def playground_tasks() -> tuple[str, ...]:
    """Return the names of all registered tasks."""
    return tuple(name for suite in SUITES for name in _registered(_source([]), suite))


def playground_task(name: str) -> PlaygroundTask:
    """Return what Playground's source states about a task.

    Args:
        name: `playground:NAME`, as `playground:Go1JoystickFlatTerrain`.
    """
    folders: list[Path] = []
    source = _source(folders)
    task = name.removeprefix(PREFIX)
    suite = next((one for one in SUITES if task in _registered(source, one)), None)
    if suite is None:
        raise TargetError(f"{name}: MuJoCo Playground has no task {task!r}; it has {', '.join(playground_tasks())}")
    made = source.call(_registered(source, suite)[task], [], {})
    attributes = made.attributes if isinstance(made, Instance) else {}
    path, config = attributes.get("_xml_path"), attributes.get("_config")
    if not isinstance(path, str) or not isinstance(config, Config):
        raise TargetError(f"{name}: its model or its configuration is not stated in a way that is read")
    code = Path(str(made.kind.module.path)).read_text(encoding="utf-8")
    parameters = source.module(f"{PACKAGE}.config.{suite}_params")
    training = UNKNOWN if parameters is None else source.call(source.value(parameters, "brax_ppo_config"), [task], {})
    worlds = training.get("num_envs") if isinstance(training, Config) else None
    model = attributes.get("_mj_model")
    options = model.attributes["opt"].attributes if isinstance(model, Instance) else {}
    return PlaygroundTask(
        name=task,
        model_file=Path(path),
        folders=tuple(folders),
        options={"timestep": config.get("sim_dt")} | {k: v for k, v in options.items() if isinstance(v, int | float)},
        config=config,
        world_count=worlds if isinstance(worlds, int) else None,
        edits=any(text in code for text in MODEL_EDITORS),
    )


def _source(folders: list[Path]) -> Source:
    """Return Playground's source; folders of files that it reads are added to a list."""

    def update_assets(args: list[Any], _: dict[str, Any]) -> None:
        if len(args) > 1 and isinstance(args[1], Path):
            folders.append(args[1])

    def model(*_: Any) -> Instance:
        return Instance(External("mujoco.MjModel"), {"opt": Instance(External("mujoco.MjOption"))})

    def editable(*_: Any) -> Instance:
        return Instance(External("mujoco.MjSpec"), {"compile": model, "sites": UNKNOWN})

    known = {
        "etils.epath.Path": source_path,
        "ml_collections.config_dict.create": lambda _, kwargs: Config(kwargs),
        f"{PACKAGE}._src.mjx_env.update_assets": update_assets,
        "mujoco.MjModel.from_xml_string": model,
        "mujoco.MjModel.from_xml_path": model,
        "mujoco.MjSpec.from_string": editable,
        "mujoco.MjSpec.from_file": editable,
    }
    return Source(package_folder(PACKAGE, "MuJoCo Playground", DISTRIBUTION), PACKAGE, known)


def _registered(source: Source, suite: str) -> Mapping[str, Any]:
    module = source.module(f"{PACKAGE}._src.{suite}")
    registered = UNKNOWN if module is None else source.value(module, "_envs")
    return registered if isinstance(registered, dict) else {}


# --- configuration ---------------------------------------------------------------------------------------------------


def _read_name(target: Any, pair: GeomPair | None) -> TrainingConfiguration:
    task = playground_task(str(target))
    try:
        packaged = packaged_model(task.model_file, task.folders)
    except TargetError as error:
        raise TargetError(f"{PREFIX}{task.name}: {error}") from None
    for option, value in task.options.items():
        setattr(packaged.model.opt, option, value)
    notes = _missing_notes(packaged)
    if task.edits:
        notes.append(f"Playground changes {task.model_file.name} before it compiles it; the file is read as it is")
    step, control = task.config.get("sim_dt"), task.config.get("ctrl_dt")
    read = mujoco_configuration(
        packaged.model,
        name=str(target),
        source=f"MuJoCo Playground {package_version(DISTRIBUTION)}, {task.model_file.name} and its configuration",
        pair=pair,
        frame_skip=round(control / step) if step and control else None,
        spec=packaged.spec,
        unknown=packaged.substituted_geoms,
    )
    return _trained(read, packaged, task.config, worlds=task.world_count, notes=notes)


def _trained(
    read: TrainingConfiguration,
    packaged: PackagedModel,
    config: Mapping[str, Any],
    *,
    worlds: int | None = None,
    notes: Sequence[str] = (),
) -> TrainingConfiguration:
    """Return the configuration of a model with what Playground trains it on, and its limits of contacts there."""
    implementation, engine, capacity = config.get("impl"), "MJX", None
    if implementation == WARP:
        engine = "MJX on mujoco_warp"
        stated = {name: config.get(name) for name in ("njmax", "naconmax")}
        whole = {name: value for name, value in stated.items() if type(value) is int}
        capacity = contact_capacity(
            packaged.model, CapacityLimits(**whole, worlds=worlds), unknown=packaged.missing_geoms
        )
    elif isinstance(implementation, str):
        engine = f"MJX's implementation {implementation!r}"
    note = f"trains with {engine}, in single precision; the rows run MuJoCo's C engine"
    scale = config.get("action_scale")
    return replace(
        read,
        robot=replace(read.robot, action_rad=float(scale)) if isinstance(scale, int | float) else read.robot,
        capacity=capacity,
        notes=(note, *notes, *read.notes),
        language=PLAYGROUND.name,
        trains_on="mujoco_warp" if implementation == WARP else "",
    )


def _missing_notes(packaged: PackagedModel) -> list[str]:
    missing, count = packaged.missing, len(packaged.missing_geoms)
    if not missing:
        return []
    shown = ", ".join(missing[:3]) + (f" and {len(missing) - 3} more" if len(missing) > 3 else "")
    geoms = f"{count} colliding geoms have one" if count else "no colliding geom has one"
    return [f"Playground downloads files that are not here ({shown}); substitutes stand for them, and {geoms}"]


# --- reader ----------------------------------------------------------------------------------------------------------


def _is_env(target: Any) -> bool:
    """Return whether an object is an environment of Playground, or of a wrapper around one."""
    inner = getattr(target, "unwrapped", target)
    return any(kind.__module__.startswith(PACKAGE) for kind in type(inner).__mro__) and isinstance(
        getattr(inner, "mj_model", None), mujoco.MjModel
    )


def _read_env(target: Any, pair: GeomPair | None) -> TrainingConfiguration:
    inner = getattr(target, "unwrapped", target)
    config, version = getattr(inner, "_config", {}), package_version(DISTRIBUTION)
    read = mujoco_configuration(
        inner.mj_model,
        name=type(inner).__name__,
        source=f"environment of MuJoCo Playground {version}, MuJoCo {mujoco.__version__}",
        pair=pair,
        frame_skip=getattr(inner, "n_substeps", None),
    )
    return _trained(read, PackagedModel(model=inner.mj_model), config)


DIALECTS = (PLAYGROUND,)

READERS = (
    Reader("a task of MuJoCo Playground (playground:Go1JoystickFlatTerrain)", has_start(PREFIX), _read_name),
    Reader("an env of MuJoCo Playground", _is_env, _read_env),
)


# --- models whose files are not all there ----------------------------------------------------------------------------

MOST_ASSET_BYTES = 256 * MEGABYTE
"""Largest size of a mesh or a picture."""

CORNERS_M = ((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.1))
"""Corners of the tetrahedron that stands for a mesh [m]; MuJoCo refuses smaller ones where a mesh is in millimetres."""

FACES = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))
"""Faces of that tetrahedron, by the numbers of their corners."""

ABSENT = "is not in the package: start the environment once, so that it downloads its robots"


@dataclass(frozen=True, kw_only=True)
class PackagedModel:
    """A compiled model of a package.

    Attributes:
        model: The compiled model.
        missing: Names of files that are not there and that a substitute stands for.
        missing_geoms: Numbers of the colliding geoms whose shape is a substitute.
        substituted_geoms: Numbers of all geoms whose shape is a substitute.
        spec: The model before it was compiled; None when it is not known.
    """

    model: mujoco.MjModel
    missing: tuple[str, ...] = ()
    missing_geoms: tuple[int, ...] = ()
    substituted_geoms: tuple[int, ...] = ()
    spec: mujoco.MjSpec | None = None


def packaged_model(path: Path, folders: Sequence[Path] = ()) -> PackagedModel:
    """Compile a model file of a package.

    Args:
        path: The model file. Files beside and below it are found by their name, as the packages do it.
        folders: Further folders in which files are found by their name.
    """
    found = (file for folder in (path.parent, *folders) for file in sorted(folder.rglob("*")) if file.is_file())
    places = {file.name: file for file in found}
    if not path.is_file():
        raise TargetError(f"{path.name} {ABSENT}")
    text = file_content(path, MOST_ASSET_BYTES)
    assets: dict[str, bytes] = {}
    missing: list[str] = []
    waiting = [(path.name, text)]
    while waiting:
        origin, content = waiting.pop()
        for name in _references(content, origin):
            if name in assets:
                continue
            if name in places:
                assets[name] = file_content(places[name], MOST_ASSET_BYTES)
                if name.endswith(".xml"):
                    waiting.append((name, assets[name]))
            elif name.endswith(".xml"):
                raise TargetError(f"{path.name} includes {name}, which {ABSENT}")
            else:
                assets[name] = _substitute(name)
                missing.append(name)
    try:
        spec = mujoco.MjSpec.from_string(text.decode(), include=assets, assets=assets)
        model = spec.compile()
    except (ValueError, UnicodeDecodeError) as error:
        raise TargetError(f"{path}: MuJoCo cannot load it: {' '.join(str(error).split())}") from None
    geoms = tuple(_substituted(model, missing))
    colliding = tuple(g for g in geoms if model.geom_contype[g] or model.geom_conaffinity[g])
    return PackagedModel(
        model=model, spec=spec, missing=tuple(missing), missing_geoms=colliding, substituted_geoms=geoms
    )


def _references(content: bytes, origin: str) -> Iterator[str]:
    """Yield names of the files that an XML text refers to, without their folders."""
    try:
        root = ElementTree.fromstring(content)
    except ElementTree.ParseError as error:
        raise TargetError(f"{origin}: is no XML: {error}") from None
    for element in root.iter():
        for attribute, value in element.attrib.items():
            if attribute.startswith("file"):
                yield Path(value).name


def _substitute(name: str) -> bytes:
    """Return a tetrahedron for a mesh, and a grey pixel for a picture."""
    suffix = Path(name).suffix.lower()
    if suffix in (".stl", ".obj"):
        import trimesh

        content = trimesh.Trimesh(CORNERS_M, FACES, process=False).export(file_type=suffix[1:])
        return content.encode() if isinstance(content, str) else bytes(content)
    if suffix == ".png":
        from PIL import Image

        stream = BytesIO()
        Image.new("RGB", (1, 1), (128, 128, 128)).save(stream, format="png")
        return stream.getvalue()
    raise TargetError(f"{name} is not in the package, and nothing can stand for a file of the kind {suffix or 'none'}")


def _substituted(model: mujoco.MjModel, missing: Sequence[str]) -> Iterator[int]:
    """Yield numbers of geoms whose mesh or height field is a substitute."""
    for geom in range(model.ngeom):
        data = int(model.geom_dataid[geom])
        kind = model.geom_type[geom]
        is_mesh, is_field = kind == mujoco.mjtGeom.mjGEOM_MESH, kind == mujoco.mjtGeom.mjGEOM_HFIELD
        if data < 0 or not (is_mesh or is_field):
            continue
        paths, start = model.paths, int((model.mesh_pathadr if is_mesh else model.hfield_pathadr)[data])
        if start >= 0 and Path(paths[start:].split(b"\0", 1)[0].decode()).name in missing:
            yield geom
