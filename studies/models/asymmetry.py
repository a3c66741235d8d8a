"""Turn the start of TextileFlinging, and see which changes of the fabric the motion then shows (`asymmetry.csv`).

The cloth hangs square to the motion of its rod, so it does not shear. Rod and cloth are turned by one angle about the
vertical and about the direction of the motion. Distances are those of MuJoCo's runs, over u of the reference.
"""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs import load_experiment, reference_band
from gauge_envs.evaluation.reference import reference_loads
from gauge_envs.evaluation.verification import load_length, solution_uncertainty
from gauge_envs.scene import Pose, Scene
from scripts.build_power import changed_scenes, distance, motion

NAME = "TextileFlinging-satin"
TURNS_DEG = (0.0, 0.5, 2.0)
CHANGES = ("bending off", "shear off", "shear x 0.8")
SETTINGS = {"cell_m": 0.04}
LAST_FRAME = 151


def turned(scene: Scene, angle_deg: float) -> Scene:
    """Return the scene with rod, cloth and markers turned about the vertical and about the motion of the rod."""
    centre_m = np.asarray(scene.body("rod").pose.position_m)
    axes = np.array([0.0, 0.0, 1.0]) + scene.drivers[0].motions[0].axis
    turn = Rotation.from_rotvec(np.radians(angle_deg) * axes)

    def place(point_m: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(centre_m + turn.apply(np.asarray(point_m) - centre_m))

    def pose(one: Pose) -> Pose:
        w, x, y, z = one.quaternion
        x, y, z, w = (turn * Rotation.from_quat([x, y, z, w])).as_quat()
        return Pose(position_m=place(one.position_m), quaternion=(w, x, y, z))

    bodies = tuple(
        replace(body, pose=pose(body.pose)) if body.name == "rod" else body
        for body in scene.bodies
    )
    cloths = tuple(replace(one, pose=pose(one.pose)) for one in scene.deformables)
    places_m = tuple(place(point) for point in scene.markers.positions_m)
    markers = replace(scene.markers, positions_m=places_m)
    return replace(scene, bodies=bodies, deformables=cloths, markers=markers)


def main() -> None:
    """Run the scenes, and write the table."""
    experiment = load_experiment(NAME)
    band, air = reference_band(experiment), load_experiment(NAME, parameters="air")
    (load,) = reference_loads(experiment, band)
    holders = experiment.scene.holders
    rows = []
    for angle_deg in TURNS_DEG:
        scene = turned(experiment.scene, angle_deg)
        changed = {
            title: one for title, one in changed_scenes(scene) if title in CHANGES
        }
        changed["air on"] = replace(scene, air=air.scene.air)
        nominal = motion(experiment, scene, last_frame=LAST_FRAME, settings=SETTINGS)
        forces = load.values(holders, nominal.trajectory().wrenches)
        for title, one in changed.items():
            run = motion(experiment, one, last_frame=LAST_FRAME, settings=SETTINGS)
            moved = distance(band, nominal, run, is_aligned=False)
            pulled = load.values(holders, run.trajectory().wrenches) - forces
            rows.append(
                {
                    "turn_deg": angle_deg,
                    "change": title,
                    "markers_u": f"{moved / solution_uncertainty(band):.3g}",
                    "force_u": f"{load_length(pulled) / load_length(load.uncertainty):.2g}",
                }
            )
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main()
