"""Draw the picture of `docs/sanity.md`: cubes of two checks of `gauge sanity` with the contacts of three targets."""

from __future__ import annotations

import io

import mujoco
import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from gauge_envs.backends import backend
from gauge_envs.fixtures.slope import moved_m
from gauge_envs.scene.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.sanity import configuration
from gauge_envs.tools.sanity.object_checks import object_check
from gauge_envs.tools.sanity.object_checks.check import run_scenario
from gauge_envs.tools.sanity.object_checks.friction import CUBE, real_friction
from scripts.generated import ROOT

FILE = ROOT / "docs" / "images" / "sanity.webp"
PANELS = {
    "creep-wood": ("A wooden cube on 10 degrees", 10.0, 1.0),
    "slide-turned": ("The same on 30 degrees, turned by 45 degrees", 30.0, 0.5),
}
"""Title, slope [degrees] and time [s] of each check."""


def draw() -> None:
    """Write the picture: displacements downhill over time, and that of Coulomb's law."""
    targets = {
        "HalfCheetah-v5": ("HalfCheetah-v5", "#CC3311"),
        "MuJoCo's defaults": (mujoco.MjModel.from_xml_string("<mujoco/>"), "#0072B2"),
        "good.toml": (str(ROOT / "examples" / "sanity" / "good.toml"), "#009E73"),
    }
    figure = Figure(figsize=(9.9, 3.5), layout="constrained")
    axes = figure.subplots(1, 2)
    for axis, (name, panel) in zip(axes, PANELS.items(), strict=True):
        title, slope_deg, seconds = panel
        scenario = object_check(name).scenario
        for label, (target, color) in targets.items():
            settings = configuration(target).settings
            rollout = run_scenario(backend("mujoco"), scenario, settings)
            moved_mm = 1e3 * moved_m(rollout, *CUBE)[:, 0]
            axis.plot(rollout.times_s, moved_mm, color=color, label=label)
        slope = np.radians(slope_deg)
        push = np.sin(slope) - real_friction("wood") * np.cos(slope)
        times_s = np.linspace(0.0, seconds)
        law_mm = 500.0 * GRAVITY_M_PER_S2 * max(push, 0.0) * times_s**2
        axis.plot(times_s, law_mm, "k:", lw=2, label="Coulomb's law")
        axis.set(title=title, xlabel="time [s]", ylabel="displacement [mm]")
        axis.set_xlim(0.0, seconds)
        axis.legend(frameon=False)
    stream = io.BytesIO()
    figure.savefig(stream, format="png")
    Image.open(stream).convert("RGB").save(FILE, quality=90)
