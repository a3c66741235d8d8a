"""Run a model in one release of MuJoCo: `python worker.py JOB`.

The process imports the release and NumPy, not this package. It needs MuJoCo 3.0 or later.
The job is a JSON object. Its `task` is one of:

- `run`: simulate `model` with `settings` from its initial states, and write the visited states.
- `probe`: compute one step from each state of the file `states`.
- `play`: run `episodes` of the environment `subject` with `policy` from `seed`, in the user's Python.

The worker writes arrays to the file `out`; the array `description` is the text of a JSON object.
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
    "time",
)
"""Values of a state; a file of saved states needs only `qpos`."""

ENUMS = {
    "jacobian": "mjtJacobian",
    "solver": "mjtSolver",
    "cone": "mjtCone",
    "integrator": "mjtIntegrator",
}
"""Enumerations of options."""

PHYSICS = re.compile(
    r"(?!.*(adr|num|bvh|plugin|rgba|matid|group|user|sameframe|simple|rootid|weldid|treeid|jntid|dataid|Madr|texcoord|"
    r"flatskin))(qpos0|qpos_spring|body_|jnt_|dof_|geom_|mesh_(scale|pos|quat|inertia)|hfield_size|pair_|exclude_|eq_|"
    r"tendon_|wrap_|actuator_|key_|flex_|flexedge_)"
)
"""Compiled fields with physical values, without addresses and counts."""

UNKNOWN = re.compile(
    r"(?:: '|Error: )(?P<word>\w+)"
    r"(?:'\s+Element '(?P<tag>\w+)'| is only available for .*\s+Element name '(?P<name>.*)', id)"
)
"""Messages of MuJoCo about an unknown attribute or value of an element."""

PERTURBATION = 1e-10
"""Negligible change of velocities [m/s, rad/s]."""

CONTROL_INTERVAL_S = 0.1
"""Time for which random controls are constant [s]."""

CONTROL_ROWS = 6001
"""Number of random controls that are drawn before the random push."""

PUSH_M_PER_S = 0.5
"""Standard deviation of the velocities of a push [m/s or rad/s]."""

MAX_INITIAL_STATES = 4
"""Maximum number of keyframes or saved states from which the model moves."""


# --- the model -------------------------------------------------------------------------------------------------------


def load_model(job: Job) -> tuple[Any, list[str]]:
    """Compile the model of a job with its settings, without attributes that the release does not know.

    Returns:
        The compiled model, and the removed attributes, for example `option apirate="100"`.
    """
    path = Path(job["model"])
    root = ElementTree.parse(path).getroot()
    dropped: list[str] = []
    model = None
    while model is None:
        try:
            if dropped:
                text = ElementTree.tostring(root, encoding="unicode")
                model = mujoco.MjModel.from_xml_string(text)
            else:
                model = mujoco.MjModel.from_xml_path(str(path))
        except ValueError as error:
            unknown = remove_unknown(root, str(error))
            if not unknown:
                raise
            dropped += unknown
            # Mesh files are relative to the folder of the model.
            os.chdir(path.parent)
    set_options(model, job["settings"])
    return model, dropped


def remove_unknown(root: Any, message: str) -> list[str]:
    """Remove the attributes that a message of MuJoCo rejects from an XML tree, and return them."""
    rejected = UNKNOWN.search(message)
    removed: list[str] = []
    if rejected is None:
        return removed
    for element in root.iter(rejected["tag"]):
        is_named = rejected["name"] in (None, element.get("name", ""))
        for name, value in list(element.items()):
            if is_named and rejected["word"] in (name, value):
                removed.append(f'{element.tag} {name}="{value}"')
                del element.attrib[name]
    return removed


def set_options(model: Any, settings: Job) -> None:
    """Write options into a model; names of enumerations are allowed."""
    for name, value in settings.items():
        members = getattr(mujoco, ENUMS[name]).__members__ if name in ENUMS else {}
        numbers = {key.partition("_")[2].lower(): int(members[key]) for key in members}
        expected = " or ".join(numbers) or getattr(model.opt, name, "another option")
        try:
            setattr(model.opt, name, numbers.get(str(value).lower(), value))
        except (AttributeError, TypeError, ValueError):
            raise SystemExit(f"{name}={value}: expected {expected}") from None
    if not model.opt.timestep > 0.0:
        raise SystemExit(f"timestep={model.opt.timestep}: expected a positive number")


def compiled_fields(model: Any) -> Job:
    """Return the rows of the options and of the physical fields of the compiled model."""
    options = [name for name in dir(model.opt) if not name.startswith("_")]
    fields = {f"opt.{name}": [np.ravel(getattr(model.opt, name))] for name in options}
    fields |= {name: getattr(model, name) for name in filter(PHYSICS.match, dir(model))}
    return {name: np.asarray(fields[name], dtype=float).tolist() for name in fields}


def names_of(objects: Callable[[int], Any], kind: str, count: int) -> list[str]:
    """Return the names of objects; an object without a name has its kind and index."""
    return [objects(index).name or f"{kind} {index}" for index in range(count)]


def object_names(model: Any) -> dict[str, list[str]]:
    """Return the names of bodies, geoms and degrees of freedom."""
    bodies = names_of(model.body, "body", model.nbody)
    geoms = names_of(model.geom, "geom", model.ngeom)
    joints = names_of(model.jnt, "joint", model.njnt)
    for geom, body in enumerate(model.geom_bodyid):
        if geoms[geom] == f"geom {geom}":
            geoms[geom] += f" of {bodies[body]}"
    dofs = []
    for dof, joint in enumerate(model.dof_jntid):
        name = joints[joint]
        if model.jnt_type[joint] == int(mujoco.mjtJoint.mjJNT_FREE):
            is_rotation = dof - model.jnt_dofadr[joint] > 2
            name = "rotation" if is_rotation else "translation"
        dofs.append(f"{name} of {bodies[model.dof_bodyid[dof]]}")
    return {"body": bodies, "geom": geoms, "dof": dofs}


# --- motion ----------------------------------------------------------------------------------------------------------


def set_state(data: Any, state: Job) -> None:
    """Write a state into reset data."""
    for name in state:
        setattr(data, name, state[name])


def get_state(data: Any) -> Job:
    """Return the state of the data of a model."""
    return {name: np.array(getattr(data, name)) for name in STATE}


def default_segments(model: Any, steps: int, seed: int) -> Iterator[Segment]:
    """Yield motions from the initial state and keyframes, with random controls, and with a push."""
    random = np.random.RandomState(seed)
    data = mujoco.MjData(model)
    is_limited = np.array(model.actuator_ctrllimited, dtype=bool).ravel()
    ranges = np.where(is_limited[:, None], model.actuator_ctrlrange, (-1.0, 1.0))
    low, high = ranges.T
    state = get_state(data)
    state["ctrl"] = np.clip(np.zeros(model.nu), low, high)
    yield "start", state, None
    for key in range(min(model.nkey, MAX_INITIAL_STATES)):
        mujoco.mj_resetDataKeyframe(model, data, key)
        state = get_state(data)
        yield f"keyframe {model.key(key).name or key}", state, None
    if model.nu:
        interval = max(1, round(CONTROL_INTERVAL_S / model.opt.timestep))
        middle, half = (low + high) / 2.0, (high - low) / 2.0
        rows = random.uniform(-1.0, 1.0, (max(CONTROL_ROWS, steps), model.nu))
        controls = middle + half * rows
        yield "random controls", state, controls[np.arange(steps) // interval]
    velocity = state["qvel"] + random.normal(0.0, PUSH_M_PER_S, model.nv)
    yield "push", {**state, "qvel": velocity}, None


def load_states(model: Any, file: str) -> list[Job]:
    """Return the states of a file."""
    with np.load(file) as arrays:
        rows = {name: arrays[name] for name in STATE if name in arrays}
    shapes = {name: np.shape(rows[name]) for name in rows}
    count, size = shapes.get("qpos", (0, 0))
    if size != model.nq or {shape[0] for shape in shapes.values()} != {count}:
        raise SystemExit(
            f"saved states have the shapes {shapes}; expected qpos with {model.nq} columns and a row for each state, "
            "and the same number of rows in the other arrays"
        )
    return [{name: rows[name][index] for name in rows} for index in range(count)]


def move(model: Any, job: Job, segment: Segment) -> Iterator[Job]:
    """Yield the states before each step of a segment."""
    name, state, controls = segment
    data = mujoco.MjData(model)
    set_state(data, state)
    for step in range(job["steps"]):
        if controls is not None:
            data.ctrl[:] = controls[step]
        yield {**get_state(data), "segment": name, "step": step}
        mujoco.mj_step(model, data)


def run(job: Job) -> tuple[Job, Job]:
    """Run the segments of a model; return a description of the model and the visited states."""
    model, dropped = load_model(job)
    saved: list[Job] = []
    segments = default_segments(model, job["steps"], job["seed"])
    if job["saved"]:
        saved = load_states(model, job["saved"])
        indices = range(0, len(saved), -(-len(saved) // MAX_INITIAL_STATES))
        segments = (
            (f"settle from state {index}", saved[index], None) for index in indices
        )
    states = [state for segment in segments for state in move(model, job, segment)]
    blank = {**get_state(mujoco.MjData(model)), "segment": "saved states"}
    states += [{**blank, **row, "step": step} for step, row in enumerate(saved)]
    description = {
        "version": mujoco.__version__,
        "sizes": f"nq {model.nq}, nv {model.nv}, nu {model.nu}",
        "fields": compiled_fields(model),
        "names": object_names(model),
        "dropped": dropped,
    }
    return description, stacked(states)


def stacked(rows: list[Job]) -> Job:
    """Return the values of all rows as arrays by name."""
    return {name: np.array([state[name] for state in rows]) for name in rows[0]}


# --- one step from a given state -------------------------------------------------------------------------------------


def contacts(data: Any) -> dict[str, list[float]]:
    """Return the sorted distances [m] of the contacts of each pair of rigid geoms, such as `0 3`."""
    contact = data.contact
    geoms = np.sort([np.ravel(contact.geom1), np.ravel(contact.geom2)], axis=0)
    pairs: dict[str, list[float]] = {}
    for first, second, distance_m in zip(*geoms, np.ravel(contact.dist), strict=True):
        if first >= 0:
            pairs.setdefault(f"{first} {second}", []).append(float(distance_m))
    return {pair: sorted(pairs[pair]) for pair in pairs}


def accelerations(model: Any, data: Any, state: Job) -> Any:
    """Write a state into the data of a model, and return its accelerations."""
    mujoco.mj_resetData(model, data)
    set_state(data, state)
    mujoco.mj_forward(model, data)
    return np.array(data.qacc)


def probe_state(model: Any, data: Any, state: Job, change: Any) -> Job:
    """Return the results of one step from a state, and the noise of its accelerations.

    Args:
        model: The model.
        data: Data of the model; they are overwritten.
        state: The state, with its saved warm start.
        change: Change of the velocity, shape [nv].
    """
    velocity = state["qvel"]
    cold = {name: state[name] for name in state if name != "qacc_warmstart"}
    states = (cold, {**state, "qvel": velocity + change})
    changed = [accelerations(model, data, changed_state) for changed_state in states]
    acceleration = accelerations(model, data, state)
    noise = np.linalg.norm(changed - acceleration, axis=1).max()
    probed = {
        "qacc": acceleration,
        # NaN counts as infinite noise.
        "noise": np.nan_to_num(noise, nan=np.inf),
        "smooth": np.array(data.qacc_smooth),
        "iterations": int(np.max(data.solver_niter, initial=0)),
        "contacts": data.ncon,
        "touching": contacts(data),
        # The solver stops if its cost, a squared acceleration, improves by less than the tolerance.
        "solver_error": np.sqrt(model.opt.tolerance) if data.nefc else 0.0,
        "geom_xpos": np.array(data.geom_xpos),
        "geom_xmat": np.array(data.geom_xmat),
    }
    set_state(data, state)
    mujoco.mj_step(model, data)
    probed["step_acc"] = (data.qvel - velocity) / model.opt.timestep
    probed["warnings"] = int(np.sum(data.warning.number))
    return probed


def probe(job: Job) -> tuple[Job, Job]:
    """Compute one step from each state of a file."""
    model, _ = load_model(job)
    data = mujoco.MjData(model)
    noise = np.random.RandomState(0)
    probed: list[Job] = []
    for state in load_states(model, job["states"]):
        change = PERTURBATION * noise.normal(size=model.nv)
        probed.append(probe_state(model, data, state, change))
    return {"touching": [state.pop("touching") for state in probed]}, stacked(probed)


# --- episodes --------------------------------------------------------------------------------------------------------


def call(text: str) -> Any:
    """Call `module:function` and return its result."""
    module, _, function = text.partition(":")
    return getattr(importlib.import_module(module), function)()


def make_policy(text: str) -> Callable[[Any, int], Any]:
    """Return a function of observation and step, from a policy `module:function` or a file of actions."""
    if text.endswith(".npy"):
        rows = np.load(text)
        return lambda observation, step: rows[min(step, len(rows) - 1)]
    policy = call(text)
    # Stable-Baselines3 returns a pair of action and state.
    predict = getattr(policy, "predict", policy)

    def act(observation: Any, step: int) -> Any:
        action = predict(observation)
        return action[0] if isinstance(action, tuple) else action

    return act


def play(job: Job) -> tuple[Job, Job]:
    """Return return and success of an episode for each seed; NaN if the environment reports no success."""
    # Modules of the user are in the working folder.
    sys.path.insert(0, "")
    subject, act = job["subject"], make_policy(job["policy"])
    is_function = ":" in subject and "/" not in subject
    make = importlib.import_module("gymnasium").make
    env = call(subject) if is_function else make(subject)
    if job["settings"]:
        set_options(env.unwrapped.model, job["settings"])
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


def main(text: str) -> None:
    """Run a job."""
    job = json.loads(text)
    description, arrays = TASKS[job["task"]](job)
    np.savez(job["out"], description=json.dumps(description), **arrays)


if __name__ == "__main__":
    main(sys.argv[1])
