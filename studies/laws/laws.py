"""What engines differ from the laws by, and closed forms of deformable bodies beside two solvers.

    python -m studies.laws.laws scored [--engines mujoco rapier ...]    writes scored.csv
    python -m studies.laws.laws checks                                  writes checks.csv

`scored` runs each id that has one of these laws on each engine that can build it. `checks` compares statics that are
no law of a scored observable: the twist of a foam bar and the sag of cloth between two rods.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from gauge_envs import GaugeEnv, load_experiment, reference_band
from gauge_envs.observables.functions import face_areas_mm2
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.scene import Cloth

FloatArray = NDArray[np.float64]
FOLDER = Path(__file__).parent
RIGID = ("mujoco", "newton", "rapier", "drake", "physx", "pybullet")
DEFORMABLE = ("mujoco", "newton")
GRAVITY = 9.80665

SCORED: Mapping[str, tuple[str, ...]] = {
    "Pendulum-metal": ("calibrated",),
    "NewtonsCradle-metal": ("calibrated", "effective"),
    **{
        f"Turntable-2-{material}": ("calibrated",)
        for material in ("wood", "plastic", "metal")
    },
    **{
        f"TableclothPulling-{material}": ("calibrated",)
        for material in ("wood", "plastic", "metal")
    },
    **{
        f"Foam{way}-{foam}": ("calibrated",)
        for way in ("Stretching", "Compressing")
        for foam in ("soft", "hard")
    },
}
"""Parameter sets of each id."""


def scored(engines: tuple[str, ...]) -> Iterator[dict[str, object]]:
    """Yield a row for each id, parameter set and engine."""
    for name, sets in SCORED.items():
        experiment = load_experiment(name)
        band = reference_band(experiment)
        assert band is not None
        known = np.isfinite(band.mean).all(axis=1)
        error = band.sigma if band.uncertainty is None else band.uncertainty
        for parameters in sets:
            for engine in engines:
                if experiment.scene.deformables and engine not in DEFORMABLE:
                    continue
                result = run_episode(
                    RunRequest(name, backend=engine, parameters=parameters)
                )
                if result.trajectory is None or result.score is None:
                    continue
                frames = result.trajectory.arrays()[1][::6][: len(known)]
                apart = np.linalg.norm(
                    (band.project(frames) - band.mean)[known], axis=1
                )
                yield {
                    "id": name,
                    "parameters": parameters,
                    "engine": engine,
                    "frames": f"{known.sum()} of {experiment.frame_count}",
                    "unit": band.unit,
                    "u_at_end": round(float(np.linalg.norm(error[known][-1])), 2),
                    "rmse": round(float(result.score.rmse or 0.0), 4),
                    "largest": round(float(apart.max()), 4),
                    "at_end": round(float(apart[-1]), 4),
                }


def checks() -> Iterator[dict[str, object]]:
    """Yield a row for each static closed form and engine."""
    for engine in DEFORMABLE:
        for foam in ("soft", "hard"):
            yield from twist(f"FoamTwisting-{foam}", engine)
        yield from sag("TextileBending-nylon", engine)


def markers_at_end(name: str, engine: str) -> FloatArray:
    """Return the markers at the last frame of an episode [m], shape [marker_count, 3]."""
    env = GaugeEnv(name, backend=engine)
    observation, _ = env.reset(seed=0)
    ended = False
    while not ended:
        observation, _, terminated, truncated, _ = env.step(
            np.zeros(env.action_space.shape or ())
        )
        ended = terminated or truncated
    return np.asarray(observation["markers"], dtype=np.float64)


def twist(name: str, engine: str) -> Iterator[dict[str, object]]:
    """Yield the twist between the marked sections beside that of a bar that twists evenly between its grips."""
    experiment = load_experiment(name)
    scene = experiment.scene
    assert scene.markers is not None
    rest, end = np.array(scene.markers.positions_m), markers_at_end(name, engine)
    axis = np.array(scene.deformables[0].pose.position_m)[:2]
    levels = np.unique(rest[:, 2].round(5))
    turned = []
    for level in levels:
        at = np.abs(rest[:, 2] - level) < 1e-4
        before, after = (
            ((rows[at, 0] - axis[0]) + 1j * (rows[at, 1] - axis[1]))
            for rows in (rest, end)
        )
        turned.append(float(np.angle(np.vdot(before, after))))
    rate = float(np.polyfit(levels, np.unwrap(turned), 1)[0])
    driver = scene.drivers[0].motions[0].value((experiment.frame_count - 1) / 30)
    exact = driver / (0.2 - 2 * 0.01285)
    yield row(name, engine, "twist per length", "rad/m", rate, exact)
    areas = face_areas_mm2(np.array([rest, end]), scene.markers.faces).sum(axis=1)
    shear = 0.025 * abs(exact)
    # A face 25 mm from the axis shears by 25 mm times the twist per length; shear alone keeps its area.
    yield row(
        name,
        engine,
        f"area ratio at a shear of {shear:.3f}",
        "1",
        float(areas[1] / areas[0]),
        1.0,
    )


def sag(name: str, engine: str) -> Iterator[dict[str, object]]:
    """Yield the depth of the middle of the free edges beside that of an inextensible catenary.

    The warp of nylon is stretched by less than 1e-3 by the weight of the cloth, and its bending moves it by less.
    """
    experiment = load_experiment(name)
    scene = experiment.scene
    cloth = scene.deformables[0]
    assert scene.markers is not None and isinstance(cloth, Cloth)
    rest, end = np.array(scene.markers.positions_m), markers_at_end(name, engine)
    driver = scene.drivers[0]
    moved = np.subtract(
        driver.pose(
            scene.body(driver.body).pose, (experiment.frame_count - 1) / 30
        ).position_m,
        scene.body(driver.body).pose.position_m,
    )
    length = cloth.size_m[0]
    span = length - float(np.linalg.norm(moved))
    scale = brentq(
        lambda a: 2.0 * a * np.sinh(0.5 * span / a) - length, 1e-3 * span, 1e3 * span
    )
    exact = scale * (np.cosh(0.5 * span / scale) - 1.0)
    yield row(
        name,
        engine,
        "largest depth",
        "mm",
        1e3 * float((rest[:, 2] - end[:, 2]).max()),
        1e3 * float(exact),
    )


def row(
    name: str, engine: str, what: str, unit: str, value: float, exact: float
) -> dict[str, object]:
    """Return a row of `checks.csv`."""
    return {
        "id": name,
        "engine": engine,
        "quantity": what,
        "unit": unit,
        "value": round(value, 5),
        "closed_form": round(exact, 5),
        "difference": round(value - exact, 5),
    }


def main() -> None:
    """Run one of the two parts and write its table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("part", choices=["scored", "checks"])
    parser.add_argument("--engines", nargs="+", default=RIGID)
    options = parser.parse_args()
    rows = scored(tuple(options.engines)) if options.part == "scored" else checks()
    writer = None
    with (FOLDER / f"{options.part}.csv").open(
        "w", encoding="utf-8", newline=""
    ) as file:
        for values in rows:
            if writer is None:
                writer = csv.DictWriter(file, list(values), lineterminator="\n")
                writer.writeheader()
            writer.writerow(values)
            file.flush()
            print(*values.values(), flush=True)


if __name__ == "__main__":
    main()
