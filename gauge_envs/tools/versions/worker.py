"""Run a model in one release of MuJoCo: `python worker.py JOB`.

The process imports the release and NumPy, not this package. It needs MuJoCo 3.0 or later, and the file
`model_fields.json` beside it.
The job is a JSON object. Its `task` is one of:

- `run`: simulate `model` with `settings` from its initial states, and write the visited states.
- `probe`: compute one step from each state of the file `states`.
- `simulate`: run the experiment `subject` of this package on `engine`, in the user's Python.
- `play`: run `episodes` of the environment `subject` with `policy` from `seed`, in the user's Python.

The worker writes arrays by name to the file `out`.
"""

import importlib
import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

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

FIELDS = json.loads(Path(__file__).with_name("model_fields.json").read_text())
"""Arrays of a compiled model in MuJoCo 3.0 to 4.0: `physics`, and `other` (addresses, counts, names, pictures)."""

PERTURBATION = 1e-10
"""Negligible change of velocities [m/s, rad/s]."""

CONTROL_INTERVAL_S = 0.1
"""Time for which random controls are constant [s]."""

CONTROL_ROWS = 6001
"""Number of random controls that are drawn before the random push."""

PUSH_M_PER_S = 0.5
"""Standard deviation of the velocities of a push [m/s or rad/s]."""


# --- the model -------------------------------------------------------------------------------------------------------


def load_model(job: Job) -> Any:
    """Compile the model of a job with its settings."""
    model = mujoco.MjModel.from_xml_path(job["model"])
    set_options(model, job["settings"])
    return model


def set_options(model: Any, settings: Job) -> None:
    """Write options into a model; names of enumerations are allowed."""
    for name, value in settings.items():
        numbers = enumerated(name)
        try:
            setattr(model.opt, name, numbers.get(str(value).lower(), value))
        except TypeError:
            expected = " or ".join(numbers) or getattr(model.opt, name)
            raise SystemExit(f"{name}={value}: expected {expected}") from None


def enumerated(option: str) -> dict[str, int]:
    """Return the values of an option by name, as those of `mjtSolver` for `solver`; empty for a number."""
    kind = getattr(mujoco, f"mjt{option.capitalize()}", None)
    members = {} if kind is None else kind.__members__
    return {key.partition("_")[2].lower(): int(members[key]) for key in members}


def array_fields(model: Any) -> list[str]:
    """Return the names of the arrays of a compiled model."""
    names = [name for name in dir(model) if not name.startswith("_")]
    return [name for name in names if isinstance(getattr(model, name), np.ndarray)]


def compiled_fields(model: Any) -> Job:
    """Return the rows of the options and of the physical fields of a compiled model; an unknown field is physical."""
    names = [name for name in array_fields(model) if name not in FIELDS["other"]]
    options = [name for name in dir(model.opt) if not name.startswith("_")]
    fields = {f"field {name}": getattr(model, name) for name in names}
    for name in options:
        fields[f"field opt.{name}"] = [np.ravel(getattr(model.opt, name))]
    unknown = [name for name in names if name not in FIELDS["physics"]]
    rows = {name: np.array(values, dtype=float) for name, values in fields.items()}
    return {**rows, "unknown fields": np.array(unknown, dtype=str)}


def names_of(objects: Callable[[int], Any], kind: str, count: int) -> list[str]:
    """Return the names of objects; an object without a name has its kind and index."""
    return [objects(index).name or f"{kind} {index}" for index in range(count)]


def dof_names(model: Any) -> list[str]:
    """Return the joint and body of each degree of freedom."""
    bodies = names_of(model.body, "body", model.nbody)
    joints = names_of(model.jnt, "joint", model.njnt)
    pairs = zip(model.dof_jntid, model.dof_bodyid, strict=True)
    return [f"{joints[joint]} of {bodies[body]}" for joint, body in pairs]


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
    state = get_state(data)
    yield "start", state, None
    for key in range(model.nkey):
        mujoco.mj_resetDataKeyframe(model, data, key)
        state = get_state(data)
        yield f"keyframe {model.key(key).name or key}", state, None
    if model.nu:
        is_limited = model.actuator_ctrllimited.astype(bool).reshape(-1, 1)
        low, high = np.where(is_limited, model.actuator_ctrlrange, (-1.0, 1.0)).T
        rows = random.uniform(-1.0, 1.0, (max(CONTROL_ROWS, steps), model.nu))
        controls = (low + high) / 2.0 + (high - low) / 2.0 * rows
        interval = max(1, round(CONTROL_INTERVAL_S / model.opt.timestep))
        yield "random controls", state, controls[np.arange(steps) // interval]
    velocity = state["qvel"] + random.normal(0.0, PUSH_M_PER_S, model.nv)
    yield "push", {**state, "qvel": velocity}, None


def load_states(model: Any, file: str) -> list[Job]:
    """Return the states of a file; values that it lacks are those of the initial state."""
    with np.load(file) as arrays:
        rows = {name: arrays[name] for name in STATE if name in arrays}
    shape = np.shape(rows.get("qpos", ()))
    if shape[1:] != (model.nq,):
        raise SystemExit(
            f"saved states have qpos of shape {shape}; expected {model.nq} columns and a row for each state"
        )
    initial = get_state(mujoco.MjData(model))
    states = []
    for index in range(len(rows["qpos"])):
        saved = {name: values[index] for name, values in rows.items()}
        states.append({**initial, **saved})
    return states


def move(model: Any, steps: int, segment: Segment) -> Iterator[Job]:
    """Yield the states before each step of a segment."""
    name, state, controls = segment
    data = mujoco.MjData(model)
    set_state(data, state)
    for step in range(steps):
        if controls is not None:
            data.ctrl[:] = controls[step]
        yield {**get_state(data), "segment": name, "step": step}
        mujoco.mj_step(model, data)


def run(job: Job) -> Job:
    """Run the segments of a model; return a description of the model and the visited states."""
    model = load_model(job)
    steps = job["steps"]
    segments = default_segments(model, steps, job["seed"])
    if job["saved"]:
        saved = load_states(model, job["saved"])
        steps = -(-steps // len(saved))
        segments = (
            (f"saved state {index}", state, None) for index, state in enumerate(saved)
        )
    states = [state for segment in segments for state in move(model, steps, segment)]
    return {
        "version": mujoco.__version__,
        "sizes": f"nq {model.nq}, nv {model.nv}, nu {model.nu}",
        "names geom": names_of(model.geom, "geom", model.ngeom),
        "names dof": dof_names(model),
        **compiled_fields(model),
        **stacked(states),
    }


def stacked(rows: list[Job]) -> Job:
    """Return the values of all rows as arrays by name."""
    return {name: np.array([state[name] for state in rows]) for name in rows[0]}


# --- one step from a given state -------------------------------------------------------------------------------------


def contacts(data: Any) -> Any:
    """Return geoms and distance [m] of each contact of two rigid geoms, in order, shape [contacts, 3]."""
    geoms = np.sort([data.contact.geom1.ravel(), data.contact.geom2.ravel()], axis=0)
    rows = np.transpose([*geoms, data.contact.dist.ravel()])
    rows = rows[np.lexsort(rows.T[::-1])]
    return rows[rows[:, 0] >= 0.0]


def accelerations(model: Any, data: Any, state: Job) -> Any:
    """Write a state into the data of a model, and return its accelerations."""
    mujoco.mj_resetData(model, data)
    set_state(data, state)
    mujoco.mj_forward(model, data)
    return np.array(data.qacc)


def probe(job: Job) -> Job:
    """Compute one step from each state of a file, and the noise of its accelerations."""
    model = load_model(job)
    data = mujoco.MjData(model)
    random = np.random.RandomState(0)
    probed, touching = [], [np.empty((0, 4))]
    for index, state in enumerate(load_states(model, job["states"])):
        velocity = state["qvel"]
        change = PERTURBATION * random.normal(size=model.nv)
        cold = {name: state[name] for name in state if name != "qacc_warmstart"}
        perturbed = {**state, "qvel": velocity + change}
        changed = [accelerations(model, data, other) for other in (cold, perturbed)]
        acceleration = accelerations(model, data, state)
        noise = np.linalg.norm(changed - acceleration, axis=1).max()
        touching.append(np.insert(contacts(data), 0, index, axis=1))
        values = {
            "qacc": acceleration,
            # NaN counts as infinite noise.
            "noise": np.nan_to_num(noise, nan=np.inf),
            "smooth": np.array(data.qacc_smooth),
            # The solver stops if its cost, a squared acceleration, improves by less than the tolerance.
            "solver_error": np.sqrt(model.opt.tolerance) if data.nefc else 0.0,
            "geom_xpos": np.array(data.geom_xpos),
            "geom_xmat": np.array(data.geom_xmat),
        }
        set_state(data, state)
        mujoco.mj_step(model, data)
        values["step_acc"] = (data.qvel - velocity) / model.opt.timestep
        probed.append(values)
    return {"contacts": np.concatenate(touching), **stacked(probed)}


# --- episodes --------------------------------------------------------------------------------------------------------


def made(text: str) -> Any:
    """Return what `module:function` returns, or the environment of an id of Gymnasium."""
    # Modules of the user are in the working folder.
    sys.path.insert(0, "")
    module, _, function = text.partition(":")
    if function and "/" not in function:
        return getattr(importlib.import_module(module), function)()
    return importlib.import_module("gymnasium").make(text)


def make_policy(text: str) -> Callable[[Any, int], Any]:
    """Return a function of observation and step, from a policy `module:function` or a file of actions."""
    if text.endswith(".npy"):
        rows = np.load(text)
        return lambda observation, step: rows[min(step, len(rows) - 1)]
    policy = made(text)
    # Stable-Baselines3 returns a pair of action and state.
    predict = getattr(policy, "predict", policy)

    def act(observation: Any, step: int) -> Any:
        action = predict(observation)
        return action[0] if isinstance(action, tuple) else action

    return act


def play(job: Job) -> Job:
    """Return the return of an episode for each seed."""
    env, act = made(job["subject"]), make_policy(job["policy"])
    if job["settings"]:
        set_options(env.unwrapped.model, job["settings"])
    returns = []
    for seed in range(job["seed"], job["seed"] + job["episodes"]):
        observation, _ = env.reset(seed=seed)
        rewards, is_over = list[float](), False
        while not is_over:
            action = act(observation, len(rewards))
            observation, reward, terminated, truncated, _ = env.step(action)
            rewards.append(float(reward))
            is_over = terminated or truncated
        returns.append(sum(rewards))
    return {"version": mujoco.__version__, "returns": returns}


def simulate(job: Job) -> Job:
    """Return the result of an experiment, and its result from an initial position 1e-9 m away."""
    from gauge_envs.runs.episodes import run_episodes
    from gauge_envs.runs.request import RunRequest
    from gauge_envs.scene.jitter import Jitter

    request = RunRequest(
        job["subject"],
        backend=job["engine"],
        settings=job["settings"],
        seed=job["seed"],
    )
    jitter = Jitter(position_m=1e-9, angle_rad=0.0)
    results = [
        run_episodes(run)[0].to_dict()
        for run in (request, replace(request, jitter=jitter))
    ]
    return {"results": [json.dumps(result) for result in results]}


def main(text: str) -> None:
    """Run a job."""
    job = json.loads(text)
    tasks = {"run": run, "probe": probe, "simulate": simulate, "play": play}
    np.savez(job["out"], **tasks[job["task"]](job))


if __name__ == "__main__":
    main(sys.argv[1])
