"""Real tosses of two hinged blocks on every engine: errors and their floor, and what the real hinge does in impacts.

    python elbow_toss.py run ENGINE OUT [--preset NAME] [--half judge] [--every 1] [--set KEY=VALUE ...]
    python elbow_toss.py floor ENGINE OUT       error between two starts within the measurement
    python elbow_toss.py pair ENGINE OTHER OUT  differences of two engines with equal starts
    python elbow_toss.py hinge OUT              angular impulse that the real hinge passes on in impacts
    python elbow_toss.py flights OUT            inertia and damping of the hinge, from flights after impacts
    python elbow_toss.py report OUT             the table of the study
    python elbow_toss.py picture OUT            elbow_toss.png: a record above MuJoCo

All but the last two write a JSON file into the folder OUT. Odd tosses judge; constants are fitted on even ones.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from toss_errors import angle_error, bootstrap_interval, shot_error
from tosses import (
    Run,
    Toss,
    add_run_options,
    median,
    quartiles,
    recorded_tosses,
    simulated_tosses,
    write,
)

from gauge_envs.evaluation.reference import reference_band
from gauge_envs.evaluation.reference_path import reference_path
from gauge_envs.experiments.resolve import load_experiment, with_trial
from gauge_envs.references.single_shot import SingleShot, SingleShots
from gauge_envs.scene.meshes import body_mass_properties
from gauge_envs.scene.scene import GRAVITY_M_PER_S2

NAME = "ElbowToss-blocks"
UNIT_MM = 50.0
"""Position error that counts as much as one radian in the loss of a fit: half the length of a block."""

WORLDS = 20
"""Tosses that are built at once."""

FloatArray = NDArray[np.float64]


def shots() -> SingleShots:
    """Return the recorded tosses."""
    return recorded_tosses(NAME)


def tosses(
    engine: str,
    trials: Sequence[int],
    *,
    settings: Mapping[str, Any] | None = None,
    constants: Mapping[str, float] | None = None,
    floor: bool = False,
) -> Iterator[Toss]:
    """Yield simulated tosses; `constants`, as `friction`, replace those of both blocks."""
    changed = {
        f"{body}.{key}": value
        for body in shots().sidecar.bodies
        for key, value in (constants or {}).items()
    }
    yield from simulated_tosses(
        NAME,
        engine,
        trials,
        settings=settings or {},
        constants=changed,
        floor=floor,
        worlds_at_once=WORLDS,
    )


def row_of(one: Toss, recorded: Sequence[SingleShot]) -> dict[str, Any]:
    """Return the errors of one simulated toss against the records of its bodies: of each body, means, and the hinge."""
    trial, times_s, states = one
    rotations = [
        Rotation.from_quat(states[:, place, 3:7], scalar_first=True)
        for place in range(len(recorded))
    ]
    bodies = [
        asdict(shot_error(shot, times_s, states[:, place, :3], rotations[place]))
        for place, shot in enumerate(recorded)
    ]
    angle = asdict(
        angle_error((recorded[0], recorded[1]), times_s, (rotations[0], rotations[1]))
    )
    mean = {
        key: float(np.mean([body[key] for body in bodies]))
        for key in bodies[0]
        if key != "trial"
    }
    return (
        {"trial": trial}
        | mean
        | {f"hinge_{key}": angle[key] for key in ("early_deg", "mean_deg", "rest_deg")}
    )


def records(trial: int) -> list[SingleShot]:
    """Return the record of each body."""
    return [shots().shot(trial, body) for body in shots().sidecar.bodies]


def run(options: argparse.Namespace) -> None:
    """Write the errors of an engine."""
    wanted = Run(
        options, shots(), lambda key: key in ("friction", "restitution", "mass_kg")
    )
    some = tosses(
        options.engine,
        wanted.trials,
        settings=wanted.settings,
        constants=wanted.constants,
    )
    found = [row_of(one, records(one[0])) for one in some]
    wanted.write(found)
    losses = [
        row["mean_mm"] / UNIT_MM + float(np.radians(row["mean_deg"])) for row in found
    ]
    print(
        wanted.name,
        len(found),
        {key: median(found, key) for key in KEYS},
        f"loss {np.mean(losses):.2f}",
        flush=True,
    )


def floor(options: argparse.Namespace) -> None:
    """Write the errors between a toss and one with a start within the measurement."""
    trials = shots().trials("judge", every=options.every)
    plain = {trial: states for trial, _, states in tosses(options.engine, trials)}
    found = [
        row_of(one, _as_records(one, plain[one[0]]))
        for one in tosses(options.engine, trials, floor=True)
    ]
    write(
        options.out,
        f"floor-{options.engine}",
        {"engine": options.engine, "preset": "floor", "rows": found},
    )
    print("floor", len(found), {key: median(found, key) for key in KEYS})


def pair(options: argparse.Namespace) -> None:
    """Write the differences between two engines, as if the second one were a record."""
    trials = shots().trials("judge", every=options.every)
    other = {trial: states for trial, _, states in tosses(options.other, trials)}
    found = [
        row_of(one, _as_records(one, other[one[0]]))
        for one in tosses(options.engine, trials)
    ]
    head = {"engine": f"{options.engine} from {options.other}", "preset": "default"}
    write(options.out, f"pair-{options.engine}-{options.other}", head | {"rows": found})
    print("pair", len(found), {key: median(found, key) for key in KEYS})


def _as_records(one: Toss, states: FloatArray) -> list[SingleShot]:
    """Return simulated states of the bodies as if they were the records of a toss."""
    return [
        replace(
            shot,
            times_s=one[1],
            positions_m=of_body[:, :3],
            quaternions=of_body[:, 3:7],
        )
        for shot, of_body in zip(records(one[0]), states.swapaxes(0, 1), strict=True)
    ]


KEYS = (
    "early_mm",
    "early_deg",
    "hinge_early_deg",
    "rest_mm",
    "rest_deg",
    "hinge_rest_deg",
    "same_face",
)


# --- impacts of the recorded tosses ----------------------------------------------------------------------------------

NEAR_M = 0.010
"""Height of a corner below which the blocks may touch the table."""

APART_M = 0.008
"""Height of the second lowest corner above the lowest one, from which on an impact is that of one corner."""

LONGEST_IMPACT, SHORTEST_FLIGHT, LONGEST_FLIGHT = 6, 6, 20
"""Frames near the table in an impact, and frames of the flights before and after it that are fitted."""

MOST_COST = 6.0
"""Largest mean robust loss of a fitted flight, in units of its noise; flights with contacts exceed it."""

NOISE_M, NOISE_RAD = 2e-4, 5e-3


def flying(
    *, inertia_kg_m2: float | None = None, damping_n_m_s: float = 0.0
) -> mujoco.MjModel:
    """Return both blocks with their hinge and no contacts, four steps a frame.

    Args:
        inertia_kg_m2: Moment of inertia about all axes; None for those of the task.
        damping_n_m_s: Torque over rate of the hinge.
    """
    scene = load_experiment(NAME).scene
    hung = shots().sidecar.hung[0]
    bodies = [
        replace(scene.body(name), inertia_kg_m2=inertia_kg_m2)
        for name in (hung.on, hung.body)
    ]
    first, second = (body_mass_properties(body)[1].diagonal() for body in bodies)
    mass_kg = scene.body(hung.on).mass_kg
    texts = [
        " ".join(map(str, one))
        for one in (
            first,
            hung.anchor_on_m,
            hung.axis,
            np.negative(hung.anchor_m),
            second,
        )
    ]
    return mujoco.MjModel.from_xml_string(f"""
        <mujoco>
          <option gravity="0 0 {-GRAVITY_M_PER_S2}" timestep="{0.25 / shots().sidecar.rate_hz}" integrator="RK4"/>
          <worldbody>
            <body><freejoint/><inertial pos="0 0 0" mass="{mass_kg}" diaginertia="{texts[0]}"/>
              <body pos="{texts[1]}"><joint axis="{texts[2]}" damping="{damping_n_m_s}"/>
                <inertial pos="{texts[3]}" mass="{mass_kg}" diaginertia="{texts[4]}"/></body>
            </body>
          </worldbody>
        </mujoco>""")


def fitted(
    model: mujoco.MjModel, recorded: Sequence[SingleShot], rows: slice, at: int
) -> tuple[Any, float]:
    """Return MuJoCo's state, at one frame, of the free motion that passes closest to some frames, and its mean loss."""
    data, rate = mujoco.MjData(model), shots().sidecar.rate_hz
    places, rotations = recorded[0].positions_m[rows], recorded[0].rotations[rows]
    axis = np.asarray(shots().sidecar.hung[0].axis)
    angles = np.unwrap(
        (rotations.inv() * recorded[1].rotations[rows]).as_rotvec() @ axis
    )
    count = len(places)

    def start(values: FloatArray) -> None:
        mujoco.mj_resetData(model, data)
        data.qpos[:3] = places[0] + values[:3]
        data.qpos[3:7] = (rotations[0] * Rotation.from_rotvec(values[3:6])).as_quat(
            scalar_first=True
        )
        data.qpos[7], data.qvel[:] = angles[0] + values[6], values[7:]

    def residuals(values: FloatArray) -> FloatArray:
        start(values)
        states = np.empty((count, 8))
        for state in states:
            state[:] = data.qpos
            mujoco.mj_step(model, data, 4)
        turned = (
            rotations.inv() * Rotation.from_quat(states[:, 3:7], scalar_first=True)
        ).as_rotvec()
        apart = [
            (states[:, :3] - places) / NOISE_M,
            turned / NOISE_RAD,
            (states[:, 7:] - angles[:, None]) / NOISE_RAD,
        ]
        return np.concatenate(apart, axis=1).ravel()

    few = min(6, count)
    times_s = np.arange(few) / rate
    straight = places[:few] + 0.5 * GRAVITY_M_PER_S2 * np.outer(
        times_s**2, [0.0, 0.0, 1.0]
    )
    turned = (rotations[0].inv() * rotations[:few]).as_rotvec()
    guess = [
        np.polyfit(times_s, one, 1)[0] for one in (straight, turned, angles[:few, None])
    ]
    scales = np.concatenate(
        [np.full(3, 1e-3), np.full(4, 1e-2), np.full(3, 0.1), np.full(4, 0.3)]
    )
    found = least_squares(
        residuals,
        np.concatenate([np.zeros(7), *guess]),
        x_scale=scales,
        loss="soft_l1",
        max_nfev=15,
    )
    start(found.x)
    steps = 4 * (at - rows.start)
    # Time runs backwards with negative velocities.
    data.qvel[:] *= 1.0 if steps >= 0 else -1.0
    if steps:
        mujoco.mj_step(model, data, nstep=abs(steps))
    data.qvel[:] *= 1.0 if steps >= 0 else -1.0
    mujoco.mj_forward(model, data)
    return data, 2.0 * found.cost / (7 * count)


def states_of(
    model: mujoco.MjModel, data: Any
) -> list[tuple[FloatArray, FloatArray, FloatArray, FloatArray]]:
    """Return centre [m], velocity of the centre [m/s], angular velocity [rad/s] and rotation matrix of both blocks."""
    found = []
    for place in (1, 2):
        velocity = np.zeros(6)
        mujoco.mj_objectVelocity(
            model, data, mujoco.mjtObj.mjOBJ_BODY, place, velocity, 0
        )
        found.append(
            (
                data.xipos[place].copy(),
                velocity[3:],
                velocity[:3],
                data.xmat[place].reshape(3, 3).copy(),
            )
        )
    return found


def impact_of(model: mujoco.MjModel, trial: int) -> dict[str, float] | None:
    """Return what happens in the first impact of a recorded toss, if one corner alone strikes."""
    recorded = records(trial)
    corners_m = load_experiment(NAME).scene.body(shots().sidecar.body).shape.corners_m
    heights_m = np.array(
        [
            (
                shot.positions_m[:, None]
                + np.einsum("tij,vj->tvi", shot.rotations.as_matrix(), corners_m)
            )[:, :, 2].T
            for shot in recorded
        ]
    )
    free = heights_m.min(axis=(0, 1)) > NEAR_M
    begin = int(np.argmax(~free))
    end = begin + int(np.argmax(free[begin:]))
    later = end + int(np.argmax(~free[end:])) if not free[end:].all() else len(free)
    if (
        begin < SHORTEST_FLIGHT
        or not 0 < end - begin <= LONGEST_IMPACT
        or later - end < SHORTEST_FLIGHT
    ):
        return None
    at = begin + int(np.argmin(heights_m.min(axis=(0, 1))[begin:end]))
    order = np.sort(heights_m[:, :, at].ravel())
    if order[1] - order[0] < APART_M:
        return None
    hit, corner = np.unravel_index(np.argmin(heights_m[:, :, at]), heights_m.shape[:2])
    before, first_cost = fitted(
        model, recorded, slice(max(0, begin - LONGEST_FLIGHT), begin), at
    )
    after, second_cost = fitted(
        model, recorded, slice(end, min(later, end + LONGEST_FLIGHT)), at
    )
    if max(first_cost, second_cost) > MOST_COST:
        return None
    old, new = states_of(model, before), states_of(model, after)
    mass_kg = float(model.body_mass[1])
    impulse: FloatArray = mass_kg * (new[0][1] + new[1][1] - old[0][1] - old[1][1])
    struck = [
        one[hit][1] + np.cross(one[hit][2], one[hit][3] @ corners_m[corner])
        for one in (old, new)
    ]
    # The block that is not struck turns about the axis by the hinge alone: its angular momentum about a point of the
    # axis changes by what the hinge passes on about its own axis.
    other, hung = 1 - int(hit), shots().sidecar.hung[0]
    axis = old[0][3] @ np.asarray(hung.axis)
    anchor_m = old[0][0] + old[0][3] @ np.asarray(hung.anchor_on_m)
    (place, early, spin, turn), (_, late, later_spin, _) = old[other], new[other]
    gained = (
        turn @ np.diag(model.body_inertia[other + 1]) @ turn.T @ (later_spin - spin)
    )
    gained = gained + mass_kg * np.cross(place - anchor_m, late - early)
    relative = float((new[other][2] - new[int(hit)][2]) @ axis)
    return {
        "trial": trial,
        "restitution": float(-struck[1][2] / struck[0][2]),
        "friction": float(np.hypot(*impulse[:2]) / impulse[2]),
        "impulse_n_s": float(impulse[2]),
        "relative_rate_rad_per_s": abs(relative),
        "hinge_against_n_m_s": -float(gained @ axis) * float(np.sign(relative)),
    }


def hinge(options: argparse.Namespace) -> None:
    """Write what happens in the first impacts of the recorded tosses."""
    model = flying()
    found = [
        one
        for trial in shots().trials()
        if (one := impact_of(model, trial)) is not None
    ]
    write(options.out, "hinge", {"rows": found})
    print(len(found), "impacts of one corner between two flights")
    for key in (
        "restitution",
        "friction",
        "impulse_n_s",
        "relative_rate_rad_per_s",
        "hinge_against_n_m_s",
    ):
        values = [one[key] for one in found]
        low, high = bootstrap_interval(values)
        print(
            f"{key}: median {np.median(values):.4g} [{low:.4g}, {high:.4g}], quartiles",
            end=" ",
        )
        print(np.percentile(values, [25, 75]).round(4).tolist())


LEAST_RATE_RAD_PER_S, LEAST_FRAMES = 2.5, 9
"""Mean rate of the hinge, and number of frames, from which on a flight after an impact is fitted."""


def later_flights(trial: int) -> Iterator[slice]:
    """Yield the frames of the flights after the first impact in which the hinge turns."""
    recorded = records(trial)
    corners_m = load_experiment(NAME).scene.body(shots().sidecar.body).shape.corners_m
    lowest_m = np.min(
        [
            (s.positions_m[:, None] + _turned(s, corners_m))[:, :, 2].min(axis=1)
            for s in recorded
        ],
        axis=0,
    )
    free = lowest_m > NEAR_M
    angles = np.unwrap(
        (recorded[0].rotations.inv() * recorded[1].rotations).as_rotvec()
        @ shots().sidecar.hung[0].axis
    )
    edges = np.flatnonzero(np.diff(free.astype(int))) + 1
    for begin, end in zip(edges, [*edges[1:], len(free)], strict=True):
        # Frames beside a contact may contain some of it.
        rows = slice(begin + 2, min(end - 1, begin + 26))
        if not free[begin] or rows.stop - rows.start < LEAST_FRAMES:
            continue
        seconds = (rows.stop - 1 - rows.start) / shots().sidecar.rate_hz
        if (
            abs(angles[rows.stop - 1] - angles[rows.start])
            > LEAST_RATE_RAD_PER_S * seconds
        ):
            yield rows


def _turned(shot: SingleShot, points_m: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("tij,vj->tvi", shot.rotations.as_matrix(), points_m))


def flights(options: argparse.Namespace) -> None:
    """Write how well free motion with some inertias and dampings passes through flights after impacts, even tosses."""
    chosen = [
        (records(trial), rows)
        for trial in shots().trials("fit")
        for rows in later_flights(trial)
    ]
    models = {
        "uniform blocks": flying(),
        "stated inertia": flying(inertia_kg_m2=STATED_INERTIA_KG_M2),
        "uniform blocks, damping 0.001 N m s": flying(damping_n_m_s=1e-3),
    }
    losses = {
        name: [fitted(model, one, rows, rows.start)[1] for one, rows in chosen]
        for name, model in models.items()
    }
    write(options.out, "flights", losses)
    best = np.array(losses["uniform blocks"])
    for name, values in losses.items():
        low, high = bootstrap_interval(values)
        better = float(np.mean(best < np.array(values)))
        print(
            f"{name}: {len(values)} flights, median loss {np.median(values):.2f} [{low:.2f}, {high:.2f}]",
            end=", ",
        )
        print(f"uniform without damping is closer in {100 * better:.0f} %")


STATED_INERTIA_KG_M2 = 6.167e-4
"""Moment of inertia about all axes in the authors' URDF."""


def report(options: argparse.Namespace) -> None:
    """Print the table of the page."""
    print(
        "| engine | preset | tosses | 0.3 s, mm | 0.3 s, degrees | hinge, degrees | 0.8 s, mm | 0.8 s, degrees "
        "| hinge, degrees | same face up |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    for file in [
        one
        for kind in ("run", "pair", "floor")
        for one in sorted(options.out.glob(f"{kind}-*.json"))
    ]:
        content = json.loads(file.read_text())
        found = content["rows"]
        label = content["preset"] + "".join(
            f", {key} {value}" for key, value in content.get("changes", {}).items()
        )
        cells = [
            content["engine"],
            label,
            str(len(found)),
            *(quartiles(found, key) for key in KEYS[:-1]),
        ]
        same = 100 * float(np.mean([row["same_face"] for row in found]))
        print(f"| {' | '.join(cells)} | {same:.0f} % |")


SHOWN_TRIAL, SHOWN_S = 9, (0.0, 0.1, 0.2, 0.3)


def picture(options: argparse.Namespace) -> None:
    """Draw one toss as recorded, above the same toss in MuJoCo."""
    from gauge_envs.rendering.camera import experiment_view
    from gauge_envs.rendering.renderer import SceneRenderer
    from gauge_envs.tools.film import Caption, PanelText, save_still, strip_picture

    experiment = with_trial(load_experiment(NAME), SHOWN_TRIAL)
    view = experiment_view(
        experiment, reference=reference_path(experiment, reference_band(experiment))
    )
    renderer = SceneRenderer(
        experiment.scene, {}, 240, 180, view=view, materials=experiment.materials
    )
    ((_, times_s, states),) = tosses("mujoco", [SHOWN_TRIAL])
    rows: list[list[NDArray[np.uint8]]] = [[], []]
    for time_s in SHOWN_S:
        simulated = states[int(np.argmin(np.abs(times_s - time_s)))]
        real = {}
        for shot in records(SHOWN_TRIAL):
            place_m, rotation = shot.poses_at(np.array([time_s]))
            real[shot.body] = np.concatenate(
                [place_m[0], rotation.as_quat(scalar_first=True)[0]]
            )
        rows[0].append(renderer.picture(real, {}))
        rows[1].append(
            renderer.picture(
                dict(zip(shots().sidecar.bodies, simulated[:, :7], strict=True)), {}
            )
        )
    renderer.close()
    texts = [
        PanelText(title=title, detail="", note="") for title in ("Recorded", "MuJoCo")
    ]
    caption = Caption(
        title=f"{NAME}, toss {SHOWN_TRIAL}",
        subtitle=experiment.title,
        reference="",
        simulated="",
    )
    clocks = [f"{time_s:.2f} s" for time_s in SHOWN_S]
    options.out.mkdir(parents=True, exist_ok=True)
    save_still(
        strip_picture(rows, texts, caption, clocks), options.out / "elbow_toss.png"
    )


def main() -> None:
    """Run one of the commands."""
    parser = argparse.ArgumentParser(
        description="Real tosses of two hinged blocks on every engine."
    )
    commands = parser.add_subparsers(required=True)
    for function in (run, floor, pair, hinge, flights, report, picture):
        command = commands.add_parser(function.__name__)
        command.set_defaults(function=function)
        if function in (run, floor, pair):
            command.add_argument("engine")
        if function is pair:
            command.add_argument("other")
        command.add_argument("out", type=Path)
        if function in (run, floor, pair):
            command.add_argument("--every", type=int, default=1)
        if function is run:
            add_run_options(command)
    options = parser.parse_args()
    options.function(options)


if __name__ == "__main__":
    main()
