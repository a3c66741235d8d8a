"""Read compiled models of MuJoCo and MJX, and what environments state beside them."""

from typing import Any

from gauge_envs.tools.sanity.probe.values import ProbeError, flat, found, is_number, is_of

MOST_GEOMS = 2000

NAMED_OPTIONS = {"integrator": "mjtIntegrator", "cone": "mjtCone", "solver": "mjtSolver", "jacobian": "mjtJacobian"}
"""Options of MuJoCo that are written by the name of their constant, since numbers change between versions."""

FLAGS = {"disableflags": "mjtDisableBit", "enableflags": "mjtEnableBit"}

WIDTHS = {
    "body": {"parentid": 1, "pos": 3, "quat": 4, "mass": 1, "ipos": 3, "iquat": 4, "inertia": 3, "mocapid": 1},
    "jnt": {"type": 1, "bodyid": 1, "pos": 3, "axis": 3, "limited": 1, "range": 2},
    "geom": {
        **dict.fromkeys(("bodyid", "contype", "conaffinity", "condim", "priority", "solmix"), 1),
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
ARRAYS = {f"{kind}_{name}": width for kind, columns in WIDTHS.items() for name, width in columns.items()}
"""Arrays of a compiled model of MuJoCo that are written as they are, with their number of columns."""

MESHES = ("mjGEOM_MESH", "mjGEOM_SDF")

STANDING = ("home", "stand", "standing")
"""Names of keyframes in which robots stand."""

COUNTS = ("nflex", "flg_adhesion", "flg_surfacevel")
"""Numbers of a compiled model that show parts which are not written."""

PLAYGROUND_PACKAGE, MJLAB_PACKAGE = "mujoco_playground", "mjlab"
"""Packages whose environments and task configurations hold more than a model."""

MODEL_PLACES = (
    *("mj_model", "_mj_model", "model", "_model", "sim.mj_model", "sim.model", "physics.model.ptr", "physics.model"),
    *("physics.model._model", "env.mj_model", "_env.mj_model"),
)
"""Attributes that hold the compiled model of an environment."""

LIMIT_PLACES = ("", "cfg.sim", "sim.cfg", "_config", "config", "sim")
"""Attributes that hold the limits of contacts and constraints of MJX and MuJoCo Warp."""


def mujoco_model(target: Any) -> Any:
    """Return the compiled model that a target is or holds; None where there is none."""
    if is_of(target, "mujoco", "MjSpec"):
        return target.compile()
    if found(target, "sim.mujoco") is not None and found(target, "scene.entities") is not None:
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
    return type(value).__name__ == "Model" and type(value).__module__.startswith("mujoco.mjx")


def capture_mujoco(target: Any) -> dict[str, Any]:
    """Return options, contact constants and masses of a compiled model."""
    import mujoco

    model = mujoco_model(target)
    if model.ngeom > MOST_GEOMS:
        raise ProbeError(f"the model has {model.ngeom} geoms, the limit is {MOST_GEOMS}")
    names = [name for name in dir(mujoco.MjModel.from_xml_string("<mujoco/>").opt) if not name.startswith("_")]
    options: dict[str, Any] = {name: getattr(model.opt, name, None) for name in names}
    options = {name: value for name, value in options.items() if is_number(value)}
    known = {}
    for name, value in options.items():
        if name in NAMED_OPTIONS:
            options[name] = getattr(mujoco, NAMED_OPTIONS[name])(int(value)).name
        elif name in FLAGS:
            bits = getattr(mujoco, FLAGS[name]).__members__
            known[name] = sorted(bit for bit in bits if bit.startswith(("mjDSBL_", "mjENBL_")))
            options[name] = [bit for bit in known[name] if int(value) & int(bits[bit])]
        else:
            listed = flat(value)
            options[name] = listed[0] if len(listed) == 1 else listed
    type_names = {int(value): name for name, value in mujoco.mjtGeom.__members__.items()}
    types = [type_names[int(kind)] for kind in flat(model.geom_type)]
    found_hulls, chosen = hulls(model, types)
    title = bytes(model.names).split(b"\0")[0].decode()
    starts = [int(start) for start in flat(model.jnt_qposadr)]
    firsts = [int(first) for first in flat(model.jnt_dofadr)]
    qpos0, armature, damping = flat(model.qpos0), flat(model.dof_armature), flat(model.dof_damping)
    driven_joints, driven_bodies = driven(model)
    runs_on = implementation(target, model)
    data = {
        "implementation": runs_on,
        "stack": stack(target),
        "options": options,
        "known_flags": known,
        "counts": {name: int(getattr(model, name)) for name in COUNTS if hasattr(model, name)},
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
        "limits": {} if runs_on == "c" else limits(target),
        "frame_skip": frame_skip(target),
    }
    source = f"model {title or 'unnamed'!r}, MuJoCo {mujoco.__version__}"
    return {"kind": "mujoco-model", "engine": "mujoco", "source": source, "data": data}


def hulls(model: Any, types: list[str]) -> tuple[dict[str, list[float]], list[int]]:
    """Return the hull of each mesh that collides, by number, and the hull of each geom; -1 where it has none."""
    paired = {int(geom) for geom in flat(model.pair_geom1) + flat(model.pair_geom2)}
    offers, accepts, meshes = flat(model.geom_contype), flat(model.geom_conaffinity), flat(model.geom_dataid)
    chosen = [
        int(mesh) if types[geom] in MESHES and (geom in paired or offers[geom] or accepts[geom]) else -1
        for geom, mesh in enumerate(meshes)
    ]
    vertices, graph, found_hulls = flat(model.mesh_vert), flat(model.mesh_graph), {}
    for mesh in sorted(set(chosen) - {-1}):
        first, count = int(flat(model.mesh_vertadr)[mesh]), int(flat(model.mesh_vertnum)[mesh])
        start = int(flat(model.mesh_graphadr)[mesh])
        # The table of a hull holds its numbers of vertices and faces, an address for each vertex, and the vertices.
        size = graph[start] if start >= 0 else 0
        corners = graph[start + 2 + size : start + 2 + 2 * size] if start >= 0 else range(count)
        rows = [3 * (first + int(corner)) for corner in corners]
        found_hulls[str(mesh)] = [number for row in rows for number in vertices[row : row + 3]]
    return found_hulls, chosen


def driven(model: Any) -> tuple[set[int], set[int]]:
    """Return the joints on which actuators act, and the bodies on which they act by tendons, at sites or directly."""
    import mujoco

    kinds, targets = flat(model.actuator_trntype), [int(target) for target in flat(model.actuator_trnid)[::2]]
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
            first, count = int(flat(model.tendon_adr)[target]), int(flat(model.tendon_num)[target])
            for wrap in range(first, first + count):
                owners = {"mjWRAP_JOINT": model.jnt_bodyid, "mjWRAP_SITE": model.site_bodyid}
                owner = owners.get(mujoco.mjtWrap(int(flat(model.wrap_type)[wrap])).name)
                if owner is not None:
                    bodies.add(int(flat(owner)[int(flat(model.wrap_objid)[wrap])]))
    return joints, bodies


def keyframes(model: Any) -> dict[str, list[float]]:
    """Return the coordinates of those keyframes in which robots stand."""
    rows, names = flat(model.key_qpos), texts(model, model.name_keyadr)
    places = {name: index * model.nq for index, name in enumerate(names) if name in STANDING}
    return {name: rows[start : start + model.nq] for name, start in places.items()}


def texts(model: Any, addresses: Any) -> list[str]:
    """Return the names at some addresses in a model's table of names."""
    table = bytes(model.names)
    return [table[start : table.index(b"\0", start)].decode() for start in flat(addresses)]


def implementation(target: Any, model: Any) -> str:
    """Return `mjx` or `mujoco_warp` where one of them runs the model, else `c`."""
    choice = str(found(target, "_config.impl") or found(target, "config.impl") or "")
    if choice == "warp" or is_of_package(target, MJLAB_PACKAGE):
        return "mujoco_warp"
    is_mjx = is_mjx_model(model) or choice == "jax" or is_of_package(target, PLAYGROUND_PACKAGE)
    return "mjx" if is_mjx else "c"


def stack(target: Any) -> str:
    """Return `playground` or `mjlab` for their environments and task configurations; else nothing."""
    if is_of_package(target, PLAYGROUND_PACKAGE):
        return "playground"
    return "mjlab" if is_of_package(target, MJLAB_PACKAGE) else ""


def is_of_package(target: Any, package: str) -> bool:
    """Return whether a class of a target, or of the environment that it wraps, is of a package."""
    for holder in (target, found(target, "unwrapped")):
        for part in type(holder).__mro__:
            if part.__module__.split(".")[0] == package:
                return True
    return False


def limits(target: Any) -> dict[str, int]:
    """Return the limits of contacts and constraints that a target states."""
    values: dict[str, int] = {}
    for place in LIMIT_PLACES:
        for holder in (target, found(target, "unwrapped")):
            for name in ("njmax", "nconmax", "naconmax"):
                value = found(holder, place + "." + name)
                if isinstance(value, int) and not isinstance(value, bool):
                    values.setdefault(name, value)
    return values


def frame_skip(target: Any) -> int | None:
    """Return the steps of the engine for one action; None where the target does not state it."""
    for holder in (target, found(target, "unwrapped")):
        for place in ("frame_skip", "n_substeps", "_n_substeps", "cfg.decimation", "decimation"):
            value = found(holder, place)
            if isinstance(value, int) and not isinstance(value, bool):
                return value
    return None
