"""Run a model in one release of MuJoCo: `python worker.py JOB.json`. Needs MuJoCo 2.3.7 or later and NumPy alone.

The process runs in the environment of the release, without this package. The job is a JSON object:

    {"model": "scene.xml", "settings": {"jacobian": "dense"}, "run": {"steps": 500, "seed": 0},
     "states": ["states.npz"], "out": "side"}

With `run`, the model moves through its segments, and the states go to `OUT.run.npz`. Each state of the files `states`
is computed for one step, from itself alone, into `OUT.probe0.npz` and so on; with `exact`, settings, then again with
these and the poses of geoms. `OUT.json` has the compiled model in words.
"""

import json
import re
import sys
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

import mujoco
import numpy as np

Job = dict[str, Any]

STATE = (
    "qpos",
    "qvel",
    "act",
    "ctrl",
    "mocap_pos",
    "mocap_quat",
    "xfrc_applied",
    "qacc_warmstart",
)
"""Arrays of a state; a file of saved states needs `qpos` alone."""

ENUMS = {
    "jacobian": "mjtJacobian",
    "solver": "mjtSolver",
    "cone": "mjtCone",
    "integrator": "mjtIntegrator",
    "disableflags": "mjtDisableBit",
    "enableflags": "mjtEnableBit",
    "jnt_type": "mjtJoint",
    "geom_type": "mjtGeom",
    "eq_type": "mjtEq",
    "wrap_type": "mjtWrap",
    "actuator_trntype": "mjtTrn",
    "actuator_dyntype": "mjtDyn",
    "actuator_gaintype": "mjtGain",
    "actuator_biastype": "mjtBias",
}
"""Enumeration of each field whose numbers mean other things in other releases."""

PHYSICS = re.compile(
    "qpos0|qpos_spring|body_|jnt_|dof_|geom_|mesh_(scale|pos|quat|inertia)|hfield_size|pair_|exclude_|eq_|tendon_|wrap_|"
    "actuator_|key_|flex_|flexedge_"
)
"""Starts of names of compiled fields that physics reads."""

STORAGE = re.compile(
    "adr|num|bvh|plugin|rgba|matid|group|user|sameframe|simple|rootid|weldid|treeid|jntid|dataid|Madr|texcoord|flatskin"
)
"""Parts of names of fields that only say where something is stored."""

PERTURBATION = 1e-10
"""Change of coordinates and velocities that no release would make on purpose [m, rad, m/s, rad/s]."""

CONTROL_INTERVAL_S = 0.1
"""Time for which random controls are held [s]."""

PUSH_M_PER_S = 0.5
"""Standard deviation of the velocities of a push [m/s or rad/s]."""

MOST_STARTS = 4
"""Keyframes that are started from, and saved states from which the model settles."""

DRIVEN_INTERVAL_S = 1.0 / 180.0
"""Time of a row of the motion of a driven body of the suite [s]."""

MOST_PROBES = 600
"""Most states of a segment that are probed; of a longer one, every n-th step."""

UNKNOWN = re.compile(
    r"(unrecognized attribute|invalid keyword): '(\w+)'\s+Element '(\w*)', line (\d+)"
)
"""MuJoCo's message on an attribute, or a value of one, that it does not know."""

MISPLACED = re.compile(r"(\w+) is only available for .*\s+Element name '.*', id \d+")
UNNAMED = r"unrecognized attribute: '\1' Element ''"
"""Its message on an attribute that it knows for other actuators alone, and the same in the words of the first."""


def without_unknown(path: Path, folder: Path) -> tuple[Any, list[str]]:
    """Compile a model file without the attributes that the release does not know.

    The copy without them goes to a folder. Returns the compiled model, and the attributes, as `option apirate="100"`.
    """
    file = path
    dropped: list[str] = []
    while True:
        try:
            return mujoco.MjModel.from_xml_path(str(file)), dropped
        except ValueError as error:
            unknown = UNKNOWN.search(MISPLACED.sub(UNNAMED, str(error)))
            text = file.read_text(encoding="utf-8")
            if unknown is None:
                raise
            # An included file has lines of its own.
            if "<include" in text:
                raise SystemExit(f"{error}: put the <include> into this file") from None
            kind, word, element, line = unknown.groups()
        lines = text.splitlines(keepends=True)
        begin = text.index("<" + element, sum(map(len, lines[: int(line) - 1])))
        stated = rf"\s{word}\s*=\s*(\"[^\"]*\"|'[^']*')"
        if kind == "invalid keyword":
            stated = rf"\s\w+\s*=\s*[\"']{word}[\"']"
        attribute = re.compile(stated).search(text, begin)
        if attribute is None:
            raise SystemExit(f"{element}: {word} is unknown to this release")
        dropped.append((element or "actuator") + " " + attribute[0].strip())
        text = text[: attribute.start()] + text[attribute.end() :]
        if file == path:
            text = with_absolute_folders(text, path)
            file = folder / ("known_" + path.name)
        file.write_text(text, encoding="utf-8")


def with_absolute_folders(text: str, path: Path) -> str:
    """Return a model whose meshes and textures are found from another folder."""
    folders = {"meshdir": "", "texturedir": ""}
    for compiler in ElementTree.fromstring(text).findall("compiler"):
        for kind in folders:
            stated = compiler.get("assetdir", folders[kind])
            folders[kind] = compiler.get(kind, stated)
    found = {kind: quoteattr(str(path.parent / at)) for kind, at in folders.items()}
    words = " ".join(f"{kind}={at}" for kind, at in found.items())
    # On the same line, so that those of the messages stay.
    end = text.rindex("</mujoco>")
    return text[:end] + f"<compiler {words}/>" + text[end:]


def set_options(model: Any, settings: Job) -> None:
    """Write options into a model; a word stands for the number of its enumeration."""
    for name, value in settings.items():
        if not hasattr(model.opt, name):
            raise SystemExit("unknown setting: " + name)
        stated = f"{name}={value}"
        if isinstance(value, str) and name in ENUMS:
            kind = getattr(mujoco, ENUMS[name]).__members__
            words = {key.partition("_")[2].lower(): int(kind[key]) for key in kind}
            value = words.get(value.lower())
            if value is None:
                raise SystemExit(f"{stated}: expected one of {', '.join(words)}")
        try:
            setattr(model.opt, name, value)
        except (TypeError, ValueError):
            known = getattr(model.opt, name)
            raise SystemExit(f"{stated}: expected a value as {known}") from None
    if not model.opt.timestep > 0.0:
        raise SystemExit(f"timestep={model.opt.timestep}: expected a positive number")


# --- the compiled model ----------------------------------------------------------------------------------------------


def named(model: Any, kind: str, index: int) -> str:
    """Return the name of an object, or its kind and index."""
    number = getattr(mujoco.mjtObj, "mjOBJ_" + kind.upper())
    return mujoco.mj_id2name(model, number, index) or f"{kind} {index}"


def enum_texts(field: str, values: Any) -> list[str]:
    """Return the names of numbers of an enumeration; of flags, the names of those that are set."""
    kind = getattr(mujoco, ENUMS[field])
    numbers = {int(value): name for name, value in kind.__members__.items()}
    if field.endswith("flags"):
        is_set = [number for number in sorted(numbers) if number & int(values)]
        return [numbers[number] for number in is_set]
    return [numbers.get(int(value), str(value)) for value in np.ravel(values)]


def compiled(model: Any) -> Job:
    """Return the fields of the compiled model that physics reads, and the options, as numbers and names."""
    fields = {}
    for name in dir(model.opt):
        if not name.startswith("_"):
            value = getattr(model.opt, name)
            if name in ENUMS:
                fields["opt." + name] = enum_texts(name, value)
            elif np.ndim(value) < 2 and not callable(value):
                fields["opt." + name] = np.ravel(value).tolist()
    for name in dir(model):
        if not PHYSICS.match(name) or STORAGE.search(name):
            continue
        value = getattr(model, name)
        if name in ENUMS:
            fields[name] = enum_texts(name, value)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
            fields[name] = value.astype(float).tolist()
    return fields


def names(model: Any) -> dict[str, list[str]]:
    """Return the names of what the rows of fields and results are of."""
    found: dict[str, list[str]] = {"geom": [], "dof": []}
    for field in ("nbody", "njnt", "nu", "nmesh", "nkey", "neq", "ntendon", "npair"):
        short = {"njnt": "joint", "nu": "actuator", "neq": "equality"}
        kind = short.get(field, field[1:])
        found[kind] = [named(model, kind, i) for i in range(getattr(model, field))]
    for i in range(model.ngeom):
        name = named(model, "geom", i)
        if name.startswith("geom "):
            name += " of " + found["body"][model.geom_bodyid[i]]
        found["geom"].append(name)
    for i in range(model.nv):
        body = found["body"][model.dof_bodyid[i]]
        joint = int(model.dof_jntid[i])
        axis = i - int(model.jnt_dofadr[joint])
        if int(model.jnt_type[joint]) == int(mujoco.mjtJoint.mjJNT_FREE):
            name = f"{'rotation' if axis > 2 else 'translation'} of {body}"
        else:
            name = f"{found['joint'][joint]} of {body}"
        found["dof"].append(name)
    return found


class Segment(NamedTuple):
    """A motion: its first state, controls (None: held), steps, and steps for which a row of controls is held."""

    name: str
    start: dict[str, Any]
    controls: Any
    steps: int
    interval: int


# --- motion ----------------------------------------------------------------------------------------------------------


def put(data: Any, state: Mapping[str, Any]) -> None:
    """Write a state into the data of a model."""
    for name in STATE:
        array = getattr(data, name)
        if name in state:
            array[:] = state[name]
        elif name not in ("mocap_pos", "mocap_quat"):
            array[:] = 0.0
    data.time = float(state.get("time", 0.0))


def taken(data: Any) -> dict[str, Any]:
    """Return the state of the data of a model."""
    state = {name: np.array(getattr(data, name)) for name in STATE}
    return state | {"time": data.time}


def starts(model: Any, seed: int) -> Iterator[tuple[str, dict[str, Any], Any]]:
    """Yield name, start and controls of each segment; controls of None are held."""
    random = np.random.RandomState(seed)
    data = mujoco.MjData(model)
    first = taken(data)
    limited = np.array(model.actuator_ctrllimited, dtype=bool).ravel()
    low = np.where(limited, model.actuator_ctrlrange[:, 0], -1.0)
    high = np.where(limited, model.actuator_ctrlrange[:, 1], 1.0)
    first["ctrl"] = np.clip(np.zeros(model.nu), low, high)
    yield "start", first, None
    for key in range(min(model.nkey, MOST_STARTS)):
        mujoco.mj_resetDataKeyframe(model, data, key)
        first = taken(data)
        yield "keyframe " + named(model, "key", key), first, None
    if model.nu:
        count = 1 + int(600.0 / CONTROL_INTERVAL_S)
        middle, half = (low + high) / 2.0, (high - low) / 2.0
        yield (
            "random controls",
            first,
            middle + half * random.uniform(-1.0, 1.0, (count, model.nu)),
        )
    pushed = dict(
        first, qvel=first["qvel"] + random.normal(0.0, PUSH_M_PER_S, model.nv)
    )
    yield "push", pushed, None


def driven(model: Any, job: Job) -> list[tuple[int, Any]]:
    """Return each driven body, and its rows: 7 numbers of qpos, 6 of qvel, 6 of xfrc_applied."""
    if job["run"].get("driven") is None:
        return []
    kind = mujoco.mjtObj.mjOBJ_BODY
    with np.load(job["run"]["driven"]) as arrays:
        return [(mujoco.mj_name2id(model, kind, name), arrays[name]) for name in arrays]


def moved(
    model: Any, part: Segment, motions: Sequence[tuple[int, Any]]
) -> Iterator[tuple[dict[str, Any], Any]]:
    """Yield the state before each step, and the data."""
    data = mujoco.MjData(model)
    put(data, part.start)
    mujoco.mj_forward(model, data)
    if "qacc_warmstart" in part.start:
        data.qacc_warmstart[:] = part.start["qacc_warmstart"]
    drive_steps = max(1, round(DRIVEN_INTERVAL_S / model.opt.timestep))
    for step in range(part.steps):
        if part.controls is not None:
            at = min(step // part.interval, len(part.controls) - 1)
            data.ctrl[:] = part.controls[at]
        if step % drive_steps == 0:
            for body, rows in motions:
                values = rows[min(step // drive_steps, len(rows) - 1)]
                joint = int(model.body_jntadr[body])
                place, dof = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
                data.qpos[place : place + 7] = values[:7]
                data.qvel[dof : dof + 6] = values[7:13]
                data.xfrc_applied[body] = values[13:]
        yield taken(data), data
        mujoco.mj_step(model, data)


def saved(model: Any, file: str) -> dict[str, Any]:
    """Return the rows of a file of saved states."""
    with np.load(file) as arrays:
        rows = {name: np.array(arrays[name]) for name in arrays.files}
    columns = {"qpos": model.nq, "qvel": model.nv, "act": model.na, "ctrl": model.nu}
    for name, size in columns.items():
        if name in rows and rows[name].shape[1:] != (size,):
            raise SystemExit(
                f"{name} of a saved state has the shape {rows[name].shape[1:]}; the model has {size}"
            )
    return rows


def row(rows: Mapping[str, Any], index: int) -> dict[str, Any]:
    """Return one state of the rows of a file."""
    return {name: rows[name][index] for name in (*STATE, "time") if name in rows}


def segments(model: Any, job: Job) -> Iterator[Segment]:
    """Yield the segments through which a model moves: from the user's states, or from its own starts."""
    steps, seed = job["run"]["steps"], job["run"].get("seed", 0)
    file = job["run"].get("saved")
    if file is None:
        interval = max(1, round(CONTROL_INTERVAL_S / model.opt.timestep))
        for name, start, controls in starts(model, seed):
            yield Segment(name, start, controls, steps, interval)
        return
    rows = saved(model, file)
    count = len(rows["qpos"])
    for index in np.unique(np.linspace(0, count - 1, MOST_STARTS).astype(int)):
        yield Segment(f"settle from state {index}", row(rows, index), None, steps, 1)
    if "ctrl" in rows and count > 1:
        interval = 1
        if "time" in rows:
            apart_s = rows["time"][1] - rows["time"][0]
            interval = max(1, round(apart_s / model.opt.timestep))
        step_count = min(interval * count, 20 * steps)
        yield Segment("replay", row(rows, 0), rows["ctrl"], step_count, interval)


def run(model: Any, job: Job) -> tuple[dict[str, Any], list[Job]]:
    """Move the model through its segments; return the states that are probed, and what became of each segment."""
    states, ends = [], []
    motions = driven(model, job)
    noise = np.random.RandomState(job["run"].get("seed", 0) + 1)
    change = PERTURBATION * noise.normal(size=model.nv)
    for index, part in enumerate(segments(model, job)):
        every = max(1, -(-part.steps // MOST_PROBES))
        depths, speed = np.zeros(model.nbody), 0.0
        for step, (state, data) in enumerate(moved(model, part, motions)):
            pairs, distances = contacts(data)
            for side in (0, 1):
                np.maximum.at(depths, model.geom_bodyid[pairs[:, side]], -distances)
            speed = max(speed, float(np.max(np.abs(data.qvel), initial=0.0)))
            if step == 0:
                first = np.array(data.xpos)
            if step % every == 0:
                states.append(dict(state, segment=index, step=step))
        mujoco.mj_forward(model, data)
        last = np.array(data.xpos)
        end = {"segment": part.name, "steps": part.steps, "largest_speed": speed}
        end |= {"speeds": speeds(model, data), "warnings": warnings(data)}
        # A start that differs by less than anyone means shows what chaos makes of nothing.
        velocity = part.start.get("qvel", np.zeros(model.nv)) + change
        other = part._replace(start=dict(part.start, qvel=velocity))
        ((_, data),) = deque(moved(model, other, motions), maxlen=1)
        mujoco.mj_forward(model, data)
        down = model.opt.gravity / max(float(np.linalg.norm(model.opt.gravity)), 1e-12)
        places = {
            "depths_m": depths,
            "first_positions_m": first,
            "fallen_m": (last - first) @ down,
            "positions_m": last,
            "perturbed_positions_m": data.xpos,
        }
        ends.append(end | {name: place.tolist() for name, place in places.items()})
    states.extend(saved_states(model, job, len(ends)))
    return stacked(states), ends


def stacked(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the values of all rows, one behind the other, by name."""
    return {name: np.array([one[name] for one in rows]) for name in rows[0]}


def saved_states(model: Any, job: Job, segment: int) -> Iterator[dict[str, Any]]:
    """Yield the states of the user's file, which are probed as they are."""
    if job["run"].get("saved") is None:
        return
    rows = saved(model, job["run"]["saved"])
    plain = taken(mujoco.MjData(model))
    count = len(rows["qpos"])
    for step in range(0, count, max(1, -(-count // MOST_PROBES))):
        yield {**plain, **row(rows, step), "segment": segment, "step": step}


def speeds(model: Any, data: Any) -> list[float]:
    """Return the speed of the frame of each body [m/s]."""
    kind, found = mujoco.mjtObj.mjOBJ_XBODY, np.zeros((model.nbody, 6))
    for body, velocity in enumerate(found):
        mujoco.mj_objectVelocity(model, data, kind, body, velocity, 0)
    return [float(speed) for speed in np.linalg.norm(found[:, 3:], axis=1)]


# --- one step from a given state -------------------------------------------------------------------------------------


def warnings(data: Any) -> dict[str, int]:
    """Return the number of each warning of the engine."""
    found = {}
    for name, index in mujoco.mjtWarning.__members__.items():
        if name != "mjNWARNING" and data.warning[int(index)].number:
            found[name] = int(data.warning[int(index)].number)
    return found


def iterations(data: Any) -> int:
    """Return the iterations of the constraint solver, the most of all islands."""
    count = data.solver_niter if hasattr(data, "solver_niter") else data.solver_iter
    return int(np.max(count, initial=0))


def contacts(data: Any) -> tuple[Any, Any]:
    """Return pairs of geoms, shape [n, 2], and distances [m] of the contacts of rigid geoms."""
    if hasattr(data.contact, "geom"):
        pairs = np.array(data.contact.geom).reshape(-1, 2)
    else:
        pairs = np.stack([data.contact.geom1, data.contact.geom2], axis=-1).reshape(
            -1, 2
        )
    pairs, distances = np.sort(pairs, axis=1), np.array(data.contact.dist).ravel()
    is_rigid = pairs[:, 0] >= 0
    return pairs[is_rigid], distances[is_rigid]


def is_discrete(model: Any) -> bool:
    """Return whether the integrator is `discrete`, which releases before 3.13 lack."""
    return enum_texts("integrator", model.opt.integrator) == ["mjINT_DISCRETE"]


def imbalance(model: Any, data: Any) -> float:
    """Return by how much `M a = smooth forces + constraint forces` fails, over the largest of the three.

    It is NaN for the integrator `discrete`, whose accelerations obey `(M + h D + h^2 K) a = forces`.
    """
    if is_discrete(model):
        return float("nan")
    inertial = np.zeros(model.nv)
    mujoco.mj_mulM(model, data, inertial, np.array(data.qacc))
    terms = (inertial, np.array(data.qfrc_smooth), np.array(data.qfrc_constraint))
    largest = max([float(np.linalg.norm(term)) for term in terms] + [1e-12])
    return float(np.linalg.norm(terms[0] - terms[1] - terms[2])) / largest


def spins(model: Any, data: Any) -> Any:
    """Return angular momenta of free bodies about their centres, shape [n, 3]; None where a force may turn them.

    Without contacts, other constraints, actuators and a medium, gravity alone acts on a free body.
    """
    option = model.opt
    if data.nefc or np.any(data.qfrc_actuator) or option.density or option.viscosity:
        return None
    roots = model.body_rootid[model.dof_bodyid]
    free = []
    for joint in np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)):
        body, dof = model.jnt_bodyid[joint], model.jnt_dofadr[joint]
        # A tree with joints changes the momenta of its parts in a step.
        if np.sum(roots == body) == 6 and not np.any(model.dof_damping[dof : dof + 6]):
            free.append(body)
    mujoco.mj_subtreeVel(model, data)
    found = np.array(data.subtree_angmom[free])
    return found if np.any(found) else None


def accelerations(model: Any, data: Any, state: Mapping[str, Any]) -> Any:
    """Put a state into the data of a model, compute it, and return its accelerations."""
    put(data, state)
    mujoco.mj_forward(model, data)
    return np.array(data.qacc)


def probe(model: Any, rows: Mapping[str, Any], has_poses: bool) -> dict[str, Any]:
    """Return what one step from each state computes; the state alone decides, with its saved warm start."""
    found, touching, pairs, distances = [], [], [], []
    noise = np.random.RandomState(0)
    data = mujoco.MjData(model)
    for index in range(len(rows["qpos"])):
        state = row(rows, index)
        velocity = state.get("qvel", np.zeros(model.nv))
        mujoco.mj_resetData(model, data)
        one = {
            "qacc": accelerations(model, data, state),
            "smooth": np.array(data.qacc_smooth),
            "constraint": np.array(data.qfrc_constraint),
            "iterations": iterations(data),
            "imbalance": imbalance(model, data),
            "contacts": data.ncon,
            # The solver stops when its cost, a square of accelerations, falls by less than the tolerance.
            "solver_error": np.sqrt(model.opt.tolerance) if data.nefc else 0.0,
            "spin": float("nan"),
        }
        for name in ("geom_xpos", "geom_xmat") if has_poses else ():
            one[name] = np.array(getattr(data, name))
        pair, distance = contacts(data)
        touching.extend([index] * len(pair))
        pairs.extend(pair.tolist())
        distances.extend(distance.tolist())
        before = spins(model, data)
        put(data, state)
        mujoco.mj_step(model, data)
        one["step_acc"] = (data.qvel - velocity) / model.opt.timestep
        one["warnings"] = sum(warnings(data).values())
        if before is not None:
            mujoco.mj_forward(model, data)
            after = spins(model, data)
            if after is not None:
                change = np.linalg.norm(after - before)
                one["spin"] = change / np.linalg.norm(before)
        other = velocity + PERTURBATION * noise.normal(size=model.nv)
        one["perturbed"] = accelerations(model, data, dict(state, qvel=other))
        state.pop("qacc_warmstart", None)
        one["cold"] = accelerations(model, data, state)
        found.append(one)
    return {
        **stacked(found),
        "contact_state": np.array(touching, dtype=int),
        "contact_pair": np.array(pairs, dtype=int).reshape(-1, 2),
        "contact_dist": np.array(distances, dtype=float),
    }


def main(file: Path) -> None:
    """Do the job of a file."""
    job = json.loads(file.read_text(encoding="utf-8"))
    model, dropped = without_unknown(Path(job["model"]), file.parent)
    set_options(model, job.get("settings", {}))
    words = {
        "version": mujoco.__version__,
        "nq": model.nq,
        "nv": model.nv,
        "nu": model.nu,
        "fields": compiled(model),
        "names": names(model),
        "dropped": dropped,
    }
    if job.get("run"):
        states, words["ends"] = run(model, job)
        np.savez(job["out"] + ".run.npz", **states)
    exact, count = job.get("exact"), 0
    for settings in [{}] if exact is None else [{}, exact]:
        set_options(model, settings)
        for file_of_states in job.get("states", []):
            found = probe(model, saved(model, file_of_states), exact is not None)
            np.savez(f"{job['out']}.probe{count}.npz", **found)
            count += 1
    Path(job["out"] + ".json").write_text(json.dumps(words), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
