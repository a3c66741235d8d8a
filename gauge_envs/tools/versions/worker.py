"""Run a model in one release of MuJoCo: `python worker.py JOB.json`.

The process runs in the environment of the release, without this package. It needs MuJoCo 2.3.7 or later and NumPy.
The job is a JSON object. Its `task` is one of:

- `run`: move `model` with `settings` from its initial states, and write the states that it visits.
- `probe`: compute one step from each state of the files `states`.
- `play`: play `episodes` of the environment `subject` with `policy` from `seed`, in the user's Python.

The worker writes a description to `OUT.json`, and arrays to `OUT.npz`.
"""

import importlib
import json
import os
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np

Job = dict[str, Any]
Segment = tuple[str, Job, Any]
"""Name of a motion, its initial state, and the controls of each step, shape [steps, nu]; None for constant controls."""

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

COUNTS = {
    "body": "nbody",
    "joint": "njnt",
    "geom": "ngeom",
    "actuator": "nu",
    "mesh": "nmesh",
    "key": "nkey",
    "equality": "neq",
    "tendon": "ntendon",
    "pair": "npair",
}
"""Field with the number of objects of each kind."""

PHYSICS = re.compile(
    "qpos0|qpos_spring|body_|jnt_|dof_|geom_|mesh_(scale|pos|quat|inertia)|hfield_size|pair_|exclude_|eq_|tendon_|wrap_|"
    "actuator_|key_|flex_|flexedge_"
)
"""Prefixes of compiled fields that the physics reads."""

STORAGE = re.compile(
    "adr|num|bvh|plugin|rgba|matid|group|user|sameframe|simple|rootid|weldid|treeid|jntid|dataid|Madr|texcoord|flatskin"
)
"""Parts of names of fields that only say where something is stored."""

UNKNOWN = re.compile(
    r"unrecognized attribute: '(?P<attribute>\w+)'\s+Element '(?P<tag>\w+)'"
    r"|invalid keyword: '(?P<keyword>\w+)'\s+Element '(?P<keyword_tag>\w+)'"
    r"|(?P<misplaced>\w+) is only available for .*\s+Element name '(?P<name>.*)', id"
)
"""Messages of MuJoCo on an attribute, or on a value of one, that the release does not know for this element."""

PERTURBATION = 1e-10
"""Change of velocities that no release would make on purpose [m/s, rad/s]."""

CONTROL_INTERVAL_S = 0.1
"""Time for which random controls are constant [s]."""

CONTROL_ROWS = 6001
"""Number of random controls that are drawn; the random push comes after them."""

PUSH_M_PER_S = 0.5
"""Standard deviation of the velocities of a push [m/s or rad/s]."""

MAX_STARTS = 4
"""Keyframes, or saved states, from which the model moves."""

MAX_PROBES = 600
"""States of a segment that are probed; of a longer segment, every n-th state."""

DRIVEN_INTERVAL_S = 1.0 / 180.0
"""Time between two rows of the prescribed motion of a body [s]."""

MAX_SPEED = 100.0
"""Velocity above which a model explodes [m/s or rad/s]."""

MAX_DEPTH_M = 5e-3
"""Depth of a contact above which a body penetrates another one [m]."""

MIN_FALL_M = 0.03
"""Displacement along gravity from which a body falls [m]."""

MAX_STANDING_M, MAX_STANDING_M_PER_S = 1e-2, 0.1
"""Displacement [m] and speed [m/s] below which a body stands."""


# --- the model -------------------------------------------------------------------------------------------------------


def load_model(job: Job) -> tuple[Any, list[str]]:
    """Compile the model of a job with its settings, without the attributes that the release does not know.

    Returns:
        The compiled model, and the attributes that were left out, as `option apirate="100"`.
    """
    path = Path(job["model"])
    root = ElementTree.parse(path).getroot()
    dropped: list[str] = []
    while True:
        try:
            if dropped:
                text = ElementTree.tostring(root, encoding="unicode")
                model = mujoco.MjModel.from_xml_string(text)
            else:
                model = mujoco.MjModel.from_xml_path(str(path))
            break
        except ValueError as error:
            unknown = remove_unknown(root, str(error))
            if not unknown:
                raise
            dropped += unknown
            # The names of meshes are relative to the folder of the model.
            os.chdir(path.parent)
    set_options(model, job["settings"])
    return model, dropped


def remove_unknown(root: Any, message: str) -> list[str]:
    """Remove the attributes from an XML tree that a message of MuJoCo rejects, and return them."""
    rejected = UNKNOWN.search(message)
    removed: list[str] = []
    if rejected is None:
        return removed
    for element in root.iter(rejected["tag"] or rejected["keyword_tag"]):
        is_named = element.get("name", "") == rejected["name"]
        for name, value in list(element.items()):
            is_rejected = name == rejected["attribute"] or value == rejected["keyword"]
            if is_rejected or (is_named and name == rejected["misplaced"]):
                removed.append(f'{element.tag} {name}="{value}"')
                del element.attrib[name]
    return removed


def set_options(model: Any, settings: Job) -> None:
    """Write options into a model; a word stands for the number of its enumeration."""
    for name, value in settings.items():
        members = getattr(mujoco, ENUMS[name]).__members__ if name in ENUMS else {}
        numbers = {key.partition("_")[2].lower(): int(members[key]) for key in members}
        expected = getattr(model.opt, name, "an option of this release")
        try:
            setattr(model.opt, name, numbers.get(str(value).lower(), value))
        except (AttributeError, TypeError, ValueError):
            expected = " or ".join(numbers) or f"a value as {expected}"
            raise SystemExit(f"{name}={value}: expected {expected}") from None
    if not model.opt.timestep > 0.0:
        raise SystemExit(f"timestep={model.opt.timestep}: expected a positive number")


def enum_names(field: str, values: Any) -> list[str]:
    """Return the names of numbers of an enumeration; of flags, the names of those that are set."""
    members = getattr(mujoco, ENUMS[field]).__members__
    names = {int(member): name for name, member in members.items()}
    if field.endswith("flags"):
        return [names[number] for number in sorted(names) if number & int(values)]
    return [names.get(int(value), str(value)) for value in np.ravel(values)]


def compiled_fields(model: Any) -> Job:
    """Return the options and the fields of the compiled model that the physics reads."""
    fields = {}
    for name in dir(model.opt):
        value = getattr(model.opt, name)
        if name in ENUMS:
            fields["opt." + name] = enum_names(name, value)
        elif not name.startswith("_") and np.ndim(value) < 2 and not callable(value):
            fields["opt." + name] = np.ravel(value).tolist()
    for name in filter(PHYSICS.match, dir(model)):
        value = getattr(model, name)
        if STORAGE.search(name):
            continue
        if name in ENUMS:
            fields[name] = enum_names(name, value)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
            fields[name] = value.astype(float).tolist()
    return fields


def object_name(model: Any, kind: str, index: int) -> str:
    """Return the name of an object, or its kind and index."""
    number = getattr(mujoco.mjtObj, "mjOBJ_" + kind.upper())
    return mujoco.mj_id2name(model, number, index) or f"{kind} {index}"


def object_names(model: Any) -> dict[str, list[str]]:
    """Return the names of bodies, joints, geoms, degrees of freedom, and other objects, by kind."""
    names = {
        kind: [
            object_name(model, kind, index) for index in range(getattr(model, count))
        ]
        for kind, count in COUNTS.items()
    }
    bodies = names["body"]
    for geom, name in enumerate(names["geom"]):
        if name.startswith("geom "):
            names["geom"][geom] = f"{name} of {bodies[model.geom_bodyid[geom]]}"
    names["dof"] = []
    for dof, joint in enumerate(model.dof_jntid):
        name = names["joint"][joint]
        if model.jnt_type[joint] == int(mujoco.mjtJoint.mjJNT_FREE):
            is_rotation = dof - model.jnt_dofadr[joint] > 2
            name = "rotation" if is_rotation else "translation"
        names["dof"].append(f"{name} of {bodies[model.dof_bodyid[dof]]}")
    return names


# --- motion ----------------------------------------------------------------------------------------------------------


def set_state(data: Any, state: Job) -> None:
    """Write a state into the data of a model; arrays that it lacks become zero."""
    for name in STATE:
        if name in state:
            getattr(data, name)[:] = state[name]
        elif not name.startswith("mocap"):
            getattr(data, name)[:] = 0.0
    data.time = float(state.get("time", 0.0))


def get_state(data: Any) -> Job:
    """Return the state of the data of a model."""
    return {name: np.array(getattr(data, name)) for name in (*STATE, "time")}


def default_segments(model: Any, steps: int, seed: int) -> Iterator[Segment]:
    """Yield motions from the initial state and keyframes, with random controls, and after a push."""
    random = np.random.RandomState(seed)
    data = mujoco.MjData(model)
    is_limited = np.array(model.actuator_ctrllimited, dtype=bool).ravel()
    low = np.where(is_limited, model.actuator_ctrlrange[:, 0], -1.0)
    high = np.where(is_limited, model.actuator_ctrlrange[:, 1], 1.0)
    state = get_state(data)
    state["ctrl"] = np.clip(np.zeros(model.nu), low, high)
    yield "start", state, None
    for key in range(min(model.nkey, MAX_STARTS)):
        mujoco.mj_resetDataKeyframe(model, data, key)
        state = get_state(data)
        yield f"keyframe {object_name(model, 'key', key)}", state, None
    if model.nu:
        interval = max(1, round(CONTROL_INTERVAL_S / model.opt.timestep))
        middle, half = (low + high) / 2.0, (high - low) / 2.0
        rows = random.uniform(-1.0, 1.0, (max(CONTROL_ROWS, steps), model.nu))
        controls = middle + half * rows
        yield "random controls", state, controls[np.arange(steps) // interval]
    velocity = state["qvel"] + random.normal(0.0, PUSH_M_PER_S, model.nv)
    yield "push", {**state, "qvel": velocity}, None


def saved_segments(model: Any, rows: Job, steps: int) -> Iterator[Segment]:
    """Yield motions from saved states, and one with all saved controls."""
    count = len(rows["qpos"])
    for index in np.unique(np.linspace(0, count - 1, MAX_STARTS).astype(int)):
        yield f"settle from state {index}", row(rows, index), None
    if "ctrl" in rows and count > 1:
        # Without times, a row of controls is a step.
        interval_s = np.diff(rows.get("time", [0.0, 0.0])[:2])[0]
        interval = max(1, round(interval_s / model.opt.timestep))
        step = np.arange(min(interval * count, 20 * steps))
        yield "replay", row(rows, 0), rows["ctrl"][step // interval]


def load_states(model: Any, file: str) -> Job:
    """Return the arrays of a file of states."""
    with np.load(file) as arrays:
        rows = dict(arrays)
    count = rows["qpos"].shape[1]
    if count != model.nq:
        raise SystemExit(
            f"a saved state has {count} numbers of qpos; the model has {model.nq}"
        )
    return rows


def row(rows: Job, index: int) -> Job:
    """Return one state of the arrays of a file."""
    return {name: rows[name][index] for name in (*STATE, "time") if name in rows}


def drive(model: Any, data: Any, motions: dict[str, Any], step: int) -> None:
    """Write the prescribed motion of bodies with free joints at a step into the data of the model.

    Args:
        model: The model.
        data: Its data.
        motions: Rows of 7 numbers of qpos, 6 of qvel and 6 of xfrc_applied by name of the body.
        step: The step.
    """
    index, rest = divmod(step, max(1, round(DRIVEN_INTERVAL_S / model.opt.timestep)))
    for name, rows in motions.items() if rest == 0 else ():
        values = rows[min(index, len(rows) - 1)]
        joint = model.body(name).jntadr[0]
        coordinate, dof = model.jnt_qposadr[joint], model.jnt_dofadr[joint]
        data.qpos[coordinate : coordinate + 7] = values[:7]
        data.qvel[dof : dof + 6] = values[7:13]
        data.xfrc_applied[model.body(name).id] = values[13:]


def move(model: Any, job: Job, state: Job, controls: Any) -> Iterator[Any]:
    """Yield the data of the model before each step of a segment, and after the last one."""
    data = mujoco.MjData(model)
    set_state(data, state)
    mujoco.mj_forward(model, data)
    if "qacc_warmstart" in state:
        data.qacc_warmstart[:] = state["qacc_warmstart"]
    if controls is None:
        controls = np.tile(data.ctrl, (job["steps"], 1))
    for step, control in enumerate(controls):
        data.ctrl[:] = control
        drive(model, data, job["motions"], step)
        yield data
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    yield data


def run(job: Job) -> tuple[Job, Job]:
    """Move the model through its segments; return the model and the ends in words, and the states that it visits."""
    model, dropped = load_model(job)
    saved: Job = {"qpos": ()}
    segments = default_segments(model, job["steps"], job["seed"])
    if job["saved"]:
        saved = load_states(model, job["saved"])
        segments = saved_segments(model, saved, job["steps"])
    states: list[Job] = []
    ends: list[Job] = []
    for segment in segments:
        visited, end = run_segment(model, job, segment)
        interval = max(1, -(-len(visited) // MAX_PROBES))
        for step in range(0, len(visited), interval):
            states.append({**visited[step], "segment": len(ends), "step": step})
        ends.append(end)
    blank = get_state(mujoco.MjData(model))
    count = len(saved["qpos"])
    for step in range(0, count, max(1, -(-count // MAX_PROBES))):
        states.append({**blank, **row(saved, step), "segment": len(ends), "step": step})
    description = {
        "version": mujoco.__version__,
        "sizes": f"nq {model.nq}, nv {model.nv}, nu {model.nu}",
        "fields": compiled_fields(model),
        "names": object_names(model),
        "dropped": dropped,
        "ends": ends,
    }
    return description, stacked(states)


def run_segment(model: Any, job: Job, segment: Segment) -> tuple[list[Job], Job]:
    """Move the model through a segment, and again from velocities that differ by 1e-10.

    Returns:
        The states, and for each body its final position, displacement, largest depth, speed and what became of it.
    """
    name, state, controls = segment
    states, depths_m, max_speed = [], np.zeros(model.nbody), 0.0
    for data in move(model, job, state, controls):
        states.append(get_state(data))
        if len(states) == 1:
            initial_m = np.array(data.xpos)
        pairs, distances_m = contacts(data)
        for geoms in pairs.T:
            np.maximum.at(depths_m, model.geom_bodyid[geoms], -distances_m)
        max_speed = max(max_speed, float(np.max(np.abs(data.qvel), initial=0.0)))
    final_m = np.array(data.xpos)
    speeds = body_speeds(model, data)
    moves_m = final_m - initial_m
    displacements_m = np.linalg.norm(moves_m, axis=1)
    falls_m = (
        moves_m @ model.opt.gravity / max(np.linalg.norm(model.opt.gravity), 1e-12)
    )
    is_still = (displacements_m < MAX_STANDING_M) & (speeds < MAX_STANDING_M_PER_S)
    is_bad = any(name.startswith("mjWARN_BAD") for name in warning_counts(data))
    conditions = [
        np.full(model.nbody, is_bad or not max_speed < MAX_SPEED),
        falls_m > MIN_FALL_M,
        depths_m > MAX_DEPTH_M,
        is_still,
    ]
    kinds = ["explodes", "falls", "penetrates", "stands"]
    noise = np.random.RandomState(job["seed"] + 1).normal(size=model.nv)
    velocity = state.get("qvel", 0.0) + PERTURBATION * noise
    *_, perturbed = move(model, job, {**state, "qvel": velocity}, controls)
    end = {
        "positions_m": final_m,
        "displacements_m": displacements_m,
        "depths_m": depths_m,
        "speeds_m_per_s": speeds,
        "kinds": np.select(conditions, kinds, "moves"),
        "noise_m": np.max(np.linalg.norm(perturbed.xpos - final_m, axis=1)),
    }
    values = {key: np.asarray(value).tolist() for key, value in end.items()}
    return states[:-1], {"segment": name, **values}


def stacked(rows: list[Job]) -> Job:
    """Return the values of all rows by name, as arrays with a row each."""
    return {name: np.array([state[name] for state in rows]) for name in rows[0]}


def body_speeds(model: Any, data: Any) -> Any:
    """Return the speed of the frame of each body [m/s], shape [nbody]."""
    velocities = np.zeros((model.nbody, 6))
    for body, velocity in enumerate(velocities):
        kind = mujoco.mjtObj.mjOBJ_XBODY
        mujoco.mj_objectVelocity(model, data, kind, body, velocity, 0)
    return np.linalg.norm(velocities[:, 3:], axis=1)


# --- one step from a given state -------------------------------------------------------------------------------------


def warning_counts(data: Any) -> dict[str, int]:
    """Return the number of each warning of the engine that occurred."""
    kinds = mujoco.mjtWarning.__members__
    counts = {
        name: int(data.warning[int(index)].number)
        for name, index in kinds.items()
        if name != "mjNWARNING"
    }
    return {name: count for name, count in counts.items() if count}


def contacts(data: Any) -> tuple[Any, Any]:
    """Return sorted pairs of geoms, shape [n, 2], and distances [m] of the contacts of rigid geoms."""
    pairs = np.stack([data.contact.geom1, data.contact.geom2], axis=-1)
    pairs = np.sort(pairs.reshape(-1, 2), axis=1)
    is_rigid = pairs[:, 0] >= 0
    return pairs[is_rigid], np.ravel(data.contact.dist)[is_rigid]


def spins(model: Any, data: Any) -> Any:
    """Return the angular momenta of free bodies about their centers, shape [n, 3]; empty where a force may turn them.

    Without constraints, applied forces, damping, actuators and a medium, gravity alone acts on a free body.
    """
    mujoco.mj_subtreeVel(model, data)
    # Inside a tree with joints, momentum moves from body to body.
    counts = np.bincount(model.body_rootid[model.dof_bodyid], minlength=model.nbody)
    is_free = model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)
    bodies = model.jnt_bodyid[is_free]
    bodies = bodies[counts[bodies] == 6]
    forces = data.qfrc_actuator + data.qfrc_passive
    is_forced = np.any(forces[np.isin(model.dof_bodyid, bodies)])
    if is_forced or data.nefc or np.any(data.xfrc_applied):
        bodies = bodies[:0]
    return np.array(data.subtree_angmom[bodies])


def accelerations(model: Any, data: Any, state: Job) -> Any:
    """Return the accelerations of a state, and leave it in the data of the model."""
    set_state(data, state)
    mujoco.mj_forward(model, data)
    return np.array(data.qacc)


def probe_state(model: Any, data: Any, state: Job, change: Any) -> Job:
    """Return what one step from a state computes, and what its accelerations are with a velocity that differs.

    Args:
        model: The model.
        data: Its data, which are overwritten.
        state: The state, which alone decides: with its saved warm start.
        change: Change of the velocity, shape [nv].
    """
    velocity = state.get("qvel", np.zeros(model.nv))
    mujoco.mj_resetData(model, data)
    acceleration = accelerations(model, data, state)
    solver_steps = (
        data.solver_niter if hasattr(data, "solver_niter") else data.solver_iter
    )
    pairs, distances_m = contacts(data)
    probed = {
        "qacc": acceleration,
        "smooth": np.array(data.qacc_smooth),
        "constraint": np.array(data.qfrc_constraint),
        "iterations": int(np.max(solver_steps, initial=0)),
        "contacts": data.ncon,
        # The solver stops when its cost, a square of accelerations, falls by less than the tolerance.
        "solver_error": np.sqrt(model.opt.tolerance) if data.nefc else 0.0,
        "geom_xpos": np.array(data.geom_xpos),
        "geom_xmat": np.array(data.geom_xmat),
        "pairs": pairs,
        "distances_m": distances_m,
    }
    before = spins(model, data)
    set_state(data, state)
    mujoco.mj_step(model, data)
    probed["step_acc"] = (data.qvel - velocity) / model.opt.timestep
    probed["warnings"] = sum(warning_counts(data).values())
    mujoco.mj_forward(model, data)
    after = spins(model, data)
    probed["spin"] = float("nan")
    if len(before) and len(after) and np.any(before):
        probed["spin"] = np.linalg.norm(after - before) / np.linalg.norm(before)
    changed = {**state, "qvel": velocity + change}
    probed["perturbed"] = accelerations(model, data, changed)
    cold = {name: state[name] for name in state if name != "qacc_warmstart"}
    probed["cold"] = accelerations(model, data, cold)
    return probed


def probe(job: Job) -> tuple[Job, Job]:
    """Compute one step from each state of files; all contacts are in one array, with the number of their state."""
    model, _ = load_model(job)
    data = mujoco.MjData(model)
    probed: list[Job] = []
    for file in job["states"]:
        rows = load_states(model, file)
        noise = np.random.RandomState(0)
        for index in range(len(rows["qpos"])):
            change = PERTURBATION * noise.normal(size=model.nv)
            probed.append(probe_state(model, data, row(rows, index), change))
    pairs = [state.pop("pairs") for state in probed]
    distances_m = [state.pop("distances_m") for state in probed]
    touching = np.repeat(np.arange(len(pairs)), [len(each) for each in pairs])
    return {}, {
        **stacked(probed),
        "contact_state": touching,
        "contact_pair": np.concatenate(pairs),
        "contact_dist": np.concatenate(distances_m),
    }


# --- episodes --------------------------------------------------------------------------------------------------------


def call(text: str) -> Any:
    """Return what a function of `module:function` returns."""
    module, _, function = text.partition(":")
    return getattr(importlib.import_module(module), function)()


def make_environment(job: Job) -> Any:
    """Return the environment of a job, with its settings."""
    subject = job["subject"]
    is_id = ":" not in subject or "/" in subject
    env = importlib.import_module("gymnasium").make(subject) if is_id else call(subject)
    if job["settings"]:
        set_options(env.unwrapped.model, job["settings"])
    return env


def make_policy(text: str) -> Callable[[Any, int], Any]:
    """Return the action of an observation and a step, by a policy `module:function` or a file of actions."""
    if text.endswith(".npy"):
        rows = np.load(text)
        return lambda observation, step: rows[min(step, len(rows) - 1)]
    policy = call(text)
    # Stable-Baselines3 returns the action with a state.
    predict = getattr(policy, "predict", policy)

    def act(observation: Any, step: int) -> Any:
        action = predict(observation)
        return action[0] if isinstance(action, tuple) else action

    return act


def play(job: Job) -> tuple[Job, Job]:
    """Return return and success of an episode from each seed; NaN where the environment states no success."""
    # The user's modules are in the working folder; the folder of this file has modules with common names.
    sys.path[0] = ""
    env, act = make_environment(job), make_policy(job["policy"])
    returns, successes = [], []
    for seed in range(job["seed"], job["seed"] + job["episodes"]):
        observation, _ = env.reset(seed=seed)
        total, success, step, is_over = 0.0, float("nan"), 0, False
        while not is_over:
            action = act(observation, step)
            observation, reward, terminated, truncated, info = env.step(action)
            total, step = total + float(reward), step + 1
            reached = info.get("is_success", info.get("success", np.nan))
            success = float(np.fmax(success, float(reached)))
            is_over = terminated or truncated
        returns.append(total)
        successes.append(success)
    arrays = {"returns": np.array(returns), "successes": np.array(successes)}
    return {"version": mujoco.__version__}, arrays


TASKS = {"run": run, "probe": probe, "play": play}


def main(file: Path) -> None:
    """Do the job of a file."""
    job = json.loads(file.read_text(encoding="utf-8"))
    description, arrays = TASKS[job["task"]](job)
    np.savez(job["out"] + ".npz", **arrays)
    Path(job["out"] + ".json").write_text(json.dumps(description), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
