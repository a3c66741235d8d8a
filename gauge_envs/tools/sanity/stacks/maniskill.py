"""ManiSkill: a SimConfig in a file of the probe, which reads a task without starting it.

Changes are a SimConfig: `SimConfig(sim_freq=200, scene_config=SceneConfig(bounce_threshold=0.2))`.
"""

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity.model import Settings, TrainingConfiguration
from gauge_envs.tools.sanity.stacks.dialect import (
    FLAG,
    WHOLE,
    Dialect,
    Kind,
    Place,
    Setting,
    number_text,
)
from gauge_envs.tools.sanity.stacks.documents import Table
from gauge_envs.tools.sanity.stacks.physx import (
    SOLVERS,
    Material,
    PhysxValues,
    combined,
    stated_material,
)

LINK_DAMPING_PER_S = 0.05
"""Linear and angular damping of links that SAPIEN starts with; a SimConfig has no field for it."""

MATERIAL = Material.constant(
    "body", "sim_config.default_materials_config", friction=0.3
)
"""Default material of ManiSkill 3."""


def _step_s(table: Table, key: str) -> float:
    rate = table.number(key)
    if rate is None or not 0.0 < rate < float("inf"):
        raise TargetError(
            f"{table.source}: there is no positive {table.name(key)}: give all fields of a SimConfig"
        )
    return 1.0 / rate


def _solver(table: Table, key: str) -> str | None:
    uses_tgs = table.flag(key)
    return None if uses_tgs is None else SOLVERS[uses_tgs]


RATE = Kind(_step_s, lambda step_s: str(round(1.0 / step_s)))
"""Step, stated by its inverse."""

TGS = Kind(_solver, lambda name: str(name == "TGS"))
"""Solver, stated by a flag."""

SCENE, LINKS = "scene_config", "links"

DAMPING = "[link.set_{key}({value}) for link in self.agent.robot.links]"
"""Call for a setting of links, which a SimConfig has no field for."""

MANISKILL = Dialect(
    name="maniskill",
    settings=(
        Setting("timestep_s", "sim_config", "sim_freq", RATE),
        Setting("bounce_threshold_m_per_s", SCENE, "bounce_threshold"),
        Setting("sleep_threshold_m2_per_s2", SCENE, "sleep_threshold"),
        Setting("contact_offset_m", SCENE, "contact_offset"),
        Setting("rest_offset_m", SCENE, "rest_offset"),
        Setting("position_iterations", SCENE, "solver_position_iterations", WHOLE),
        Setting("velocity_iterations", SCENE, "solver_velocity_iterations", WHOLE),
        Setting("persistent_manifolds", SCENE, "enable_pcm", FLAG),
        Setting("continuous_detection", SCENE, "enable_ccd", FLAG),
        Setting("enhanced_determinism", SCENE, "enable_enhanced_determinism", FLAG),
        Setting(
            "friction_every_iteration", SCENE, "enable_friction_every_iteration", FLAG
        ),
        Setting("solver", SCENE, "enable_tgs", TGS),
        Setting("link_linear_damping_per_s", LINKS, "linear_damping", pattern=DAMPING),
        Setting("angular_damping_per_s", LINKS, "angular_damping", pattern=DAMPING),
    ),
    other="{key}={value}",
    places={
        SCENE: Place(form="scene_config=SceneConfig({})", within="sim_config"),
        "sim_config": Place(form="SimConfig({})"),
    },
    text=number_text,
    other_text=number_text,
    gravity="SimConfig(scene_config=SceneConfig(gravity=[{}]))",
    is_closed=True,
)


def maniskill_configuration(
    sim_config: Settings, *, name: str, source: str
) -> TrainingConfiguration:
    """Return the training configuration of a SimConfig.

    Args:
        sim_config: The fields of a SimConfig, as `dataclasses.asdict` returns them.
        name: Name of the configuration.
        source: Description of where it is from.
    """
    table = Table(sim_config, source=name, path="sim_config")
    scene = table.part("scene_config")
    values = PhysxValues("out_of_box", MANISKILL)
    values.take_places({"sim_config": table, SCENE: scene})
    values.origins["timestep_s"] = "1 / sim_config.sim_freq"
    stated = table.table("default_materials_config")
    ground, robot = (
        stated_material(stated, body, MATERIAL) for body in ("ground", "robot")
    )
    values.take_articulation()
    for setting in ("link_linear_damping_per_s", "angular_damping_per_s"):
        values.take(setting, LINK_DAMPING_PER_S, "SAPIEN's default for links")
    values.notes.append(
        "materials that a task gives its own objects, and friction of joints, are not seen"
    )
    control = table.number("control_freq")
    return values.configuration(
        table,
        name=name,
        source=source,
        gravity_m_per_s2=scene.numbers("gravity", 3),
        frame_skip=None
        if not control or control < 0.0
        else round((table.number("sim_freq") or 0.0) / control),
        foot_contact=combined(ground, robot),
    )


DIALECTS = (MANISKILL,)
