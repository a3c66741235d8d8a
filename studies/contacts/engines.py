"""Measure contacts of each engine with its two main presets; write a table.

    python -m studies.contacts.engines mujoco newton physx pybullet rapier > studies/contacts/engines.csv

Bodies of 0.5 kg with friction 0.4 and restitution 0.6; the scenes are those of `gauge recipe`.
"""

import sys
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gauge_envs.backends import Backend, backend
from gauge_envs.fixtures.parts import ball, contact, ground
from gauge_envs.fixtures.recording import DivergedError
from gauge_envs.scene import Scene
from gauge_envs.tools.recipes import Probe

MASS_KG, FRICTION, RESTITUTION = 0.5, 0.4, 0.6


@dataclass(frozen=True)
class Preset:
    """Settings of a preset in place of those of a recipe.

    Attributes:
        engine: The engine.
        name: Name of the preset.
        timestep_s: Its time step [s].
    """

    engine: Backend
    name: str
    timestep_s: float
    sliding_friction: float = FRICTION
    restitution: float | None = RESTITUTION
    torsion_m: float = 0.0
    rolling_m: float = 0.0

    def backend(self) -> Backend:
        """Return the engine."""
        return self.engine

    def backend_settings(self, mass_kg: float) -> dict[str, Any]:
        """Return the preset; the default one has no name."""
        return {} if self.name == "default" else {"preset": self.name}


def measured(engine: str, preset: str) -> dict[str, str]:
    """Return a row of the table; an empty value where a scene diverges or is unsupported."""
    built = backend(engine)
    still = ball("ball", (0.0, 0.0, 0.1), mass_kg=MASS_KG)
    pair = contact("ball", "ground", friction=FRICTION, restitution=RESTITUTION)
    scene = Scene(bodies=(still, ground()), contacts=(pair,), duration_s=1.0)
    simulation = built.build(
        scene, Preset(built, preset, 0.0).backend_settings(MASS_KG)
    )
    settings = Preset(built, preset, float(simulation.settings["timestep_s"]))
    simulation.close()
    probe = Probe(settings=settings, mass_kg=MASS_KG)  # type: ignore[arg-type]
    lasting = replace(probe, settings=replace(settings, restitution=None))
    row = {
        "engine": engine,
        "preset": preset,
        "step_ms": f"{1e3 * settings.timestep_s:.3g}",
    }
    values: dict[str, float] = {}
    for scene_of in (probe.drop, lasting.slide, lasting.creep, lasting.hop):
        try:
            values |= scene_of()
        except DivergedError as error:
            print(engine, preset, error, file=sys.stderr)
    ratios, slip = probe.impacts()
    steep, middle, grazing = np.mean(ratios, axis=1)
    found = {
        "slide": values.get("friction", np.nan) / FRICTION,
        "steep": steep,
        "middle": middle,
        "grazing": grazing,
        "slip_rebound": slip,
        "rebound": values.get("restitution", np.nan),
        "creep_mm_s": 1e3 * values.get("creep_m_s", np.nan),
        "hop_mm": 1e3 * values.get("hop_m", np.nan),
    }
    return row | {name: f"{round(value, 6) + 0.0:.3g}" for name, value in found.items()}


if __name__ == "__main__":
    for engine in sys.argv[1:]:
        for preset in ("default", "out_of_box"):
            row = measured(engine, preset)
            if engine == sys.argv[1] and preset == "default":
                print(",".join(row))
            print(",".join(row.values()), flush=True)
