"""Friction of boxes that slide on MuJoCo with a recipe's contact, in a loop of MuJoCo alone: the table of the note.

    python -m studies.recipes.hopping_plates

A box slides for 0.5 s on a slope 10 degrees steeper than the friction angle. Friction is that of Coulomb's law for its
mean accelerations along and off the slope. Columns are turns of the box about the normal.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from gauge_envs.scene import GRAVITY_M_PER_S2 as G
from gauge_envs.tools.recipes import Aim, engine_settings, find_recipe

AIM = Aim(friction=0.9, restitution=0.75, mass_kg=0.5, timestep_s=0.001)
TURNS_DEG = (0.0, 15.0, 30.0, 45.0)
PLATE, CUBE, WIDE = (0.06, 0.06, 0.015), (0.05, 0.05, 0.05), (0.3, 0.3, 0.015)
"""Half edges [m]."""

FREE = "<freejoint/>"
SLIDING = "".join(
    f"<joint type='slide' axis='{axis}'/>" for axis in ("1 0 0", "0 1 0", "0 0 1")
)


def slide(
    contact: str,
    half: tuple[float, ...],
    turn_deg: float,
    joints: str,
    tip: NDArray[np.float64],
) -> tuple[float, float, float]:
    """Return the friction of the box and of its contacts, and how far it hops [mm]."""
    x, y, z = half
    place = z + x * abs(tip[1]) + y * abs(tip[0])
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><compiler eulerseq='XYZ' angle='radian'/>{contact}<worldbody><geom name='floor' type='plane' "
        f"size='9 9 1'/><body pos='0 0 {place}' euler='{tip[0]} {tip[1]} {math.radians(turn_deg)}'>{joints}"
        f"<geom name='foot' type='box' size='{x} {y} {z}' mass='{AIM.mass_kg}'/></body></worldbody></mujoco>"
    )
    slope = math.atan(AIM.friction) + math.radians(10.0)
    model.opt.gravity[:] = (G * math.sin(slope), 0.0, -G * math.cos(slope))
    data = mujoco.MjData(model)
    times, places = [], []
    normal, tangential, force = 0.0, 0.0, np.zeros(6)
    while data.time < 0.5:
        mujoco.mj_step(model, data)
        times.append(data.time)
        places.append(data.xpos[1].copy())
        for index in range(data.ncon if data.time >= 0.1 else 0):
            mujoco.mj_contactForce(model, data, index, force)
            normal += force[0]
            tangential += math.hypot(force[1], force[2])
    seen = np.array(times) >= 0.1
    fit = 2.0 * np.polyfit(np.array(times)[seen], np.array(places)[seen], 2)[0]
    friction = (G * math.sin(slope) - fit[0]) / (G * math.cos(slope) + fit[2])
    return (
        float(friction),
        tangential / normal,
        1e3 * max(place[2] - z for place in places),
    )


def main() -> None:
    """Print the table."""
    recipe = find_recipe(engine_settings("mujoco"), AIM)
    print(recipe.snippet)
    level, rng = np.zeros((1, 2)), np.random.default_rng(0)
    tips = 1e-3 * rng.standard_normal((16, 2))
    print(
        "box",
        *(f"{turn:g} deg" for turn in TURNS_DEG),
        "contacts",
        "hop [mm]",
        sep=" | ",
    )
    for name, half, joints, starts in (
        ("plate that cannot turn", PLATE, SLIDING, level),
        ("wide plate, level start", WIDE, FREE, level),
        ("plate, level start", PLATE, FREE, level),
        ("plate, 16 tipped starts", PLATE, FREE, tips),
        ("cube, 16 tipped starts", CUBE, FREE, tips),
    ):
        found = np.array(
            [
                np.mean(
                    [slide(recipe.snippet, half, turn, joints, tip) for tip in starts],
                    axis=0,
                )
                for turn in TURNS_DEG
            ]
        )
        print(
            name,
            *(f"{one:.3f}" for one in found[:, 0]),
            f"{found[:, 1].mean():.3f}",
            f"{found[:, 2].max():.1f}",
            sep=" | ",
        )


if __name__ == "__main__":
    main()
