"""What the README and the guides state with numbers that come from the product: phrases that code and data give.

A page must hold its phrases word for word, so that a constant that changes makes `test_numbers` name the page.
"""

from __future__ import annotations

import json
import math
import re
import tomllib
from functools import cache
from importlib import import_module
from inspect import getsource
from typing import get_args

import gymnasium as gym
from places import ROOT
from test_docs import NOTE_WORDS

from gauge_envs import load_experiment, reference_band, variants
from gauge_envs.registry import command_lines

DEGREE = math.pi / 180.0


def of(name):
    """A value of the package by its module and name, as `files.MOST_TOML_BYTES`."""
    module, _, constant = name.rpartition(".")
    return getattr(
        import_module(f"gauge_envs.{module}" if module else "gauge_envs"), constant
    )


def mb(name):
    return f"{of(name) / 1e6:g} MB"


def quoted(module, text):
    """A text that a module of the package has word for word."""
    assert text in getsource(import_module(f"gauge_envs.{module}"))
    return text


def toml(file):
    return tomllib.loads((ROOT / file).read_text(encoding="utf-8"))


def law_frames(name):
    """Frames that the law of an experiment scores."""
    band = reference_band(load_experiment(name))
    assert band is not None
    return int(band.measured.sum())


def step(settings):
    return f"1/{1.0 / settings.timestep_s:.0f} s"


def presets(engine):
    return of(f"backends.{engine}.settings.PRESETS")


@cache
def columns():
    """Results of the conformance checks, by engine and configuration."""
    matrix = json.loads(
        (ROOT / "scoring" / "conformance.json").read_text(encoding="utf-8")
    )
    return {
        (column["backend"], column["name"]): column["findings"]
        for column in matrix["columns"]
    }


def count(engine, *statuses, configuration="default"):
    """Number of checks of an engine with some statuses; of all its checks if none is given."""
    findings = columns()[engine, configuration].values()
    return sum(not statuses or finding["status"] in statuses for finding in findings)


def measured(engine, check, configuration="out_of_box"):
    return float(columns()[engine, configuration][check]["measured"])


def expected(check):
    return float(columns()["mujoco", "default"][check]["expected"])


@cache
def score(name, parameters="calibrated"):
    """The score of an experiment in MuJoCo with default settings."""
    env = gym.make(f"GAUGE/{name}", parameters=parameters)
    env.reset(seed=0)
    over = False
    while not over:
        *_, terminated, truncated, info = env.step(0)
        over = terminated or truncated
    env.close()
    return info["score"]


def real_mm(name):
    """Mean distance of single real trials from their mean [mm]."""
    found = score(name)
    return found.rmse / found.rmse_normalized


@cache
def limit(task):
    """Limit of a control task with its uncertainty."""
    env = gym.make(f"GAUGE/{task}").unwrapped
    found = env.limit
    env.close()
    places = 4 if found.unit == "m/J" else 3
    return f"{found.value:.{places}f} +- {found.sigma:.{places}f}{'' if found.unit == '1' else f' {found.unit}'}"


def limits(task):
    return ", ".join(
        limit(f"{task}-Limit-{material}") for material in ("wood", "plastic", "metal")
    )


@cache
def configurations():
    """Values of the popular configurations, by each of their targets."""
    rows = json.loads(
        (ROOT / "scoring" / "popular_configurations.json").read_text(encoding="utf-8")
    )["rows"]
    return {target: row["values"] for row in rows for target in row["targets"]}


def real_value(phenomenon):
    """Value of a phenomenon of the sanity check in reality."""
    return float(of("tools.sanity.phenomena.phenomenon")(phenomenon).reality.value)


def tolerance(phenomenon):
    return float(of("tools.sanity.phenomena.phenomenon")(phenomenon).reality.tolerance)


def met(target, check):
    """Effective friction of a cube in a popular configuration over its stated one [%]."""
    gravity, slope = of("scene.GRAVITY_M_PER_S2"), 30.0 * DEGREE
    coulomb = gravity * math.sin(slope) - real_value("slide-wood")
    return (
        100.0 * (gravity * math.sin(slope) - configurations()[target][check]) / coulomb
    )


def jitter(phrase):
    found = of("Jitter")()
    return phrase.format(
        position=f"{1e3 * found.position_m:g} mm",
        angle=f"{found.angle_rad / DEGREE:g} degrees",
    )


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


def engines():
    """Steps, sizes and constants of presets, and results of the conformance checks."""
    checks = f"the {count('mujoco')} [conformance checks](conformance.md#results)"
    sapien = presets("physx")["out_of_box"]
    cell_m = get_args(get_args(of("backends.shared.cells.CellSize"))[0])[1].metadata
    cells = f"{1e3 * of('backends.mujoco.settings.CLOTH_CELL_M'):g} mm"
    mujoco, newton, genesis = presets("mujoco"), presets("newton"), presets("genesis")
    physx, pybullet, rapier, drake = (
        presets("physx"),
        presets("pybullet"),
        presets("rapier"),
        presets("drake"),
    )
    return {
        "docs/engines/index.md": [
            f"triangles of {cells}; {1e3 * mujoco['drape'].cell_m:.0f} mm in preset",
            f"triangles of {1e3 * of('backends.newton.settings.CLOTH_CELL_M'):g} mm |",
            f"{1e3 * of('backends.newton.settings.SOFT_CELL_M'):g} mm, {1e3 * newton['soft_row'].cell_m:.1f} mm in",
            f"voxels of {1e3 * of('backends.newton.settings.VOXEL_M'):g} mm",
            f"segments of {1e3 * of('backends.mujoco.settings.ROPE_CELL_M'):g} mm | "
            f"segments of {1e3 * of('backends.newton.settings.ROPE_CELL_M'):g} mm |",
            f"between {1e3 * cell_m[0].ge:g} mm and {cell_m[1].le:g} m",
            f"{of('backends.mujoco.settings.NODE_LIMIT'):,} nodes on MuJoCo or "
            f"{of('backends.newton.settings.NODE_LIMIT'):,} on Newton".replace(
                ",", " "
            ),
            f"elements of {3**3} nodes",
        ],
        "docs/engines/mujoco.md": [
            f"bodies of {mujoco['contact'].kinematic_mass_kg:g} kg",
            f"| {step(mujoco['contact'])}, contacts with a time constant of "
            f"{mujoco['contact'].sustained_solref[0]:g} s:",
            f"softer contacts, {step(mujoco['stack'])}: cheaper",
            f"`discrete` at {step(mujoco['cloth'])}, cells of {cells}",
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
            f"below {of('backends.genesis.document.MIN_FRICTION'):g}** is raised",
            f"inertia of {genesis['out_of_box'].hinge_armature_kg_m2:g} kg m^2",
            f"Of {checks}, `default` passes {count('genesis', 'pass')} and declines {count('genesis', 'declined')}; "
            f"`out_of_box` passes {count('genesis', 'pass', configuration='out_of_box')} and fails "
            f"{count('genesis', 'fail', 'error', configuration='out_of_box')}.",
            "leaves with "
            f"{100 - 100 * measured('genesis', spin := 'oblique-grip-spin', 'default') / expected(spin):.0f} % less",
        ],
        "docs/engines/physx.md": [
            f"TGS at {step(physx['default'])}, bounce threshold {physx['default'].bounce_threshold_m_per_s:g} m/s",
            f"the same at {step(physx['stack'])}: cheaper",
            f"the paper's {step(sapien)}: bounce threshold {sapien.bounce_threshold_m_per_s:g} m/s, angular damping "
            f"{sapien.angular_damping_per_s:g}, sleep",
            f"{sapien.bounce_threshold_m_per_s:g} m/s in SAPIEN, "
            f"{physx['isaac'].bounce_threshold_m_per_s:g} m/s in Isaac Lab",
            f"`out_of_box` and `isaac` fail {count('physx', 'fail', configuration='out_of_box')} and "
            f"{count('physx', 'fail', configuration='isaac')} of the {count('physx', 'pass', 'fail')} "
            f"[conformance checks](conformance.md#results) that they build; `default` fails {count('physx', 'fail')}",
        ],
        "docs/engines/pybullet.md": [
            f"reaches {of('backends.pybullet.world.PLANE_REACH_M'):g} m to each side",
            f"bodies of {of('backends.pybullet.world.DRIVEN_MASS_KG'):.0e} kg".replace(
                "e+06", "e6"
            ),
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
            f"fails {count('rapier', 'fail', configuration='out_of_box')}, among them:",
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
            f"on 30 degrees slides with {measured('drake', 'slide'):.2f} instead of {expected('slide'):.2f} m/s^2, "
            f"boxes sink by {-measured('drake', 'rest-box'):.0f} mm",
        ],
        "docs/engines/isaac_sim.md": [
            f"{of('tools.usd.isaac_fabric.POISSON_BELOW'):.2f} if that is negative, "
            f"{of('tools.usd.isaac_fabric.POISSON_ABOVE'):.2f} if it is 0.5 or more",
            f"{of('tools.assets.isaac_sim.VOLUME_HZ')} Hz with foam",
        ],
    }


def control():
    """Limits, ranges and tolerances of the control tasks."""
    family = {
        name: of(f"tools.control.{name.lower()}.{name}Limit")
        for name in ("Turntable", "Throw", "Fling", "Pendulum", "Carry", "Push")
    }
    slope = of("tools.control.slope_slider.SlopeSliderLimit")
    durations = [task.DURATION_S for task in (*family.values(), slope)]
    uncertain = of("references.sensitivities.input_uncertainties")().friction
    slip, rest = (
        of("tools.control.friction.SLIP_SPEED_M_PER_S"),
        of("tools.control.least_time.REST_M_PER_S"),
    )
    tolerance_m = of("tools.control.least_time.TOLERANCE_M")
    tolerance_rad = of("tools.control.least_time.TOLERANCE_RAD")
    push = family["Push"]
    braking = (
        of("tools.control.limit.pair_friction")(
            load_experiment("SlopeSlider-3-wood").scene, "cube", "board"
        )
        * 9.80665
    )
    fling = family["Fling"]("satin")
    (cloth,) = fling.experiment.scene.deformables
    # A hanging strip of length L sinks by rho g L^2 / (3 K) on average, and gravity stretches it with half of its work.
    stretch = (
        9.80665
        * cloth.size_m[0]
        * (cloth.areal_density_kg_per_m2 / cloth.stretch_stiffness_n_per_m / 3) ** 0.5
    )
    assert "`ratio` is at most 1.03; without an impact it is 0.88" in push.__doc__
    return [
        f"up to {family['Turntable'].ACCELERATION_RAD_PER_S2:g} rad/s^2",
        f"up to {slope.ACCELERATION_RAD_PER_S2:g} rad/s^2",
        f"up to {of('tools.control.pendulum.TORQUE_SHARE'):g} of weight times length",
        f"to {of('tools.control.pendulum.TARGET_RAD') / DEGREE:.0f} degrees | {limit('Pendulum-Limit-metal')} |",
        f"up to {family['Carry'].ACCELERATION_M_PER_S2:g} m/s^2 | 4 D",
        f"up to {push.ACCELERATION_M_PER_S2:g} m/s^2 | 2 D",
        f"up to {family['Throw'].ACCELERATION_M_PER_S2:g} m/s^2",
        f"| {limits('Turntable')} |",
        f"| {limits('SlopeSlider')} |",
        f"| {limit('Throw-Limit-rubber')} |",
        f"up to {fling._most_m_per_s2:.2f} m/s^2 | g h <= U^2 / 2",
        f"| {limit('Fling-Limit-satin')} |",
        f"| Fling | {1.0 + 2.0 * stretch / fling._speed_m_per_s:.2f} |",
        f"lasts at most {min(durations):g} to {max(durations):g} s",
        f"over {of('tools.control.friction.HOLD_S'):g} s without a slip",
        f"moves at {1e3 * slip:g} mm/s on it",
        f"within {1e3 * tolerance_m:g} mm, {tolerance_rad / DEGREE:.0f} degrees and {1e3 * rest:g} mm/s of a goal",
        f"lifts it by {1e3 * of('tools.control.push.LIFTED_M'):g} mm",
        f"less than {1e2 * of('tools.control.throw.EDGE_M'):g} cm from its edge",
        f"{100 * uncertain.std(1.0, 'wood'):.1f} % (wood), {100 * uncertain.std(1.0, 'plastic'):.1f} % (plastic), "
        f"{100 * uncertain.std(1.0, 'metal'):.1f} %",
        f"length, {100 * of('tools.control.pendulum.LENGTH_SIGMA'):.1f} %",
        f"| Push | 1.03; {1 / (1 + braking / push.ACCELERATION_M_PER_S2):.2f} without an impact",
        f"slips below {1e3 * slip:g} mm/s do not count",
    ]


def readers():
    """Limits of what is read, and tolerances of imports and submissions."""
    start, baseline, motion = (
        of(f"tools.leaderboard.trajectory.{name}")
        for name in ("START_TOLERANCE", "COPY_OF_BASELINE", "COPY_OF_MOTION")
    )
    (download_size,) = re.findall(r"\d+ GB", command_lines()["data download"])
    files = (of("files.MOST_JSON_CONTAINERS"), of("scene.timing.MOST_FRAMES"))
    return {
        "docs/limits.md": [
            f"| trial of the dataset | {mb('tools.dataset.trial.MOST_TRIAL_BYTES')}, {files[0]:,} objects and lists |",
            f"| {mb('runs.result_file.MAX_RESULT_BYTES')}; arrays of an NPZ file "
            f"{mb('evaluation.trajectory_file.MOST_ARRAY_BYTES')} |",
            f"| {mb('files.MOST_TOML_BYTES')}, {files[1]:,} frames; {mb('references.tables.MOST_TABLE_BYTES')} |",
            f"| USD | {mb('tools.usd.source.MOST_FILE_BYTES')}, text layers {mb('tools.usd.source.MOST_TEXT_BYTES')}; "
            f"{of('tools.usd.source.MOST_PRIMS'):,} prims, {of('tools.usd.reader.MOST_BODIES'):,} bodies |",
            f"| MJCF | {mb('tools.mjcf.reader.MOST_FILE_BYTES')}, a time step of at least "
            f"{of('tools.mjcf.reader.SHORTEST_STEP_S'):.0e} s |".replace("e-07", "e-7"),
            f"of `gauge sanity` | {mb('tools.sanity.stacks.documents.MOST_YAML_BYTES')}; "
            f"{mb('tools.sanity.stacks.mjcf.MOST_MODEL_BYTES')} without meshes |",
            f"| sweep file | {mb('files.MEGABYTE')}, {of('tools.sweep.spec.MAX_EPISODES'):,} episodes |",
            f"| policy | {mb('tools.transfer.policies.load.MOST_ONNX_BYTES')} |",
            f"| {mb('tools.conformance.matrix.MOST_BYTES')}; {mb('tools.video.track.MOST_TRACK_BYTES')}, "
            f"{mb('files.MEGABYTE')} |",
            f"is read every {of('runs.isolation.LOOK_S'):g} s",
            jitter(
                "The jitter of {position} is that of real starts where it was measured; the {angle} are"
            ),
        ],
        "docs/leaderboard.md": [
            f"{mb('runs.result_file.MAX_RESULT_BYTES')} for a result and "
            f"{mb('tools.leaderboard.submission.MAX_TOTAL_BYTES')} for a submission",
            f"within {start['mm']:g} mm, {start['mm^2']:g} mm^2 or {start['rad']:.0e} rad".replace(
                "e-06", "e-6"
            ),
            f"{100 * baseline:g} % of the distance of real trials from their mean or {100 * motion:g} % of the motion",
            f"at most {100 * of('tools.leaderboard.reruns.RERUN_SHARE'):g} % of the distance",
            f"published, {100 * of('tools.leaderboard.reruns.RERUN_SHARE'):g} % of the motion",
        ],
        "docs/dataset.md": [
            f"{download_size}) is not in the package",
            f"{download_size} of disk in all, at 100 Mbit/s {80 * float(download_size.split()[0]) / 60:.0f} minutes",
            f"more than {of('tools.dataset.trial.LARGEST_MM') / 1e3:g} m from the origin",
            f"by more than {of('tools.dataset.trial.NORM_TOLERANCE'):g}",
            f"more than {of('tools.dataset.observation.START_RANGE_MM'):g} mm from its calibrated start",
            f"more than {of('tools.dataset.observation.SWAPPED_MARKERS_MM'):g} mm from their own positions",
            f"more than {100 * of('tools.dataset.importer.FLAGGED_DIFFERENCE'):g} % is flagged",
        ],
        "docs/adding_a_stack.md": [
            f"{mb('tools.sanity.stacks.documents.MOST_YAML_BYTES')}, {of('tools.sanity.stacks.documents.MOST_DEPTH')} "
            f"levels, {of('tools.sanity.stacks.documents.MOST_NODES'):,} values".replace(
                "50,000", "50 000"
            ),
            f"| a probe file | `probe.py` in `stacks/` | {mb('tools.sanity.stacks.probe.MOST_PROBE_BYTES')}",
        ],
        "docs/sanity_stacks.md": [
            f"at most {mb('tools.sanity.stacks.documents.MOST_YAML_BYTES')}, "
            f"{of('tools.sanity.stacks.documents.MOST_DEPTH')} levels",
            quoted("tools.sanity.stacks.isaac_gym", "taken as 0.04 m and 0.025 m"),
            "material of the robot; 1.0 otherwise",
            f"damps links at {presets('physx')['out_of_box'].link_linear_damping_per_s:g}/s",
            f"below {presets('physx')['out_of_box'].bounce_threshold_m_per_s:g} m/s does not bounce",
            "does not slide down 30 degrees",
            f"{real_value('slide-wood'):.2f} m/s² in reality",
            f"| 1 / 5, 4 ms | {configurations()['Go1JoystickFlatTerrain']['slide-wood']:.3f} |",
            f"| 2 / 5, 2.5 ms | {configurations()['WalkerWalk']['slide-wood']:.2f} |",
            f"| 3 / 5, 2 ms | {configurations()['G1JoystickFlatTerrain']['slide-wood']:.2f} |",
            f"| 10, 5 ms, elliptic | {configurations()['Mjlab-Velocity-Flat-Unitree-Go1']['slide-wood']:.2f} |",
        ],
    }


def stated_friction(target):
    """Friction that a target states for its feet on the ground."""
    rows = json.loads(
        (ROOT / "scoring" / "popular_configurations.json").read_text(encoding="utf-8")
    )["rows"]
    return next(float(row["friction"]) for row in rows if target in row["targets"])


def sanity():
    """Rules of the sanity check, and what it found in popular configurations."""
    visible, found = of("tools.sanity.model.VISIBLE_WITHIN"), configurations()
    popular = "docs/sanity_popular.md"
    one_iteration = (
        "Go1JoystickFlatTerrain",
        "SpotFlatTerrainJoystick",
        "H1InplaceGaitTracking",
        "Op3Joystick",
    )
    slides = [f"{found[target]['foot-slide']:.2f}" for target in one_iteration]
    turned = [
        met(target, "slide-turned")
        for target, values in found.items()
        if "slide-turned" in values
    ]
    pyramids = [share for share in turned if 60.0 < share < 80.0]
    return {
        "docs/adding_a_phenomenon.md": [f"*visible* up to {visible:g}, else *wrong*"],
        "docs/glossary.md": [f"at most {visible:g} half-widths"],
        "docs/sanity.md": [
            f"at most {visible:g} half-widths",
            f"*visible* up to {visible:g} half-widths",
            f"outside {9.80665 - tolerance_of_gravity():.2f} to {9.80665 + tolerance_of_gravity():.2f} m/s²",
            f"more than {math.degrees(tolerance_of_gravity() / 9.80665):.1f} degrees",
            f"at a step of {1e3 * good_step_s():g} ms",
            f"1 / (1 + {presets('mujoco')['cloth_loaded'].cloth_softness_m2_per_kg:g} rho)",
        ],
        popular: [
            f"accelerate by {', '.join(slides[:3])} and {slides[3]} instead of {real_value('slide-wood'):.2f} m/s²",
            f"A cube of wood (friction {of('tools.sanity.phenomena.friction.real_friction')('wood'):.2f}) does not "
            "slide down 30 degrees",
            f"is {min(pyramids):.0f} to {max(pyramids):.0f} % on 30 degrees",
            f"Once sunk in, by {-found['HalfCheetah-v5']['rest-height']:.1f} mm, it meets 100 % of its friction",
            f"its friction of {stated_friction('HalfCheetah-v5'):g} at "
            f"{found['HalfCheetah-v5']['foot-creep']:.0f} mm/s",
            f"rests {found['Ant-v5']['rest-height']:.0f} mm above",
            f"rests {found['Hopper-v5']['rest-height']:.0f} mm above",
            f"bounce threshold of {presets('physx')['out_of_box'].bounce_threshold_m_per_s:g} m/s",
            f"is {met('G1JoystickFlatTerrain', 'slide-wood'):.0f} % on 30 degrees",
            f"{met('WalkerWalk', 'slide-wood'):.0f} % with the two iterations of Playground's walker",
            f"with their friction of {stated_friction('Go1JoystickFlatTerrain'):g} on 10 degrees, their feet move at "
            f"{found['Go1JoystickFlatTerrain']['foot-creep']:.0f} and "
            f"{found['SpotFlatTerrainJoystick']['foot-creep']:.0f} mm/s",
            f"down to {met('ApolloJoystickFlatTerrain', 'slide-turned'):.0f} % (Apollo)",
            "meets the law of friction on 30 degrees",
            "slides down 30 degrees, over its stated friction; *held*: it does not slide | 100 % |",
            f"turned by {of('tools.sanity.phenomena.friction.TURN_DEG'):g} degrees about the vertical | 100 % |",
            f"rest on 10 degrees | 0 +- {tolerance('creep-wood'):.1f} mm/s |",
            f"sinks in | 0 +- {tolerance('rest-height'):g} mm |",
            f"on {of('tools.sanity.phenomena.foot.HOLD_DEG'):.0f} degrees, with its load and its friction "
            f"| 0 +- {tolerance('creep-wood'):.1f} mm/s |",
            f"on {of('tools.sanity.phenomena.foot.SLIDE_DEG'):.0f} degrees, over its stated friction | 100 % |",
        ],
    }


def tolerance_of_gravity():
    return float(of("tools.sanity.target_checks.GRAVITY_ROW").reality.tolerance)


def good_step_s():
    return float(toml("examples/sanity/good.toml")["settings"]["timestep_s"])


def withheld_count():
    bands = (
        reference_band(load_experiment(variant.name), use_withheld=True)
        for variant in variants()
    )
    return sum(band is not None and band.withheld is not None for band in bands)


def scores():
    """What simulations of MuJoCo score, and laws of the normal distribution."""
    cube, ball = score("SlopeSlider-2-wood"), score("BouncingBall-rubber")
    restitution, recorded = (
        score("BouncingBall-rubber", parameters)
        for parameters in ("effective", "recorded")
    )
    aligned = [found.rmse_aligned for found in (ball, restitution, recorded)]
    release, real = (
        ball.rmse - ball.rmse_aligned,
        ball.rmse_aligned / ball.rmse_aligned_normalized,
    )
    later = of("envs.episode.LATER_FRAMES")
    shares = [
        100 * score(f"SlopeSlider-2-{material}").extrapolated_share
        for material in ("wood", "plastic", "metal")
    ]
    friction, summary = cube.implied[0], configurations()
    return {
        "README.md": [
            f"is {ball.rmse:.1f} mm (RMSE) from the mean of {ball.trial_count} real drops",
            f"released at frame 0 | {ball.rmse:.1f} mm |",
            f"{aligned[0]:.1f} mm | real hands let go {ball.release_offset_s:.3f} s later: {release:.1f} mm |",
            f"{ball.implied[0].real:.3f} instead of {ball.implied[0].value:.3f} | {aligned[1]:.1f} mm | "
            f"restitution: {aligned[0] - aligned[1]:.1f} mm |",
            f"| {aligned[2]:.1f} mm | heights: {aligned[1] - aligned[2]:.1f} mm |",
            f"| {real:.1f} mm | mean of {ball.trial_count} |",
            f"{cube.percentile_aligned:.0f} % of {cube.trial_count} real trials are closer",
            f"is {cube.rmse_aligned:.2f} mm away, {cube.rmse_aligned_normalized:.2f} times as far",
            "a cube on 30 degrees does not slide",
            f"creeps at {summary['HalfCheetah-v5']['foot-creep']:.0f} mm/s on 10 degrees",
            f"rest {summary['Ant-v5']['rest-height']:.0f} mm above",
        ],
        "docs/getting_started.md": [
            f"A single real trial is {real_mm('SlopeSlider-2-wood'):.0f} mm from that mean",
            f"`score.rmse_aligned_normalized` is {cube.rmse_aligned_normalized:.2f}: the motion itself",
            jitter("standard deviations of {position} and {angle}"),
            f"positions of the markers instead, over {of('references.models.POINT_SIGMA_MM'):g} mm or",
        ],
        "docs/sweeps.md": [jitter("{position} and {angle} if there are repeats")],
        "docs/index.md": [
            f"is {ball.rmse:.1f} mm from the mean",
            f"lets go {ball.release_offset_s:.2f} s later",
            f"trials, {aligned[1]:.1f} mm is left. A real trial is {real:.1f} mm from the mean of the others",
            f"{cube.percentile_aligned:.0f} % of the real trials are closer",
            f"it is {cube.rmse_aligned:.2f} mm away, {cube.rmse_aligned_normalized:.2f} times as far",
        ],
        "docs/scores.md": [
            f"one more real trial has {math.sqrt(2 / math.pi):.2f} |",
            f"a real trial has {math.erf(1 / math.sqrt(2)):.2f} and {math.erf(2 / math.sqrt(2)):.2f} |",
            f"{release:.1f} mm of the bouncing ball's {ball.rmse:.1f} mm",
            f"explains {cube.rmse_aligned - cube.explained[0].left:.1f} of {cube.rmse_aligned:.1f} mm",
            f"at most {later} frames, and the RMSE",
            f"simulate {later} frames past",
            f"{shares[0]:.0f} %, {shares[1]:.0f} % and {shares[2]:.0f} % for wood, plastic and metal",
            f"friction of MuJoCo's motion is {friction.value:.4f}, that of the trials {friction.real:.4f} +- "
            f"{friction.real_uncertainty:.4f}",
            f"end after {law_frames('NonsmoothContact-1-wood')} and {law_frames('SlopeContact-wood')} frames",
            f"{withheld_count()} ids have a recording",
        ],
        "docs/tutorial.md": [
            f"Here {reference_band(load_experiment('BouncingBall-rubber')).trial_count} trials",
            f"of the {load_experiment('BouncingBall-rubber').frame_count} frames are",
            f"The ball is {ball.rmse:.1f} mm (root mean square)",
            f"is released {ball.release_offset_s:.3f} s later",
            f"after this shift {aligned[0]:.1f} mm is left",
            f"all {ball.trial_count} trials are closer",
            f"they are {real:.1f} mm away on average, so the ball is {ball.rmse_aligned_normalized:.1f} times as far",
            f"error falls to {aligned[1]:.1f} mm",
            f"gives {9.80665 * 0.2**2 / 2:.4f} m",
        ],
    }


def recipes():
    """Ranges and tolerances of `gauge recipe`."""
    mass, step_s, friction = (
        of(f"tools.recipes.aim.{name}_RANGE{unit}") for name, unit in RANGES
    )
    probes = "tools.recipes.probes"
    return [
        f"holds contact, {friction[0]:g} to {friction[1]:g}; without it the contact has "
        f"{of('tools.recipes.aim.FREE_FRICTION'):g}",
        f"{mass[0]:g} to {mass[1]:g} kg; step of the engine, {step_s[0]:.0e} to {step_s[1]:g} s".replace(
            "e-05", "e-5"
        ),
        f"{of(f'{probes}.SLIDE_BEYOND_DEG'):g} degrees steeper",
        f"turned by {of(f'{probes}.TURN_DEG'):g} degrees",
        f"by up to {max(of(f'{probes}.HOP_TURNS_DEG')):g} degrees, from a start tipped by "
        f"{math.degrees(math.hypot(*of(f'{probes}.HOP_TIPS_RAD')[0])):.1g} degrees",
        f"{of(f'{probes}.BALL_COUNT')} balls fall by {of(f'{probes}.DROP_M'):g} m",
        f"within {100 * of('tools.recipes.search.FRICTION_SHARE'):g} % of the friction, "
        f"{of('tools.recipes.search.RESTITUTION_TOLERANCE'):g} of the restitution and "
        f"{100 * of('tools.recipes.search.DEPTH_SHARE'):g} % of the depth",
        f"holds at {math.sqrt(2 * 9.80665 * of(f'{probes}.DROP_M')):.0f} m/s",
    ]


RANGES = (("MASS", "_KG"), ("TIMESTEP", "_S"), ("FRICTION", ""))


def others():
    """Pages with few numbers."""
    crate = toml("examples/usd_experiment/crate.toml")
    table = (
        (ROOT / "scoring" / "published" / "world_model_results.csv")
        .read_text(encoding="utf-8")
        .splitlines()
    )
    real = {tuple(line.split(",")[:2]): line.split(",")[3] for line in table}
    slopes = ", ".join(
        real[f"SlopeSlider-2-{material}", "a"]
        for material in ("wood", "plastic", "metal")
    )
    width, height = of("tools.video.tasks.REFERENCE_SIZE_PX")
    return {
        "docs/assets.md": [
            f"ramp of {math.degrees(math.acos(crate['band']['projection'][0][0])):.0f} degrees",
            f"more than {1e3 * of('observables.observer.MARKER_REACH_M'):g} mm from its node",
        ],
        "docs/architecture.md": [f"at most {NOTE_WORDS} words"],
        "docs/commands.md": [
            f"have the same resampled real mean in {of('evaluation.uncertainty.DRAW_COUNT')} draws",
            f"at {100 * of('tools.compare.grades.ERROR_RATE'):.0f} % the two are *distinguishable*",
            f"A difference of at most {of('tools.compare.significance.NEGLIGIBLE')}, which tables do not show",
        ],
        "docs/report_site.md": [
            f"after {of('tools.site.experiment_page.MAX_SECONDS'):g} s"
        ],
        "docs/transfer.md": [
            f"below {100 * of('tools.transfer.transfer.FALL_SHARE'):g} % of what",
            jitter("scatter by {position}"),
        ],
        "docs/world_models.md": [
            f"| {slopes} m/s²; 0 |",
            f"| {real['BouncingBall-rubber', 'a']} m/s²; 0 |",
            f"| 1; {real['Pendulum-metal', 'pd']} s |",
            "a ball fall with 9.81 m/s²",
            f"{width} x {height}",
            f"| {float(real['Turntable-2-wood', 'de']):g} N |",
        ],
    }


@cache
def stated():
    """Phrases of each page."""
    tables = (
        engines(),
        readers(),
        sanity(),
        scores(),
        others(),
        {"docs/control.md": control(), "docs/recipes.md": recipes()},
    )
    merged = {}
    for page, phrases in (item for table in tables for item in table.items()):
        merged.setdefault(page, []).extend(phrases)
    return merged


VIDEO = "tests/tools/video/test_video"
TESTED = {
    "docs/adding_a_phenomenon.md": [
        ("*wrong*, 85.9 mm", "tests/docs/test_adding_guides.py")
    ],
    "docs/control.md": [
        ("it is 1 within 0.006", "tests/tools/control/test_control.py")
    ],
    "docs/recipes.md": [
        ("3.4 times as much", "tests/tools/recipes/test_recipe_requests.py")
    ],
    "docs/engines/physx.md": [
        ("1.8 times the torque", "tests/backends/physx/test_physx_laws.py"),
        (
            "with 95 % of the law's acceleration",
            "tests/backends/physx/test_physx_laws.py",
        ),
    ],
    "docs/world_models.md": [
        (
            "0.4 solid ball, 0.667 hollow ball, 0.5 solid cylinder",
            f"{VIDEO}_phone_films.py",
        ),
        (
            "| synthetic clips: error at most | 2 % | 0.01 N | 0.02 | 1 % |",
            f"{VIDEO}_score.py",
        ),
        (
            "| rendered MuJoCo films: error at most | 2 % | 0.03 N | 0.02 | 1 % |",
            f"{VIDEO}_render.py",
        ),
    ],
}
"""Phrases of each page with the file of the test that measures their numbers: it holds them, or reads the page."""
