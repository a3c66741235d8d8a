"""Print slides and rebounds of an engine: `python studies/rapier_contact/contact.py rapier`.

A cube of 50 mm slides for 0.4 s down 30 degrees with friction 0.2737: acceleration over g (sin - mu cos), and rise over
the board. A ball falls onto a plane: square root of the first rebound's height, and energy, over that of the fall.
"""

import sys
from itertools import product
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.backends import backend
from gauge_envs.scene import (
    GRAVITY_M_PER_S2,
    Box,
    Contact,
    ContactMode,
    Motion,
    Plane,
    Pose,
    RigidBody,
    Scene,
    Sphere,
)

FRICTION, SLOPE, RADIUS_M = 0.2737, Rotation.from_euler("y", 30.0, degrees=True), 0.03
LAW_M_PER_S2 = GRAVITY_M_PER_S2 * (
    np.sin(np.radians(30)) - FRICTION * np.cos(np.radians(30))
)
STEPS = [{"timestep_s": 1 / rate_hz} for rate_hz in (180, 900, 1800, 3600, 9000)]
DRAKE = product(
    ("hydroelastic", "point"), STEPS[::2], ("tamsi", "sap", "similar", "lagged")
)
SLIDES: dict[str, list[dict[str, Any]]] = {
    "rapier": [
        step | {"friction_model": model}
        for step, model in product(STEPS, ("simplified", "coulomb"))
    ],
    "drake": [
        {"contact_model": model, **step, "approximation": name}
        for model, step, name in DRAKE
    ],
    "physx": STEPS,
    "pybullet": [{}],
    "genesis": [
        {"contact_resolution": name, "timestep_s": 1 / 1800}
        for name in ("signorini", "convex")
    ],
}
REBOUNDS: dict[
    str, tuple[tuple[float, ...], tuple[float, ...], list[dict[str, Any]]]
] = {
    "rapier": (
        (0.2, 0.5767, 0.9),
        (0.5,),
        [step | {"solver_iterations": n} for step in STEPS[:4] for n in (1, 2, 4)],
    ),
    "drake": (
        (0.2, 0.577, 0.9),
        (0.00459, 0.051, 0.3997, 1.8355),
        [{"impact_speed_m_per_s": 2.8}],
    ),
    "physx": ((0.577,), (0.3,), [{}, STEPS[0]]),
    "pybullet": ((0.2, 0.5, 0.75, 0.95), (0.4,), [{}]),
    "genesis": ((0.2, 0.5, 0.75, 0.95), (0.4,), [{"preset": "impact"}]),
}


def solid(
    name: str, shape: Any, place: Any, motion: Motion, turn: Rotation
) -> RigidBody:
    """Return a body of 0.1 kg."""
    pose = Pose.from_rotation(tuple(map(float, place)), turn)
    return RigidBody(name=name, shape=shape, motion=motion, pose=pose, mass_kg=0.1)


def states(
    engine: str,
    bodies: tuple[RigidBody, RigidBody],
    seconds: float,
    settings: dict[str, Any],
    e: float,
) -> Any:
    """Return states of the first of two bodies at 180 Hz, shape [sample_count, 13]."""
    mode = ContactMode.IMPACT if e else ContactMode.SUSTAINED
    contact = Contact(
        first=("body",), second=("other",), friction=FRICTION, restitution=e, mode=mode
    )
    simulation = backend(engine).build(
        Scene(bodies=bodies, contacts=(contact,), duration_s=10.0), settings
    )
    rows = [simulation.body_states(["body"])[0]]
    for _ in range(round(180 * seconds)):
        simulation.advance(1 / 180)
        rows.append(simulation.body_states(["body"])[0])
    simulation.close()
    return np.array(rows)


engine, flat = sys.argv[1], Rotation.identity()
for settings in SLIDES[engine]:
    board = solid(
        "other",
        Box(size_m=(2.0, 0.3, 0.02)),
        SLOPE.apply((0, 0, -0.01)),
        Motion.FIXED,
        SLOPE,
    )
    cube = solid(
        "body",
        Box(size_m=(0.05, 0.05, 0.05)),
        SLOPE.apply((0, 0, 0.025)),
        Motion.DYNAMIC,
        SLOPE,
    )
    places = SLOPE.inv().apply(states(engine, (cube, board), 0.4, settings, 0.0)[:, :3])
    ratio = (
        2.0
        * np.polyfit(np.arange(len(places)) / 180, places[:, 0], 2)[0]
        / LAW_M_PER_S2
    )
    print(f"slide {settings}: {ratio:.5f}, {1e3 * (places[:, 2].max() - 0.025):.4f} mm")
for settings, e, height_m in product(REBOUNDS[engine][2], *REBOUNDS[engine][:2]):
    ball = solid(
        "body",
        Sphere(radius_m=RADIUS_M),
        (0, 0, height_m + RADIUS_M),
        Motion.DYNAMIC,
        flat,
    )
    fall_s = np.sqrt(2 * height_m / GRAVITY_M_PER_S2)
    pair = (ball, solid("other", Plane(), (0, 0, 0), Motion.FIXED, flat))
    rows = states(engine, pair, (1.0 + 1.3 * e) * fall_s + 0.05, settings, e)[
        round(180 * fall_s) + 1 :
    ]
    highest, energy = (
        rows[:, 2] - RADIUS_M,
        rows[:, 2] - RADIUS_M + rows[:, 9] ** 2 / (2.0 * GRAVITY_M_PER_S2),
    )
    found = [
        np.sqrt(max(of[rows[:, 9] > -0.06].max(), 0.0) / height_m)
        for of in (highest, energy)
    ]
    print(
        f"rebound {settings} {e} from {height_m:.5g} m: {found[0]:.4f} by height, {found[1]:.4f} by energy"
    )
