"""Write the physics that a policy is trained with to a file that `gauge sanity` reads elsewhere.

Run this file in the training environment. It needs Python 3.8 or later, and nothing of gauge-envs.

    python gauge_probe.py my_package.robots:make_model --out robot.gaugeprobe.json
    python gauge_probe.py HalfCheetah-v5
    python gauge_probe.py "mujoco_playground:registry.load('CheetahRun')"
    python gauge_probe.py "mjlab.tasks.registry:load_env_cfg('Mjlab-Velocity-Flat-Unitree-Go1')"
    python gauge_probe.py "dm_control.suite:load('walker', 'walk')"

`MODULE:EXPRESSION` is Python, evaluated in that module; what can be called without arguments is called. A program that
has the environment, model or configuration already writes it itself:

    import gauge_probe

    gauge_probe.save(env, "robot.gaugeprobe.json")

A compiled model of MuJoCo is written as MJCF, number by number: what a program changed after loading is in it. Meshes
are written by their convex hulls, those without one as boxes.
"""

from __future__ import annotations

import argparse
import importlib
import json
import re
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any, NamedTuple

FORMAT, VERSION = "gauge-probe", 4

SUFFIX = ".gaugeprobe.json"


class ProbeError(Exception):
    """The target cannot be read."""


# --- a compiled model of MuJoCo as MJCF ------------------------------------------------------------------------------

SPELLED = {"euler": "Euler", "rk4": "RK4", "pgs": "PGS", "cg": "CG", "newton": "Newton"}
"""Values of attributes with capital letters."""


class Attribute(NamedTuple):
    """An attribute of an element of MJCF, and where a compiled model has its value.

    Attributes:
        name: Its name in MJCF.
        arrays: Arrays of the model with its numbers, by their names behind the prefix of the element.
        kind: Enumeration of its value, such as `mjtGeom`, or kind of the object whose name it is; empty for numbers.
    """

    name: str
    arrays: tuple[str, ...]
    kind: str = ""


def numbers(*names: str, **arrays: str) -> list[Attribute]:
    """Return attributes with numbers: those whose arrays have the same names, and those of arrays by their names."""
    same = {name: name for name in names}
    return [Attribute(name, (array,)) for name, array in {**same, **arrays}.items()]


def enumerations(**kinds: str) -> list[Attribute]:
    """Return attributes with a constant, by their enumerations, such as `mjtGeom`."""
    return [Attribute(name, (name,), kind) for name, kind in kinds.items()]


STIFFNESS = Attribute("stiffness", ("stiffness", "stiffnesspoly"))
DAMPING = Attribute("damping", ("damping", "dampingpoly"))
FORCES = numbers(actuatorfrcrange="actfrcrange", actuatorfrclimited="actfrclimited")
LIMITS = numbers(solreflimit="solref", solimplimit="solimp")
FRICTIONS = numbers(solreffriction="solref", solimpfriction="solimp")

BODY = numbers("pos", "quat", "gravcomp")
SITE = numbers("pos", "quat")
INERTIAL = numbers("mass", pos="ipos", quat="iquat", diaginertia="inertia")
JOINT = [
    *enumerations(type="mjtJoint"),
    *numbers("pos", "axis", "range", "limited", "margin"),
    *numbers(actuatorgravcomp="actgravcomp"),
    *FORCES,
    STIFFNESS,
    *LIMITS,
]
DOF = [*numbers("armature", "frictionloss"), DAMPING, *FRICTIONS]
GEOM = [
    *enumerations(type="mjtGeom"),
    *numbers("pos", "quat", "size", "contype", "conaffinity", "condim", "priority"),
    *numbers("solmix", "friction", "solref", "solimp", "margin", "gap", "group"),
    *numbers("adhesion", "surfacevel"),
]
TENDON = [
    *numbers("range", "limited", "margin", "armature", "frictionloss"),
    *numbers(springlength="lengthspring"),
    *numbers(solreflimit="solref_lim", solimplimit="solimp_lim"),
    *numbers(solreffriction="solref_fri", solimpfriction="solimp_fri"),
    *FORCES,
    STIFFNESS,
    DAMPING,
]
ACTUATOR = [
    *enumerations(dyntype="mjtDyn", gaintype="mjtGain", biastype="mjtBias"),
    *numbers("gear", "dynprm", "gainprm", "biasprm", "ctrlrange", "ctrllimited"),
    *numbers("forcerange", "forcelimited", "actrange", "actlimited", "actearly"),
    *numbers("group", "lengthrange", "armature", "delay"),
    DAMPING,
]
PAIR = [
    Attribute("geom1", ("geom1",), "geom"),
    Attribute("geom2", ("geom2",), "geom"),
    *numbers("friction", "solref", "solreffriction", "solimp", "margin", "gap"),
    *numbers("adhesion", condim="dim"),
]
EQUALITY = numbers("solref", "solimp", active="active0")
KEY = numbers("time", "qpos", "qvel", "act", "ctrl", "mpos", "mquat")
HEIGHT_FIELD = numbers("nrow", "ncol", "size")
WRAPS = {
    "joint": [Attribute("joint", ("objid",), "joint"), *numbers(coef="prm")],
    "pulley": numbers(divisor="prm"),
    "site": [Attribute("site", ("objid",), "site")],
    "geom": [
        Attribute("geom", ("objid",), "geom"),
        Attribute("sidesite", ("prm",), "site"),
    ],
}
"""Attributes of what a tendon wraps around, by its kind."""

SITE_KEYS = {"site": ["site", "refsite"], "slidercrank": ["cranksite", "slidersite"]}
"""Attributes of an actuator for its two sites."""

BODY_EQUALITIES = 4
"""Number of types of equalities that are written; those of flexes are left out with them."""


def text(*values: Any) -> str:
    """Return numbers and arrays as the text of an attribute, with all their digits."""
    import numpy

    numbers = numpy.concatenate([numpy.ravel(value).astype("U") for value in values])
    return " ".join(numbers).lower()


def constant(kind: str, value: Any) -> str:
    """Return the constant of an enumeration, such as `mjtGeom`, as MJCF spells it."""
    import mujoco

    name = getattr(mujoco, kind)(int(value)).name.split("_", 1)[1].lower()
    return SPELLED.get(name, name)


def name_of(model: Any, kind: str, index: Any) -> str:
    """Return the name of an object."""
    return getattr(model, kind)(int(index)).name


def attributes(
    model: Any, prefix: str, index: int, table: list[Attribute]
) -> dict[str, str]:
    """Return the attributes of a table for an object, without those whose array is empty or unknown to this MuJoCo."""
    written = {}
    for attribute in table:
        keys = [f"{prefix}_{array}" for array in attribute.arrays]
        values = [getattr(model, key)[index] for key in keys if hasattr(model, key)]
        kind = attribute.kind
        if kind.startswith("mjt"):
            written[attribute.name] = constant(kind, values[0])
        elif kind and values[0] >= 0:
            written[attribute.name] = name_of(model, kind, values[0])
        elif not kind and values and values[0].size:
            written[attribute.name] = text(*values)
    return written


def named(
    model: Any, prefix: str, index: int, table: list[Attribute]
) -> dict[str, str]:
    """Return the attributes of a table for an object that has a name."""
    written = attributes(model, prefix, index, table)
    written["name"] = name_of(model, prefix, index)
    return written


def mjcf(model: Any) -> str:
    """Return a compiled model as MJCF; see `mjcf_root`."""
    return ET.tostring(mjcf_root(model), encoding="unicode")


def mjcf_root(model: Any) -> ET.Element:
    """Return a compiled model as the root of MJCF.

    Raises:
        ProbeError: An actuator has several inputs.
    """
    if len(model.actuator_trntype) != model.nu:
        raise ProbeError("an actuator has several inputs: give the model's file")
    root = ET.Element("mujoco", model=bytes(model.names).split(b"\0", 1)[0].decode())
    compiler = {"angle": "radian", "autolimits": "false", "inertiafromgeom": "false"}
    ET.SubElement(root, "compiler", compiler)
    add_options(root, model)
    add_shapes(ET.SubElement(root, "asset"), model)
    add_bodies(ET.SubElement(root, "worldbody"), model)
    add_contacts(ET.SubElement(root, "contact"), model)
    add_tendons(ET.SubElement(root, "tendon"), model)
    add_equalities(ET.SubElement(root, "equality"), model)
    add_actuators(ET.SubElement(root, "actuator"), model)
    keyframe = ET.SubElement(root, "keyframe")
    for index in range(model.nkey):
        ET.SubElement(keyframe, "key", named(model, "key", index, KEY))
    return root


def add_bodies(world: ET.Element, model: Any) -> None:
    """Add bodies with their joints, geoms and sites."""
    bodies = [world]
    for index in range(1, model.nbody):
        body = named(model, "body", index, BODY)
        body["mocap"] = text(model.body_mocapid[index] >= 0)
        bodies.append(ET.SubElement(bodies[model.body_parentid[index]], "body", body))
        inertial = attributes(model, "body", index, INERTIAL)
        ET.SubElement(bodies[-1], "inertial", inertial)
    for index, body in enumerate(model.jnt_bodyid):
        ET.SubElement(bodies[body], "joint", joint(model, index))
    for index, body in enumerate(model.geom_bodyid):
        ET.SubElement(bodies[body], "geom", geom(model, index))
    for index, body in enumerate(model.site_bodyid):
        ET.SubElement(bodies[body], "site", named(model, "site", index, SITE))


def add_contacts(parent: ET.Element, model: Any) -> None:
    """Add pairs of geoms, and pairs of bodies that do not collide."""
    for index in range(model.npair):
        ET.SubElement(parent, "pair", attributes(model, "pair", index, PAIR))
    for signature in model.exclude_signature:
        names = [name_of(model, "body", end) for end in divmod(int(signature), 1 << 16)]
        ET.SubElement(parent, "exclude", body1=names[0], body2=names[1])


def add_options(root: ET.Element, model: Any) -> None:
    """Add options, and each flag."""
    import mujoco

    option, flags = ET.SubElement(root, "option"), {}
    for entry in dir(model.opt):
        value = getattr(model.opt, entry)
        if entry in ("integrator", "cone", "solver", "jacobian"):
            option.set(entry, constant(f"mjt{entry.title()}", value))
        elif entry == "disableactuator":
            groups = [group for group in range(31) if value >> group & 1]
            option.set("actuatorgroupdisable", text(groups))
        elif not entry.startswith("_") and not entry.endswith("flags"):
            option.set(entry, text(value))
    for bits, values, effects in (
        (mujoco.mjtDisableBit, model.opt.disableflags, ("enable", "disable")),
        (mujoco.mjtEnableBit, model.opt.enableflags, ("disable", "enable")),
    ):
        for name, bit in bits.__members__.items():
            if "_" in name:
                flags[name[7:].lower()] = effects[bool(values & int(bit))]
    ET.SubElement(option, "flag", flags)


def joint(model: Any, index: int) -> dict[str, str]:
    """Return a joint, with the coefficients of its first degree of freedom and its zeros."""
    written = named(model, "jnt", index, JOINT)
    written.update(attributes(model, "dof", model.jnt_dofadr[index], DOF))
    if written["type"] in ("hinge", "slide"):
        start = model.jnt_qposadr[index]
        written["ref"] = text(model.qpos0[start])
        written["springref"] = text(model.qpos_spring[start])
    return written


def geom(model: Any, index: int) -> dict[str, str]:
    """Return a geom with its height field, or its mesh: the convex hull, or a box of its size without a hull."""
    written = named(model, "geom", index, GEOM)
    number, kind = model.geom_dataid[index], written["type"]
    if kind == "hfield":
        written["hfield"] = name_of(model, "hfield", number)
    elif kind in ("mesh", "sdf") and model.mesh_graphadr[number] >= 0:
        del written["size"]
        written.update(type="mesh", mesh=name_of(model, "mesh", number))
    elif kind in ("mesh", "sdf"):
        # A box has a height.
        written.update(type="box", size=text(model.geom_aabb[index, 3:] + 1e-9))
    return written


def add_shapes(parent: ET.Element, model: Any) -> None:
    """Add height fields, and meshes by their convex hulls; a mesh that touches nothing has none."""
    for index, start in enumerate(model.hfield_adr):
        field = named(model, "hfield", index, HEIGHT_FIELD)
        rows, columns = model.hfield_nrow[index], model.hfield_ncol[index]
        data = model.hfield_data[start : start + rows * columns]
        # MJCF has the rows from the top.
        elevation = text(data.reshape(rows, columns)[::-1])
        ET.SubElement(parent, "hfield", field, elevation=elevation)
    for index, start in enumerate(model.mesh_graphadr):
        if start >= 0:
            # The table of a hull has its numbers of vertices and faces, an address for each vertex, and the vertices.
            first = start + 2 + model.mesh_graph[start]
            corners = model.mesh_graph[first : first + model.mesh_graph[start]]
            vertices = text(model.mesh_vert[model.mesh_vertadr[index] + corners])
            name = name_of(model, "mesh", index)
            ET.SubElement(parent, "mesh", name=name, vertex=vertices)


def add_tendons(parent: ET.Element, model: Any) -> None:
    """Add tendons with what they wrap around."""
    for index, first in enumerate(model.tendon_adr):
        tendon = ET.SubElement(parent, "spatial", named(model, "tendon", index, TENDON))
        for wrap in range(first, first + model.tendon_num[index]):
            kind = constant("mjtWrap", model.wrap_type[wrap])
            if kind == "joint":
                tendon.tag = "fixed"
            if kind in ("sphere", "cylinder"):
                kind = "geom"
            ET.SubElement(tendon, kind, attributes(model, "wrap", wrap, WRAPS[kind]))


def add_equalities(parent: ET.Element, model: Any) -> None:
    """Add equalities between bodies, sites, joints or tendons."""
    for index, number in enumerate(model.eq_type):
        if number >= BODY_EQUALITIES:
            continue
        kind = constant("mjtEq", number)
        data, what = model.eq_data[index], constant("mjtObj", model.eq_objtype[index])
        written = attributes(model, "eq", index, EQUALITY)
        if kind in ("joint", "tendon"):
            what = kind
            written["polycoef"] = text(data[:5])
        if kind == "weld":
            written["torquescale"] = text(data[10])
        if what == "body":
            written["anchor"] = text(data[:3])
        if what == "body" and kind == "weld":
            written["relpose"] = text(data[3:10])
        ends = [
            Attribute(f"{what}1", ("obj1id",), what),
            Attribute(f"{what}2", ("obj2id",), what),
        ]
        written.update(attributes(model, "eq", index, ends))
        ET.SubElement(parent, kind, written)


def add_actuators(parent: ET.Element, model: Any) -> None:
    """Add actuators with what they act on."""
    for index, number in enumerate(model.actuator_trntype):
        written = named(model, "actuator", index, ACTUATOR)
        kind = constant("mjtTrn", number)
        if hasattr(model, "actuator_history"):
            written["nsample"] = text(model.actuator_history[index][0])
        if kind == "slidercrank":
            written["cranklength"] = text(model.actuator_cranklength[index])
        keys = SITE_KEYS.get(kind, [kind])
        what = "site" if kind in SITE_KEYS else kind.replace("inparent", "")
        for key, end in zip(keys, model.actuator_trnid[index]):  # noqa: B905
            if end >= 0:
                written[key] = name_of(model, what, end)
        ET.SubElement(parent, "general", written)


# --- targets ---------------------------------------------------------------------------------------------------------

MODEL_PLACES = (
    "mj_model",
    "_mj_model",
    "model",
    "_model",
    "sim.mj_model",
    "sim.model",
    "physics.model.ptr",
    "physics.model",
    "physics.model._model",
    "env.mj_model",
    "_env.mj_model",
    "unwrapped.model",
    "unwrapped.mj_model",
    "unwrapped.sim.mj_model",
)
"""Attributes with the compiled model of an environment."""

ENGINES = {"mjlab": "MuJoCo Warp", "newton": "MuJoCo Warp", "mujoco_playground": "MJX"}
"""Engine that runs the model in training, by the package of the target."""


def value_at(value: Any, place: str) -> Any:
    """Return the attribute or entry at a place such as `sim.cfg`; None without one."""
    for name in [part for part in place.split(".") if part]:
        try:
            value = value[name] if isinstance(value, dict) else getattr(value, name)
        except Exception:  # Properties of other packages raise anything, such as an error before the first reset.
            return None
    return value


def kind_of(value: Any) -> str:
    """Return module and name of a value's class."""
    return f"{type(value).__module__}.{type(value).__qualname__}"


def mujoco_model(target: Any) -> Any:
    """Return the compiled model of a target; None without one."""
    if kind_of(target).endswith(".MjSpec"):
        return target.compile()
    if value_at(target, "sim.mujoco") and value_at(target, "scene.entities"):
        # A task's configuration of mjlab; no simulation is started.
        from mjlab.scene import Scene

        model = Scene(target.scene, device="cpu").compile()
        target.sim.mujoco.apply(model)
        return model
    values = [target, *(value_at(target, place) for place in MODEL_PLACES)]
    models = [v for v in values if kind_of(v) == "mujoco._structs.MjModel"]
    return models[0] if models else None


def capture_mujoco(target: Any) -> dict[str, Any] | None:
    """Return the model of a target as MJCF, and notes; None without a model."""
    model = mujoco_model(target)
    if model is None:
        return None
    import mujoco

    engine = ENGINES.get(kind_of(target).split(".")[0], "MuJoCo")
    if value_at(target, "_config.impl") == "warp":
        engine = "MuJoCo Warp"
    notes = [
        f"the file has no {part} of the model"
        for part in ("flex", "plugin")
        if getattr(model, f"n{part}", 0)
    ]
    return {
        "mujoco": mujoco.__version__,
        "engine": engine,
        "notes": notes,
        "data": mjcf(model),
    }


# --- the file --------------------------------------------------------------------------------------------------------


def save(target: Any, file: str) -> None:
    """Write an environment, a model or a configuration to a file for `gauge sanity`.

    Raises:
        ProbeError: The target has no model.
    """
    captured = capture_mujoco(target)
    kind = kind_of(target)
    if captured is None:
        raise ProbeError(f"{kind} has no mujoco.MjModel: give that object itself")
    head = {"format": FORMAT, "version": VERSION, "source": kind}
    content = json.dumps({**head, **captured})
    Path(file).write_text(content, encoding="utf-8")


def resolve(target: str) -> Any:
    """Return the object that a text names: a Gymnasium id, or `MODULE:EXPRESSION`."""
    module, colon, expression = target.partition(":")
    if not colon:
        import gymnasium

        return gymnasium.make(target)
    value = eval(expression, dict(vars(importlib.import_module(module))))
    return value() if callable(value) else value


def main() -> None:
    """Write the file for the target of the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("target", help="Gymnasium id or MODULE:EXPRESSION")
    parser.add_argument("--out", help=f"file to write, NAME{SUFFIX} by default")
    options = parser.parse_args()
    sys.path.insert(0, str(Path.cwd()))
    target = options.target
    file = options.out or re.sub(r"[^\w.-]+", "_", target).strip("_") + SUFFIX
    try:
        save(resolve(target), file)
    except ProbeError as error:
        sys.exit(f"error: {target}: {error}")
    print(file)


if __name__ == "__main__":
    main()
