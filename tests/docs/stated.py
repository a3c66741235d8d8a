"""What the README and the guides state with numbers that come from the product: phrases that code and data give.

A page must hold its phrases word for word, so that a constant that changes makes `test_numbers` name the page.
"""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Mapping
from functools import cache, reduce
from importlib import import_module
from typing import Any

import gymnasium as gym
from places import ROOT

from gauge_envs import Score, load_experiment, reference_band, variants
from gauge_envs.backends.settings import SteppedSettings

DEGREE = math.pi / 180.0


def of(name: str) -> Any:
    """A value of the package by its module and name, as `files.MOST_TOML_BYTES`."""
    module, _, constant = name.rpartition(".")
    return getattr(import_module(f"gauge_envs.{module}"), constant)


def mb(name: str) -> str:
    return f"{of(name) / 1e6:g} MB"


def step(settings: SteppedSettings) -> str:
    return f"1/{1.0 / settings.timestep_s:.0f} s"


def presets(engine: str) -> Mapping[str, Any]:
    return of(f"backends.{engine}.settings.PRESETS")


@cache
def columns() -> Mapping[tuple[str, str], Mapping[str, Any]]:
    """Results of the conformance checks, by engine and configuration."""
    matrix = json.loads((ROOT / "scoring" / "conformance.json").read_text(encoding="utf-8"))
    return {(column["backend"], column["name"]): column["findings"] for column in matrix["columns"]}


def count(engine: str, *statuses: str, configuration: str = "default") -> int:
    """Number of checks of an engine with some statuses; of all its checks if none is given."""
    findings = columns()[engine, configuration].values()
    return sum(not statuses or finding["status"] in statuses for finding in findings)


def measured(engine: str, check: str, configuration: str = "out_of_box") -> float:
    return float(columns()[engine, configuration][check]["measured"])


def expected(check: str) -> float:
    return float(columns()["mujoco", "default"][check]["expected"])


@cache
def score(name: str) -> Score:
    """The score of an experiment in MuJoCo with default settings."""
    env = gym.make(f"GAUGE/{name}")
    env.reset(seed=0)
    over = False
    while not over:
        *_, terminated, truncated, info = env.step(0)
        over = terminated or truncated
    env.close()
    return info["score"]


def real_mm(name: str) -> float:
    """Mean distance of single real trials from their mean [mm]."""
    found = score(name)
    return found.rmse / found.rmse_normalized


@cache
def limit(task: str) -> str:
    """Limit of a control task with its uncertainty."""
    env = gym.make(f"GAUGE/{task}").unwrapped
    found = env.limit
    env.close()
    places = 4 if found.unit == "m/J" else 3
    return f"{found.value:.{places}f} +- {found.sigma:.{places}f}{'' if found.unit == '1' else f' {found.unit}'}"


def limits(task: str) -> str:
    return ", ".join(limit(f"{task}-Limit-{material}") for material in ("wood", "plastic", "metal"))


@cache
def configurations() -> Mapping[str, Mapping[str, Any]]:
    """Values of the popular configurations, by each of their targets."""
    rows = json.loads((ROOT / "scoring" / "popular_configurations.json").read_text(encoding="utf-8"))["rows"]
    return {target: row["values"] for row in rows for target in row["targets"]}


EVERYWHERE = (
    f"1/{of('scene.timing.FRAME_RATE_HZ'):g} s",
    f"{of('scene.timing.FRAME_RATE_HZ'):g} Hz",
    f"1/{1 / of('scene.timing.SAMPLE_INTERVAL_S'):.0f} s",
    f"{1 / of('scene.timing.SAMPLE_INTERVAL_S'):.0f} Hz",
    f"{1 / of('scene.timing.SAMPLE_INTERVAL_S'):.0f} times a second",
    f"{1 / of('scene.timing.SAMPLE_INTERVAL_S'):.0f} samples a second",
    f"{len(variants())} ids",
    f"{len(variants())} experiments",
    "95 %",
)
"""Phrases that any page may have. All intervals are of 95 %."""


def engines() -> dict[str, list[str]]:
    """Steps, sizes and constants of presets, and results of the conformance checks."""
    checks = f"the {count('mujoco')} [conformance checks](conformance.md#results)"
    mujoco, newton, genesis = presets("mujoco"), presets("newton"), presets("genesis")
    physx, pybullet, rapier, drake = presets("physx"), presets("pybullet"), presets("rapier"), presets("drake")
    return {
        "docs/engines/index.md": [
            f"triangles of {1e3 * of('backends.mujoco.settings.CLOTH_CELL_M'):g} mm; "
            f"{1e3 * mujoco['drape'].cell_m:.0f} mm in preset",
            f"triangles of {1e3 * of('backends.newton.settings.CLOTH_CELL_M'):g} mm |",
            f"{1e3 * of('backends.newton.settings.SOFT_CELL_M'):g} mm, {1e3 * newton['soft_row'].cell_m:.1f} mm in",
            f"voxels of {1e3 * of('backends.newton.settings.VOXEL_M'):g} mm",
            f"segments of {1e3 * of('backends.mujoco.settings.ROPE_CELL_M'):g} mm | "
            f"segments of {1e3 * of('backends.newton.settings.ROPE_CELL_M'):g} mm |",
            "between 0.5 mm and 1 m",
            f"{of('backends.mujoco.settings.NODE_LIMIT'):,} nodes on MuJoCo or "
            f"{of('backends.newton.settings.NODE_LIMIT'):,} on Newton".replace(",", " "),
            "elements of 27 nodes",
        ],
        "docs/engines/mujoco.md": [
            f"bodies of {mujoco['contact'].kinematic_mass_kg:g} kg",
            f"| {step(mujoco['contact'])}, contacts with a time constant of {mujoco['contact'].sustained_solref[0]:g} s:",
            f"softer contacts, {step(mujoco['stack'])}: cheaper",
            f"`discrete` at {step(mujoco['cloth'])}, cells of {1e3 * of('backends.mujoco.settings.CLOTH_CELL_M'):g} mm",
            f"cells of {1e3 * mujoco['drape'].cell_m:.0f} mm: cheaper",
            f"up to {mujoco['soft'].iterations} iterations",
            f"`discrete` at {step(mujoco['rod'])} |",
            f"has a step of {1e3 * mujoco['out_of_box'].timestep_s:g} ms",
            f"Of the {count('mujoco')} checks of [conformance](conformance.md#results), `out_of_box` fails "
            f"{count('mujoco', 'fail', 'error', configuration='out_of_box')} at 1/540 s:",
            f"slides with {measured('mujoco', 'slide-plane'):.2f} instead of {expected('slide-plane'):.2f} m/s^2",
            f"slips {measured('mujoco', 'carry-turn'):.1f} mm",
            f"MuJoCo's default of {mujoco['out_of_box'].contact_solref[0]:g} s",
        ],
        "docs/engines/newton.md": [
            f"| {step(newton['rigid'])}: a tumbling brick",
            f"| {step(newton['impact_chain'])}, harder impacts",
            f"| {step(newton['contact_free'])}, RK4",
            f"| {step(newton['cloth'])}, {newton['cloth'].iterations} iterations:",
            f"collide too, {newton['cloth_probed'].iterations} iterations",
            f"| {newton['cloth_loaded'].iterations} iterations: with fewer,",
            f"| {step(newton['cloth_fine'])}, {newton['cloth_fine'].iterations} iterations |",
            f"| {step(newton['soft'])}, {newton['soft'].iterations} iterations |",
            f"smaller cells, {newton['soft_fine'].iterations} iterations |",
            f"| {step(newton['rod'])}, {newton['rod'].iterations} iterations |",
            f"| {step(newton['rope'])}, {newton['rope'].iterations} iterations |",
            f"the paper's {1 / newton['mpm_full'].timestep_s:.0f} Hz: expensive",
            f"slides with {measured('newton', 'slide-plane'):.2f} instead of {expected('slide-plane'):.2f} m/s^2",
        ],
        "docs/engines/genesis.md": [
            f"bodies of {genesis['default'].kinematic_mass_kg:g} kg",
            f"{step(genesis['default'])}, {1e3 * genesis['default'].sustained_timeconst_s:g} ms: little creep",
            f"| {step(genesis['impact'])}: a rebound",
            f"| {step(genesis['impact_chain'])}: cheaper",
            f"| {step(genesis['contact_free'])}: the pendulum",
            f"`convex`, {step(genesis['stack'])}: cheaper",
            f"slips outward by {measured('genesis', 'carry-turn', 'default'):.1f} mm",
            f"inertia of {genesis['out_of_box'].hinge_armature_kg_m2:g} kg m^2",
            f"Of {checks}, `default` passes {count('genesis', 'pass')} and declines {count('genesis', 'declined')}; "
            f"`out_of_box` passes {count('genesis', 'pass', configuration='out_of_box')} and fails "
            f"{count('genesis', 'fail', 'error', configuration='out_of_box')}.",
        ],
        "docs/engines/physx.md": [
            f"TGS at {step(physx['default'])}, bounce threshold {physx['default'].bounce_threshold_m_per_s:g} m/s",
            f"the same at {step(physx['stack'])}: cheaper",
            f"the paper's {step(physx['out_of_box'])}: bounce threshold {physx['out_of_box'].bounce_threshold_m_per_s:g} "
            f"m/s, angular damping {physx['out_of_box'].angular_damping_per_s:g}, sleep",
            f"{physx['out_of_box'].bounce_threshold_m_per_s:g} m/s in SAPIEN, "
            f"{physx['isaac'].bounce_threshold_m_per_s:g} m/s in Isaac Lab",
            f"`out_of_box` and `isaac` fail {count('physx', 'fail', configuration='out_of_box')} and "
            f"{count('physx', 'fail', configuration='isaac')} of the {count('physx', 'pass')} [conformance checks]",
        ],
        "docs/engines/pybullet.md": [
            f"reaches {of('backends.pybullet.world.PLANE_REACH_M'):g} m to each side",
            "bodies of 1e6 kg",
            f"| {step(pybullet['contact'])}: cylinders",
            f"| {step(pybullet['rope'])}: with longer steps",
            f"cells of {1e3 * of('backends.pybullet.settings.SOFT_CELL_M'):.1f} mm; the step is at most "
            f"{of('backends.pybullet.settings.STABLE_SHARE'):g} of the time",
            f"| {step(pybullet['stack'])}, {pybullet['stack'].solver_iterations} iterations",
            f"fails {count('pybullet', 'fail', configuration='out_of_box')} of the {count('pybullet', 'pass')} "
            "[conformance checks]",
            f"damping of {pybullet['out_of_box'].linear_damping:g} (free fall "
            f"{100 * (1 - measured('pybullet', 'free-fall') / expected('free-fall')):.1f} % too slow)",
            f"({measured('pybullet', 'rebound-0.5'):.3f} for a restitution of 0.5), no rebound below "
            f"{pybullet['out_of_box'].rebound_threshold:g} m/s",
        ],
        "docs/engines/rapier.md": [
            f"Of {checks}, `default` passes {count('rapier', 'pass')} and declines {count('rapier', 'declined')},",
            f"fails {count('rapier', 'fail', configuration='out_of_box')}:",
            f"| {step(rapier['default'])} with {rapier['default'].solver_iterations} substeps",
            f"sinks {-measured('rapier', 'rest-box'):.0f} mm",
            f"slips {measured('rapier', 'carry-turn'):.0f} mm",
            f"{measured('rapier', 'pendulum-energy'):.1f} % lost in 3 s, "
            f"{100 * (1 - measured('rapier', 'pendulum-period') / expected('pendulum-period')):.1f} % too short",
            f"| {measured('rapier', 'rebound-0.95'):.3f} |",
            f"| {measured('rapier', 'spin-orientation'):.1f} degrees off |",
        ],
        "docs/engines/drake.md": [
            f"`lagged`, {step(drake['default'])}: it neither",
            f"the same at {step(drake['rolling'])} and a rate of {drake['rolling'].sustained_rate:g}",
            f"`sap`, {step(drake['impact'])}: a linear contact",
            f"the same at {step(drake['impact_chain'])} |",
            f"points at corners, {step(drake['corners'])}: a hydroelastic corner",
            f"| {step(drake['contact_free'])}: a pendulum",
            f"points at corners, {step(drake['stack'])}: hydroelastic",
            "(2 g cos(slope))",
            f"on 30 degrees slides with {measured('drake', 'slide'):.2f} instead of {expected('slide'):.2f} m/s^2, "
            f"boxes sink by {-measured('drake', 'rest-box'):.0f} mm",
        ],
        "docs/engines/isaac_sim.md": [
            f"{of('scene.fabrics.ISAAC_POISSON_BELOW'):.2f} if that is negative, "
            f"{of('scene.fabrics.ISAAC_POISSON_ABOVE'):.2f} if it is 0.5 or more",
            f"{of('tools.assets.isaac_sim.VOLUME_HZ')} Hz with foam",
        ],
    }
