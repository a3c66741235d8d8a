"""ManiSkill: a SimConfig in a file of the probe, which reads a task without starting it.

Changes are a SimConfig: `SimConfig(sim_freq=200, scene_config=SceneConfig(bounce_threshold=0.2))`.
"""

import math
from typing import Any

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity.readers.dialect import (
    Dialect,
    Entries,
    NestedTable,
    python_text,
    settings_of,
)
from gauge_envs.tools.sanity.readers.physx import (
    GRAVITY,
    physx_configuration,
    solver_name,
)
from gauge_envs.tools.sanity.training import TrainingConfiguration

LINK_DAMPING_PER_S = 0.05
"""Linear and angular damping of links that SAPIEN starts with; a SimConfig has no field for it."""


def _step_s(table: NestedTable, key: str) -> float:
    """Return the step [s] from its inverse."""
    rate = table.number(key) or 0.0
    if not 0.0 < rate < math.inf:
        raise TargetError(
            f"{table.source}: there is no positive {table.name(key)}: give all fields of a SimConfig"
        )
    return 1.0 / rate


def _sim_config(entries: Entries) -> str:
    """Return a SimConfig, and calls for settings of links, which it has no field for."""
    fields = list(entries.get("sim_config", ()))
    if "scene_config" in entries:
        scene = ", ".join(entries["scene_config"])
        fields.append(f"scene_config=SceneConfig({scene})")
    config = [f"SimConfig({', '.join(fields)})"] if fields else []
    return " and ".join([*config, *entries.get("links", ())])


DAMPING = "[link.set_{key}({value}) for link in self.agent.robot.links]"

SETTINGS = """
timestep_s                sim_config   sim_freq                        rate
bounce_threshold_m_per_s  scene_config bounce_threshold                number
sleep_threshold_m2_per_s2 scene_config sleep_threshold                 number
contact_offset_m          scene_config contact_offset                  number
rest_offset_m             scene_config rest_offset                     number
position_iterations       scene_config solver_position_iterations      value
velocity_iterations       scene_config solver_velocity_iterations      value
persistent_manifolds      scene_config enable_pcm                      value
continuous_detection      scene_config enable_ccd                      value
enhanced_determinism      scene_config enable_enhanced_determinism     value
friction_every_iteration  scene_config enable_friction_every_iteration value
solver                    scene_config enable_tgs                      solver
link_linear_damping_per_s links        linear_damping                  damping
angular_damping_per_s     links        angular_damping                 damping
"""

MANISKILL = Dialect(
    name="maniskill",
    settings=settings_of(
        SETTINGS,
        {
            "rate": (_step_s, lambda step_s: str(round(1.0 / step_s)), ""),
            "solver": (solver_name, lambda solver: str(solver == "TGS"), ""),
            "damping": (NestedTable.number, None, DAMPING),
        },
    ),
    pattern="{key}={value}",
    join=_sim_config,
    text=python_text,
    is_closed=True,
)


def maniskill_configuration(
    sim_config: Any, *, name: str, source: str
) -> TrainingConfiguration:
    """Return the training configuration of a SimConfig.

    Args:
        sim_config: The fields of a SimConfig, as `dataclasses.asdict` returns them.
        name: Name of the configuration.
        source: Description of where it is from.
    """
    table = NestedTable(sim_config, source=name, path="sim_config")
    scene = table.part("scene_config")
    settings = {
        **MANISKILL.read({"sim_config": table, "scene_config": scene}),
        "preset": ("out_of_box", "not given: this package's preset"),
    }
    for name_of_damping in ("link_linear_damping_per_s", "angular_damping_per_s"):
        settings[name_of_damping] = LINK_DAMPING_PER_S, "SAPIEN's default for links"
    control_hz = table.number("control_freq") or math.inf
    step_s, _ = settings["timestep_s"]
    return physx_configuration(
        table,
        settings,
        source=source,
        gravity_m_per_s2=scene.numbers("gravity", 3) or GRAVITY,
        frame_skip=round(1.0 / (control_hz * step_s)) or None,
        bounces=bool(table.number("default_materials_config.restitution")),
        language=MANISKILL.name,
    )
