"""Write the physics settings that a policy is trained with to a file that `gauge sanity` reads elsewhere.

Run this file in the training environment. It needs Python 3.8 or later, and nothing of gauge-envs.

    python gauge_probe.py HalfCheetah-v5
    python gauge_probe.py robot/scene.xml --out robot.gaugeprobe.json
    python gauge_probe.py logs/rsl_rl/anymal/params/env.yaml
    python gauge_probe.py my_package.robots:make_model
    python gauge_probe.py "mujoco_playground:registry.load('CheetahRun')"
    python gauge_probe.py "mjlab.tasks.registry:load_env_cfg('Mjlab-Velocity-Flat-Unitree-Go1')"
    python gauge_probe.py "dm_control.suite:load('walker', 'walk')"
    python gauge_probe.py "mani_skill.envs.tasks:PickCubeEnv"

`MODULE:EXPRESSION` is Python, evaluated in that module; what can be called without arguments is called. A program that
has the environment, model or configuration already writes it itself:

    import gauge_probe

    gauge_probe.save(env, "robot.gaugeprobe.json")
"""

from __future__ import annotations

import argparse
import dataclasses
import enum
import importlib
import json
import math
import os
import platform
import re
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

MOST_DEPTH = 24


class ProbeError(Exception):
    """The target cannot be read."""


def plain(value: Any, depth: int = 0) -> Any:
    """Return a value in JSON's types: NaN and infinity as texts, classes and functions as `module:name`."""
    if depth > MOST_DEPTH:
        raise ProbeError(f"its values are nested more than {MOST_DEPTH} deep")
    if isinstance(value, enum.Enum):
        return value.name
    if value is None or isinstance(value, (bool, str, int)):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else str(value)
    if isinstance(value, (list, tuple, set, frozenset)):
        return [plain(entry, depth + 1) for entry in value]
    listed = array_values(value)
    if listed is not None:
        return plain(listed, depth + 1)
    if callable(value):
        return f"{getattr(value, '__module__', '')}:{getattr(value, '__qualname__', type(value).__qualname__)}"
    if isinstance(value, (slice, bytes)):
        return None
    return {
        str(name): plain(entry, depth + 1) for name, entry in members(value).items()
    }


def members(value: Any) -> dict[Any, Any]:
    """Return the public entries of a mapping, a dataclass, a pydantic model or any other object."""
    if hasattr(value, "items"):
        return dict(value.items())
    if dataclasses.is_dataclass(value):
        return {
            field.name: getattr(value, field.name)
            for field in dataclasses.fields(value)
        }
    if hasattr(value, "model_dump"):
        return dict(value.model_dump())
    public = {
        name: found(value, name) for name in dir(value) if not name.startswith("_")
    }
    return {name: entry for name, entry in public.items() if not callable(entry)}


def array_values(value: Any) -> Any:
    """Return the numbers of an array of NumPy, JAX, Torch or Warp as lists; None for any other value."""
    if isinstance(value, type):
        return None
    for step in ("detach", "cpu", "numpy"):
        method = getattr(value, step, None)
        value = method() if callable(method) else value
    if str(getattr(value, "dtype", "")) == "float32":
        import numpy

        # The shortest decimals of single precision: 0.004 instead of 0.004000000189989805.
        value = numpy.asarray(value).astype("U").astype(float)
    return value.tolist() if callable(getattr(value, "tolist", None)) else None


def flat(value: Any) -> list[Any]:
    """Return the numbers of an array as one list; a number is a list of one, and a truth value is 0 or 1."""
    listed = value if isinstance(value, (list, int, float)) else array_values(value)
    if not isinstance(listed, list):
        return [int(listed) if isinstance(listed, bool) else listed]
    return [number for entry in listed for number in flat(entry)]


def found(value: Any, place: str) -> Any:
    """Return the attribute or entry at a place such as `sim.cfg`; None where there is none."""
    for name in [part for part in place.split(".") if part]:
        try:
            value = (
                value[name] if isinstance(value, dict) else getattr(value, name, None)
            )
        except Exception:  # Properties of other packages raise anything, such as an error before the first reset.
            return None
        if value is None:
            return None
    return value


def is_of(value: Any, package: str, name: str) -> bool:
    """Return whether a value's class has that name and is from that package, which need not be imported."""
    return any(
        one.__name__ == name and one.__module__.split(".")[0] == package
        for one in type(value).__mro__
    )


def is_number(value: Any) -> bool:
    """Return whether a value is a number or an array."""
    return isinstance(value, (int, float)) or array_values(value) is not None


MOST_GEOMS = 2000

NAMED_OPTIONS = {
    "integrator": "mjtIntegrator",
    "cone": "mjtCone",
    "solver": "mjtSolver",
    "jacobian": "mjtJacobian",
}
"""Options of MuJoCo that are written by the name of their constant, since numbers change between versions."""

FLAGS = {"disableflags": "mjtDisableBit", "enableflags": "mjtEnableBit"}

WIDTHS = {
    "body": {
        **dict.fromkeys(("parentid", "mass", "mocapid"), 1),
        **dict.fromkeys(("pos", "ipos", "inertia"), 3),
        **dict.fromkeys(("quat", "iquat"), 4),
    },
    "jnt": {"type": 1, "bodyid": 1, "pos": 3, "axis": 3, "limited": 1, "range": 2},
    "geom": {
        **dict.fromkeys(
            ("bodyid", "contype", "conaffinity", "condim", "priority", "solmix"), 1
        ),
        **dict.fromkeys(("margin", "gap", "rbound"), 1),
        **dict.fromkeys(("friction", "size", "pos"), 3),
        "solref": 2,
        "solimp": 5,
        "quat": 4,
    },
    "pair": {
        **dict.fromkeys(("dim", "geom1", "geom2", "margin", "gap"), 1),
        **dict.fromkeys(("solref", "solreffriction"), 2),
        **dict.fromkeys(("friction", "solimp"), 5),
    },
    "exclude": {"signature": 1},
}
ARRAYS = {
    f"{kind}_{name}": width
    for kind, columns in WIDTHS.items()
    for name, width in columns.items()
}
"""Arrays of a compiled model of MuJoCo that are written as they are, with their number of columns."""

MESHES = ("mjGEOM_MESH", "mjGEOM_SDF")

STANDING = ("home", "stand", "standing")
"""Names of keyframes in which robots stand."""

COUNTS = ("nflex", "flg_adhesion", "flg_surfacevel")
"""Numbers of a compiled model that show parts which are not written."""

MODEL_PLACES = (
    *("mj_model", "_mj_model", "model", "_model", "sim.mj_model", "sim.model"),
    *("physics.model.ptr", "physics.model", "physics.model._model"),
    *("env.mj_model", "_env.mj_model"),
)
"""Attributes that hold the compiled model of an environment."""

SKIPS = ("frame_skip", "n_substeps", "_n_substeps", "cfg.decimation", "decimation")
"""Attributes that hold the steps of the engine for one action."""


def mujoco_model(target: Any) -> Any:
    """Return the compiled model that a target is or holds; None where there is none."""
    if is_of(target, "mujoco", "MjSpec"):
        return target.compile()
    if (
        found(target, "sim.mujoco") is not None
        and found(target, "scene.entities") is not None
    ):
        return mjlab_model(target)
    for holder in (target, found(target, "unwrapped")):
        for value in (holder, *(found(holder, place) for place in MODEL_PLACES)):
            if is_of(value, "mujoco", "MjModel") or is_mjx_model(value):
                return value
    return None


def mjlab_model(cfg: Any) -> Any:
    """Return the compiled model of a task configuration of mjlab, with its options; no simulation is started."""
    from mjlab.scene import Scene

    model = Scene(cfg.scene, device="cpu").compile()
    cfg.sim.mujoco.apply(model)
    return model


def is_mjx_model(value: Any) -> bool:
    """Return whether a value is a model of MJX, whose arrays have MuJoCo's names."""
    return type(value).__name__ == "Model" and type(value).__module__.startswith(
        "mujoco.mjx"
    )


def capture_mujoco(target: Any) -> dict[str, Any]:
    """Return options, contact constants and masses of a compiled model."""
    import mujoco

    model = mujoco_model(target)
    if model.ngeom > MOST_GEOMS:
        raise ProbeError(
            f"the model has {model.ngeom} geoms, the limit is {MOST_GEOMS}"
        )
    names = [
        name
        for name in dir(mujoco.MjModel.from_xml_string("<mujoco/>").opt)
        if not name.startswith("_")
    ]
    options: dict[str, Any] = {name: getattr(model.opt, name, None) for name in names}
    options = {name: value for name, value in options.items() if is_number(value)}
    known = {}
    for name, value in options.items():
        if name in NAMED_OPTIONS:
            options[name] = getattr(mujoco, NAMED_OPTIONS[name])(int(value)).name
        elif name in FLAGS:
            bits = getattr(mujoco, FLAGS[name]).__members__
            known[name] = sorted(
                bit for bit in bits if bit.startswith(("mjDSBL_", "mjENBL_"))
            )
            options[name] = [bit for bit in known[name] if int(value) & int(bits[bit])]
        else:
            listed = flat(value)
            options[name] = listed[0] if len(listed) == 1 else listed
    type_names = {
        int(value): name for name, value in mujoco.mjtGeom.__members__.items()
    }
    types = [type_names[int(kind)] for kind in flat(model.geom_type)]
    found_hulls, chosen = hulls(model, types)
    title = bytes(model.names).split(b"\0")[0].decode()
    starts = [int(start) for start in flat(model.jnt_qposadr)]
    firsts = [int(first) for first in flat(model.jnt_dofadr)]
    qpos0 = flat(model.qpos0)
    armature, damping = flat(model.dof_armature), flat(model.dof_damping)
    driven_joints, driven_bodies = driven(model)
    data = {
        "implementation": implementation(target, model),
        "options": options,
        "known_flags": known,
        "counts": {
            name: int(getattr(model, name)) for name in COUNTS if hasattr(model, name)
        },
        "arrays": {
            **{name: flat(getattr(model, name)) for name in ARRAYS},
            "jnt_ref": [qpos0[start] for start in starts],
            "jnt_armature": [armature[first] for first in firsts],
            "jnt_damping": [damping[first] for first in firsts],
            "jnt_driven": [int(joint in driven_joints) for joint in range(model.njnt)],
            "body_driven": [int(body in driven_bodies) for body in range(model.nbody)],
        },
        "geom_types": types,
        "geom_hulls": chosen,
        "geom_names": texts(model, model.name_geomadr),
        "body_names": texts(model, model.name_bodyadr),
        "hulls": found_hulls,
        "keyframes": keyframes(model),
        "frame_skip": frame_skip(target),
    }
    source = f"model {title or 'unnamed'!r}, MuJoCo {mujoco.__version__}"
    return {"kind": "mujoco-model", "engine": "mujoco", "source": source, "data": data}


def hulls(model: Any, types: list[str]) -> tuple[dict[str, list[float]], list[int]]:
    """Return the hull of each mesh that collides, by number, and the hull of each geom; -1 where it has none."""
    paired = {int(geom) for geom in flat(model.pair_geom1) + flat(model.pair_geom2)}
    offers, accepts = flat(model.geom_contype), flat(model.geom_conaffinity)
    meshes = flat(model.geom_dataid)
    chosen = [
        int(mesh)
        if types[geom] in MESHES and (geom in paired or offers[geom] or accepts[geom])
        else -1
        for geom, mesh in enumerate(meshes)
    ]
    vertices, graph, found_hulls = flat(model.mesh_vert), flat(model.mesh_graph), {}
    for mesh in sorted(set(chosen) - {-1}):
        first = int(flat(model.mesh_vertadr)[mesh])
        corners = list(range(int(flat(model.mesh_vertnum)[mesh])))
        start = int(flat(model.mesh_graphadr)[mesh])
        if start >= 0:
            # The table of a hull holds its numbers of vertices and faces, an address for each vertex, and the vertices.
            size = graph[start]
            corners = graph[start + 2 + size : start + 2 + 2 * size]
        rows = [3 * (first + int(corner)) for corner in corners]
        found_hulls[str(mesh)] = [
            number for row in rows for number in vertices[row : row + 3]
        ]
    return found_hulls, chosen


def driven(model: Any) -> tuple[set[int], set[int]]:
    """Return the joints on which actuators act, and the bodies on which they act by tendons, at sites or directly."""
    import mujoco

    kinds = flat(model.actuator_trntype)
    targets = [int(target) for target in flat(model.actuator_trnid)[::2]]
    joints, bodies = set(), set()
    for number, target in enumerate(targets):
        kind = mujoco.mjtTrn(int(kinds[number])).name
        if kind == "mjTRN_JOINT":
            joints.add(target)
        elif kind == "mjTRN_JOINTINPARENT":
            bodies.add(int(flat(model.jnt_bodyid)[target]))
        elif kind == "mjTRN_BODY":
            bodies.add(target)
        elif kind in ("mjTRN_SITE", "mjTRN_SLIDERCRANK"):
            bodies.add(int(flat(model.site_bodyid)[target]))
        elif kind == "mjTRN_TENDON":
            first = int(flat(model.tendon_adr)[target])
            count = int(flat(model.tendon_num)[target])
            for wrap in range(first, first + count):
                part = int(flat(model.wrap_objid)[wrap])
                wrapped = mujoco.mjtWrap(int(flat(model.wrap_type)[wrap])).name
                if wrapped == "mjWRAP_JOINT":
                    bodies.add(int(flat(model.jnt_bodyid)[part]))
                elif wrapped == "mjWRAP_SITE":
                    bodies.add(int(flat(model.site_bodyid)[part]))
    return joints, bodies


def keyframes(model: Any) -> dict[str, list[float]]:
    """Return the coordinates of those keyframes in which robots stand."""
    rows, names = flat(model.key_qpos), texts(model, model.name_keyadr)
    places = {
        name: index * model.nq for index, name in enumerate(names) if name in STANDING
    }
    return {name: rows[start : start + model.nq] for name, start in places.items()}


def texts(model: Any, addresses: Any) -> list[str]:
    """Return the names at some addresses in a model's table of names."""
    table = bytes(model.names)
    return [
        table[start : table.index(b"\0", start)].decode() for start in flat(addresses)
    ]


def implementation(target: Any, model: Any) -> str:
    """Return `mjx` or `mujoco_warp` where one of them runs the model, else `c`."""
    choice = str(found(target, "_config.impl") or found(target, "config.impl") or "")
    if choice == "warp" or is_of_package(target, "mjlab"):
        return "mujoco_warp"
    is_mjx = (
        is_mjx_model(model)
        or choice == "jax"
        or is_of_package(target, "mujoco_playground")
    )
    return "mjx" if is_mjx else "c"


def is_of_package(target: Any, package: str) -> bool:
    """Return whether a class of a target, or of the environment that it wraps, is of a package."""
    for holder in (target, found(target, "unwrapped")):
        for part in type(holder).__mro__:
            if part.__module__.split(".")[0] == package:
                return True
    return False


def frame_skip(target: Any) -> int | None:
    """Return the steps of the engine for one action; None where the target does not state it."""
    for holder in (target, found(target, "unwrapped")):
        for place in SKIPS:
            value = found(holder, place)
            if isinstance(value, int) and not isinstance(value, bool):
                return value
    return None


FORMAT, VERSION = "gauge-probe", 3

SUFFIX = ".gaugeprobe.json"

MOST_BYTES = 16 * 10**6

PACKAGES = (
    *("numpy", "mujoco", "mujoco-mjx", "mujoco-warp", "warp-lang", "jax", "torch"),
    *("gymnasium", "dm_control", "playground", "mjlab", "isaaclab", "isaacsim"),
    *("mani_skill", "sapien", "newton", "genesis-world"),
)
"""Packages whose versions are written if they are installed."""


def isaaclab_cfg(target: Any) -> Any:
    """Return the configuration of an environment of Isaac Lab; None for any other target."""
    for value in (target, found(target, "cfg"), found(target, "unwrapped.cfg")):
        if (
            found(value, "sim.physx") is not None
            or found(value, "sim.physics_material") is not None
        ):
            return value
    return None


def capture_isaaclab(target: Any) -> dict[str, Any]:
    """Return the configuration as Isaac Lab writes it to `env.yaml`."""
    cfg = isaaclab_cfg(target)
    entries = cfg.to_dict() if callable(getattr(cfg, "to_dict", None)) else cfg
    source = f"Isaac Lab, {type(cfg).__name__}"
    return of_physx("isaaclab-cfg", source, {"cfg": plain(entries)})


def of_physx(kind: str, source: str, data: dict[str, Any]) -> dict[str, Any]:
    """Return the entries of the file for a configuration of PhysX."""
    return {"kind": kind, "engine": "physx", "source": source, "data": data}


def maniskill_config(target: Any) -> Any:
    """Return the SimConfig of an environment of ManiSkill or of its class; None for any other target."""
    for value in (
        target,
        found(target, "sim_config"),
        found(target, "unwrapped.sim_config"),
    ):
        if is_of(value, "mani_skill", "SimConfig"):
            return value
    default = found(target, "_default_sim_config") if isinstance(target, type) else None
    default = default.__get__(object()) if isinstance(default, property) else default
    return default if is_of(default, "mani_skill", "SimConfig") else None


def capture_maniskill(target: Any) -> dict[str, Any]:
    """Return the fields of ManiSkill's SimConfig."""
    data = {"sim_config": plain(maniskill_config(target))}
    return of_physx("maniskill-sim-config", "ManiSkill, SimConfig", data)


CAPTURES: Any = (
    (lambda target: mujoco_model(target) is not None, capture_mujoco),
    (lambda target: isaaclab_cfg(target) is not None, capture_isaaclab),
    (lambda target: maniskill_config(target) is not None, capture_maniskill),
)
"""What can be captured: whether a target is of a kind, and the function that returns its entries of the file."""


def document(target: Any, name: str = "") -> dict[str, Any]:
    """Return the content of the file for an environment, a model or a configuration."""
    head = {
        "format": FORMAT,
        "version": VERSION,
        "name": name or type(target).__qualname__,
        "versions": versions(),
    }
    if isinstance(target, str):
        data = {"env_yaml": target}
        return {**head, **of_physx("isaaclab-cfg", "Isaac Lab, env.yaml", data)}
    capture = next((capture for matches, capture in CAPTURES if matches(target)), None)
    if capture is None:
        kind = f"{type(target).__module__}.{type(target).__qualname__}"
        raise ProbeError(
            f"{kind} holds no model or configuration that is known: give the model itself"
        )
    return {**head, **capture(target)}


def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that are installed here."""
    installed = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            installed[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return installed


def save(target: Any, file: str, name: str = "") -> None:
    """Write an environment, a model or a configuration to a file for `gauge sanity`."""
    content = json.dumps(
        document(target, name), allow_nan=False, separators=(",", ": ")
    ).encode()
    if len(content) > MOST_BYTES:
        raise ProbeError(
            f"the file would have {len(content)} bytes, the limit is {MOST_BYTES}"
        )
    part = Path(f"{file}.{os.getpid()}.tmp")
    part.write_bytes(content)
    part.replace(file)


def resolve(text: str) -> Any:
    """Return the object that a text names: a file, a Gymnasium id, or `MODULE:EXPRESSION`."""
    suffix = Path(text).suffix.lower()
    if suffix in (".yaml", ".yml"):
        return Path(text).read_text(encoding="utf-8")
    if suffix in (".xml", ".mjcf", ".urdf", ".mjb"):
        import mujoco

        if suffix == ".mjb":
            return mujoco.MjModel.from_binary_path(text)
        return mujoco.MjModel.from_xml_path(text)
    module, colon, expression = text.partition(":")
    if colon and not re.search(r"-v\d+$", text):
        value = eval(expression, dict(vars(importlib.import_module(module))))
        is_plain_class = isinstance(value, type) and maniskill_config(value) is None
        kind = type(value).__name__
        is_called = is_plain_class or kind in ("function", "method", "partial")
        return value() if is_called else value
    import gymnasium

    return gymnasium.make(text)


def main() -> None:
    """Write the file for the target of the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("target", help="file, Gymnasium id, or MODULE:EXPRESSION")
    parser.add_argument("--out", help=f"file to write, NAME{SUFFIX} by default")
    options = parser.parse_args()
    sys.path.insert(0, str(Path.cwd()))
    name = (
        Path(options.target).name if Path(options.target).is_file() else options.target
    )
    file = options.out or re.sub(r"[^\w.-]+", "_", name).strip("_") + SUFFIX
    try:
        save(resolve(options.target), file, name)
    except ProbeError as error:
        sys.exit(f"error: {options.target}: {error}")
    print(file)


if __name__ == "__main__":
    main()
