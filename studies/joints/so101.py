"""Servos of the SO-101 arm: constants from half of the motions, errors on the others, beside constants in circulation.

    python studies/joints/so101.py

MuJoCo simulates the whole arm. Writes so101_constants.csv, so101_inertia.csv, so101_errors.csv (each motion),
so101_judged.csv (over the judged motions, also with one constant left out or changed), so101_load.csv,
so101_held.csv, so101_steps.csv and so101.png.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from itertools import product

import matplotlib.pyplot as plt
import mujoco
import numpy as np
from fits import HERE, FloatArray, Trial, trials, write
from mujoco.rollout import rollout

JOINTS = ("Rotation", "Pitch", "Elbow", "Wrist_Pitch", "Wrist_Roll", "Jaw")
LOADED = np.array([False, True, True, True, False, False])
"""Joints whose sag under gravity gives the gain in N m; the others get the geometric mean of these."""

SUBSTEPS = 8
FIELDS = ("kp", "damping", "dry", "armature", "delay", "limit")
STEPS = np.array([0.05, 0.05, 0.05, 0.05, 0.004, 0.05])
"""Steps of the finite differences: of logarithms, and of the delay [s]."""

TASK = mujoco.MjModel.from_xml_path(str(HERE / "so101.xml"))


CHIRP_S = 100.0
"""Time of the chirp up to which it is fitted [s]: faster than that the jaw loses cycles, as no such servo does."""

ROUNDS = 3
BLOCK_FRAMES = 100
"""Frames of a block of the bootstrap: 2 s."""

COPIES = 1000


@dataclass(frozen=True, eq=False)
class Servos:
    """Constants of the six servos, each of shape [6].

    Attributes:
        kp: Torque per error [N m/rad].
        damping: Viscous friction of the joint [N m s/rad].
        dry: Dry friction [N m].
        armature: Inertia of the drive [kg m^2].
        delay: Delay of the command [s].
        limit: Largest torque of the servo [N m].
        kv: Torque per rate of the servo, inside the limit [N m s/rad].
        soft: Whether dry friction is as soft as MuJoCo's default, so that a joint that sticks creeps.
        light: Whether links have 1 % of their inertia, and gravity is so strong that their weight stays.
    """

    kp: FloatArray
    damping: FloatArray
    dry: FloatArray
    armature: FloatArray
    delay: FloatArray
    limit: FloatArray
    kv: FloatArray
    soft: bool = False
    light: bool = False

    def changed(self, field: str, step: float) -> Servos:
        """Return the constants with one field of all joints changed, by a factor or a time."""
        value = getattr(self, field)
        return replace(
            self, **{field: value + step if field == "delay" else value * np.exp(step)}
        )

    def model(self, interval_s: float) -> mujoco.MjModel:
        """Return the arm with these servos."""
        model = copy.copy(TASK)
        model.opt.timestep = interval_s / SUBSTEPS
        model.dof_damping[:], model.dof_frictionloss[:], model.dof_armature[:] = (
            self.damping,
            self.dry,
            self.armature,
        )
        model.actuator_gainprm[:, 0], model.actuator_biasprm[:, 1] = self.kp, -self.kp
        model.actuator_biasprm[:, 2] = -self.kv
        model.actuator_forcerange[:] = np.stack([-self.limit, self.limit], axis=1)
        if self.light:
            model.body_mass[:] *= 0.01
            model.body_inertia[:] *= 0.01
            model.opt.gravity[:] *= 100.0
        if self.soft:
            model.dof_solref[:], model.dof_solimp[:, :3] = (
                (0.02, 1.0),
                (0.9, 0.95, 0.001),
            )
        # The softness of dry friction is scaled by the inertia that the model has here.
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return model


def commands(trial: Trial, delay: FloatArray) -> FloatArray:
    """Return the mean command of each step: a frame's command holds until the next one, shape [steps, 6]."""
    assert trial.commands is not None
    count, interval = len(trial.times_s), trial.interval_s
    edges = np.arange(count * SUBSTEPS + 1) * interval / SUBSTEPS
    grid = np.concatenate([[-10.0], np.arange(count + 1) * interval])
    columns = []
    for j in range(6):
        held = trial.commands[:, j]
        integral = np.concatenate([[-10.0 * held[0], 0.0], np.cumsum(held) * interval])
        columns.append(
            np.diff(np.interp(edges - delay[j], grid, integral)) * SUBSTEPS / interval
        )
    return np.stack(columns, axis=1)


def simulate(servos: list[Servos], trial: Trial) -> FloatArray:
    """Return the angles of the arm at the frames, one copy for each set of servos, shape [copies, T, 6]."""
    models = [one.model(trial.interval_s) for one in servos]
    start = np.concatenate([[0.0], trial.angles_rad[0], np.zeros(6)])
    control = np.stack([commands(trial, one.delay) for one in servos])
    states, _ = rollout(
        models, mujoco.MjData(models[0]), np.tile(start, (len(models), 1)), control
    )
    after = states[:, SUBSTEPS - 1 :: SUBSTEPS, 1:7]
    return np.concatenate(
        [np.tile(trial.angles_rad[:1], (len(models), 1, 1)), after[:, :-1]], axis=1
    )


def shared(servos: Servos) -> Servos:
    """Return the constants with the gain of the joints without load from the loaded ones."""
    mean = np.exp(np.log(servos.kp[LOADED]).mean())
    return replace(servos, kp=np.where(LOADED, servos.kp, mean))


def residuals(servos: list[Servos], fit: list[Trial]) -> FloatArray:
    """Return simulated minus recorded angles of all trials [rad], shape [copies, frames, 6]."""
    return np.concatenate(
        [simulate(servos, trial) - trial.angles_rad for trial in fit], axis=1
    )


def identify(guess: Servos, fit: list[Trial], rounds: int) -> tuple[Servos, FloatArray]:
    """Fit the servos; return them, and residuals there and after a step of each field, shape [1 + FIELDS, frames, 6].

    A change of one joint hardly moves the others, so that one simulation changes a constant of all six joints, and each
    joint keeps the step that improves it.
    """
    now, damping = shared(guess), np.full(6, 1e-2)
    rows = residuals(
        [now, *(now.changed(*one) for one in zip(FIELDS, STEPS, strict=True))], fit
    )
    for _ in range(rounds):
        jacobian = (rows[1:] - rows[0]) / STEPS[:, None, None]
        cost = np.square(rows[0]).sum(axis=0)
        tried = now
        moves = np.zeros((len(FIELDS), 6))
        for j in range(6):
            free = [k for k, field in enumerate(FIELDS) if field != "kp" or LOADED[j]]
            slope = jacobian[free, :, j]
            normal = slope @ slope.T
            moves[free, j] = -np.linalg.solve(
                normal + damping[j] * np.diag(np.diag(normal) + 1e-9),
                slope @ rows[0][:, j],
            )
        for k, field in enumerate(FIELDS):
            value = getattr(tried, field)
            if field == "delay":
                tried = replace(
                    tried,
                    delay=np.clip(value + np.clip(moves[k], -0.02, 0.02), 0.0, 0.2),
                )
            else:
                tried = replace(
                    tried, **{field: value * np.exp(np.clip(moves[k], -0.7, 0.7))}
                )
        tried = shared(tried)
        new = residuals(
            [tried, *(tried.changed(*one) for one in zip(FIELDS, STEPS, strict=True))],
            fit,
        )
        better = np.square(new[0]).sum(axis=0) < cost
        damping = np.where(better, damping / 4.0, damping * 6.0)
        now = replace(
            now,
            **{
                field: np.where(better, getattr(tried, field), getattr(now, field))
                for field in FIELDS
            },
        )
        rows = np.where(better, new, rows)
        print(
            1e3 * np.sqrt(np.square(rows[0]).mean(axis=0)).round(5), better, flush=True
        )
    return now, rows


def part(trial: Trial, first_s: float, last_s: float) -> Trial:
    """Return the frames of a motion between two times."""
    inside = slice(*np.searchsorted(trial.times_s, [first_s, last_s]))
    assert trial.commands is not None
    times = trial.times_s[inside] - trial.times_s[inside][0]
    return replace(
        trial,
        times_s=times,
        angles_rad=trial.angles_rad[inside],
        commands=trial.commands[inside],
    )


def intervals(servos: Servos, rows: FloatArray) -> dict[str, FloatArray]:
    """Return 95 % intervals of the fitted constants, shape [2, 6] each: blocks of frames are drawn, fits are linear."""
    rng = np.random.default_rng(0)
    slopes = (rows[1:] - rows[0]) / STEPS[:, None, None]
    count = rows.shape[1] // BLOCK_FRAMES
    cut = slice(0, count * BLOCK_FRAMES)
    found = {field: np.full((2, 6), np.nan) for field in FIELDS}
    for j in range(6):
        free = [k for k, field in enumerate(FIELDS) if field != "kp" or LOADED[j]]
        a = slopes[free, cut, j].reshape(len(free), count, BLOCK_FRAMES)
        normals = np.einsum("abf,cbf->bac", a, a)
        pulls = np.einsum("abf,bf->ba", a, rows[0, cut, j].reshape(count, BLOCK_FRAMES))
        moves = []
        for _ in range(COPIES):
            drawn = rng.integers(0, count, count)
            normal = normals[drawn].sum(axis=0)
            moves.append(
                -np.linalg.lstsq(
                    normal, (pulls[drawn] - pulls.mean(axis=0)).sum(axis=0), rcond=1e-10
                )[0]
            )
        low, high = np.percentile(moves, [2.5, 97.5], axis=0)
        for k, which in enumerate(free):
            field, value = FIELDS[which], getattr(servos, FIELDS[which])[j]
            ends = np.array([low[k], high[k]])
            found[field][:, j] = (
                value + ends
                if field == "delay"
                else value * np.exp(np.clip(ends, -7.0, 7.0))
            )
    return found


def same(value: float) -> FloatArray:
    """Return one value for all joints."""
    return np.full(6, value)


def circulating(
    kp: float, damping: float, dry: float, armature: float, kv: float = 0.0
) -> Servos:
    """Return constants of a file, with its torque limit of 3.35 N m and MuJoCo's default softness."""
    one = {
        "kp": kp,
        "damping": damping,
        "dry": dry,
        "armature": armature,
        "delay": 0.0,
        "limit": 3.35,
        "kv": kv,
    }
    return Servos(**{name: same(value) for name, value in one.items()}, soft=True)


GUESS = Servos(
    kp=np.array([12.5, 15.8, 11.55, 10.59, 12.5, 12.48]),
    damping=np.array([0.9214, 1.09, 0.4965, 0.6506, 0.6776, 1.05]),
    dry=np.array([0.1165, 0.325, 0.4724, 0.1546, 0.1162, 0.02622]),
    armature=np.array([0.00804, 0.0171, 0.001453, 0.005903, 0.0009122, 0.01939]),
    delay=np.array([0.01186, 0.01329, 0.0261, 0.01462, 0.02919, 0.006768]),
    limit=np.array([2.096, 3.124, 2.351, 1.82, 1.928, 1.124]),
    kv=same(0.0),
)
"""Where ten earlier rounds of the fit ended, from three guesses, with the same motions."""

IN_CIRCULATION = {
    "kp 998": circulating(998.22, 0.60, 0.052, 0.028, 2.731),
    "kp 17.8": circulating(17.8, 0.60, 0.052, 0.028),
    "kp 50": circulating(50.0, 1.0, 0.1, 0.005),
}


def rms_mrad(off: FloatArray) -> FloatArray:
    """Return the root mean square over frames [mrad], shape [..., 6]."""
    return 1e3 * np.sqrt(np.mean(np.square(off), axis=-2))


def link_inertia() -> FloatArray:
    """Return the inertia of the links about each joint in the pose of rest [kg m^2], shape [6]."""
    data, inertia = mujoco.MjData(TASK), np.zeros((6, 6))
    data.qpos[:] = (0.0, 0.0, 0.5, 0.0, 0.0, 0.5)
    mujoco.mj_forward(TASK, data)
    mujoco.mj_fullM(TASK, data, inertia)
    return np.diag(inertia).copy()


def variants(found: Servos) -> dict[str, Servos]:
    """Return the identified constants, those in circulation, and the identified ones with one thing changed."""
    return {
        "identified": found,
        **IN_CIRCULATION,
        "no dry friction": replace(found, dry=same(0.0)),
        "no delay": replace(found, delay=same(0.0)),
        "no torque limit": replace(found, limit=same(100.0)),
        "soft dry friction": replace(found, soft=True),
        "links without inertia": replace(found, light=True),
        "half the armature": replace(found, armature=0.5 * found.armature),
        "double armature": replace(found, armature=2.0 * found.armature),
    }


def load_rows(found: Servos, motions: list[Trial]) -> list[tuple[object, ...]]:
    """Return, per joint, what the load says of the servo's torque."""
    rows: list[tuple[object, ...]] = []
    for j, joint in enumerate(JOINTS):
        load, torque, moving, resting = [], [], [], []
        for trial in motions:
            assert trial.load is not None
            command = commands(trial, found.delay)[::SUBSTEPS, j]
            torque.append(
                np.abs(
                    np.clip(
                        found.kp[j] * (command - trial.angles_rad[:, j]),
                        -found.limit[j],
                        found.limit[j],
                    )
                )
            )
            load.append(trial.load[:, j])
            change = np.abs(np.gradient(trial.angles_rad[:, j], trial.interval_s))
            moving.append(change > 0.2)
            resting.append(np.convolve(change > 0.0, np.ones(25), mode="same") == 0.0)
        loads, torques, fast, still = (
            np.concatenate(one) for one in (load, torque, moving, resting)
        )
        held = still & (torques > 0.1)
        silent = float(np.mean(loads[held] == 0.0)) if held.any() else float("nan")
        correlation = float(np.corrcoef(loads[fast], torques[fast])[0, 1])
        rows.append(
            (joint, len(np.unique(loads)), correlation, float(np.mean(held)), silent)
        )
    return rows


def held_rows(found: Servos, motions: list[Trial]) -> list[tuple[object, ...]]:
    """Return, per loaded joint, what friction holds at rest over the fitted one, and what it sags by [mrad].

    Friction holds the weight less the servo's torque.
    """
    data = mujoco.MjData(TASK)
    shares: list[FloatArray] = []
    sags: list[FloatArray] = []
    for trial in motions:
        assert trial.commands is not None
        same = [
            (one[50:] == one[:-50]).all(axis=1)
            for one in (trial.angles_rad, trial.commands)
        ]
        for frame in (np.flatnonzero(same[0] & same[1]) + 50)[::50]:
            data.qpos[:] = trial.angles_rad[frame]
            mujoco.mj_forward(TASK, data)
            servo = found.kp * (trial.commands[frame] - trial.angles_rad[frame])
            sags.append(1e3 * np.abs(servo / found.kp))
            shares.append(np.abs(servo - data.qfrc_bias) / found.dry)
    middle, most, largest = np.percentile(shares, [50, 90, 100], axis=0)
    sag = np.percentile(sags, 90, axis=0)
    numbers = zip(
        JOINTS, zip(middle, most, largest, sag, strict=True), LOADED, strict=True
    )
    return [(joint, *map(float, values)) for joint, values, loaded in numbers if loaded]


def step_rows(motions: list[Trial]) -> list[tuple[object, ...]]:
    """Return, per motion and joint, the times in which the recorded joint covers half of a step [ms].

    A step is a change of the command by 0.15 rad or more in a frame, after twelve frames in which it stays; it ends
    with the next change.
    """
    rows: list[tuple[object, ...]] = []
    for trial, (j, joint) in product(motions, enumerate(JOINTS)):
        assert trial.commands is not None
        command, angle, times_ms = trial.commands[:, j], trial.angles_rad[:, j], []
        for k in np.flatnonzero(np.abs(np.diff(command)) > 0.15) + 1:
            if k < 12 or np.ptp(command[k - 12 : k]) > 0.02:
                continue
            still = np.abs(command[k : k + 40] - command[k]) < 0.02
            size = command[k] - command[k - 1]
            left = 0.5 * abs(size) - np.sign(size) * (
                angle[k : k + int(still.argmin() or 40)] - angle[k - 1]
            )
            if (left < 0.0).any() and left[0] > 0.0:
                over = int((left < 0.0).argmax())
                times_ms.append(
                    1e3
                    * trial.interval_s
                    * (over + left[over] / (left[over - 1] - left[over]))
                )
        if times_ms:
            rows.append(
                (
                    trial.name,
                    joint,
                    len(times_ms),
                    *map(float, np.percentile(times_ms, [0, 50, 100])),
                )
            )
    return rows


def picture(
    judged: dict[str, FloatArray], trial: Trial, sets: dict[str, Servos]
) -> None:
    """Draw errors per joint, and steps of three joints."""
    figure, axes = plt.subplots(
        1, 4, figsize=(14, 3.6), layout="constrained", width_ratios=(1.5, 1, 1, 1)
    )
    shown = ("identified", *IN_CIRCULATION)
    for k, name in enumerate(shown):
        axes[0].bar(np.arange(6) + 0.2 * (k - 1.5), judged[name], 0.2, label=name)
    axes[0].set_xticks(np.arange(6), JOINTS, rotation=30)
    axes[0].set(ylabel="error on judged motions [mrad rms]")
    axes[0].legend()
    steps = part(trial, 14.0, 18.5)
    angles = simulate(
        [sets[name] for name in shown], replace(steps, angles_rad=steps.angles_rad)
    )
    assert steps.commands is not None
    for axis, j in zip(axes[1:], (1, 2, 5), strict=True):
        axis.plot(steps.times_s, steps.commands[:, j], color="0.7", label="command")
        axis.plot(
            steps.times_s, steps.angles_rad[:, j], "k.", markersize=3, label="recorded"
        )
        for k in range(len(shown)):
            axis.plot(steps.times_s, angles[k, :, j], color=f"C{k}", linewidth=1)
        axis.set(xlabel="time [s]", title=JOINTS[j])
    axes[1].set_ylabel("angle [rad]")
    axes[1].legend()
    figure.savefig(HERE / "so101.png", dpi=100)


def main() -> None:
    """Identify, judge and write the tables."""
    motions = trials("ServoArm-so101")
    fit = [part(motions[0], 0.0, CHIRP_S), *motions[2::2]]
    found, rows = identify(GUESS, fit, ROUNDS)
    ends = intervals(found, rows)
    constants = [
        (
            joint,
            field,
            *(float(one) for one in (getattr(found, field)[j], *ends[field][:, j])),
        )
        for j, joint in enumerate(JOINTS)
        for field in FIELDS
    ]
    write(
        "so101_constants.csv", ("joint", "constant", "value", "low", "high"), constants
    )
    inertia = zip(
        JOINTS, map(float, link_inertia()), map(float, found.armature), strict=True
    )
    write("so101_inertia.csv", ("joint", "links_kg_m2", "armature_kg_m2"), inertia)
    sets = variants(found)
    table, squares, count = [], np.zeros((len(sets), 6)), 0
    for k, trial in enumerate(motions):
        off = simulate(list(sets.values()), trial) - trial.angles_rad
        split = (
            int(np.searchsorted(trial.times_s, CHIRP_S))
            if k == 0
            else len(trial.times_s)
        )
        for name, cut in (
            (trial.name, slice(0, split)),
            (f"{trial.name} from {CHIRP_S:g} s", slice(split, None)),
        ):
            if cut.start == len(trial.times_s):
                continue
            half = "judge" if k % 2 or cut.start else "fit"
            for title, errors in zip(sets, rms_mrad(off[:, cut]), strict=True):
                if title in ("identified", *IN_CIRCULATION):
                    table.append((name, half, title, *map(float, errors)))
            if half == "judge" and k:
                squares += np.square(off[:, cut]).sum(axis=1)
                count += off[:, cut].shape[1]
    judged = dict(zip(sets, 1e3 * np.sqrt(squares / count), strict=True))
    write("so101_errors.csv", ("motion", "half", "constants", *JOINTS), table)
    write(
        "so101_judged.csv",
        ("constants", *JOINTS),
        [(name, *map(float, errors)) for name, errors in judged.items()],
    )
    loads = (
        "joint",
        "levels",
        "correlation_with_torque",
        "share_of_frames_held",
        "share_of_these_without_load",
    )
    write("so101_load.csv", loads, load_rows(found, motions))
    write(
        "so101_held.csv",
        ("joint", "median", "percentile_90", "largest", "sag_percentile_90_mrad"),
        held_rows(found, motions),
    )
    write(
        "so101_steps.csv",
        ("motion", "joint", "steps", "least_ms", "median_ms", "most_ms"),
        step_rows(motions),
    )
    picture(judged, motions[4], sets)


if __name__ == "__main__":
    main()
