"""Static rules: what a model states and MuJoCo does not do, what no real part has, and what contradicts itself."""

from gauge_envs.tools.sanity.static_rules import consistent, plausible, stated

STATIC_RULES = (
    plausible.range_unit,
    plausible.density,
    plausible.inertia,
    plausible.centre,
    plausible.mesh_mass,
    plausible.armature,
    consistent.names,
    consistent.command_range,
    consistent.servo_gain,
    consistent.mirror,
    consistent.mirror_axis,
    stated.gear,
    stated.gravcomp,
    consistent.touch,
    consistent.start_range,
    consistent.start_command,
    consistent.start_overlap,
    consistent.start_tendon,
    plausible.foot_friction,
    plausible.free_joint,
    plausible.imu_frame,
    plausible.medium,
    stated.solimp,
    stated.solref,
    stated.margin,
    stated.friction,
    stated.rolling,
)
"""Static rules, in their order."""
