"""Backlash in logs: what M1 leaves of it, and what the law with a play finds: backlash.csv.

    python -m studies.joints.backlash leg
    python -m studies.joints.backlash tilt

Two robots of `robots`, whose rotor turns the link at two stops. The encoder is at the link or at the rotor. Each of two
files is fitted and predicts the other, from its recorded start. The armature is known.
"""

import csv
import sys
from collections.abc import Iterator

import mujoco
import numpy as np

from gauge_envs.backends import backend
from gauge_envs.tools.identify import Log, identify
from studies.joints.pendulums import HERE
from studies.joints.robots import COUNT, NOISE_RAD, ROBOTS, SAMPLE_S, STEP_S, XML

PLAYS_DEG = (0.25, 0.5, 1.0, 2.0)
PLAY = (
    '<joint name="play" axis="{axis}" limited="true" range="{low} {high}" solimplimit="0.99 0.999 0.0001" '
    'solreflimit="0.001 1"/><inertial'
)
HEADER = "robot encoder backlash_deg M1_mrad with_play_mrad chosen found_deg lag_mrad noise_mrad"


def logged(robot: str, play_deg: float, at_rotor: bool, seed: int) -> Log:
    """Return a noisy log of random steps."""
    axis, pos, mass, inertia, (dry, kp, kv, delay_s, armature), reach_rad = ROBOTS[robot]  # fmt: skip
    half = np.radians(0.5 * play_deg)
    servo = f'<actuator><position joint="j" kp="{kp}" kv="{kv}"/></actuator>'
    place = {"axis": axis, "pos": pos, "mass": mass, "inertia": inertia}
    xml = XML.format(step=STEP_S, armature=armature, dry=dry, rest=servo, **place)
    if play_deg:
        play = PLAY.format(axis=axis, low=-half, high=half)
        xml = xml.replace("<inertial", play).replace("<mujoco>", '<mujoco><compiler angle="radian"/>')  # fmt: skip
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    random = np.random.default_rng(seed)
    command = np.repeat(random.uniform(-reach_rad, reach_rad, COUNT // 20), 20)
    command[:20] = 0.0
    late = round(delay_s / STEP_S)
    per_sample = round(SAMPLE_S / STEP_S)
    angles = []
    for step in range(-4000, COUNT * per_sample):
        if step >= 0 and step % per_sample == 0:
            angles.append(data.qpos[0] if at_rotor else data.qpos.sum())
        data.ctrl[0] = command[max(step - late, 0) // per_sample]
        mujoco.mj_step(model, data)
    measured = np.array(angles) + NOISE_RAD * random.standard_normal(COUNT)
    times_s = SAMPLE_S * np.arange(COUNT)
    return Log(str(seed), times_s, measured[:, None], command[:, None], joints=("j",))


def rows(robot: str) -> Iterator[tuple[object, ...]]:
    """Yield what is left of each encoder and play of a robot."""
    axis, pos, mass, inertia, numbers, _ = ROBOTS[robot]
    place = {"axis": axis, "pos": pos, "mass": mass, "inertia": inertia}
    xml = XML.format(step=0.002, armature=numbers[4], dry=0.0, rest="", **place)
    known = {"armature_kg_m2": numbers[4]}
    for encoder, plays_deg in (("link", (0.0, *PLAYS_DEG)), ("rotor", PLAYS_DEG[1:])):
        for play_deg in plays_deg:
            logs = [logged(robot, play_deg, encoder == "rotor", seed) for seed in (1, 2)]  # fmt: skip
            spec = mujoco.MjSpec.from_string(xml)
            found = identify(backend("mujoco"), spec, logs, ["M1", "backlash"], known=known)  # fmt: skip
            errors = {one.name: one.held_out_rad for one in found.laws}
            values = {one.name: one.value for one in found.settings}
            yield (
                robot, encoder, play_deg, f"{1e3 * errors['M1']:.2g}", f"{1e3 * errors['backlash']:.2g}",
                found.laws[0].name, f"{np.degrees(values.get('backlash_rad', 0.0)):.3g}",
                f"{1e3 * found.plain_rad['2']['lag'][0]:.3g}", f"{1e3 * NOISE_RAD:.2g}",
            )  # fmt: skip


if __name__ == "__main__":
    file = HERE / "backlash.csv"
    before: list[list[str]] = []
    if file.is_file():
        before = list(csv.reader(file.read_text(encoding="utf-8").splitlines()))[1:]
    with file.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(HEADER.split())
        writer.writerows(row for row in before if row[0] != sys.argv[1])
        for row in rows(sys.argv[1]):
            writer.writerow(row)
            stream.flush()
