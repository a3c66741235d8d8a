"""Standard uncertainty of each closed form as a solution of the scene of its task file.

    python studies/solutions/uncertainty.py

Friction, speed and start are given by the scene, and nothing is measured, so only what a law leaves out is uncertain:

- Free flight, the pendulum, a carried cube: nothing.
- A cube thrown off a turntable: how pressure spreads under its base. Rigid bodies leave it open. Four corners are its
  limit, so u is the distance from their motion over the root of 3, as for a rectangular distribution (JCGM 100, 4.3.7).
- A cube on a pulled cloth: the catenary of the cloth between rod and table, its stretch, and the slip at the start.
- A strained bar of foam: what a clamp suppresses, its stiffness, the law of large strain, and the time of sound.
"""

import math
import re
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from gauge_envs import load_experiment
from gauge_envs.files import data_folder
from gauge_envs.observables.functions import face_areas_mm2
from gauge_envs.references.band import load_band
from gauge_envs.scene import Box, Scene
from gauge_envs.scene.timing import FRAME_RATE_HZ

EXACT = ("NonsmoothContact-1", "NonsmoothContact-2", "NonsmoothContact-3")
EXACT_IDS = (
    *(f"{family}-{material}" for family in EXACT for material in ("wood", "plastic")),
    *(f"SlopeContact-{material}" for material in ("wood", "plastic")),
    *(f"Turntable-1-{material}" for material in ("wood", "plastic", "metal")),
    "Pendulum-metal",
)
"""Ids with a closed form that leaves nothing out."""

RAMP_M_PER_S = 1e-6
"""Speed of sliding below which friction is proportional to it [m/s]."""

CLAMP_DECAY = 2.106
"""Decay of the effect of a clamp per half width: real part of the first root of sin(2 z) = -2 z (Papkovich, Fadle)."""

CORNERS = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])

Array = NDArray[np.float64]


def frame_times_s(variant: str) -> Array:
    """Return the times of the frames [s], shape [T]."""
    count = load_experiment(variant).frame_count
    return np.arange(count, dtype=np.float64) / FRAME_RATE_HZ


def friction_of(scene: Scene, first: str, second: str) -> float:
    """Return the friction between two bodies."""
    for contact in scene.contacts:
        if {first, second} in map(set, scene.colliding_pairs(contact)):
            return contact.friction
    raise LookupError(f"{first} and {second} do not touch")


def left_turned(rows: Array) -> Array:
    """Return rows turned by a right angle about z, shape [N, 2]."""
    return np.column_stack([-rows[:, 1], rows[:, 0]])


def thrown_cube_mm(variant: str, point_m: float) -> Array:
    """Return the centre of a cube on a turning plate by Coulomb's law [mm], shape [T, 3].

    Pressure is linear in the place. Its centre is mu times the height of the cube's centre from the middle, towards the
    sliding.

    Args:
        variant: An id of Turntable-2.
        point_m: Distance of four points of pressure from the middle of the base along its axes [m].
    """
    scene = load_experiment(variant).scene
    cube, plate = scene.body("cube"), scene.body("plate")
    (turning,) = scene.drivers[0].motions
    friction = friction_of(scene, "cube", "plate")
    height_m = 0.5 * cube.shape.size_m[2]
    square_of_gyration_m2 = cube.shape.size_m[0] ** 2 / 6.0
    axle_m = np.array(plate.pose.position_m)[:2]
    lever_m = friction * height_m

    def rates(time_s: float, state: Array) -> list[float]:
        place, velocity, heading, spin = state[:2], state[2:4], state[4], state[5]
        cosine, sine = math.cos(heading), math.sin(heading)
        points = point_m * CORNERS @ np.array([[cosine, sine], [-sine, cosine]])
        carried = turning.rate(time_s) * left_turned(place + points - axle_m)
        sliding = velocity + spin * left_turned(points) - carried
        speeds = np.sqrt(np.square(sliding).sum(axis=1) + RAMP_M_PER_S**2)
        direction = sliding / speeds[:, None]
        moment = lever_m * direction.T @ points / (4.0 * point_m**2)
        centre = np.linalg.solve(np.eye(2) - moment, lever_m * direction.mean(axis=0))
        shares = 0.25 * (1.0 + points @ centre / point_m**2)
        pulls = -friction * scene.gravity_m_per_s2 * shares[:, None] * direction
        torque = float((left_turned(points) * pulls).sum())
        turned = torque / square_of_gyration_m2
        return [*velocity, *pulls.sum(axis=0), spin, turned]

    times_s = frame_times_s(variant)
    x, y, z = cube.pose.position_m
    heading = float(cube.pose.rotation.as_rotvec()[2])
    found = solve_ivp(
        rates,
        (0.0, times_s[-1]),
        [x, y, 0.0, 0.0, heading, 0.0],
        "LSODA",
        times_s,
        rtol=1e-8,
        atol=1e-10,
        max_step=2e-3,
    )
    return 1e3 * np.column_stack([found.y[0], found.y[1], np.full_like(times_s, z)])


def of_pressure_mm(variant: str) -> Array:
    """Return the uncertainty of a thrown cube [mm], shape [T, 3]."""
    scene = load_experiment(variant).scene
    half_m = 0.5 * scene.body("cube").shape.size_m[0]
    # Four points with the second moment of a uniform pressure.
    uniform_mm = thrown_cube_mm(variant, half_m / math.sqrt(3.0))
    return np.abs(thrown_cube_mm(variant, half_m) - uniform_mm) / math.sqrt(3.0)


def of_pulled_cloth_mm(variant: str) -> Array:
    """Return the uncertainty of a cube on a cloth that is pulled off a table [mm], shape [T, 3]."""
    scene = load_experiment(variant).scene
    cube, rod, table = (scene.body(name) for name in ("cube", "rod", "table"))
    cloth = scene.deformables[0]
    gravity = scene.gravity_m_per_s2
    times_s = frame_times_s(variant)
    rod_m = scene.drivers[0].path(rod.pose, times_s)[:, :3]
    moved_m = rod_m - rod_m[0]
    along = moved_m[-1] / np.linalg.norm(moved_m[-1])
    speed_m_per_s = float(moved_m[-1] @ along) / times_s[-1]
    length_m, width_m = cloth.size_m
    edge_m = float((table.pose.to_world(table.shape.corners_m) @ along).max())
    span_m = np.maximum(rod_m @ along - edge_m, 1e-9)
    lying_kg = cloth.mass_kg * np.clip(1.0 - span_m / length_m, 0.0, 1.0)
    of_table, of_cube = (friction_of(scene, cloth.name, x) for x in ("table", "cube"))
    tension_n_per_m = of_table * gravity * (lying_kg + cube.mass_kg) / width_m
    # A catenary with the parameter a = tension / weight per length is 2 a sinh(span / 2 a) long.
    areal_weight = cloth.mass_kg * gravity / (length_m * width_m)
    parameter_m = tension_n_per_m / areal_weight
    sag_m = 2.0 * parameter_m * np.sinh(0.5 * span_m / parameter_m) - span_m
    apart_m = float((rod_m[0] - np.array(cube.pose.position_m)) @ along)
    stretch_m = tension_n_per_m / cloth.stretch_stiffness_n_per_m * apart_m
    braking_m = 0.5 * speed_m_per_s**2 / (of_cube * gravity)
    slip_m = np.minimum(speed_m_per_s * times_s, braking_m)
    left_out_m = np.sqrt(sag_m**2 + stretch_m**2 + slip_m**2)
    return 1e3 * np.abs(np.outer(left_out_m, along))


def of_bar_mm2(variant: str) -> Array:
    """Return the uncertainty of the faces of a bar between two grips [mm^2], shape [T, face_count]."""
    scene = load_experiment(variant).scene
    (bar,) = scene.deformables
    base = scene.body("base-2")
    held_m = {one.region.side: one.region.depth_m for one in scene.attachments}
    assert isinstance(bar.shape, Box)
    width_m, _, height_m = bar.shape.size_m
    free_m = height_m - held_m["low"] - held_m["high"]
    times_s = frame_times_s(variant)
    moved_m = scene.drivers[0].path(base.pose, times_s)[:, 2] - base.pose.position_m[2]
    strain = moved_m / free_m
    rate_per_s = np.gradient(strain, times_s)
    poisson = bar.poisson_ratio
    own_m = bar.pose.to_body(np.array(scene.markers.positions_m))
    faces = np.array(scene.markers.faces)
    rest_mm2 = face_areas_mm2(own_m[None], faces)
    from_low_m = own_m[faces, 2].mean(axis=1) + 0.5 * height_m - held_m["low"]
    from_clamp_m = np.minimum(from_low_m, free_m - from_low_m)
    suppressed = poisson * np.exp(-CLAMP_DECAY * from_clamp_m / (0.5 * width_m))
    stiffer = poisson**2 * width_m / free_m
    large = 0.5 * poisson * (1.0 + poisson) * strain**2
    sound_m_per_s = math.sqrt(
        bar.young_modulus_pa * width_m**2 * height_m / bar.mass_kg
    )
    parts = [
        np.outer(strain, suppressed),
        stiffer * strain[:, None],
        large[:, None],
        (rate_per_s * free_m / sound_m_per_s)[:, None],
    ]
    squares = [np.square(part * np.ones(len(faces))) for part in parts]
    return np.asarray(rest_mm2 * np.sqrt(np.sum(squares, axis=0)))


def uncertainties() -> dict[str, Array]:
    """Return the standard uncertainty of each closed form at the frames, in the unit of its reference."""
    found = {}
    for variant in EXACT_IDS:
        band = load_band(variant)
        assert band is not None
        found[variant] = np.zeros_like(band.mean)
    for material in ("wood", "plastic", "metal"):
        thrown, pulled = f"Turntable-2-{material}", f"TableclothPulling-{material}"
        found[thrown] = of_pressure_mm(thrown)
        found[pulled] = of_pulled_cloth_mm(pulled)
    for foam in ("soft", "hard"):
        for family in ("FoamStretching", "FoamCompressing"):
            variant = f"{family}-{foam}"
            found[variant] = of_bar_mm2(variant)
    return found


def write(folder: Path) -> None:
    """Write each uncertainty into the two files of its reference."""
    for variant, uncertainty in uncertainties().items():
        band = load_band(variant)
        assert band is not None
        u = band.length(uncertainty)
        file = folder / f"{variant}.npz"
        with np.load(file) as stored:
            arrays = dict(stored)
        uncertainty = np.where(np.isfinite(band.mean), uncertainty, np.nan)
        np.savez_compressed(file, **arrays | {"uncertainty": uncertainty})
        sidecar = file.with_suffix(".toml")
        # Tables of events have a key of the same name.
        head, *events = sidecar.read_text(encoding="utf-8").partition("[[events]]")
        line = f"standard_uncertainty = {u:.6g}  # {band.unit}"
        head = re.sub("^standard_uncertainty = .*$", line, head, flags=re.MULTILINE)
        sidecar.write_text(head + "".join(events), encoding="utf-8")
        print(f"{variant:28} u = {u:.3g} {band.unit}")


if __name__ == "__main__":
    write(Path(sys.argv[1]) if sys.argv[1:] else data_folder("scoring") / "bands")
