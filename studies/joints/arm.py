"""SO-101 by `gauge recipe joint`, with the armature of a bench, and one kp of the joints that no weight turns.

    python -m studies.joints.arm

Writes arm_constants.csv, arm_errors.csv, and arm_payload.csv: a step with a load, also with the armature that is fitted
(so101_constants.csv).
"""

import csv
import time
from collections.abc import Iterable, Mapping, Sequence

import mujoco
import numpy as np

from gauge_envs.backends import backend
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.identify import Identified, Log, identify, read_mjcf
from gauge_envs.tools.identify.model_files import joints_of_model
from gauge_envs.tools.identify.snippets import snippet_lines
from studies.joints.recordings import HERE, trials

JOINTS = ("Rotation", "Pitch", "Elbow", "Wrist_Pitch", "Wrist_Roll", "Jaw")
NAMES = {
    "kp": "kp_n_m_per_rad",
    "damping": "viscous_friction_n_m_s_per_rad",
    "dry": "dry_friction_n_m",
    "armature": "armature_kg_m2",
    "limit": "torque_limit_n_m",
    "delay": "delay_s",
}
BENCH_KG_M2 = 0.0236
"""Mean of six laws of one servo on a bench (Rhoban/bam, commit 31e5b97, params/feetech_sts3215_7_4V)."""
KP_N_M_PER_RAD = 12.7
"""Mean of the joints that carry weight (arm_constants.csv). The others tell ratios of torques alone."""
WEIGHTLESS = ("Rotation", "Wrist_Roll", "Jaw")
SWEEP_S = 100.0
"""The sweep is used up to here: beyond, the jaw loses cycles."""
STEP_S = 0.005
PAYLOAD_KG, LOAD_RADIUS_M, STEP_RAD = 0.3, 0.02, 0.3
Constants = Sequence[Mapping[str, float]]
"""Numbers of each joint by their names."""


def logs() -> list[Log]:
    """Return the eight motions; even ones are fitted."""
    found = []
    for one in trials("ServoArm-so101"):
        assert one.commands is not None
        used = one.times_s < (SWEEP_S if one.name == "chirp_sweep" else np.inf)
        found.append(
            Log(
                one.name,
                one.times_s[used],
                one.angles_rad[used],
                one.commands[used],
                joints=JOINTS,
            )
        )
    return found


def fitted() -> Identified:
    """Fit even motions and predict odd ones from their recorded starts."""
    motions = logs()
    known = {NAMES["armature"]: BENCH_KG_M2}
    known |= {f"{joint}.{NAMES['kp']}": KP_N_M_PER_RAD for joint in WEIGHTLESS}
    return identify(
        backend("mujoco"),
        read_mjcf(HERE / "so101.xml"),
        motions[::2],
        [one for one in NAMES.values() if one not in known],
        known=known,
        held_out=motions[1::2],
        settings={"timestep_s": STEP_S},
    )


def stored() -> Constants:
    """Return the constants whose armature is fitted."""
    found: list[dict[str, float]] = [{} for _ in JOINTS]
    with (HERE / "so101_constants.csv").open(encoding="utf-8", newline="") as stream:
        for row in csv.DictReader(stream):
            joint = JOINTS.index(row["joint"])
            found[joint][NAMES[row["constant"]]] = float(row["value"])
    return found


def constants(found: Identified) -> Iterable[Sequence[object]]:
    """Yield the rows of the constants: value, interval of the next file, and what is pasted."""
    yield ("joint", "constant", "value", "next_low", "next_high", "pasted", "not_determined")  # fmt: skip
    for row in found.settings:
        ends = (row.value, row.next_low, row.next_high, row.pasted)
        numbers = ("" if value is None else f"{value:.4g}" for value in ends)
        yield (row.joint_name, row.name, *numbers, row.unknown)


def errors(found: Identified) -> Iterable[Sequence[object]]:
    """Yield the errors over all samples of the odd motions [mrad], beside those without a model."""
    held_out = logs()[1::2]
    counts = [len(log.times_s) for log in held_out]

    def pooled(by_log: Sequence[FloatArray]) -> list[str]:
        squares = np.average(np.square(by_log), axis=0, weights=counts)
        return [f"{1e3 * value:.4g}" for value in np.sqrt(squares)]

    yield ("constants", *JOINTS)
    yield ("bench armature", *pooled([found.held_out_rad[log.name] for log in held_out]))  # fmt: skip
    by_log = replayed(stored(), held_out)
    yield ("fitted armature", *pooled([by_log[log.name] for log in held_out]))
    for law in ("command", "lag"):
        yield (law, *pooled([found.plain_rad[log.name][law] for log in held_out]))
    yield ("constant", *pooled([log.position_rad.std(axis=0) for log in held_out]))


def pasted() -> Constants:
    """Return the constants that are pasted, with the armature of the bench."""
    found: list[dict[str, float]] = [{} for _ in JOINTS]
    with (HERE / "arm_constants.csv").open(encoding="utf-8", newline="") as stream:
        for row in csv.DictReader(stream):
            joint = JOINTS.index(row["joint"])
            found[joint][row["constant"]] = float(row["pasted"] or 0.0)
    return found


def replayed(constants: Constants, recorded: Sequence[Log]) -> dict[str, FloatArray]:
    """Return the errors of constants as `identify` has them: of pasted lines, from the recorded starts [rad]."""
    spec = read_mjcf(HERE / "so101.xml")
    machine = joints_of_model(spec, recorded[0], {"timestep_s": STEP_S})
    values = [
        {**stated, **given}
        for stated, given in zip(machine.stated, constants, strict=True)
    ]
    nothing: list[dict[str, str]] = [{} for _ in JOINTS]
    lines = snippet_lines(
        "mujoco",
        names=JOINTS,
        joints=values,
        left_out=nothing,
        marked=nothing,
        timestep_s=STEP_S,
    )
    return machine.replayed(lines, values, recorded)


def payload(sets: Mapping[str, Constants]) -> Iterable[Sequence[object]]:
    """Yield what a step of each joint does, without and with a load in the gripper."""
    yield ("armature", "joint", "payload_kg", "ms_to_63_percent", "overshoot_mrad", "off_at_the_end_mrad")  # fmt: skip
    for title, numbers in sets.items():
        for joint in JOINTS:
            for load_kg in (0.0, PAYLOAD_KG):
                yield (title, joint, load_kg, *_step(numbers, joint, load_kg))


def _step(constants: Constants, moved: str, load_kg: float) -> list[str]:
    """Return the time to 63 % of a step [ms], the overshoot and the distance from the command at the end [mrad]."""
    spec = mujoco.MjSpec.from_file(str(HERE / "so101.xml"))
    spec.option.timestep = 0.001
    for motor in list(spec.actuators):
        spec.delete(motor)
    for name, numbers in zip(JOINTS, constants, strict=True):
        joint = spec.joint(name)
        joint.damping[0] = numbers[NAMES["damping"]]
        joint.frictionloss = numbers[NAMES["dry"]]
        joint.armature = numbers[NAMES["armature"]]
        motor = spec.add_actuator(
            name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT
        )
        motor.set_to_position(kp=numbers[NAMES["kp"]])
        if limit := numbers[NAMES["limit"]]:
            motor.forcelimited, motor.forcerange = 1, [-limit, limit]
    if load_kg:
        load = spec.body("gripper").add_body(pos=[0.0, 0.0, -0.08])
        load.mass, load.explicitinertial = load_kg, 1
        load.inertia = [0.4 * load_kg * LOAD_RADIUS_M**2] * 3
    model = spec.compile()
    data = mujoco.MjData(model)
    place = JOINTS.index(moved)
    mujoco.mj_step(model, data, nstep=2000)
    start = data.qpos[place]
    data.ctrl[place] = STEP_RAD
    angles = []
    for _ in range(2000):
        mujoco.mj_step(model, data)
        angles.append(float(data.qpos[place]))
    moved_rad = np.array(angles) - start
    end = float(moved_rad[-1])
    reached_s = 0.001 * float(np.argmax(moved_rad > 0.632 * end))
    reached_s += constants[place][NAMES["delay"]]
    overshoot = float(moved_rad.max() - end)
    off = abs(STEP_RAD - angles[-1])
    return [f"{1e3 * reached_s:.0f}", f"{1e3 * overshoot:.1f}", f"{1e3 * off:.0f}"]


def write(found: Identified) -> None:
    """Write the tables."""
    tables = {
        "arm_constants.csv": constants(found),
        "arm_errors.csv": errors(found),
        "arm_payload.csv": payload({"bench": found.joints, "fitted": stored()}),
    }
    for name, table in tables.items():
        with (HERE / name).open("w", encoding="utf-8", newline="") as stream:
            csv.writer(stream, lineterminator="\n").writerows(table)


if __name__ == "__main__":
    start_s = time.process_time()
    write(fitted())
    print(f"{time.process_time() - start_s:.0f} CPU s")
