"""Plant mistakes of logs and of the policy's side, and count what `gauge replay` names first.

Usage: `python studies/replay/mistakes.py {policies,policy_twins,logs,log_twins} FIRST LAST ROBOT...`, with seeds FIRST
to LAST - 1. Robots are MJCF files; each is reduced to its links and joints, with servos, and its base floats without
gravity if it has a free joint. The formulas here are written again, and use nothing of the package but `replay`.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from gauge_envs.tools.replay import read_map, replay

INTERVAL_S, STEP_S, DURATION_S = 0.02, 0.002, 10.0
NOISE, RATE_NOISE, TURN_NOISE = 5e-4, 1e-2, 2e-4
MAX_JOINTS = 12
TYPES = mujoco.mjtJoint
FREE, SLIDE = TYPES.mjJNT_FREE.value, TYPES.mjJNT_SLIDE.value
Columns = dict[str, np.ndarray]


def robot(file: str, rng: np.random.Generator) -> mujoco.MjSpec:
    """Return links and joints of a robot, without shapes, with a servo at each joint."""
    given = mujoco.MjModel.from_xml_path(file)
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.timestep = STEP_S
    bodies, joints = {0: spec.worldbody}, 0
    for index in range(1, given.nbody):
        body = given.body(index)
        link = bodies[int(body.parentid[0])].add_body(
            name=f"link{index}", pos=body.pos, quat=body.quat
        )
        bodies[index] = link
        if body.mass[0] > 0.0:
            link.mass, link.ipos, link.iquat = body.mass[0], body.ipos, body.iquat
            link.inertia, link.explicitinertial = np.maximum(body.inertia, 1e-7), True
        for joint in range(body.jntadr[0], body.jntadr[0] + body.jntnum[0]):
            row = given.joint(joint)
            if row.type[0] == FREE:
                link.add_freejoint()
                spec.option.gravity = [0.0, 0.0, 0.0]
            elif row.type[0] >= SLIDE and joints < MAX_JOINTS:
                low, high = row.range if np.ptp(row.range) > 0.0 else (-2.0, 2.0)
                added = link.add_joint(
                    name=f"joint{joints}", axis=row.axis, pos=row.pos
                )
                added.type, added.range = TYPES(int(row.type[0])), [low, high]
                added.armature = 0.01
                joints += 1
    with_servos(spec, rng)
    return spec


def with_servos(spec: mujoco.MjSpec, rng: np.random.Generator) -> None:
    """Add a servo of 8 to 16 rad/s to each joint."""
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    inertia = model.dof_M0
    for joint in spec.joints:
        if joint.type == TYPES.mjJNT_FREE:
            continue
        total, rate = inertia[model.joint(joint.name).dofadr[0]], rng.uniform(8.0, 16.0)
        drive = spec.add_actuator(name=f"drive_{joint.name}", target=joint.name)
        drive.trntype = mujoco.mjtTrn.mjTRN_JOINT
        drive.set_to_position(kp=total * rate**2, kv=1.4 * total * rate)


def matrix(quaternion: np.ndarray) -> np.ndarray:
    """Return the rotation matrix of a quaternion w x y z."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


# --- the policy's side ---

SCALES = {"base_angvel": 0.25, "joint_vel": 0.05}


def observe(
    pose: np.ndarray, rates: np.ndarray, home: np.ndarray, is_free: bool
) -> Columns:
    """Return the terms of an observation, without scales."""
    angles, speeds = pose[-len(home) :], rates[-len(home) :]
    terms: Columns = {}
    if is_free:
        turn = matrix(pose[3:7])
        terms["base_linvel"] = turn.T @ rates[:3]
        terms["base_angvel"] = rates[3:6]
        terms["projected_gravity"] = turn.T @ [0.0, 0.0, -1.0]
    return terms | {"joint_pos": angles - home, "joint_vel": speeds}


def policy_mistake(
    kind: str, rng: np.random.Generator, home: np.ndarray, is_free: bool
) -> tuple[str, tuple[str, ...], Callable[..., np.ndarray]]:
    """Return the term that is wrong, the words that name the mistake, and a function of (values, pose, rates)."""
    base = str(rng.choice(["base_angvel", "base_linvel"]))
    joint = str(rng.choice(["joint_pos", "joint_vel"]))
    count = len(home)
    if kind == "quaternion":
        shift = int(rng.choice([-1, 1]))
        return (
            "projected_gravity",
            ("quaternion",),
            lambda _, pose, rates: (
                matrix(np.roll(pose[3:7], shift)).T @ [0.0, 0.0, -1.0]
            ),
        )
    if kind == "frame":
        return (
            base,
            ("world frame",),
            lambda values, pose, rates: matrix(pose[3:7]) @ values,
        )
    if kind == "twice":
        return (
            base,
            ("twice",),
            lambda values, pose, rates: matrix(pose[3:7]).T @ values,
        )
    if kind == "scale":
        term = "base_angvel" if is_free and rng.random() < 0.3 else joint
        factor = float(rng.choice([0.25, 0.5, 2.0, 4.0, 20.0]))
        return term, ("times its scale",), lambda values, *_: factor * values
    if kind == "order":
        order = rng.permutation(count)
        while (order == np.arange(count)).all():
            order = rng.permutation(count)
        return joint, ("order",), lambda values, *_: values[order]
    if kind == "pose":
        other = home + rng.uniform(-0.5, 0.5, count) * rng.integers(2)
        other = np.zeros(count) if (other == home).all() else other
        return (
            "joint_pos",
            ("default pose",),
            lambda values, *_: values + home - other,
        )
    if kind == "delay":
        return joint, ("late",), np.copy
    return joint, ("clipped",), np.copy


POLICY_KINDS = (
    "quaternion",
    "frame",
    "twice",
    "scale",
    "order",
    "pose",
    "delay",
    "clip",
)
OF_JOINTS = ("scale", "order", "pose", "delay", "clip")


def act(
    spec: mujoco.MjSpec, kind: str, rng: np.random.Generator
) -> tuple[Columns, str, str, tuple[str, ...]]:
    """Return the log of a robot that a policy drives with a mistake, the map, and what is wrong."""
    model = spec.compile()
    data = mujoco.MjData(model)
    is_free = model.nq > model.nv
    count = model.nu
    ranges = model.jnt_range[-count:]
    home = ranges.mean(axis=1) + rng.uniform(-0.3, 0.3, count) * np.minimum(
        1.0, np.ptp(ranges, axis=1) / 2
    )
    term, words, change = (
        policy_mistake(kind, rng, home, is_free) if kind else ("", (), None)
    )
    late, clip = int(rng.integers(1, 4)), float(rng.uniform(0.3, 0.6))
    data.qpos[-count:] = home
    if is_free:
        data.qvel[3:6] = rng.normal(0.0, 1.0, 3)
        data.qvel[:3] = rng.normal(0.0, 0.3, 3)
    width = len(np.hstack([*observe(data.qpos, data.qvel, home, is_free).values()])) + 2
    layers = (
        rng.normal(0.0, 1.2 / np.sqrt(width), (32, width)),
        rng.normal(0.0, 0.25, (count, 32)),
    )
    gait = rng.normal(0.0, 0.4, (count, 4))
    rate = rng.uniform(4.0, 8.0)
    history: list[np.ndarray] = []
    peaks: list[np.ndarray] = []
    rows: list[Columns] = []
    for step in range(round(DURATION_S / INTERVAL_S)):
        terms = observe(data.qpos, data.qvel, home, is_free)
        if term:
            history.append(terms[term].copy())
            peaks.append(np.abs(terms[term]))
            if kind == "delay":
                terms[term] = history[max(0, step - late)]
            elif kind == "clip":
                limit = clip * 3.0 if term == "joint_vel" else clip * 0.4
                terms[term] = terms[term].clip(-limit, limit)
            else:
                terms[term] = change(terms[term], data.qpos, data.qvel)
        phase = rate * step * INTERVAL_S
        command = np.array([np.sin(phase), np.cos(phase)])
        values = [SCALES.get(name, 1.0) * each for name, each in terms.items()]
        seen = np.hstack([*values, command])
        waves = np.hstack([command, np.sin(0.37 * phase), np.cos(0.61 * phase)])
        action = np.tanh(layers[1] @ np.tanh(layers[0] @ seen)) + gait @ waves
        data.ctrl[:] = home + 0.3 * action
        pose, rates = data.qpos.copy(), data.qvel.copy()
        row = {"t": step * INTERVAL_S, "q": pose[-count:], "dq": rates[-count:]}
        if is_free:
            row |= {"base_pos": pose[:3], "base_quat": pose[3:7]}
            row |= {"base_linvel": rates[:3], "base_angvel": rates[3:6]}
        rows.append(row | {"target": data.ctrl.copy(), "action": action, "obs": seen})
        for _ in range(round(INTERVAL_S / STEP_S)):
            mujoco.mj_step(model, data)
    log = {key: np.array([row[key] for row in rows]) for key in rows[0]}
    if kind == "clip" and np.mean(np.array(peaks) > limit) < 0.03:
        raise ValueError("the limit is never reached")
    names = [*terms, "command 2"]
    poses = ", ".join(f"joint{k} = {value:.9g}" for k, value in enumerate(home))
    scales = ", ".join(
        f"{key} = {value}" for key, value in SCALES.items() if key in terms
    )
    mapped = (
        f'observation = {names}\nobservation_scale = {{ {scales} }}\ncommand = "target"\n'
        f"[control]\naction_scale = 0.3\ndefault_rad = {{ {poses} }}\n"
    )
    return with_noise(log, rng), mapped, term, words


def with_noise(log: Columns, rng: np.random.Generator) -> Columns:
    """Return a log with noise of sensors."""
    sizes = {"q": NOISE, "dq": RATE_NOISE, "base_pos": NOISE, "base_quat": TURN_NOISE}
    sizes |= {"base_linvel": RATE_NOISE, "base_angvel": RATE_NOISE}
    return {
        key: values + sizes.get(key, 0.0) * rng.normal(size=np.shape(values))
        for key, values in log.items()
    }


# --- logs ---


def swing(spec: mujoco.MjSpec, rng: np.random.Generator, interval_s: float) -> Columns:
    """Return the log of a robot with targets of slow and fast waves."""
    model = spec.compile()
    data = mujoco.MjData(model)
    count, is_free = model.nu, model.nq > model.nv
    ranges = model.jnt_range[-count:]
    middle, size = ranges.mean(axis=1), np.minimum(np.ptp(ranges, axis=1), 2.0)
    times = np.arange(0.0, DURATION_S, interval_s)
    rates, phases = (
        rng.uniform(1.0, 11.0, (count, 3)),
        rng.uniform(0.0, 6.0, (count, 3)),
    )
    waves = np.sin(rates * times[:, None, None] + phases).sum(axis=2)
    targets = middle + 0.12 * size * waves
    data.qpos[-count:] = targets[0]
    if is_free:
        data.qvel[3:6], data.qvel[:3] = rng.normal(0, 0.8, 3), rng.normal(0, 0.3, 3)
    states = []
    for target in targets:
        states.append(np.concatenate([data.qpos, data.qvel]))
        data.ctrl[:] = target
        for _ in range(round(interval_s / STEP_S)):
            mujoco.mj_step(model, data)
    pose, rate = np.split(np.array(states), [model.nq], axis=1)
    log = {"t": times, "q": pose[:, -count:], "dq": rate[:, -count:], "target": targets}
    if is_free:
        log |= {"base_pos": pose[:, :3], "base_quat": pose[:, 3:7]}
        log |= {"base_linvel": rate[:, :3], "base_angvel": rate[:, 3:6]}
    return with_noise(log, rng)


LOG_KINDS = {
    "degrees": ("degrees",),
    "percent": ("-100 to 100",),
    "mm": ("mm",),
    "sign": ("sign of",),
    "zero": ("zero",),
    "order": ("exchanged", "order"),
    "axes": ("other axes",),
    "base": ("fixed",),
    "spikes": ("spikes",),
    "held": ("repeat the position", "held for"),
    "clock": ("times are in", "command_t", "clock"),
    "rate": ("velocities",),
}
"""Words of the message by mistake."""
ANGLES = ("q", "dq", "target")
UPS = {"y": [[1, 0, 0], [0, 0, -1], [0, 1, 0]], "x": [[0, 0, -1], [0, 1, 0], [1, 0, 0]]}


def write_wrongly(  # noqa: C901
    kind: str, log: Columns, spec: mujoco.MjSpec, rng: np.random.Generator
) -> None:
    """Change the columns of a log by a mistake."""
    rows, count = log["q"].shape
    joints = [joint for joint in spec.joints if joint.type != TYPES.mjJNT_FREE]
    joint, other = (int(k) for k in rng.choice(count, 2, replace=False))
    slides = [joint.type == TYPES.mjJNT_SLIDE for joint in joints]
    if kind == "degrees":
        unit = np.where(slides, 1.0, 180.0 / np.pi)
        log |= {key: unit * log[key] for key in ANGLES}
    elif kind == "percent":
        low, high = np.array([each.range for each in joints]).T
        log |= {
            key: 200.0 * (log[key] - (low + high) / 2) / (high - low)
            for key in ("q", "target")
        }
        log["dq"] = 200.0 * log["dq"] / (high - low)
    elif kind == "mm":
        log |= {key: np.where(slides, 1e3, 1.0) * log[key] for key in ANGLES}
    elif kind == "sign":
        for key in ANGLES:
            log[key][:, joint] *= -1.0
    elif kind == "zero":
        shift = rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 0.8)
        log["q"][:, joint] += shift
        log["target"][:, joint] += shift
    elif kind == "order":
        for key in ANGLES:
            log[key][:, [joint, other]] = log[key][:, [other, joint]]
    elif kind == "axes":
        turn = np.array(UPS[str(rng.choice([*UPS]))], float)
        # Axes of the world and of the base are renamed alike.
        whole = np.array([turn.T @ matrix(each) @ turn for each in log["base_quat"]])
        log["base_quat"] = np.array([quaternion_of(each) for each in whole])
        for key in ("base_pos", "base_linvel", "base_angvel"):
            log[key] = log[key] @ turn
    elif kind == "spikes":
        hit = rng.choice(rows, rows // 100, replace=False)
        log["q"][hit, joint] += rng.choice([-1.0, 1.0], len(hit)) * rng.uniform(
            0.3, 1.0
        )
    elif kind == "held":
        for row in np.sort(rng.choice(rows - 5, rows // 50, replace=False)) + 1:
            size = rng.integers(1, 4)
            for key in set(log) - {"t", "target"}:
                log[key][row : row + size] = log[key][row - 1]
    elif kind == "clock":
        choice = rng.integers(3)
        if choice == 0:
            log["t"] = log["t"] * float(rng.choice([1e3, 1e6, 1e9]))
        elif choice == 1:
            log["command_t"] = log["t"] + 1.7e9
        else:
            log["t"] = log["t"] * float(rng.choice([0.5, 2.0]))
    elif kind == "rate":
        choice = rng.integers(3)
        if choice == 0:
            log["dq"] = log["dq"] * rng.choice(
                [180.0 / np.pi, 30.0 / np.pi, 0.5 / np.pi]
            )
        elif choice == 1:
            log["dq"][:, joint] *= -1.0
        else:
            log["dq"] = np.roll(log["dq"], 1, axis=1)


def is_seen(spec: mujoco.MjSpec, log: Columns) -> bool:
    """Return whether predictions of 0.3 s from the states of a log miss a joint by 30 mrad or 30 mm (median)."""
    model = spec.compile()
    data, count, steps = mujoco.MjData(model), model.nu, round(INTERVAL_S / STEP_S)
    errors = []
    for row in range(0, len(log["t"]) - 20, 20):
        mujoco.mj_resetData(model, data)
        if model.nq > model.nv:
            data.qpos[:7] = np.hstack([log["base_pos"][row], log["base_quat"][row]])
            data.qvel[:6] = np.hstack(
                [log["base_linvel"][row], log["base_angvel"][row]]
            )
        data.qpos[-count:], data.qvel[-count:] = log["q"][row], log["dq"][row]
        for target in log["target"][row : row + 15]:
            data.ctrl[:] = target
            mujoco.mj_step(model, data, steps)
        errors.append(np.abs(data.qpos[-count:] - log["q"][row + 15]))
    return bool(np.median(errors, axis=0).max() > 0.03)


def quaternion_of(turn: np.ndarray) -> np.ndarray:
    """Return the quaternion w x y z of a rotation matrix."""
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, turn.ravel())
    return quaternion


TWINS = ("plain", "trot", "noise", "slow", "coarse")


def right_log(name: str, spec: mujoco.MjSpec, rng: np.random.Generator) -> Columns:
    """Return a log without a mistake: a trot at 50 Hz, a noisy encoder, 10 Hz, or an encoder of 12 bits."""
    log = swing(spec, rng, 0.1 if name == "slow" else INTERVAL_S)
    if name == "noise":
        log["q"] = log["q"] + 5e-3 * rng.normal(size=log["q"].shape)
    elif name == "coarse":
        log["q"] = np.round(log["q"] * 4096 / (2 * np.pi)) * 2 * np.pi / 4096
    return log


def is_suited(kind: str, file: str) -> bool:
    """Return whether a robot can have a mistake."""
    types = mujoco.MjModel.from_xml_path(file).jnt_type
    if kind in ("quaternion", "frame", "twice", "axes", "base"):
        return bool((types == FREE).any())
    return kind != "mm" or bool((types == SLIDE).any())


def write_case(
    subset: str, seed: int, files: list[str], folder: Path
) -> tuple[str, tuple[str, ...]]:
    """Write log, model and map of a seed; return what is wrong, and the words that name it."""
    rng = np.random.default_rng([seed, len(subset)])
    kinds = POLICY_KINDS if subset == "policies" else tuple(LOG_KINDS)
    kind = kinds[seed % len(kinds)] if subset in ("policies", "logs") else ""
    suited = [file for file in files if is_suited(kind, file)]
    file = suited[(seed // len(kinds) if kind else seed) % len(suited)]
    spec, mapped = robot(file, rng), ""
    label = f"{kind or 'right'} {Path(file).stem}"
    if subset in ("policies", "policy_twins"):
        for _ in range(20):
            try:
                log, mapped, term, words = act(spec, kind, rng)
                break
            except ValueError:
                continue
        words, label = (term, *words) if kind else (), f"{label} {term}"
    elif subset == "logs":
        words = LOG_KINDS[kind]
        for _ in range(20):
            log = swing(spec, rng, INTERVAL_S)
            write_wrongly(kind, log, spec, rng)
            if kind not in ("sign", "zero", "order") or is_seen(spec, log):
                break
    else:
        twin = TWINS[seed % len(TWINS)]
        log, words, label = right_log(twin, spec, rng), (), f"{twin} {label}"
    text = spec.to_xml()
    if kind == "base":
        text = text.replace('<joint type="free"/>', "")
    (folder / "robot.xml").write_text(text)
    (folder / "map.toml").write_text(mapped)
    names = [joint.name for joint in spec.joints if joint.type != TYPES.mjJNT_FREE]
    np.savez(folder / "log.npz", **log, joints=np.array(names))
    return label, words


def outcome_of(subset: str, words: tuple[str, ...], line: Any) -> str:
    """Return `right`, `nothing` or `wrong`."""
    found = list(line.policy if "polic" in subset else line.mistakes)
    if (
        line.named
        and line.named[0].cause == "zero"
        and line.verdict == "a mistake of the log"
    ):
        found.append("zero")
    if not words:
        return (
            "right" if not found and not line.named and not line.mistakes else "wrong"
        )
    if not found:
        return "wrong" if line.named or line.mistakes else "nothing"
    if "polic" in subset:
        return "right" if all(word in found[0] for word in words) else "wrong"
    is_first = any(word in found[0] for word in words) and "MJCF" not in line.paste
    return "right" if is_first else "wrong"


def main() -> None:
    """Run the seeds, and print a line each and the counts."""
    subset, first, last, *files = sys.argv[1:]
    counts: dict[str, int] = {}
    for seed in range(int(first), int(last)):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            label, words = write_case(subset, seed, files, folder)
            begin_s = time.process_time()
            mapped = read_map(folder / "map.toml")
            line = replay(folder / "log.npz", folder / "robot.xml", mapped=mapped).line
            cost_s = time.process_time() - begin_s
        outcome = outcome_of(subset, words, line)
        counts[outcome] = counts.get(outcome, 0) + 1
        print(seed, outcome, label, f"{cost_s:.1f} s |", line.sentence, flush=True)
    print(subset, counts)


if __name__ == "__main__":
    main()
